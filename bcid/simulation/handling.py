"""How a small car is handled: what its drivers know of it, and how they aim it and keep its speed.

A driver's throttle follows the wanted speed along a line between the throttles of a slow and of a fast car, as somebody
knows the car who has driven it.
"""

import math
from typing import NamedTuple

from bcid.aliases import Floats
from bcid.compiled.njit import njit

SPEED_GAIN = 0.12  # of the throttle's range for each m/s that the car is too slow
BRAKE_SHARE, TOO_FAST_MPS = 0.4, 0.4
AIM_GAIN = 0.9


class Handling(NamedTuple):
    """What drivers know of a car, and how one drives it on a day."""

    slow: float  # m/s
    fast: float
    slow_throttle: float  # that keeps it so slow
    fast_throttle: float
    lock: float  # rad, the largest angle commanded
    wheelbase: float  # m, with which its turns are reckoned
    most_sideways: float  # m/s^2 that the tyres hold
    pace: float  # 0 to 1: how fast of what the car can
    rhythm: float  # 0 to 1: how often things change


@njit
def throttle_for(speed: float, h: Handling) -> float:
    """Throttle that keeps about so much `speed` (m/s)."""
    share = (speed - h.slow) / (h.fast - h.slow)
    return min(h.slow_throttle + share * (h.fast_throttle - h.slow_throttle), 1.0)


@njit
def speed_at_throttle(throttle: float, h: Handling) -> float:
    """Speed (m/s) to which a car comes at a `throttle` held: the way back of `throttle_for`, 0 at none or braking."""
    share = (throttle - h.slow_throttle) / (h.fast_throttle - h.slow_throttle)
    return max(h.slow + share * (h.fast - h.slow), 0.0) if throttle > 0.0 else 0.0


@njit
def body_motion(s: Floats) -> tuple[float, float, float]:
    """Heading (rad), and velocity along and across the body (m/s) in the plant's state `s`."""
    cos_h, sin_h = math.cos(s[2]), math.sin(s[2])
    return s[2], cos_h * s[3] + sin_h * s[4], cos_h * s[4] - sin_h * s[3]


@njit
def steer_at(s: Floats, x: float, y: float, h: Handling) -> float:
    """Angle (rad) of a wheel that is turned to the point (x, y) (m), within the lock."""
    bearing = math.atan2(y - s[1], x - s[0]) - s[2]
    return max(-h.lock, min(h.lock, AIM_GAIN * math.atan2(math.sin(bearing), math.cos(bearing))))


@njit
def keep_speed(s: Floats, speed: float, steer: float, h: Handling) -> float:
    """Throttle that brings a car in the state `s` to the wanted `speed` (m/s), or to what tyres hold at `steer` (rad).

    It is a brake share where the car is far too fast.
    """
    held = math.sqrt(1.3 * h.most_sideways * h.wheelbase / max(math.tan(abs(steer)), 1e-3))
    along, speed = body_motion(s)[1], min(speed, held)
    if along > speed + TOO_FAST_MPS:
        return -BRAKE_SHARE
    reach = h.fast_throttle - h.slow_throttle
    return max(0.0, min(throttle_for(speed, h) + SPEED_GAIN * reach * (speed - along), 1.0))
