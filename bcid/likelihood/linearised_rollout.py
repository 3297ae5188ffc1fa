"""Rollouts of LANES segments with their derivatives: the columns of a state's changes, carried along by each step."""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Switches
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.actuators import ActuatorChain
from bcid.effects.car import Actuation, BodyState, LagState, is_lagging, varies_with_pose
from bcid.effects.constants import Constants
from bcid.effects.motion import stage_actuation
from bcid.effects.remainder_table import INPUTS
from bcid.effects.unnamed_action import add_remainder, inputs_of_remainder, turn_wheel
from bcid.likelihood.lag_derivatives import store_steady
from bcid.likelihood.lane_rollout import (
    PATH_SIZE,
    LaneSegments,
    SegmentLayout,
    push_wrenches,
    step_inputs_in_lanes,
    store_pose,
)
from bcid.likelihood.lane_start import first_actuation, first_lags, known_steps, load_body
from bcid.likelihood.observe import observe_row, row_reader, row_spans
from bcid.likelihood.step_derivatives import (
    BODY_STEP,
    LAG,
    N_STATE,
    TURN_STEP,
    TWIST,
    allocate_derivatives,
    car_of_row,
    get,
    move_component,
    put,
)
from bcid.likelihood.step_matrix import N_PUSH, PARAMETER, PUSH, advance_change, step_matrix
from bcid.likelihood.take import KNOTS, N_START
from bcid.likelihood.variational import differentiate_step
from bcid.physics.car import Car
from bcid.physics.elementary import sincos

ALONG = len(INPUTS) + 1  # quantities that are told of the middle of each knot: INPUTS, and the heading


class Resolution(NamedTuple):
    """Into how many parts a segment is cut for derivatives by accelerations of the body, and turns of the wheel."""

    knots: int
    turns: int  # 1 where derivatives by turns are asked for, else 0


