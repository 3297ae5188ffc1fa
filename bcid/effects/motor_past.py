"""What a lagging motor still gives as a prediction begins: it follows from the throttle before, which is known.

The force F_m obeys tau F_m' = F_cmd(u_m, v_w) - F_m.  Before the beginning the throttle's course u_m(t) is known
exactly.  The wheel's speed v_w is known as the prediction begins, and how it came there follows from the forces.
"""

import math

from bcid.aliases import Switches
from bcid.compiled.lanes import any_lane
from bcid.compiled.njit import njit, njit_inline
from bcid.effects import motor
from bcid.effects.car import Actuation, BodyState, LagState, Wrench, motor_force_with_effects
from bcid.effects.constants import Constants
from bcid.physics.car import Car
from bcid.physics.elementary import sincos

# time constants of a lag that are gone through: what was before counts e^-16, a ten-millionth
REMEMBERED = 16.0


@njit
def remembered_steps(past: int, h: float, e: Switches) -> int:
    """Number of steps of `h` s, at most `past`, before a beginning that a motor with the lag in `e` remembers."""
    return int(min(float(past), math.ceil(REMEMBERED * e.motor_lag__tau / h)))


@njit
def mean_age_in_step(ratio: float) -> float:
    """How far back in a step, as a share of it, a steady force stands for all of the step at its end.

    The step lasts `ratio` time constants of the lag.  With the force of that instant held over each step, one that
    changes steadily is followed exactly, however long the steps are.
    """
    return 1.0 / ratio - 1.0 / (math.exp(min(ratio, 700.0)) - 1.0)


@njit_inline
def forward_pull(lags: LagState, act: Actuation, p: Car) -> float:
    """Force (N) along the body of the motor forces `lags` at both axles."""
    return p.front_share * lags.F_mf * sincos(act.delta)[1] + (1.0 - p.front_share) * lags.F_mr


@njit_inline
def forward_acceleration(b: BodyState, w: Wrench, p: Car) -> float:
    """Rate (m/s^2) of the speed v_x of a car at `b` under the wrench `w`."""
    return w.F_x / (w.mass_factor * p.m) + b.omega * b.v_y


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
def follow_throttle(
    lags: LagState, v_fx: float, v_rx: float, act: Actuation, h: float, p: Car, e: Switches, c: Constants
) -> LagState:
    """Lagging motor forces (N) after a step of `h` s from `lags` on, in closed form at the wheels' speeds (m/s).

    Where the throttle of `act` changes within the step, it is gone through in two parts.
    """
    if any_lane(act.late != 0.0):
        before, after = _hold_throttle(act, act.u_m), _hold_throttle(act, act.u_next)
        lags = _follow_held_throttle(lags, v_fx, v_rx, before, (1.0 - act.late) * h, p, e, c)
        return _follow_held_throttle(lags, v_fx, v_rx, after, act.late * h, p, e, c)
    return _follow_held_throttle(lags, v_fx, v_rx, act, h, p, e, c)


@njit_inline
def _hold_throttle(act: Actuation, u_m: float) -> Actuation:
    """What the actuators give, at a throttle that stays at `u_m`."""
    return Actuation(act.t, act.T, act.delta, act.delta_rate, u_m, u_m, 0.0 * act.late, act.brake, act.rest)


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
