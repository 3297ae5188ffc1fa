"""What a lagging motor still gives as a prediction begins: it follows from the throttle before, which is known.

The force F_m obeys tau F_m' = F_cmd(u_m, v_w) - F_m.  Before the beginning the throttle's course u_m(t) is known
exactly, the wheel's speed v_w only as the prediction begins.  Speeds change slowly beside a throttle that steps, so
that v_w is held while the throttle's steps are gone through, each in closed form: exact at a constant speed, and
smooth in all parameters.
"""

import math

from bcid.aliases import Switches
from bcid.compiled.lanes import any_lane
from bcid.compiled.njit import njit, njit_inline
from bcid.effects import motor
from bcid.effects.actuators import ActuatorChain, actuation_at
from bcid.effects.car import (
    Actuation,
    BodyState,
    LagState,
    add_remainder,
    motor_force_with_effects,
    wrench_with_effects,
)
from bcid.effects.constants import Constants
from bcid.physics.car import Car
from bcid.physics.kinematics import wheel_velocity

# time constants of a lag that are gone through: of what was before, e^-14 is left, a millionth
REMEMBERED = 14.0


@njit
def remembered_steps(past: int, h: float, e: Switches) -> int:
    """Number of steps of `h` s, at most `past`, before a beginning that a motor with the lag in `e` remembers."""
    return int(min(float(past), math.ceil(REMEMBERED * e.motor_lag__tau / h)))


@njit
def steps_of_recording(k: int, chain: ActuatorChain) -> int:
    """Number of steps before step `k` of the actuator chain that lie in the recording, whose time begins at 0 s."""
    return min(k, int(math.floor(chain.t_0 / chain.h + k + 1e-6)))


@njit_inline
def hold_throttle(act: Actuation, u_m: float) -> Actuation:
    """What the actuators give, at a throttle that stays at `u_m`."""
    return Actuation(act.t, act.T, act.delta, act.delta_rate, u_m, u_m, 0.0 * act.late, act.brake, act.rest)


@njit_inline
def rear_wheel_speed(b: BodyState, p: Car) -> float:
    """Rolling speed (m/s) of the rear wheels at the twist of `b`."""
    return wheel_velocity(b.v_x, b.v_y, b.omega, -p.l_r, 0.0)[0]


@njit_inline
def motor_forces_at(
    lags: LagState, v_fx: float, v_rx: float, act: Actuation, p: Car, e: Switches, c: Constants
) -> LagState:
    """Motor forces (N) without lag under the throttle of `act`, at the wheels' speeds `v_fx`, `v_rx` (m/s).

    The slip angle is that of `lags`, and so is a force at the rear where no wheel is driven there.
    """
    F_mr = motor_force_with_effects(v_rx, act, p, e, c) if p.front_share < 1.0 else lags.F_mr
    return LagState(lags.alpha_f, motor_force_with_effects(v_fx, act, p, e, c), F_mr)


@njit_inline
def _follow_held_throttle(
    lags: LagState, v_fx: float, v_rx: float, act: Actuation, held: float, p: Car, e: Switches, c: Constants
) -> LagState:
    """Lagging motor forces (N) after the unchanging throttle of `act` was `held` (s) at the wheels' speeds (m/s)."""
    to, tau = motor_forces_at(lags, v_fx, v_rx, act, p, e, c), e.motor_lag__tau
    return LagState(
        lags.alpha_f, motor.motor_lag(lags.F_mf, to.F_mf, to.F_mf, held, tau),
        motor.motor_lag(lags.F_mr, to.F_mr, to.F_mr, held, tau),
    )  # fmt: skip


@njit_inline
def follow_throttle(
    lags: LagState, v_fx: float, v_rx: float, act: Actuation, h: float, p: Car, e: Switches, c: Constants
) -> LagState:
    """Lagging motor forces (N) after a step of `h` s from `lags` on, the wheels' speeds `v_fx`, `v_rx` (m/s) held.

    Where the throttle of `act` changes within the step, it is gone through in two parts.
    """
    if any_lane(act.late != 0.0):
        before, after = hold_throttle(act, act.u_m), hold_throttle(act, act.u_next)
        lags = _follow_held_throttle(lags, v_fx, v_rx, before, (1.0 - act.late) * h, p, e, c)
        return _follow_held_throttle(lags, v_fx, v_rx, after, act.late * h, p, e, c)
    return _follow_held_throttle(lags, v_fx, v_rx, act, h, p, e, c)


@njit
def lags_as_step_begins(
    b: BodyState, k: int, past: int, chain: ActuatorChain, T: float, p: Car, e: Switches, c: Constants
) -> LagState:
    """Front slip angle (rad) and motor forces (N) of a car at `b` as step `k` of the actuator chain begins.

    The slip angle is the steady one.  A lagging motor's forces are what the throttle over the `past` steps (at most k)
    before has left, the motor in steady state before them, all at the wheels' speeds at `b`.  `T` is the recording's
    length (s).
    """
    now = actuation_at(k, chain, T)
    act = add_remainder(hold_throttle(now, now.u_m), b, p, e)
    w = wrench_with_effects(b, act, LagState(0.0, 0.0, 0.0), p, e, c)
    n = remembered_steps(past, chain.h, e)
    if n == 0:
        return w.steady
    v_fx, v_rx, first = w.v_fx, rear_wheel_speed(b, p), actuation_at(k - n, chain, T)
    lags = motor_forces_at(w.steady, v_fx, v_rx, hold_throttle(first, first.u_m), p, e, c)
    for i in range(k - n, k):
        lags = follow_throttle(lags, v_fx, v_rx, actuation_at(i, chain, T), chain.h, p, e, c)
    return lags
