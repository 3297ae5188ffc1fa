"""Rollouts of LANES segments with their derivatives: the columns of a state's changes, carried along by each step."""

import numpy as np

from bcid.aliases import Floats, Switches
from bcid.compiled.lane_access import load_lanes, store_lanes
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit
from bcid.effects.actuators import ActuatorChain
from bcid.effects.car import BodyState, is_lagging, is_pulled_by_place
from bcid.effects.constants import Constants
from bcid.effects.motion import steady_lags
from bcid.likelihood.lane_rollout import (
    PATH_SIZE,
    LaneSegments,
    first_actuation,
    load_body,
    push_wrenches,
    step_inputs_in_lanes,
    store_pose,
)
from bcid.likelihood.take import KNOTS, N_NUISANCE, N_START
from bcid.likelihood.variational import (
    BODY_STEP,
    LAG,
    N_COLUMNS,
    N_STATE,
    TWIST,
    advance_column,
    allocate_derivatives,
    car_of_row,
    differentiate_step,
    flatten,
    move_component,
    step_matrix,
)
from bcid.physics.elementary import sincos

N_PUSH = 3  # components of a push


@njit
def linearise_segments(
    path: Floats, changes: Floats, nuisance: Floats, lanes: LaneSegments, chain: ActuatorChain, cars: Floats,
    widths: Floats, e: Switches, c: Constants,
) -> None:  # fmt: skip
    """Write the predicted path of LANES segments to `path`, and its derivatives to `changes`.

    `path` is (steps + 1, PATH_SIZE, LANES), `changes` (steps + 1, C PATH_SIZE, LANES), zeros before: C derivatives,
    by initial states and pushes, which `nuisance` (N_NUISANCE, LANES) holds, then by R parameters; without those by the
    initial pose where nothing varies with the pose.  `cars` (R + 1, 21) and `widths` (R,) are those of
    `linearise_poses`.
    """
    lagging, pulled, p, steps = is_lagging(e), is_pulled_by_place(e), car_of_row(cars[0]), len(path) - 1
    columns, begin, each = N_NUISANCE + len(widths), 0 if pulled else TWIST, steps // KNOTS
    pushes, d = flatten(push_wrenches(nuisance, p)), allocate_derivatives(len(widths))
    x, matrix = np.zeros((columns, N_STATE, LANES)), np.zeros((N_COLUMNS, N_STATE, LANES))
    unit, nothing, scratch, turned = np.zeros((N_PUSH, 6, LANES)), np.zeros((6, LANES)), np.zeros((N_STATE, LANES)), np.zeros((2, LANES))
    for j in range(N_START):
        x[j, j] = 1.0
    for j in range(N_PUSH):
        unit[j, j] = 1.0
    b, act = load_body(nuisance[:N_START]), first_actuation(lanes, chain)
    lags = steady_lags(b, act, p, e, c)
    if lagging:
        for j in range(TWIST, columns):
            if j < N_START or j >= N_NUISANCE:
                row = max(j - N_NUISANCE + 1, 0)
                moved = steady_lags(move_component(b, j if row == 0 else -1, BODY_STEP), act, car_of_row(cars[row]), e, c)
                by = BODY_STEP if row == 0 else widths[row - 1]
                store_lanes((moved.alpha_f - lags.alpha_f) / by, flatten(x[j]), LAG * LANES)
                store_lanes((moved.F_mf - lags.F_mf) / by, flatten(x[j]), (LAG + 1) * LANES)
                store_lanes((moved.F_mr - lags.F_mr) / by, flatten(x[j]), (LAG + 2) * LANES)
    store_pose(path, 0, b, e)
    _store_changes(changes, 0, x, begin, N_NUISANCE, path, b)
    for i in range(steps):
        knot = i // each
        inputs = step_inputs_in_lanes(lanes, i, chain, pushes, N_PUSH * LANES * knot)
        before_x, before_y = b.p_x, b.p_y
        b, lags = differentiate_step(d, b, lags, inputs, chain.h, cars, widths, e, c)
        store_lanes(b.p_x - before_x, flatten(turned), 0)
        store_lanes(b.p_y - before_y, flatten(turned), LANES)
        step_matrix(matrix, d, chain.h, lagging, pulled)
        ends, mine = N_START + N_PUSH * (knot + 1), N_START + N_PUSH * knot
        for j in range(begin, columns):
            if ends <= j < N_NUISANCE:  # a push changes nothing before it begins
                continue
            if j >= N_NUISANCE:
                advance_column(x[j], matrix, turned, d.added[j - N_NUISANCE], lagging, pulled, scratch)
            elif j >= mine:
                advance_column(x[j], matrix, turned, unit[j - mine], lagging, pulled, scratch)
            else:
                advance_column(x[j], matrix, turned, nothing, lagging, pulled, scratch)
        store_pose(path, i + 1, b, e)
        _store_changes(changes, i + 1, x, begin, ends, path, b)


@njit
def _store_changes(changes: Floats, i: int, x: Floats, begin: int, ends: int, path: Floats, b: BodyState) -> None:
    """Write the derivatives of the tracked point's pose and of its rates to row `i` of `changes`.

    `x` (C, N_STATE, LANES) holds those of the state, of which the columns before `begin`, and the pushes from column
    `ends` on, are left out; `path` holds the pose itself, `b` the state.
    """
    flat, along, at = flatten(changes), flatten(path), i * PATH_SIZE * LANES
    sin_t, cos_t = sincos(b.theta)
    off_x, off_y = load_lanes(along, at) - b.p_x, load_lanes(along, at + LANES) - b.p_y
    v_x, v_y = load_lanes(along, at + 3 * LANES), load_lanes(along, at + 4 * LANES)
    for j in range(begin, len(x)):
        if ends <= j < N_NUISANCE:
            continue
        state, to = flatten(x[j]), (i * changes.shape[1] + (j - begin) * PATH_SIZE) * LANES
        theta, omega = load_lanes(state, 2 * LANES), load_lanes(state, 5 * LANES)
        u, v = load_lanes(state, 3 * LANES), load_lanes(state, 4 * LANES)
        store_lanes(load_lanes(state, 0) - off_y * theta, flat, to)
        store_lanes(load_lanes(state, LANES) + off_x * theta, flat, to + LANES)
        store_lanes(theta, flat, to + 2 * LANES)
        store_lanes(cos_t * u - sin_t * v - off_y * omega - v_y * theta, flat, to + 3 * LANES)
        store_lanes(sin_t * u + cos_t * v + off_x * omega + v_x * theta, flat, to + 4 * LANES)
        store_lanes(omega, flat, to + 5 * LANES)
