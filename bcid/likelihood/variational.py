"""The variational equation: how a predicted motion changes with its beginning, with pushes and with parameters.

With the state x = [pose, twist, lags] and its rate f(x, u, parameters), a small change obeys dx' = (df/dx) dx + df.
An RK4 step is differentiated stage by stage: at each stage the wrench is evaluated once more for each component of the
twist, which gives df/dx (3 x 3, and a column for each quantity that lags); all else is linear algebra.  So a step gives
a matrix, from the state before it and from what is added to the accelerations in it to the state after it, and any
number of columns follow for a multiplication each.  Differences are of accelerations in one stage at one place, so that
what happens where a place on the floor begins does not enter: the derivative is that of the branch taken.

Arrays end with LANES segments side by side.  Rows of a state: x, y, theta, v_x, v_y, omega, alpha_f, F_mf, F_mr.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Switches
from bcid.compiled.lane_access import load_lanes, store_lanes
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.car import (
    BodyState,
    LagState,
    Wrench,
    force_by_place,
    is_lagging,
    is_pulled_by_place,
    wrench_with_effects,
)
from bcid.effects.constants import Constants
from bcid.effects.motion import (
    StepInputs,
    add_rates,
    advance_lags,
    body_rates,
    lags_at_stage,
    stage_actuation,
    stage_time,
    stage_weight,
)
from bcid.physics.car import Car
from bcid.physics.elementary import sincos

POSE, TWIST, LAG, N_STATE = 0, 3, 6, 9  # where a state's parts begin, and its size
ADDED = N_STATE  # columns of a step's matrix after those of the state: three accelerations, then three steady lags
N_COLUMNS = ADDED + 6
# difference steps of a twist (m/s, rad/s) and of a pose (m, rad), of a lagging slip angle (rad) and force (N)
BODY_STEP, ANGLE_STEP, FORCE_STEP = 1e-5, 1e-5, 1e-2


class StageDerivatives(NamedTuple):
    """Derivatives at the four stages of a step; of lagging quantities the coefficients of what they follow from."""

    acceleration: Floats  # (4, N_STATE, 3, LANES) of v_x', v_y', omega' by the state; lags as at the stage
    steady: Floats  # (4, 3, 4, LANES) of alpha_f, F_mf, F_mr as they would be without lag, and of v_fx, by the twist
    lag: Floats  # (5, 3, 5, LANES) of each lag at the stage, and after the step, by its start, steady_0, v_0, steady, v
    pose: Floats  # (4, 4, LANES) cos, sin of theta, x', y'
    mass_factor: Floats  # (4, LANES)
    added: Floats  # (R, 6, LANES) by each parameter, of accelerations and steady lags, in the middle of the step


@njit
def allocate_derivatives(parameters: int) -> StageDerivatives:
    """Arrays for the derivatives of a step, of LANES segments and of so many `parameters`."""
    return StageDerivatives(
        np.zeros((4, N_STATE, 3, LANES)), np.zeros((4, 3, 4, LANES)), np.zeros((5, 3, 5, LANES)),
        np.zeros((4, 4, LANES)), np.zeros((4, LANES)), np.zeros((parameters, 6, LANES)),
    )  # fmt: skip


@njit_inline
def flatten(x: Floats) -> Floats:
    """The numbers of a contiguous array in one row, without a copy."""
    return x.reshape(x.size)


@njit_inline
def car_of_row(x: Floats) -> Car:
    """The car whose constants are the row `x` (21,), in the order of `Car`."""
    return Car(
        x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8], x[9], x[10], x[11], x[12], x[13], x[14], x[15], x[16],
        x[17], x[18], x[19], x[20],
    )  # fmt: skip


@njit_inline
def move_component(b: BodyState, j: int, by: float) -> BodyState:
    """The state `b` with its component `j` (0 to 5) greater by `by`; `b` itself for j < 0."""
    return BodyState(
        b.p_x + (by if j == 0 else 0.0), b.p_y + (by if j == 1 else 0.0), b.theta + (by if j == 2 else 0.0),
        b.v_x + (by if j == 3 else 0.0), b.v_y + (by if j == 4 else 0.0), b.omega + (by if j == 5 else 0.0),
    )  # fmt: skip


@njit_inline
def move_lag(lags: LagState, j: int) -> LagState:
    """The lagging quantities, number `j` (0 to 2) greater by its difference step; as they are for other j."""
    return LagState(
        lags.alpha_f + (ANGLE_STEP if j == 0 else 0.0), lags.F_mf + (FORCE_STEP if j == 1 else 0.0),
        lags.F_mr + (FORCE_STEP if j == 2 else 0.0),
    )  # fmt: skip


@njit_inline
def _move_lags(lags: LagState) -> LagState:
    """All lagging quantities, greater by their difference steps."""
    return LagState(lags.alpha_f + ANGLE_STEP, lags.F_mf + FORCE_STEP, lags.F_mr + FORCE_STEP)


@njit_inline
def _move_steady(w: Wrench, steady: bool, rolling: bool) -> Wrench:
    """The wrench `w` with its steady lags, or its rolling speed v_fx, greater by their difference steps."""
    to = _move_lags(w.steady)
    return Wrench(
        w.F_x, w.F_y, w.M_z, w.mass_factor,
        LagState(
            to.alpha_f if steady else w.steady.alpha_f, to.F_mf if steady else w.steady.F_mf,
            to.F_mr if steady else w.steady.F_mr,
        ),
        w.v_fx + (BODY_STEP if rolling else 0.0),
    )  # fmt: skip


@njit
def _store_lag_coefficients(
    out: Floats, at: int, start: LagState, first: Wrench, now: Wrench, ahead: float, h: float, e: Switches
) -> None:
    """Write the derivatives of the three lagging quantities by what they follow from to `out` from `at` on.

    Those of a stage `ahead` seconds into a step of `h` seconds; for `ahead` > h, those after the step.  Each follows
    from its value `start` as the step begins, from its steady value and v_fx in the wrench `first`, and in `now`.
    """
    still = start
    for j in range(6):
        s = _move_lags(start) if j == 1 else start
        f, n = _move_steady(first, j == 2, j == 3), _move_steady(now, j == 4, j == 5)
        lags = advance_lags(s, f, n, h, e) if ahead > h else lags_at_stage(s, f, n, ahead, h, e)
        if j == 0:
            still = lags
        else:
            angle, force = (BODY_STEP, BODY_STEP) if j in (3, 5) else (ANGLE_STEP, FORCE_STEP)
            store_lanes((lags.alpha_f - still.alpha_f) / angle, out, at + (j - 1) * LANES)
            store_lanes((lags.F_mf - still.F_mf) / force, out, at + (5 + j - 1) * LANES)
            store_lanes((lags.F_mr - still.F_mr) / force, out, at + (10 + j - 1) * LANES)


@njit_inline
def _store_steady(out: Floats, at: int, moved: Wrench, now: Wrench, by: float) -> None:
    """Write the derivatives of steady lags and v_fx, by differences between `moved` and `now` over `by`, from `at` on."""
    a, b = moved.steady, now.steady
    store_lanes((a.alpha_f - b.alpha_f) / by, out, at)
    store_lanes((a.F_mf - b.F_mf) / by, out, at + LANES)
    store_lanes((a.F_mr - b.F_mr) / by, out, at + 2 * LANES)
    store_lanes((moved.v_fx - now.v_fx) / by, out, at + 3 * LANES)


@njit_inline
def _store_accelerations(out: Floats, at: int, moved: BodyState, now: BodyState, by: float) -> None:
    """Write the derivatives of v_x', v_y', omega', by differences between two rates over `by`, to `out` from `at` on."""
    store_lanes((moved.v_x - now.v_x) / by, out, at)
    store_lanes((moved.v_y - now.v_y) / by, out, at + LANES)
    store_lanes((moved.omega - now.omega) / by, out, at + 2 * LANES)


