"""Rollouts of LANES segments with their derivatives: the columns of a state's changes, carried along by each step."""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Switches
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.actuators import ActuatorChain
from bcid.effects.car import (
    Actuation,
    BodyState,
    LagState,
    add_remainder,
    inputs_of_remainder,
    is_lagging,
    varies_with_pose,
)
from bcid.effects.constants import Constants
from bcid.effects.motion import steady_lags, steady_lags_beside
from bcid.effects.remainder import DIRECTION, WHEEL_ANGLE, remainder_function
from bcid.likelihood.lag_derivatives import store_steady
from bcid.likelihood.lane_rollout import (
    PATH_SIZE,
    LaneSegments,
    SegmentLayout,
    first_actuation,
    load_body,
    push_wrenches,
    step_inputs_in_lanes,
    store_pose,
)
from bcid.likelihood.observe import observe_row, row_reader, row_spans
from bcid.likelihood.remainder_derivatives import directions_in_use, turn_wheel
from bcid.likelihood.step_derivatives import (
    BODY_STEP,
    LAG,
    N_STATE,
    TWIST,
    allocate_derivatives,
    car_of_row,
    get,
    move_component,
    put,
)
from bcid.likelihood.step_matrix import N_COLUMNS, PUSH, add_function, advance_change, step_matrix
from bcid.likelihood.take import KNOTS, N_NUISANCE, N_START
from bcid.likelihood.variational import differentiate_step
from bcid.physics.car import Car
from bcid.physics.elementary import sincos

N_PUSH = 3  # components of a push


class TrackedPoint(NamedTuple):
    """The heading's sine and cosine, and in the world how far from the CoG the tracked point is, and its velocity."""

    sin_t: float
    cos_t: float
    off_x: float
    off_y: float
    v_x: float
    v_y: float


