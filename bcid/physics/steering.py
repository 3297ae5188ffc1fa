"""The steering actuator: first order with a rate limit (paper, App. actuators, deltaDot)."""

import math

from bcid.compiled.njit import njit_inline
from bcid.physics.elementary import clip


@njit_inline
def steering_rate(u_s: float, delta: float, T_s: float, d: float) -> float:
    """Rate of the steering angle `delta` (rad/s): (u_s - delta)/T_s limited to [-d, d].

    `u_s` (rad) is the command, `T_s` (s) the time constant, `d` (rad/s) the rate limit (paper, App. actuators).
    """
    # a loop divides once, not in every step
    return clip((u_s - delta) * (1.0 / T_s), -d, d)


@njit_inline
def steering_step(delta: float, u_s: float, T_s: float, d: float, h: float) -> float:
    """Steering angle (rad), from `delta`, after `h` seconds of the command `u_s` (rad); exact.

    It moves at the rate limit d (rad/s) until |u_s - delta| = d T_s, then approaches exponentially with the time
    constant T_s (s).
    """
    # a loop divides once, not in every step
    inverse_d, inverse_T_s = 1.0 / d, 1.0 / T_s
    miss = u_s - delta
    ramp = min(max(abs(miss) * inverse_d - T_s, 0.0), h)
    miss -= math.copysign(d * ramp, miss)
    return u_s - miss * math.exp((ramp - h) * inverse_T_s)