@njit_inline
def _store_added(out: Floats, at: int, rates: tuple[BodyState, BodyState], w: Wrench, now: Wrench, by: float) -> None:
    """Write the derivatives of accelerations and steady lags by a parameter that differs by `by`, to `out` from `at` on.

    `rates` are those with the parameter changed and as they are, `w` and `now` the wrenches.  Accelerations are those
    of a car without a load: they are multiplied by the mass factor.
    """
    (moved, still), a, b = rates, w.steady, now.steady
    store_lanes(now.mass_factor * (moved.v_x - still.v_x) / by, out, at)
    store_lanes(now.mass_factor * (moved.v_y - still.v_y) / by, out, at + LANES)
    store_lanes(now.mass_factor * (moved.omega - still.omega) / by, out, at + 2 * LANES)
    store_lanes((a.alpha_f - b.alpha_f) / by, out, at + 3 * LANES)
    store_lanes((a.F_mf - b.F_mf) / by, out, at + 4 * LANES)
    store_lanes((a.F_mr - b.F_mr) / by, out, at + 5 * LANES)


@njit
def differentiate_step(
    out: StageDerivatives, b: BodyState, lags: LagState, inputs: StepInputs, h: float, cars: Floats, widths: Floats,
    e: Switches, c: Constants,
) -> tuple[BodyState, LagState]:  # fmt: skip
    """State and lags after an RK4 step of `h` seconds, as `rk4_body_step` gives them, and its stages' derivatives.

    They are written to `out`.  `cars` (R + 1, 21) holds the car, then one for each of R parameters with that parameter
    changed, by `widths` (R,); derivatives by parameters are taken in the middle of the step alone, at its third stage.
    """
    zero, lagging, pulled = 0.0 * b.v_x, is_lagging(e), is_pulled_by_place(e)
    rate = total = BodyState(zero, zero, zero, zero, zero, zero)
    first = steady = now = Wrench(zero, zero, zero, zero, lags, zero)
    acceleration, steadies, coefficients = flatten(out.acceleration), flatten(out.steady), flatten(out.lag)
    for stage in range(4):
        act, ahead = stage_actuation(stage, inputs, h, e), stage_time(stage) * h
        there, at = add_rates(b, rate, ahead), lags
        if stage == 2:
            steady = now
            at = lags_at_stage(lags, first, steady, ahead, h, e)
        # evaluations: of steady values, where lags follow from them, as it is and by each component of the twist; of
        # rates, as it is, by the twist, by lags, by parameters
        before, by_lags = (4 if lagging and stage != 2 else 0), (3 if lagging else 0)
        for k in range(before + 4 + by_lags + (len(widths) if stage == 2 else 0)):
            ahead_of_lags = k < before
            j = k if ahead_of_lags else k - before
            lag, row = (j - 4 if 4 <= j < 4 + by_lags else -1), max(j - 3 - by_lags, 0)
            body = move_component(there, TWIST + j - 1 if 0 < j < 4 else -1, BODY_STEP)
            p = car_of_row(cars[row])
            w = wrench_with_effects(body, act, move_lag(lags if ahead_of_lags else at, lag), p, e, c)
            if ahead_of_lags and j > 0:
                _store_steady(steadies, (stage * 3 + j - 1) * 4 * LANES, w, steady, BODY_STEP)
                continue
            if j == 0 and (ahead_of_lags or not lagging):
                steady = w
                if stage == 0:
                    first = w
            if ahead_of_lags:
                at = lags_at_stage(lags, first, steady, ahead, h, e)
                continue
            moved = body_rates(body, w, inputs.push, p)
            if j == 0:
                rate, now = moved, w
            elif row > 0:
                _store_added(flatten(out.added), (row - 1) * 6 * LANES, (moved, rate), w, now, widths[row - 1])
            else:
                width = BODY_STEP if j < 4 else (ANGLE_STEP if lag == 0 else FORCE_STEP)
                to = TWIST + j - 1 if j < 4 else LAG + lag
                _store_accelerations(acceleration, (stage * N_STATE + to) * 3 * LANES, moved, rate, width)
        p = car_of_row(cars[0])
        if lagging:
            if stage == 2:  # the third stage's steady values are the second's
                out.steady[2] = out.steady[1]
            _store_lag_coefficients(coefficients, stage * 15 * LANES, lags, first, steady, ahead, h, e)
        if pulled:
            _store_pull(acceleration, stage * N_STATE * 3 * LANES, there, now.mass_factor, p, e)
        _store_pose_rates(flatten(out.pose), stage * 4 * LANES, there, rate)
        store_lanes(now.mass_factor, flatten(out.mass_factor), stage * LANES)
        total = add_rates(total, rate, stage_weight(stage))
    if lagging:
        _store_lag_coefficients(coefficients, 4 * 15 * LANES, lags, first, steady, 2.0 * h, h, e)
    return add_rates(b, total, h / 6.0), advance_lags(lags, first, steady, h, e)


