"""How accelerations change with the state and with parameters, at each stage of an RK4 step.

With the state x = [pose, twist, lags] and its rate f(x, u, parameters), a small change obeys the variational equation
dx' = (df/dx) dx + df.  At each stage the wrench is evaluated once more for each component of the twist, for each
quantity that lags, and for each parameter; all else is linear algebra (`bcid.likelihood.step_matrix`).  Differences are
of accelerations, within one stage and at one place: the derivative is that of the branch taken, and where a patch of
floor begins does not enter.  What has no name is differentiated in closed form (`remainder_derivatives`).
"""

from bcid.aliases import Bools, Floats, Switches
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.car import (
    Actuation,
    BodyState,
    LagState,
    Wrench,
    force_by_place,
    is_lagging,
    is_pulled_by_place,
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
from bcid.effects.remainder import add_to_remainder
from bcid.likelihood.lag_derivatives import move_lag, store_lag_coefficients, store_steady
from bcid.likelihood.remainder_derivatives import (
    accelerations_by,
    differentiate_remainder,
    slope_of_remainder,
    store_directions,
    turn_wheel,
)
from bcid.likelihood.step_derivatives import (
    ACCELERATION,
    ANGLE_STEP,
    BODY_STEP,
    COEFFICIENT,
    FORCE_STEP,
    LAG,
    MASS_FACTOR,
    N_DIRECTIONS,
    N_STATE,
    POSE_RATE,
    STEADY,
    TURN_STEP,
    TWIST,
    car_of_row,
    move_component,
    place_of_change,
    put,
)
from bcid.physics.elementary import sincos


@njit
def differentiate_step(
    out: Floats, b: BodyState, lags: LagState, inputs: StepInputs, h: float, cars: Floats, widths: Floats,
    used: Bools, e: Switches, c: Constants,
) -> tuple[BodyState, LagState]:  # fmt: skip
    """State and lags after an RK4 step of `h` seconds, as `rk4_body_step` gives them, and its stages' derivatives.

    They are written to `out`.  `cars` (R + 1, 21) holds the car, then one for each of R parameters with that parameter
    changed, by `widths` (R,); `used` (N_DIRECTIONS,) says where functions of a remainder act.
    """
    zero, p, R, lagging = 0.0 * b.v_x, car_of_row(cars[0]), len(widths), is_lagging(e)
    rate = total = BodyState(zero, zero, zero, zero, zero, zero)
    first = steady = now = Wrench(zero, zero, zero, zero, lags, zero)
    for stage in range(4):
        act, ahead = stage_actuation(stage, inputs, h, e), stage_time(stage) * h
        there = add_rates(b, rate, ahead)
        act = differentiate_remainder(out, stage, there, act, p, e, R)
        at = lags
        if lagging:
            # the third stage is at the time of the second, whose steady values serve it
            steady = now if stage == 2 else _differentiate_steady(out, stage, there, act, lags, cars, widths, e, c)
            first = steady if stage == 0 else first
            at = lags_at_stage(lags, first, steady, ahead, h, e)
            store_lag_coefficients(out, COEFFICIENT + stage * 15, lags, first, steady, ahead, h, e)
        rate, now, turned = _differentiate_rates(out, stage, there, act, at, inputs.push, cars, widths, e, c)
        if not lagging:
            steady = now
            first = steady if stage == 0 else first
        if e.remainders > 0.0:
            store_directions(out, stage, wheel_directions(there, act), now, turned, p, used, R)
        if varies_with_pose(e):
            _store_pull(out, ACCELERATION + stage * N_STATE * 3, there, now, turned, cars, e)
        _store_pose_rates(out, POSE_RATE + stage * 4, there, rate)
        put(out, MASS_FACTOR + stage, now.mass_factor)
        total = add_rates(total, rate, stage_weight(stage))
    if lagging:
        store_lag_coefficients(out, COEFFICIENT + 4 * 15, lags, first, steady, 2.0 * h, h, e)
    return add_rates(b, total, h / 6.0), advance_lags(lags, first, steady, h, e)


@njit_inline
def _differentiate_steady(
    out: Floats, stage: int, b: BodyState, act: Actuation, lags: LagState, cars: Floats, widths: Floats, e: Switches,
    c: Constants,
) -> Wrench:  # fmt: skip
    """The wrench at a stage, from which lags follow; derivatives of steady lags by twist and parameters go to `out`.

    The arguments are those of `_differentiate_rates`, `lags` being those as the step begins.
    """
    steady = Wrench(b.v_x, b.v_x, b.v_x, b.v_x, lags, b.v_x)
    for k in range(4 + len(widths)):  # as it is, by twist, by parameters
        j, row = (k if k < 4 else 0), max(k - 3, 0)
        w = wrench_with_effects(
            move_component(b, TWIST + j - 1 if j > 0 else -1, BODY_STEP), _move_with_twist(out, act, j, e), lags,
            car_of_row(cars[row]), e, c,
        )  # fmt: skip
        if k == 0:
            steady = w
        elif row == 0:
            at = STEADY + (stage * 3 + j - 1) * 4
            store_steady(out, at, w.steady, steady.steady, BODY_STEP)
            put(out, at + 3, (w.v_fx - steady.v_fx) / BODY_STEP)
        else:
            at = place_of_change(stage, N_DIRECTIONS + row - 1, len(widths)) + 3
            store_steady(out, at, w.steady, steady.steady, widths[row - 1])
    return steady


@njit_inline
def _differentiate_rates(
    out: Floats, stage: int, b: BodyState, act: Actuation, lags: LagState, push: tuple[float, float, float],
    cars: Floats, widths: Floats, e: Switches, c: Constants,
) -> tuple[BodyState, Wrench, Wrench]:  # fmt: skip
    """Rates at a stage, the wrench, and that with the wheel turned by TURN_STEP, where something has no name.

    Derivatives of accelerations by twist, lags and parameters go to `out`.
    """
    by_lags, R = (3 if is_lagging(e) else 0), len(widths)
    rate, now = b, Wrench(b.v_x, b.v_x, b.v_x, b.v_x, lags, b.v_x)
    turned = now
    # as it is, by twist, by lags, by parameters, by a turn of the wheel
    for k in range(4 + by_lags + R + (1 if e.remainders > 0.0 else 0)):
        j, lag, row = (k if k < 4 else 0), (k - 4 if k < 4 + by_lags else -1), k - 3 - by_lags
        turns, row = row > R, (row if 0 < row <= R else 0)
        p = car_of_row(cars[row])
        here = turn_wheel(_move_with_twist(out, act, j, e), TURN_STEP if turns else 0.0)
        there = move_component(b, TWIST + j - 1 if j > 0 else -1, BODY_STEP)
        w = wrench_with_effects(there, here, move_lag(lags, lag), p, e, c)
        if turns:
            turned = w
            continue
        # a push is an acceleration, whatever mass and inertia
        m, I_z = p.m / cars[0, 0], p.I_z / cars[0, 1]
        moved = body_rates(there, w, (m * push[0], m * push[1], I_z * push[2]), p)
        if k == 0:
            rate, now = moved, w
        elif row > 0:
            at = place_of_change(stage, N_DIRECTIONS + row - 1, R)
            _store_accelerations(out, at, moved, rate, widths[row - 1])
        else:
            by = BODY_STEP if j > 0 else (ANGLE_STEP if lag == 0 else FORCE_STEP)
            at = ACCELERATION + (stage * N_STATE + (TWIST + j - 1 if j > 0 else LAG + lag)) * 3
            _store_accelerations(out, at, moved, rate, by)
    return rate, now, turned


@njit_inline
def _move_with_twist(d: Floats, act: Actuation, j: int, e: Switches) -> Actuation:
    """What the actuators give, what has no name changed as by BODY_STEP more of v_x, v_y or omega (`j` = 1, 2, 3)."""
    if e.remainders == 0.0 or j == 0:
        return act
    return replace_remainder(act, add_to_remainder(act.rest, slope_of_remainder(d, TWIST + j - 1), BODY_STEP))


@njit_inline
def _store_accelerations(out: Floats, at: int, moved: BodyState, now: BodyState, by: float) -> None:
    """Write derivatives of v_x', v_y', omega', by differences between two rates over `by`, to `out` from `at` on."""
    put(out, at, (moved.v_x - now.v_x) / by)
    put(out, at + 1, (moved.v_y - now.v_y) / by)
    put(out, at + 2, (moved.omega - now.omega) / by)


@njit
def _store_pull(out: Floats, at: int, b: BodyState, now: Wrench, turned: Wrench, cars: Floats, e: Switches) -> None:
    """Write derivatives of accelerations by the pose to `out` from `at` on: by cable, slope and remainder in `e`."""
    p, zero = car_of_row(cars[0]), 0.0 * b.v_x
    F_x, F_y = force_by_place(b, now.mass_factor, p, e) if is_pulled_by_place(e) else (zero, zero)
    for j in range(3):
        a_x = a_y = alpha = zero
        if e.remainders > 0.0:
            a_x, a_y, alpha = accelerations_by(slope_of_remainder(out, j), now, turned, p)
        if is_pulled_by_place(e):
            there_x, there_y = force_by_place(move_component(b, j, BODY_STEP), now.mass_factor, p, e)
            a_x += (there_x - F_x) / (now.mass_factor * p.m * BODY_STEP)
            a_y += (there_y - F_y) / (now.mass_factor * p.m * BODY_STEP)
        put(out, at + 3 * j, a_x)
        put(out, at + 3 * j + 1, a_y)
        put(out, at + 3 * j + 2, alpha)


@njit_inline
def _store_pose_rates(out: Floats, at: int, b: BodyState, rate: BodyState) -> None:
    """Write cos and sin of the heading, and the velocity x', y' in the world, to `out` from `at` on."""
    sin_t, cos_t = sincos(b.theta)
    put(out, at, cos_t)
    put(out, at + 1, sin_t)
    put(out, at + 2, rate.p_x)
    put(out, at + 3, rate.p_y)