@njit
def linearise_segments(
    path: Floats, derivatives: Floats, nuisance: Floats, lanes: LaneSegments, count: int, layout: SegmentLayout,
    chain: ActuatorChain, cars: Floats, widths: Floats, e: Switches, c: Constants,
) -> None:  # fmt: skip
    """Write the predicted path of LANES segments to `path`, and derivatives of their mean poses to `derivatives`.

    `path` is (steps + 1, PATH_SIZE, LANES), `derivatives` (N, 3, C), of which the rows of the segments in the first
    `count` lanes are written: by initial states and pushes, which `nuisance` (N_NUISANCE, LANES) holds, by R
    parameters, then by K coefficients of a remainder; without those by the initial pose where nothing varies with the
    pose, and without the tracking's scale.  `cars` (R + 1, 21) and `widths` (R,) are those of `linearise_poses`.
    """
    lagging, pulled, p, steps = is_lagging(e), varies_with_pose(e), car_of_row(cars[0]), len(path) - 1
    R, K, used = len(widths), int(e.remainders), directions_in_use(e)
    functions, begin, each = N_NUISANCE + R, 0 if pulled else TWIST, steps // KNOTS
    columns = functions + K
    wrenches = push_wrenches(nuisance, p)
    pushes, d = wrenches.reshape(wrenches.size), allocate_derivatives(R, K)
    x, matrix = np.zeros(columns * N_STATE * LANES), np.zeros((N_COLUMNS + R) * N_STATE * LANES)
    along, spans = path.reshape(path.size), row_spans(count, lanes, layout, chain.h)
    C, r = columns - begin, 0
    reader = row_reader(layout.first[lanes.s], C, lanes, layout)
    # changes of the tracked point, of the steps that rows still need
    changes = np.zeros(spans.kept * C * PATH_SIZE * LANES)
    b, act = load_body(nuisance[:N_START]), first_actuation(lanes, chain)
    lags = _begin_changes(x, b, act, cars, widths, e, c)
    store_pose(path, 0, b, e)
    point = _tracked_point(along, 0, b)
    for j in range(begin, columns):
        if not N_START <= j < N_NUISANCE:
            _store_change(changes, (j - begin) * PATH_SIZE, x, j * N_STATE, point)
    for i in range(steps):
        mine, before, to = N_START + N_PUSH * (i // each), b, (i + 1) % spans.kept * C
        ends = mine + N_PUSH
        inputs = step_inputs_in_lanes(lanes, i, chain, pushes, (mine - N_START) * LANES)
        b, lags = differentiate_step(d, b, lags, inputs, chain.h, cars, widths, used, e, c)
        step_matrix(matrix, d, chain.h, lagging, pulled, used, R)
        store_pose(path, i + 1, b, e)
        turned, point = (b.p_x - before.p_x, b.p_y - before.p_y), _tracked_point(along, (i + 1) * PATH_SIZE, b)
        for j in range(begin, columns):
            if ends <= j < N_NUISANCE:  # a push changes nothing before it begins
                continue
            added = N_COLUMNS + j - N_NUISANCE if j >= N_NUISANCE else (PUSH + j - mine if j >= mine else -1)
            advance_change(x, j * N_STATE, matrix, added if j < functions else -1, turned, lagging, pulled)
            if j >= functions:
                direction = int(e.remainder[j - functions, DIRECTION])
                add_function(x, j * N_STATE, matrix, direction, d, j - functions, R, lagging)
            _store_change(changes, (to + j - begin) * PATH_SIZE, x, j * N_STATE, point)
        while r < len(spans.high) and spans.high[r] <= i + 1:
            observe_row(derivatives, begin, r, changes, C, reader, count, lanes, layout, chain.h)
            r += 1


@njit
def _begin_changes(
    x: Floats, b: BodyState, act: Actuation, cars: Floats, widths: Floats, e: Switches, c: Constants
) -> LagState:
    """Lags as a segment begins, in steady state; the changes of the state then are written to `x`, zeros before."""
    p, functions = car_of_row(cars[0]), N_NUISANCE + len(widths)
    for j in range(N_START):
        put(x, j * N_STATE + j, 0.0 * b.v_x + 1.0)
    lags = steady_lags(b, act, p, e, c)
    if not is_lagging(e):
        return lags
    for j in range(TWIST, functions):
        row = max(j - N_NUISANCE + 1, 0)
        if j < N_START or row > 0:
            own, there = car_of_row(cars[row]), move_component(b, j if row == 0 else -1, BODY_STEP)
            moved, by = steady_lags(there, act, own, e, c), BODY_STEP if row == 0 else widths[row - 1]
            store_steady(x, j * N_STATE + LAG, moved, lags, by)
    if e.remainders > 0.0:
        _begin_turned(x, functions * N_STATE, b, act, lags, p, e, c)
    return lags


@njit
def _begin_turned(
    x: Floats, at: int, b: BodyState, act: Actuation, lags: LagState, p: Car, e: Switches, c: Constants
) -> None:
    """Write the changes of steady lags by each function of the remainder that turns the wheel to `x` from `at` on."""
    here = add_remainder(act, b, p, e)
    turned, s = steady_lags_beside(b, turn_wheel(here, BODY_STEP), p, e, c), inputs_of_remainder(act, b, p)
    for j in range(int(e.remainders)):
        if e.remainder[j, DIRECTION] == WHEEL_ANGLE:
            share, to = remainder_function(e, j, s) / BODY_STEP, at + j * N_STATE + LAG
            put(x, to, share * (turned.alpha_f - lags.alpha_f))
            put(x, to + 1, share * (turned.F_mf - lags.F_mf))
            put(x, to + 2, share * (turned.F_mr - lags.F_mr))


@njit_inline
def _tracked_point(path: Floats, at: int, b: BodyState) -> TrackedPoint:
    """The tracked point of the cars in the state `b`, whose pose and rates stand in `path` from number `at` on."""
    sin_t, cos_t = sincos(b.theta)
    return TrackedPoint(
        sin_t, cos_t, get(path, at) - b.p_x, get(path, at + 1) - b.p_y, get(path, at + 3), get(path, at + 4)
    )


@njit_inline
def _store_change(out: Floats, to: int, x: Floats, at: int, point: TrackedPoint) -> None:
    """Write the change of the tracked point's pose and of its rates to vectors of `out` from number `to` on.

    The change of the state is N_STATE vectors of `x` from number `at` on.
    """
    theta, u, v, omega = get(x, at + 2), get(x, at + 3), get(x, at + 4), get(x, at + 5)
    put(out, to, get(x, at) - point.off_y * theta)
    put(out, to + 1, get(x, at + 1) + point.off_x * theta)
    put(out, to + 2, theta)
    put(out, to + 3, point.cos_t * u - point.sin_t * v - point.off_y * omega - point.v_y * theta)
    put(out, to + 4, point.sin_t * u + point.cos_t * v + point.off_x * omega + point.v_x * theta)
    put(out, to + 5, omega)