@njit_inline
def _store_pull(out: Floats, at: int, b: BodyState, mass_factor: float, p: Car, e: Switches) -> None:
    """Write the derivatives of accelerations by the pose, through cable and floor slope in `e`, to `out` from `at` on."""
    F_x, F_y = force_by_place(b, mass_factor, p, e)
    for j in range(3):
        there_x, there_y = force_by_place(move_component(b, j, BODY_STEP), mass_factor, p, e)
        store_lanes((there_x - F_x) / (mass_factor * p.m * BODY_STEP), out, at + 3 * j * LANES)
        store_lanes((there_y - F_y) / (mass_factor * p.m * BODY_STEP), out, at + (3 * j + 1) * LANES)


@njit_inline
def _store_pose_rates(out: Floats, at: int, b: BodyState, rate: BodyState) -> None:
    """Write cos and sin of the heading, and the velocity x', y' in the world, to `out` from `at` on."""
    sin_t, cos_t = sincos(b.theta)
    store_lanes(cos_t, out, at)
    store_lanes(sin_t, out, at + LANES)
    store_lanes(rate.p_x, out, at + 2 * LANES)
    store_lanes(rate.p_y, out, at + 3 * LANES)


@njit
def step_matrix(out: Floats, d: StageDerivatives, h: float, lagging: bool, pulled: bool) -> None:
    """Write to `out` (N_COLUMNS, N_STATE, LANES) how the state after a step of `h` seconds answers each column.

    Columns are the state before the step, three accelerations and three steady lags that are added within it.  Those
    of a pose are left out where nothing depends on it (not `pulled`), those of lags where nothing is `lagging`.
    """
    for column in range(N_COLUMNS):
        of_lags = LAG <= column < ADDED or column >= ADDED + 3
        if (of_lags and not lagging) or (column < TWIST and not pulled):
            continue
        _answer_to_column(flatten(out), column, d, h, lagging, pulled)


