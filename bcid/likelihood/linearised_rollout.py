"""Rollouts of LANES segments with their derivatives: the columns of a state's changes, carried along by each step."""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Switches
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.actuators import ActuatorChain
from bcid.effects.car import Actuation, BodyState, inputs_of_remainder, is_lagging, varies_with_pose
from bcid.effects.constants import Constants
from bcid.effects.motion import stage_actuation, steady_lags
from bcid.effects.remainder import INPUTS
from bcid.likelihood.lane_rollout import (
    PATH_SIZE,
    LaneSegments,
    first_actuation,
    load_body,
    push_wrenches,
    step_inputs_in_lanes,
    store_pose,
)
from bcid.likelihood.step_matrix import N_COLUMNS, PUSH, advance_change, step_matrix
from bcid.likelihood.take import KNOTS, N_START
from bcid.likelihood.variational import (
    BODY_STEP,
    LAG,
    N_STATE,
    TWIST,
    allocate_derivatives,
    car_of_row,
    differentiate_step,
    get,
    move_component,
    put,
)
from bcid.physics.car import Car
from bcid.physics.elementary import sincos

N_PUSH = 3  # components of a push
ALONG = len(INPUTS) + 1  # quantities that are told of the middle of each knot: INPUTS, and the heading


class Resolution(NamedTuple):
    """Into how many parts a segment is cut for derivatives by accelerations of the body, and turns of the wheel."""

    knots: int
    turns: int  # 1 where derivatives by turns are asked for, else 0


@njit
def linearise_segments(
    path: Floats, changes: Floats, along: Floats, nuisance: Floats, lanes: LaneSegments, chain: ActuatorChain,
    cars: Floats, widths: Floats, resolution: Resolution, e: Switches, c: Constants,
) -> None:  # fmt: skip
    """Write the predicted path of LANES segments to `path`, and its derivatives to `changes`.

    `path` is (steps + 1, PATH_SIZE, LANES), `changes` (steps + 1, C PATH_SIZE, LANES), zeros before: C derivatives, by
    initial states, by three accelerations of the body in each of the knots of the `resolution`, by R parameters, then
    by a turn of the wheel in each knot; without those by the initial pose where nothing varies with the pose.  To
    `along` (knots, ALONG, LANES) goes what the car is at in the middle of each knot.  `nuisance` (N_NUISANCE, LANES)
    holds initial states and pushes; `cars` (R + 1, 21) and `widths` (R,) are those of `linearise_poses`.
    """
    lagging, pulled, p, steps = is_lagging(e), varies_with_pose(e), car_of_row(cars[0]), len(path) - 1
    (knots, turns), fitted = resolution, len(widths) + resolution.turns
    after_pushes = N_START + N_PUSH * knots
    turned_from = after_pushes + len(widths)
    columns, begin, each = turned_from + turns * knots, 0 if pulled else TWIST, steps // KNOTS
    wrenches = push_wrenches(nuisance, p)
    pushes, d = wrenches.reshape(wrenches.size), allocate_derivatives(fitted)
    x, matrix = np.zeros(columns * N_STATE * LANES), np.zeros((N_COLUMNS + fitted) * N_STATE * LANES)
    to, told = changes.reshape(changes.size), path.reshape(path.size)
    b, act = load_body(nuisance[:N_START]), first_actuation(lanes, chain)
    for j in range(N_START):
        put(x, j * N_STATE + j, 0.0 * b.v_x + 1.0)
    lags = steady_lags(b, act, p, e, c)
    if lagging:
        for j in range(TWIST, N_START + len(widths)):
            row = max(j - N_START + 1, 0)
            own, there = car_of_row(cars[row]), move_component(b, j if row == 0 else -1, BODY_STEP)
            moved, by = steady_lags(there, act, own, e, c), BODY_STEP if row == 0 else widths[row - 1]
            at = (j if row == 0 else after_pushes + row - 1) * N_STATE + LAG
            put(x, at, (moved.alpha_f - lags.alpha_f) / by)
            put(x, at + 1, (moved.F_mf - lags.F_mf) / by)
            put(x, at + 2, (moved.F_mr - lags.F_mr) / by)
    store_pose(path, 0, b, e)
    _store_changes(to, 0, x, begin, N_START, after_pushes, turned_from, told, 0, b)
    for i in range(steps):
        knot, before = i * knots // steps, b
        mine = N_START + N_PUSH * knot
        ends, turned_to = mine + N_PUSH, turned_from + turns * (knot + 1)
        inputs = step_inputs_in_lanes(lanes, i, chain, pushes, N_PUSH * LANES * (i // each))
        b, lags = differentiate_step(d, b, lags, inputs, chain.h, cars, widths, turns, e, c)
        if i == (2 * knot + 1) * steps // (2 * knots):
            _store_along(along, knot, before, stage_actuation(0, inputs, chain.h, e), p)
        step_matrix(matrix, d, chain.h, lagging, pulled, fitted)
        turned = (b.p_x - before.p_x, b.p_y - before.p_y)
        for j in range(begin, turned_to):
            if ends <= j < after_pushes:  # a push changes nothing before it begins, nor does a turn
                continue
            added = PUSH + j - mine if mine <= j < ends else -1
            if j >= after_pushes:
                added = N_COLUMNS + min(j - after_pushes, len(widths))
                if turned_from <= j < turned_to - 1:
                    added = -1
            advance_change(x, j * N_STATE, matrix, added, turned, lagging, pulled)
        store_pose(path, i + 1, b, e)
        at = (i + 1) * changes.shape[1]
        _store_changes(to, at, x, begin, ends, after_pushes, turned_to, told, (i + 1) * PATH_SIZE, b)


@njit
def _store_along(along: Floats, knot: int, b: BodyState, act: Actuation, p: Car) -> None:
    """Write what a remainder depends on, and the heading, to row `knot` of `along` (knots, ALONG, LANES)."""
    flat, at = along.reshape(along.size), knot * ALONG
    s = inputs_of_remainder(act, b, p)
    for k, value in enumerate((
        s.v_x, s.omega, s.v_fx, s.alpha_f, s.alpha_r, s.delta, s.delta_rate, s.u_m, s.p_x, s.p_y, s.t, b.theta,
    )):  # fmt: skip
        put(flat, at + k, value)


@njit_inline
def _store_changes(
    out: Floats, to: int, x: Floats, begin: int, ends: int, again: int, until: int, path: Floats, at: int, b: BodyState
) -> None:  # fmt: skip
    """Write the derivatives of the tracked point's pose and of its rates to vectors of `out` from number `to` on.

    `x` holds those of the state, N_STATE vectors for each column; written are columns `begin` to `ends`, and `again` to
    `until`.  `path` holds the pose itself from number `at` on, `b` is the state.
    """
    sin_t, cos_t = sincos(b.theta)
    off_x, off_y = get(path, at) - b.p_x, get(path, at + 1) - b.p_y
    v_x, v_y = get(path, at + 3), get(path, at + 4)
    for j in range(begin, until):
        if ends <= j < again:
            continue
        k, own = j * N_STATE, to + (j - begin) * PATH_SIZE
        theta, u, v, omega = get(x, k + 2), get(x, k + 3), get(x, k + 4), get(x, k + 5)
        put(out, own, get(x, k) - off_y * theta)
        put(out, own + 1, get(x, k + 1) + off_x * theta)
        put(out, own + 2, theta)
        put(out, own + 3, cos_t * u - sin_t * v - off_y * omega - v_y * theta)
        put(out, own + 4, sin_t * u + cos_t * v + off_x * omega + v_x * theta)
        put(out, own + 5, omega)
