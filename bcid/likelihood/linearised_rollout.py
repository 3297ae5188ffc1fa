"""Rollouts of LANES segments with their derivatives: the columns of a state's changes, carried along by each step."""

import numpy as np

from bcid.aliases import Floats, Ints, Switches
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
    replace_remainder,
    varies_with_pose,
    wheel_directions,
)
from bcid.effects.constants import Constants
from bcid.effects.remainder import DIRECTION, Remainder, remainder_function, unit_remainder
from bcid.likelihood.lane_rollout import (
    PATH_SIZE,
    LaneSegments,
    push_wrenches,
    step_inputs_in_lanes,
    store_pose,
)
from bcid.likelihood.lane_start import first_actuation, first_lags, known_steps, load_body
from bcid.likelihood.step_matrix import N_COLUMNS, PUSH, advance_change, step_matrix
from bcid.likelihood.take import KNOTS, N_NUISANCE, N_START
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
    turn_wheel,
)
from bcid.physics.car import Car
from bcid.physics.elementary import sincos

N_PUSH = 3  # components of a push


@njit
def linearise_segments(
    path: Floats, changes: Floats, nuisance: Floats, lanes: LaneSegments, chain: ActuatorChain, cars: Floats,
    widths: Floats, e: Switches, c: Constants,
) -> None:  # fmt: skip
    """Write the predicted path of LANES segments to `path`, and its derivatives to `changes`.

    `path` is (steps + 1, PATH_SIZE, LANES), `changes` (steps + 1, C PATH_SIZE, LANES), zeros before: C derivatives,
    by initial states and pushes, which `nuisance` (N_NUISANCE, LANES) holds, by R parameters, then by K coefficients of
    a remainder; without those by the initial pose where nothing varies with the pose.  `cars` (R + 1, 21) and `widths`
    (R,) are those of `linearise_poses`.
    """
    lagging, pulled, p, steps = is_lagging(e), varies_with_pose(e), car_of_row(cars[0]), len(path) - 1
    fitted = len(widths) + int(e.remainders)
    columns, begin, each = N_NUISANCE + fitted, 0 if pulled else TWIST, steps // KNOTS
    wrenches = push_wrenches(nuisance, p)
    pushes, d = wrenches.reshape(wrenches.size), allocate_derivatives(fitted)
    x, matrix = np.zeros(columns * N_STATE * LANES), np.zeros((N_COLUMNS + fitted) * N_STATE * LANES)
    to, along = changes.reshape(changes.size), path.reshape(path.size)
    b, act, past = load_body(nuisance[:N_START]), first_actuation(lanes, chain), known_steps(lanes, chain)
    for j in range(N_START):
        put(x, j * N_STATE + j, 0.0 * b.v_x + 1.0)
    lags = first_lags(b, add_remainder(act, b, p, e), past, lanes, chain, p, e, c)
    if lagging:
        for j in range(begin, N_NUISANCE + len(widths)):
            row = max(j - N_NUISANCE + 1, 0)
            if j < N_START or row > 0:
                own, there = car_of_row(cars[row]), move_component(b, j if row == 0 else -1, BODY_STEP)
                here, by = add_remainder(act, there, own, e), BODY_STEP if row == 0 else widths[row - 1]
                moved = first_lags(there, here, past, lanes, chain, own, e, c)
                put(x, j * N_STATE + LAG, (moved.alpha_f - lags.alpha_f) / by)
                put(x, j * N_STATE + LAG + 1, (moved.F_mf - lags.F_mf) / by)
                put(x, j * N_STATE + LAG + 2, (moved.F_mr - lags.F_mr) / by)
        if e.remainders > 0.0:
            at = (columns - int(e.remainders)) * N_STATE + LAG
            _begin_beside_remainder(x, at, b, act, lags, past, lanes, chain, p, e, c)
    store_pose(path, 0, b, e)
    _store_changes(to, 0, x, begin, N_START, columns, along, 0, b)
    for i in range(steps):
        mine, before = N_START + N_PUSH * (i // each), b
        ends = mine + N_PUSH
        inputs = step_inputs_in_lanes(lanes, i, chain, pushes, (mine - N_START) * LANES)
        b, lags = differentiate_step(d, b, lags, inputs, chain.h, cars, widths, e, c)
        step_matrix(matrix, d, chain.h, lagging, pulled, fitted)
        turned = (b.p_x - before.p_x, b.p_y - before.p_y)
        for j in range(begin, columns):
            if ends <= j < N_NUISANCE:  # a push changes nothing before it begins
                continue
            added = N_COLUMNS + j - N_NUISANCE if j >= N_NUISANCE else (PUSH + j - mine if j >= mine else -1)
            advance_change(x, j * N_STATE, matrix, added, turned, lagging, pulled)
        store_pose(path, i + 1, b, e)
        _store_changes(to, (i + 1) * changes.shape[1], x, begin, ends, columns, along, (i + 1) * PATH_SIZE, b)


@njit
def _begin_beside_remainder(
    x: Floats, at: int, b: BodyState, act: Actuation, lags: LagState, past: Ints, lanes: LaneSegments,
    chain: ActuatorChain, p: Car, e: Switches, c: Constants,
) -> None:  # fmt: skip
    """Write the changes of first lags by each function of the remainder to `x` from `at` on.

    First lags depend on how the wheel is turned and on what drives the car along, to first order.
    """
    here, s, w = add_remainder(act, b, p, e), inputs_of_remainder(act, b, p), wheel_directions(b, act)
    rest = here.rest
    driven = replace_remainder(here, Remainder(rest.f_x + BODY_STEP, rest.f_y, rest.arm, rest.alpha, rest.turn))
    by_force = first_lags(b, driven, past, lanes, chain, p, e, c)
    by_turn = first_lags(b, turn_wheel(here, BODY_STEP), past, lanes, chain, p, e, c)
    for j in range(int(e.remainders)):
        unit, amount = unit_remainder(e.remainder[j, DIRECTION], w, p), remainder_function(e, j, s) / BODY_STEP
        force, turn, to = amount * unit.f_x, amount * unit.turn, at + j * N_STATE
        put(x, to, force * (by_force.alpha_f - lags.alpha_f) + turn * (by_turn.alpha_f - lags.alpha_f))
        put(x, to + 1, force * (by_force.F_mf - lags.F_mf) + turn * (by_turn.F_mf - lags.F_mf))
        put(x, to + 2, force * (by_force.F_mr - lags.F_mr) + turn * (by_turn.F_mr - lags.F_mr))


@njit_inline
def _store_changes(
    out: Floats, to: int, x: Floats, begin: int, ends: int, columns: int, path: Floats, at: int, b: BodyState
) -> None:
    """Write the derivatives of the tracked point's pose and of its rates to vectors of `out` from number `to` on.

    `x` holds those of the state, N_STATE vectors for each of `columns`, of which those before `begin`, and pushes
    from `ends` on, are left out; `path` holds the pose itself from number `at` on, `b` is the state.
    """
    sin_t, cos_t = sincos(b.theta)
    off_x, off_y = get(path, at) - b.p_x, get(path, at + 1) - b.p_y
    v_x, v_y = get(path, at + 3), get(path, at + 4)
    for j in range(begin, columns):
        if ends <= j < N_NUISANCE:
            continue
        k, own = j * N_STATE, to + (j - begin) * PATH_SIZE
        theta, u, v, omega = get(x, k + 2), get(x, k + 3), get(x, k + 4), get(x, k + 5)
        put(out, own, get(x, k) - off_y * theta)
        put(out, own + 1, get(x, k + 1) + off_x * theta)
        put(out, own + 2, theta)
        put(out, own + 3, cos_t * u - sin_t * v - off_y * omega - v_y * theta)
        put(out, own + 4, sin_t * u + cos_t * v + off_x * omega + v_x * theta)
        put(out, own + 5, omega)