@njit
def _answer_to_column(out: Floats, column: int, d: StageDerivatives, h: float, lagging: bool, pulled: bool) -> None:
    """Write to the flat `out` how the state after a step of `h` seconds answers a unit of `column`: RK4, linearised."""
    acceleration, steadies, coefficients = flatten(d.acceleration), flatten(d.steady), flatten(d.lag)
    poses, factors = flatten(d.pose), flatten(d.mass_factor)
    none = 0.0 * load_lanes(factors, 0)
    rate = total = BodyState(none, none, none, none, none, none)
    begin = move_component(total, column, 1.0)
    answer, first = np.zeros((4, LANES)), np.zeros((4, LANES))  # steady lags and v_fx: at a stage, and at the first
    now, at_first, lags = flatten(answer), flatten(first), np.zeros((3, LANES))
    for stage in range(4):
        x = add_rates(begin, rate, stage_time(stage) * h)
        push = (none, none, none)
        if ADDED <= column < ADDED + 3:
            share = 1.0 / load_lanes(factors, stage * LANES)
            push = (
                share if column == ADDED else none, share if column == ADDED + 1 else none,
                share if column == ADDED + 2 else none,
            )  # fmt: skip
        at = stage * N_STATE * 3 * LANES
        a_x, a_y, a_w = push
        if pulled:
            for j in range(3):
                step = x.p_x if j == 0 else (x.p_y if j == 1 else x.theta)
                a_x += load_lanes(acceleration, at + 3 * j * LANES) * step
                a_y += load_lanes(acceleration, at + (3 * j + 1) * LANES) * step
        for j in range(3):
            step, to = x.v_x if j == 0 else (x.v_y if j == 1 else x.omega), at + 3 * (TWIST + j) * LANES
            a_x += load_lanes(acceleration, to) * step
            a_y += load_lanes(acceleration, to + LANES) * step
            a_w += load_lanes(acceleration, to + 2 * LANES) * step
        if lagging:
            if stage != 2:
                for i in range(4):
                    to = (stage * 12 + i) * LANES
                    change = load_lanes(steadies, to) * x.v_x + load_lanes(steadies, to + 4 * LANES) * x.v_y
                    change += load_lanes(steadies, to + 8 * LANES) * x.omega
                    store_lanes(change + (1.0 if column == ADDED + 3 + i else 0.0), now, i * LANES)
                if stage == 0:
                    first[:] = answer
            _answer_of_lags(flatten(lags), coefficients, stage * 15 * LANES, column, at_first, now)
            for i in range(3):
                step, to = load_lanes(flatten(lags), i * LANES), at + 3 * (LAG + i) * LANES
                a_x += load_lanes(acceleration, to) * step
                a_y += load_lanes(acceleration, to + LANES) * step
                a_w += load_lanes(acceleration, to + 2 * LANES) * step
        cos_t, sin_t = load_lanes(poses, 4 * stage * LANES), load_lanes(poses, (4 * stage + 1) * LANES)
        v_x, v_y = load_lanes(poses, (4 * stage + 2) * LANES), load_lanes(poses, (4 * stage + 3) * LANES)
        rate = BodyState(
            cos_t * x.v_x - sin_t * x.v_y - v_y * x.theta, sin_t * x.v_x + cos_t * x.v_y + v_x * x.theta, x.omega,
            a_x, a_y, a_w,
        )  # fmt: skip
        total = add_rates(total, rate, stage_weight(stage))
    _answer_of_lags(flatten(lags), coefficients, 4 * 15 * LANES, column, at_first, now)
    after, to = add_rates(begin, total, h / 6.0), column * N_STATE * LANES
    store_lanes(after.p_x, out, to)
    store_lanes(after.p_y, out, to + LANES)
    store_lanes(after.theta, out, to + 2 * LANES)
    store_lanes(after.v_x, out, to + 3 * LANES)
    store_lanes(after.v_y, out, to + 4 * LANES)
    store_lanes(after.omega, out, to + 5 * LANES)
    for i in range(3):
        store_lanes(load_lanes(flatten(lags), i * LANES), out, to + (LAG + i) * LANES)


