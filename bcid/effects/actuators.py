"""The actuator chain from commands to wheel angle and throttle: delays, the servo with its effects, lag and play.

It needs the commands alone and so runs ahead of the body; the angle is known at every half step, as RK4 asks for it.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Switches
from bcid.compiled.njit import njit, njit_inline
from bcid.effects import corrections, motor, steering
from bcid.effects.car import Actuation
from bcid.effects.remainder import RemainderAction
from bcid.physics.car import Car
from bcid.physics.steering import steering_step

SAME_TIME_S = 1e-9
NO_REMAINDER = RemainderAction(0.0, 0.0, 0.0, 0.0, 0.0)


class ActuatorChain(NamedTuple):
    """Steering angles (rad) and throttles that reach the car over n steps of h seconds from t_0 (s) on."""

    t_0: float
    h: float
    delta: Floats  # (2 n + 1,)
    u_m: Floats  # (n + 1,) as each step begins
    u_next: Floats  # (n + 1,) mean after the first change within the step
    late: Floats  # (n + 1,) share of the step after that change, 0 where there is none
    brake: Floats  # (n + 1,) brake share, its mean over the step


class SteeringState(NamedTuple):
    """Angles of the steering on its way to the wheel, rad."""

    angle: float  # of the servo
    lagged: float  # behind its further lag
    behind: float  # behind its play


@njit_inline
def actuation_at(k: int, chain: ActuatorChain, T: float) -> Actuation:
    """What the actuators give at the start of step `k` of `chain`: time (s), steering angle (rad) and throttle.

    The throttle comes with its change within the step.  `T` is the recording's length (s), for effects that grow
    with time.
    """
    return Actuation(
        chain.t_0 + k * chain.h, T, chain.delta[2 * k], _steering_rate(2 * k, chain), chain.u_m[k], chain.u_next[k],
        chain.late[k], chain.brake[k], NO_REMAINDER,
    )  # fmt: skip


@njit_inline
def _steering_rate(i: int, chain: ActuatorChain) -> float:
    """Rate (rad/s) of the steering angle at half step `i` of `chain`, over the half steps before and after it."""
    before, after = max(i - 1, 0), min(i + 1, len(chain.delta) - 1)
    rate: float = (chain.delta[after] - chain.delta[before]) / (0.5 * chain.h * (after - before))
    return rate


@njit
def mean_held_command(times: Floats, values: Floats, integral: Floats, a: float, b: float) -> float:
    """Mean over [a, b] (s) of commands `values` (m,) that hold from their `times` (m,) (s) until the next.

    The first holds before its time, too.  `integral` (m,) is the commands' integral from the first time to each.
    The mean is continuous in a and b, so that predictions have a gradient with respect to a delay.
    """
    return (_command_integral(times, values, integral, b) - _command_integral(times, values, integral, a)) / (b - a)


@njit
def _command_integral(times: Floats, values: Floats, integral: Floats, t: float) -> float:
    """Integral from times[0] to `t` (s) of commands `values` (m,) that each hold from their time until the next.

    `integral` (m,) is its value at each of `times` (m,) (s).
    """
    k = max(int(np.searchsorted(times, t, side="right")) - 1, 0)
    return float(integral[k] + (t - times[k]) * values[k])


@njit
def servo_step(delta: float, u_s: float, p: Car, e: Switches, h: float) -> float:
    """Servo angle (rad), from `delta` (rad), after `h` seconds of the command `u_s` (rad).

    First order with the rate limit of `p`, and with the dead band and the rate asymmetry among the effects'
    parameters `e`.
    """
    rate_limit = steering.steering_rate_asymmetry(p.d, u_s - delta, e.steering_rate_asymmetry__a)
    after = steering_step(delta, u_s, p.T_s, rate_limit, h)
    return steering.steering_dead_band(delta, after, u_s, e.steering_dead_band__b)


@njit
def actuator_chain(
    times: Floats, commands: Floats, t_0: float, n: int, h: float, p: Car, limit: float, e: Switches
) -> ActuatorChain:
    """Steering angles and throttles that reach the car over `n` steps of `h` seconds from `t_0` (s) on.

    They result from delays, servo, lag and play of `p` and the effects' parameters `e`.  `commands` (m, 2) are steering
    (rad), limited to +-`limit`, and throttle (reference speed in m/s or share of full force; below 0 the brake share),
    in (m, 3) followed by a brake of its own; each holds from its time in `times` (m,) (s) until the next.  The steering
    starts at rest at the first command.
    """
    first = min(max(commands[0, 0], -limit), limit)
    return continue_actuator_chain(SteeringState(first, first, first), times, commands, t_0, n, h, p, limit, e)[0]


@njit
def continue_actuator_chain(
    servo: SteeringState,
    times: Floats,
    commands: Floats,
    t_0: float,
    n: int,
    h: float,
    p: Car,
    limit: float,
    e: Switches,
) -> tuple[ActuatorChain, SteeringState]:
    """Steering angles and throttles over `n` steps of `h` seconds from `t_0` (s) on, and the steering's last state.

    It differs from `actuator_chain` in two points: the angles (rad) of servo, lag and play start from `servo`, so
    that a simulation can be continued; and half steps are divided at the exact times at which the delayed command
    changes, since a servo at its rate limit depends on these times and not only on the command's mean over the step.
    """
    u_s, u_m = np.clip(commands[:, 0], -limit, limit), commands[:, 1].copy()
    half, tau = 0.5 * h, e.steering_delay__tau
    arrivals = corrections.throttle_timing(motor.motor_delay(times, e.motor_delay__tau), e.throttle_timing__tau)
    delta_out = np.empty(2 * n + 1)
    throttle, throttle_next, late = _throttle_per_step(arrivals, u_m, t_0, n, h)
    brake = _brake_per_step(arrivals, commands, t_0, n, h)
    angle, lagged, behind = servo.angle, servo.lagged, servo.behind
    row = 0
    for k in range(2 * n + 1):
        t = t_0 + k * half
        behind = steering.steering_backlash(behind, lagged, e.steering_backlash__b)
        delta_out[k] = behind
        now, end = t, t + half
        while k < 2 * n and now < end:
            while row + 1 < len(times) and steering.steering_delay(times[row + 1], tau) <= now:
                row += 1
            until = min(steering.steering_delay(times[row + 1], tau), end) if row + 1 < len(times) else end
            after = servo_step(angle, u_s[row], p, e, until - now)
            lagged = steering.steering_lag(lagged, angle, after, until - now, e.steering_lag__tau)
            angle, now = after, until
    return ActuatorChain(t_0, h, delta_out, throttle, throttle_next, late, brake), SteeringState(angle, lagged, behind)


@njit
def _brake_per_step(times: Floats, commands: Floats, t_0: float, n: int, h: float) -> Floats:
    """Mean brake share (n + 1,) of each step of `h` seconds from `t_0` (s) on; 0 where `commands` (m, 2) have none.

    The third column of `commands` (m, 3) acts from `times` (m,) (s) until the next.
    """
    brake = np.zeros(n + 1)
    if commands.shape[1] > 2 and commands[:, 2].any():
        share, area = commands[:, 2].copy(), np.zeros(len(times))
        area[1:] = np.cumsum(share[:-1] * np.diff(times))
        for k in range(n + 1):
            brake[k] = mean_held_command(times, share, area, t_0 + k * h, t_0 + (k + 1) * h)
    return brake


@njit
def _throttle_per_step(times: Floats, u_m: Floats, t_0: float, n: int, h: float) -> tuple[Floats, Floats, Floats]:
    """Throttle as each step begins, its mean after the first change in the step, and the share of the step after it.

    Each has shape (n + 1,); the share is 0 where nothing changes.  Commands `u_m` (m,) act from `times` (m,) (s)
    until the next; the `n` steps of `h` seconds begin at `t_0` (s).
    """
    area = np.zeros(len(times))
    area[1:] = np.cumsum(u_m[:-1] * np.diff(times))
    now, after, late = np.empty(n + 1), np.empty(n + 1), np.zeros(n + 1)
    for k in range(n + 1):
        t = t_0 + k * h
        # the next to come; the first has always been
        row = max(int(np.searchsorted(times, t + SAME_TIME_S, side="right")), 1)
        now[k] = after[k] = u_m[row - 1]
        if row < len(times) and times[row] < t + h - SAME_TIME_S:
            late[k] = (t + h - times[row]) / h
            after[k] = mean_held_command(times, u_m, area, times[row], t + h)
    return now, after, late
