"""How accelerations change with the state and with parameters, at each stage of an RK4 step.

With the state x = [pose, twist, lags] and its rate f(x, u, parameters), a small change obeys the variational equation
dx' = (df/dx) dx + df.  At each stage the wrench is evaluated once more for each component of the twist, for each
quantity that lags, and for each parameter; all else is linear algebra (`bcid.likelihood.step_matrix`).  Differences are
of accelerations, within one stage and at one place: the derivative is that of the branch taken, and where a patch of
floor begins does not enter.

Arrays are flat, of vectors of LANES segments side by side.  Rows of a state: x, y, theta, v_x, v_y, omega, alpha_f,
F_mf, F_mr.
"""

import numpy as np

from bcid.aliases import Floats, Switches
from bcid.compiled.lane_access import load_lanes, store_lanes
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.car import (
    Actuation,
    BodyState,
    LagState,
    Wrench,
    add_remainder,
    force_by_place,
    inputs_of_remainder,
    is_lagging,
    replace_remainder,
    varies_with_pose,
    wheel_directions,
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
from bcid.effects.remainder import DIRECTION, Remainder, remainder_function, unit_remainder
from bcid.physics.car import Car
from bcid.physics.elementary import sincos

TWIST, LAG, N_STATE = 3, 6, 9  # where twist and lags begin in a state, and its size
# difference steps of a twist (m/s, rad/s) and of a pose (m, rad), of a lagging slip angle (rad) and force (N)
BODY_STEP, ANGLE_STEP, FORCE_STEP = 1e-5, 1e-5, 1e-2


# where the derivatives of a step stand in one flat array, in units of LANES numbers
ACCELERATION = 0  # (4, N_STATE, 3) at each stage, of v_x', v_y', omega' by the state, its lags as at the stage
STEADY = ACCELERATION + 4 * N_STATE * 3  # (4, 3, 4) of alpha_f, F_mf, F_mr without lag, and of v_fx, by the twist
COEFFICIENT = STEADY + 4 * 3 * 4  # (5, 3, 5) of each lag, at a stage or after the step, by what it follows from
POSE_RATE = COEFFICIENT + 5 * 3 * 5  # (4, 4) cos and sin of theta, x', y'
MASS_FACTOR = POSE_RATE + 4 * 4  # (4,)
PARAMETER = MASS_FACTOR + 4  # (4, R + K, 6) at each stage, of accelerations and steady lags by R parameters of a car
# and by K coefficients of a remainder, which has no name


@njit
def allocate_derivatives(parameters: int) -> Floats:
    """The flat array for a step's derivatives, of LANES segments, by so many `parameters` and coefficients: zeros."""
    return np.zeros((PARAMETER + 4 * 6 * parameters) * LANES)


@njit_inline
def get(x: Floats, i: int) -> float:
    """Vector number `i` of the flat array `x`."""
    vector: float = load_lanes(x, i * LANES)
    return vector


@njit_inline
def put(x: Floats, i: int, value: float) -> None:
    """Write `value` to vector number `i` of the flat array `x`."""
    store_lanes(value, x, i * LANES)


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
            put(out, at + j - 1, (lags.alpha_f - still.alpha_f) / angle)
            put(out, at + 5 + j - 1, (lags.F_mf - still.F_mf) / force)
            put(out, at + 10 + j - 1, (lags.F_mr - still.F_mr) / force)


@njit_inline
def _store_steady(out: Floats, at: int, moved: Wrench, now: Wrench, by: float) -> None:
    """Write derivatives of steady lags, by differences between `moved` and `now` over `by`, to `out` from `at` on."""
    a, b = moved.steady, now.steady
    put(out, at, (a.alpha_f - b.alpha_f) / by)
    put(out, at + 1, (a.F_mf - b.F_mf) / by)
    put(out, at + 2, (a.F_mr - b.F_mr) / by)


@njit_inline
def _store_accelerations(out: Floats, at: int, moved: BodyState, now: BodyState, by: float) -> None:
    """Write derivatives of v_x', v_y', omega', by differences between two rates over `by`, to `out` from `at` on."""
    put(out, at, (moved.v_x - now.v_x) / by)
    put(out, at + 1, (moved.v_y - now.v_y) / by)
    put(out, at + 2, (moved.omega - now.omega) / by)


@njit
def differentiate_step(
    out: Floats, b: BodyState, lags: LagState, inputs: StepInputs, h: float, cars: Floats, widths: Floats,
    e: Switches, c: Constants,
) -> tuple[BodyState, LagState]:  # fmt: skip
    """State and lags after an RK4 step of `h` seconds, as `rk4_body_step` gives them, and its stages' derivatives.

    They are written to `out`.  `cars` (R + 1, 21) holds the car, then one for each of R parameters with that parameter
    changed, by `widths` (R,); derivatives by the remainder's coefficients follow theirs.
    """
    zero, lagging, pulled, R, K = 0.0 * b.v_x, is_lagging(e), varies_with_pose(e), len(widths), int(e.remainders)
    turning = 1 if K > 0 else 0
    rate = total = BodyState(zero, zero, zero, zero, zero, zero)
    first = steady = now = Wrench(zero, zero, zero, zero, lags, zero)
    for stage in range(4):
        act, ahead = stage_actuation(stage, inputs, h), stage_time(stage) * h
        there = add_rates(b, rate, ahead)
        act = add_remainder(act, there, car_of_row(cars[0]), e)
        at, own = lags, PARAMETER + 6 * (R + K) * stage
        if stage == 2:  # its steady values are the second stage's
            steady = now
            at = lags_at_stage(lags, first, steady, ahead, h, e)
        # evaluations: of steady values, where lags follow from them, as it is, by the twist and by parameters; of
        # rates, as it is, by the twist, by lags, by parameters and by a turn of the wheel
        before, by_lags = (4 + R if lagging and stage != 2 else 0), (3 if lagging else 0)
        turned = now
        for k in range(before + 4 + by_lags + R + turning):
            ahead_of_lags = k < before
            j = k if ahead_of_lags else k - before
            lag, row, turns = -1, 0, not ahead_of_lags and j == 4 + by_lags + R
            if turns:
                row = 0
            elif ahead_of_lags:
                row = max(j - 3, 0)
            else:
                lag, row = (j - 4 if j < 4 + by_lags else -1), max(j - 3 - by_lags, 0)
            body = move_component(there, TWIST + j - 1 if 0 < j < 4 else -1, BODY_STEP)
            p = car_of_row(cars[row])
            here = turn_wheel(act, ANGLE_STEP if turns else 0.0)
            if turning == 1 and 0 < j < 4:
                here = add_remainder(act, body, car_of_row(cars[0]), e)
            w = wrench_with_effects(body, here, move_lag(lags if ahead_of_lags else at, lag), p, e, c)
            if turns:
                turned = w
                continue
            by = widths[row - 1] if row > 0 else BODY_STEP
            if ahead_of_lags and j > 0:
                to = own + 6 * (row - 1) + 3 if row > 0 else STEADY + (stage * 3 + j - 1) * 4
                _store_steady(out, to, w, steady, by)
                if row == 0:
                    put(out, to + 3, (w.v_fx - steady.v_fx) / by)
                continue
            if j == 0 and (ahead_of_lags or not lagging):
                steady = w
                if stage == 0:
                    first = w
            if ahead_of_lags:
                at = lags_at_stage(lags, first, steady, ahead, h, e)
                continue
            # a push is an acceleration, whatever mass and inertia
            m, I_z, push = p.m / cars[0, 0], p.I_z / cars[0, 1], inputs.push
            moved = body_rates(body, w, (m * push[0], m * push[1], I_z * push[2]), p)
            if j == 0:
                rate, now = moved, w
                continue
            if row > 0:
                to = own + 6 * (row - 1)
            elif j < 4:
                to = ACCELERATION + (stage * N_STATE + TWIST + j - 1) * 3
            else:
                to, by = ACCELERATION + (stage * N_STATE + LAG + lag) * 3, ANGLE_STEP if lag == 0 else FORCE_STEP
            _store_accelerations(out, to, moved, rate, by)
        p = car_of_row(cars[0])
        if K > 0:
            _store_remainder(out, own + 6 * R, there, act, now, turned, p, e)
        if lagging:
            if stage == 2:  # the third stage's steady values are the second's
                for i in range(12):
                    put(out, STEADY + 24 + i, get(out, STEADY + 12 + i))
                for i in range(6 * (R + K)):
                    if i % 6 > 2:
                        put(out, own + i, get(out, own - 6 * (R + K) + i))
            _store_lag_coefficients(out, COEFFICIENT + stage * 15, lags, first, steady, ahead, h, e)
        if pulled:
            _store_pull(out, ACCELERATION + stage * N_STATE * 3, there, act, now, turned, p, e)
        _store_pose_rates(out, POSE_RATE + stage * 4, there, rate)
        put(out, MASS_FACTOR + stage, now.mass_factor)
        total = add_rates(total, rate, stage_weight(stage))
    if lagging:
        _store_lag_coefficients(out, COEFFICIENT + 4 * 15, lags, first, steady, 2.0 * h, h, e)
    return add_rates(b, total, h / 6.0), advance_lags(lags, first, steady, h, e)


@njit_inline
def turn_wheel(act: Actuation, by: float) -> Actuation:
    """What the actuators give, the wheel turned further `by` (rad)."""
    rest = act.rest
    return replace_remainder(act, Remainder(rest.f_x, rest.f_y, rest.arm, rest.alpha, rest.turn + by))


@njit
def _store_remainder(
    out: Floats, at: int, b: BodyState, act: Actuation, now: Wrench, turned: Wrench, p: Car, e: Switches
) -> None:
    """Write derivatives of accelerations and steady lags by each coefficient of the remainder to `out` from `at` on.

    `turned` is the wrench `now` with the wheel turned by ANGLE_STEP.
    """
    s, w = inputs_of_remainder(act, b, p), wheel_directions(b, act)
    for j in range(int(e.remainders)):
        unit = unit_remainder(e.remainder[j, DIRECTION], w, p)
        _store_changes_by(out, at + 6 * j, remainder_function(e, j, s), unit, now, turned, p)


@njit_inline
def _store_changes_by(
    out: Floats, to: int, amount: float, unit: Remainder, now: Wrench, turned: Wrench, p: Car
) -> None:
    """Write changes of accelerations and steady lags by `amount` times a `unit` of a remainder to `out` from `to`."""
    a_x, a_y, alpha = _accelerations_by(unit, now, turned, p)
    turn = amount * unit.turn / ANGLE_STEP
    put(out, to, amount * a_x)
    put(out, to + 1, amount * a_y)
    put(out, to + 2, amount * alpha)
    put(out, to + 3, turn * (turned.steady.alpha_f - now.steady.alpha_f))
    put(out, to + 4, turn * (turned.steady.F_mf - now.steady.F_mf))
    put(out, to + 5, turn * (turned.steady.F_mr - now.steady.F_mr))


@njit_inline
def _accelerations_by(rest: Remainder, now: Wrench, turned: Wrench, p: Car) -> tuple[float, float, float]:
    """Accelerations (m/s^2, m/s^2, rad/s^2) by a small remainder `rest`, to first order, by wrenches as above."""
    per_rad, ratio = rest.turn / (ANGLE_STEP * now.mass_factor), p.m / p.I_z
    return (
        rest.f_x / now.mass_factor + per_rad * (turned.F_x - now.F_x) / p.m,
        rest.f_y / now.mass_factor + per_rad * (turned.F_y - now.F_y) / p.m,
        (ratio * rest.arm + rest.alpha) / now.mass_factor + per_rad * (turned.M_z - now.M_z) / p.I_z,
    )


@njit
def _store_pull(
    out: Floats, at: int, b: BodyState, act: Actuation, now: Wrench, turned: Wrench, p: Car, e: Switches
) -> None:
    """Write derivatives of accelerations by the pose to `out` from `at` on: by cable, slope and remainder in `e`."""
    F_x, F_y = force_by_place(b, now.mass_factor, p, e)
    for j in range(3):
        there = move_component(b, j, BODY_STEP)
        there_x, there_y = force_by_place(there, now.mass_factor, p, e)
        a_x, a_y = (there_x - F_x) / (now.mass_factor * p.m), (there_y - F_y) / (now.mass_factor * p.m)
        alpha = 0.0 * a_x
        if e.remainders > 0.0:
            more, rest = add_remainder(act, there, p, e).rest, act.rest
            change = Remainder(
                more.f_x - rest.f_x, more.f_y - rest.f_y, more.arm - rest.arm, more.alpha - rest.alpha,
                more.turn - rest.turn,
            )  # fmt: skip
            more_x, more_y, alpha = _accelerations_by(change, now, turned, p)
            a_x += more_x
            a_y += more_y
        put(out, at + 3 * j, a_x / BODY_STEP)
        put(out, at + 3 * j + 1, a_y / BODY_STEP)
        put(out, at + 3 * j + 2, alpha / BODY_STEP)


@njit_inline
def _store_pose_rates(out: Floats, at: int, b: BodyState, rate: BodyState) -> None:
    """Write cos and sin of the heading, and the velocity x', y' in the world, to `out` from `at` on."""
    sin_t, cos_t = sincos(b.theta)
    put(out, at, cos_t)
    put(out, at + 1, sin_t)
    put(out, at + 2, rate.p_x)
    put(out, at + 3, rate.p_y)
