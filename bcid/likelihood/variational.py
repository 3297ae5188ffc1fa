"""How accelerations change with the state and with parameters, at each stage of an RK4 step.

With the state x = [pose, twist, lags] and its rate f(x, u, parameters), a small change obeys the variational equation
dx' = (df/dx) dx + df.  At each stage the wrench is evaluated once more for each component of the twist, for each
quantity that lags, and for each parameter; all else is linear algebra (`bcid.likelihood.step_matrix`).  Differences are
of accelerations, within one stage and at one place: the derivative is that of the branch taken, and where a patch of
floor begins does not enter.  What has no name is differentiated in closed form (`remainder_derivatives`).
"""

from bcid.aliases import Floats, Switches
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.car import (
    Actuation,
    BodyState,
    LagState,
    Wrench,
    force_by_place,
    is_lagging,
    is_pulled_by_place,
    own_pushes,
    varies_with_pose,
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
from bcid.effects.own_laws import own_pushes_vary_with_pose
from bcid.effects.remainder import RemainderAction, add_to_remainder
from bcid.effects.unnamed_action import replace_remainder, turn_wheel
from bcid.likelihood.lag_derivatives import move_lag, store_lag_coefficients, store_steady
from bcid.likelihood.remainder_derivatives import (
    accelerations_by,
    differentiate_remainder,
    slope_of_remainder,
)
from bcid.likelihood.step_derivatives import (
    ACCELERATION,
    ANGLE_STEP,
    BODY_STEP,
    COEFFICIENT,
    FORCE_STEP,
    LAG,
    MASS_FACTOR,
    N_STATE,
    POSE_RATE,
    TURN_STEP,
    TWIST,
    car_of_row,
    move_component,
    place_of_change,
    place_of_steady,
    put,
)
from bcid.physics.car import Car
from bcid.physics.elementary import sincos


@njit
def differentiate_step(
    out: Floats, b: BodyState, lags: LagState, inputs: StepInputs, h: float, cars: Floats, widths: Floats,
    turns: int, e: Switches, c: Constants,
) -> tuple[BodyState, LagState]:  # fmt: skip
    """State and lags after an RK4 step of `h` seconds, as `rk4_body_step` gives them, and its stages' derivatives.

    They are written to `out`.  `cars` (R + 1, 22) holds the car, then one for each of R parameters with that parameter
    changed, by `widths` (R,); those by a turn of the steered wheel are asked for where `turns` is 1, not 0.
    """
    zero, p, lagging, turning = 0.0 * b.v_x, car_of_row(cars[0]), is_lagging(e), turns > 0 or e.remainders > 0.0
    rate = total = BodyState(zero, zero, zero, zero, zero, zero)
    first = steady = now = Wrench(zero, zero, zero, zero, lags, zero)
    for stage in range(4):
        act, ahead = stage_actuation(stage, inputs, h), stage_time(stage) * h
        there = add_rates(b, rate, ahead)
        act = differentiate_remainder(out, there, act, p, e)
        at = lags
        if lagging:
            # the third stage is at the time of the second, whose steady values serve it
            steady = now if stage == 2 else _differentiate_steady(out, stage, there, act, lags, cars, widths, e, c)
            first = steady if stage == 0 else first
            at = lags_at_stage(lags, first, steady, ahead, h, e)
            store_lag_coefficients(out, COEFFICIENT + stage * 15, lags, first, steady, ahead, h, e)
        rate, now, turned = _differentiate_rates(out, stage, there, act, at, inputs.push, cars, widths, turning, e, c)
        if not lagging:
            steady = now
            first = steady if stage == 0 else first
        if turning:
            _store_turn(out, place_of_change(stage, 0, len(widths)), now, turned, p)
        if varies_with_pose(e):
            _store_pull(out, stage, there, act, now, turned, cars, e)
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
            at = place_of_steady(stage, TWIST + j - 1)
            store_steady(out, at, w.steady, steady.steady, BODY_STEP)
            put(out, at + 3, (w.v_fx - steady.v_fx) / BODY_STEP)
        else:
            at = place_of_change(stage, row, len(widths)) + 3
            store_steady(out, at, w.steady, steady.steady, widths[row - 1])
    return steady


@njit_inline
def _differentiate_rates(
    out: Floats, stage: int, b: BodyState, act: Actuation, lags: LagState, push: tuple[float, float, float],
    cars: Floats, widths: Floats, turning: bool, e: Switches, c: Constants,
) -> tuple[BodyState, Wrench, Wrench]:  # fmt: skip
    """Rates at a stage, the wrench, and that with the wheel turned by TURN_STEP, where this is asked for (`turning`).

    Derivatives of accelerations by twist, lags and parameters go to `out`.
    """
    by_lags, R = (3 if is_lagging(e) else 0), len(widths)
    rate, now = b, Wrench(b.v_x, b.v_x, b.v_x, b.v_x, lags, b.v_x)
    turned = now
    # as it is, by twist, by lags, by parameters, by a turn of the wheel
    for k in range(4 + by_lags + R + (1 if turning else 0)):
        j, lag, row = (k if k < 4 else 0), (k - 4 if k < 4 + by_lags else -1), k - 3 - by_lags
        turned_now, row = row > R, (row if 0 < row <= R else 0)
        p = car_of_row(cars[row])
        here = turn_wheel(_move_with_twist(out, act, j, e), TURN_STEP if turned_now else 0.0, e)
        there = move_component(b, TWIST + j - 1 if j > 0 else -1, BODY_STEP)
        w = wrench_with_effects(there, here, move_lag(lags, lag), p, e, c)
        if turned_now:
            turned = w
            continue
        # a push is an acceleration, whatever mass and inertia
        m, I_z = p.m / cars[0, 0], p.I_z / cars[0, 1]
        moved = body_rates(there, w, (m * push[0], m * push[1], I_z * push[2]), p)
        if k == 0:
            rate, now = moved, w
        elif row > 0:
            at = place_of_change(stage, row, R)
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


@njit_inline
def _store_turn(out: Floats, at: int, now: Wrench, turned: Wrench, p: Car) -> None:
    """Write derivatives of accelerations and steady lags by a turn of the steered wheel to `out` from `at` on.

    `turned` is the wrench `now` with the wheel turned by TURN_STEP.
    """
    none = 0.0 * now.F_x
    a_x, a_y, alpha = accelerations_by(RemainderAction(none, none, none, none, none + 1.0), now, turned, p)
    put(out, at, a_x)
    put(out, at + 1, a_y)
    put(out, at + 2, alpha)
    store_steady(out, at + 3, turned.steady, now.steady, TURN_STEP)


@njit
def _store_pull(
    out: Floats, stage: int, b: BodyState, act: Actuation, now: Wrench, turned: Wrench, cars: Floats, e: Switches
) -> None:
    """Write derivatives of accelerations and steady lags by the pose to `out`: by all in `e` that depends on it.

    These are the pulls of cable and slope, the user's laws, and what has no name.
    """
    p, zero = car_of_row(cars[0]), 0.0 * b.v_x
    F_x, F_y = force_by_place(b, now.mass_factor, p, e) if is_pulled_by_place(e) else (zero, zero)
    for j in range(3):
        a_x = a_y = alpha = zero
        if e.remainders > 0.0:
            slope = slope_of_remainder(out, j)
            a_x, a_y, alpha = accelerations_by(slope, now, turned, p)
            # where the place turns the wheel, lags follow that
            at, per_rad = place_of_steady(stage, j), slope.turn / TURN_STEP
            put(out, at, per_rad * (turned.steady.alpha_f - now.steady.alpha_f))
            put(out, at + 1, per_rad * (turned.steady.F_mf - now.steady.F_mf))
            put(out, at + 2, per_rad * (turned.steady.F_mr - now.steady.F_mr))
            put(out, at + 3, per_rad * (turned.v_fx - now.v_fx))
        if is_pulled_by_place(e):
            there_x, there_y = force_by_place(move_component(b, j, BODY_STEP), now.mass_factor, p, e)
            a_x += (there_x - F_x) / (now.mass_factor * p.m * BODY_STEP)
            a_y += (there_y - F_y) / (now.mass_factor * p.m * BODY_STEP)
        if own_pushes_vary_with_pose(e):
            here, there = own_pushes(b, act, p, e), own_pushes(move_component(b, j, BODY_STEP), act, p, e)
            a_x += (there[0] - here[0]) / (now.mass_factor * p.m * BODY_STEP)
            a_y += (there[1] - here[1]) / (now.mass_factor * p.m * BODY_STEP)
            alpha += (there[2] - here[2]) / (now.mass_factor * p.I_z * BODY_STEP)
        at = ACCELERATION + (stage * N_STATE + j) * 3
        put(out, at, a_x)
        put(out, at + 1, a_y)
        put(out, at + 2, alpha)


@njit_inline
def _store_pose_rates(out: Floats, at: int, b: BodyState, rate: BodyState) -> None:
    """Write cos and sin of the heading, and the velocity x', y' in the world, to `out` from `at` on."""
    sin_t, cos_t = sincos(b.theta)
    put(out, at, cos_t)
    put(out, at + 1, sin_t)
    put(out, at + 2, rate.p_x)
    put(out, at + 3, rate.p_y)