@njit
def linearise_segments(
    path: Floats, derivatives: Floats, along: Floats, nuisance: Floats, lanes: LaneSegments, count: int,
    layout: SegmentLayout, chain: ActuatorChain, cars: Floats, widths: Floats, resolution: Resolution, e: Switches,
    c: Constants,
) -> None:  # fmt: skip
    """Write the predicted path of LANES segments to `path`, and derivatives of their mean poses to `derivatives`.

    `path` is (steps + 1, PATH_SIZE, LANES), `derivatives` (N, 3, C), zeros before, of which the rows of the segments in
    the first `count` lanes are written: by initial states, by R parameters, then by three accelerations of the body,
    and a turn of the wheel where the `resolution` has it, in each of its knots; without those by the initial pose where
    nothing varies with the pose, and without the tracking's scale.  To `along` (knots, ALONG, LANES) goes what the car
    is at in the middle of each knot.  `nuisance` (N_NUISANCE, LANES) holds initial states and pushes; `cars` (R + 1,
    22) and `widths` (R,) are those of `linearise_poses`.
    """
    lagging, pulled, p, steps = is_lagging(e), varies_with_pose(e), car_of_row(cars[0]), len(path) - 1
    (knots, turns), begin, fitted = resolution, 0 if pulled else TWIST, N_START + len(widths)
    columns, wrenches = fitted + (N_PUSH + turns) * knots, push_wrenches(nuisance, p)
    pushes, each, d = wrenches.reshape(wrenches.size), steps // KNOTS, allocate_derivatives(len(widths))
    x, matrix = np.zeros(columns * N_STATE * LANES), np.zeros((PARAMETER + len(widths)) * N_STATE * LANES)
    C, spans, told = columns - begin, row_spans(count, lanes, layout, chain.h), path.reshape(path.size)
    reader, r = row_reader(layout.first[lanes.s], C, lanes, layout), 0
    # changes of the tracked point, of the steps that rows still need; zeros of what has not begun
    changes = np.zeros(spans.kept * C * PATH_SIZE * LANES)
    b = load_body(nuisance[:N_START])
    lags = _begin_changes(x, b, turns, lanes, chain, cars, widths, e, c)
    store_pose(path, 0, b, e)
    _store_changes(changes, 0, x, begin, N_START, told, 0, b)
    for i in range(steps):
        knot, before = i * knots // steps, b
        mine = fitted + (N_PUSH + turns) * knot
        begun = mine + N_PUSH + turns
        inputs = step_inputs_in_lanes(lanes, i, chain, pushes, N_PUSH * LANES * (i // each))
        b, lags = differentiate_step(d, b, lags, inputs, chain.h, cars, widths, turns, e, c)
        middle = (2 * knot + 1) * steps
        if i == middle // (2 * knots):
            # of a knot of an odd number of steps the middle is that of a step
            there, stage = (before, 0) if middle % (2 * knots) == 0 else (_middle_state(before, b), 1)
            _store_along(along, knot, there, stage_actuation(stage, inputs, chain.h), p, e)
        step_matrix(matrix, d, chain.h, lagging, pulled, turns, len(widths))
        turned = (b.p_x - before.p_x, b.p_y - before.p_y)
        for j in range(begin, begun):
            added = PARAMETER + j - N_START if N_START <= j < fitted else (PUSH + j - mine if j >= mine else -1)
            advance_change(x, j * N_STATE, matrix, added, turned, lagging, pulled)
        store_pose(path, i + 1, b, e)
        at = (i + 1) % spans.kept * C * PATH_SIZE
        _store_changes(changes, at, x, begin, begun, told, (i + 1) * PATH_SIZE, b)
        while r < len(spans.high) and spans.high[r] <= i + 1:
            observe_row(derivatives, begin, begun, r, changes, C, reader, count, lanes, layout, chain.h)
            r += 1


@njit
def _begin_changes(
    x: Floats, b: BodyState, turns: int, lanes: LaneSegments, chain: ActuatorChain, cars: Floats, widths: Floats,
    e: Switches, c: Constants,
) -> LagState:  # fmt: skip
    """Lags as the segments in the lanes begin; the changes of the state then are written to `x`, zeros before.

    A lagging motor's force then depends a little on what slowed the car before, too.  Of accelerations this is left
    out: pushes have not begun then, and of what has no name it is 4 % of all that it does, at a lag of 0.2 s.
    """
    p, fitted, act = car_of_row(cars[0]), N_START + len(widths), first_actuation(lanes, chain)
    for j in range(N_START):
        put(x, j * N_STATE + j, 0.0 * b.v_x + 1.0)
    past, here = known_steps(lanes, chain), add_remainder(act, b, p, e)
    lags = first_lags(b, here, past, lanes, chain, p, e, c)
    if is_lagging(e):
        for j in range(0 if varies_with_pose(e) else TWIST, fitted):
            row = max(j - N_START + 1, 0)
            own, there = car_of_row(cars[row]), move_component(b, j if row == 0 else -1, BODY_STEP)
            moved = first_lags(there, add_remainder(act, there, own, e), past, lanes, chain, own, e, c)
            store_steady(x, j * N_STATE + LAG, moved, lags, BODY_STEP if row == 0 else widths[row - 1])
        if turns > 0:
            moved = first_lags(b, turn_wheel(here, TURN_STEP, e), past, lanes, chain, p, e, c)
            store_steady(x, (fitted + N_PUSH) * N_STATE + LAG, moved, lags, TURN_STEP)
    return lags


@njit_inline
def _middle_state(begin: BodyState, end: BodyState) -> BodyState:
    """The mean of two states, as a step begins and at its end: the state in its middle, to second order."""
    return BodyState(
        0.5 * (begin.p_x + end.p_x), 0.5 * (begin.p_y + end.p_y), 0.5 * (begin.theta + end.theta),
        0.5 * (begin.v_x + end.v_x), 0.5 * (begin.v_y + end.v_y), 0.5 * (begin.omega + end.omega),
    )  # fmt: skip


@njit
def _store_along(along: Floats, knot: int, b: BodyState, act: Actuation, p: Car, e: Switches) -> None:
    """Write what a remainder depends on, and the heading, to row `knot` of `along` (knots, ALONG, LANES)."""
    flat, at = along.reshape(along.size), knot * ALONG
    s = inputs_of_remainder(act, b, p, e)
    for k, value in enumerate((
        s.v_x, s.omega, s.v_fx, s.alpha_f, s.alpha_r, s.delta, s.delta_rate, s.u_m, s.p_x, s.p_y, s.t, b.theta,
    )):  # fmt: skip
        put(flat, at + k, value)


@njit_inline
def _store_changes(out: Floats, to: int, x: Floats, begin: int, end: int, path: Floats, at: int, b: BodyState) -> None:
    """Write the changes of the tracked point's pose and of its rates to vectors of `out` from number `to` on.

    `x` holds those of the state `b`, N_STATE vectors for each column, of which those from `begin` to `end` are written.
    `path` holds the tracked point's pose and rates themselves from number `at` on.
    """
    sin_t, cos_t = sincos(b.theta)
    off_x, off_y = get(path, at) - b.p_x, get(path, at + 1) - b.p_y
    v_x, v_y = get(path, at + 3), get(path, at + 4)
    for j in range(begin, end):
        k, own = j * N_STATE, to + (j - begin) * PATH_SIZE
        theta, u, v, omega = get(x, k + 2), get(x, k + 3), get(x, k + 4), get(x, k + 5)
        put(out, own, get(x, k) - off_y * theta)
        put(out, own + 1, get(x, k + 1) + off_x * theta)
        put(out, own + 2, theta)
        put(out, own + 3, cos_t * u - sin_t * v - off_y * omega - v_y * theta)
        put(out, own + 4, sin_t * u + cos_t * v + off_x * omega + v_x * theta)
        put(out, own + 5, omega)
