"""The steering actuator: first order with a rate limit (paper, App. actuators, deltaDot)."""

import math

from bcid.compiled.njit import njit, njit_inline
from bcid.physics.elementary import clip


@njit_inline
def steering_rate(u_s: float, delta: float, T_s: float, d: float) -> float:
    """Rate of the steering angle (rad/s): sat((u_s - delta)/T_s) within [-d, d]."""
    return clip((u_s - delta) / T_s, -d, d)


@njit
def steering_step(delta: float, u_s: float, T_s: float, d: float, h: float) -> float:
    """Steering angle (rad) after `h` seconds: at the rate limit d until |u_s - delta| = d T_s, then an exponential."""
    miss = u_s - delta
    ramp = min(max(abs(miss) / d - T_s, 0.0), h)
    miss -= math.copysign(d * ramp, miss)
    return u_s - miss * math.exp(-(h - ramp) / T_s)