@njit_inline
def _answer_of_lags(lags: Floats, coefficients: Floats, at: int, column: int, first: Floats, now: Floats) -> None:
    """Write to `lags` (3 LANES,) the change of each lagging quantity by a unit of `column`.

    It follows by `coefficients` from its start, and from the changes of steady lags and v_fx, `first` as the step
    begins and `now` (4 LANES,).
    """
    for i in range(3):
        to = at + 5 * i * LANES
        change = load_lanes(coefficients, to) * (1.0 if column == LAG + i else 0.0)
        change += load_lanes(coefficients, to + LANES) * load_lanes(first, i * LANES)
        change += load_lanes(coefficients, to + 2 * LANES) * load_lanes(first, 3 * LANES)
        change += load_lanes(coefficients, to + 3 * LANES) * load_lanes(now, i * LANES)
        change += load_lanes(coefficients, to + 4 * LANES) * load_lanes(now, 3 * LANES)
        store_lanes(change, lags, i * LANES)


@njit
def advance_column(
    x: Floats, matrix: Floats, turned: Floats, added: Floats, lagging: bool, pulled: bool, scratch: Floats
) -> None:
    """Advance one change of the state, `x` (N_STATE, LANES), by a step with the `matrix` of `step_matrix`, in place.

    `added` (6, LANES) are the accelerations and steady lags added within the step.  Where nothing depends on the pose
    (not `pulled`), a change of it moves the rest of the path as a rigid body, by `turned` (2, LANES), the step's way
    in x and y.  `scratch` is as large as `x`.
    """
    M, before, more, after = flatten(matrix), flatten(x), flatten(added), flatten(scratch)
    for i in range(N_STATE if lagging else LAG):
        total = 0.0 * load_lanes(before, 0)
        if i < TWIST and not pulled:
            total = load_lanes(before, i * LANES)
            if i == 0:
                total -= load_lanes(flatten(turned), LANES) * load_lanes(before, 2 * LANES)
            elif i == 1:
                total += load_lanes(flatten(turned), 0) * load_lanes(before, 2 * LANES)
        for j in range(POSE if pulled else TWIST, N_STATE if lagging else LAG):
            total += load_lanes(M, (j * N_STATE + i) * LANES) * load_lanes(before, j * LANES)
        for j in range(6 if lagging else 3):
            total += load_lanes(M, ((ADDED + j) * N_STATE + i) * LANES) * load_lanes(more, j * LANES)
        store_lanes(total, after, i * LANES)
    x[:] = scratch
