"""Motor and drag force along the driven wheel.

Each law of a motor is a straight line in the wheel's speed, between two limits, which only the throttle chooses: in a
step of constant throttle the line is found once, and each of its stages is one product, one sum and two limits.
"""

from typing import NamedTuple

from bcid.compiled.lanes import multiply_add, where
from bcid.compiled.njit import njit_inline
from bcid.physics.elementary import clip


class MotorLine(NamedTuple):
    """A motor's force (N) under one throttle: clip(F_0 + slope (v_w - v_0), low, high) at the wheel speed v_w (m/s)."""

    F_0: float  # N
    v_0: float  # m/s
    slope: float  # N s/m
    low: float  # N
    high: float  # N


@njit_inline
def force_on_line(line: MotorLine, v_w: float) -> float:
    """Motor force (N) of `line` at the wheel speed `v_w` (m/s)."""
    return clip(multiply_add(v_w - line.v_0, line.slope, line.F_0), line.low, line.high)


@njit_inline
def speed_controlled_line(u_m: float, K_t: float, K_b: float, F_max: float) -> MotorLine:
    """The force of a proportional speed controller under the throttle `u_m`, as a line in the wheel's speed v_w (m/s).

    `u_m` >= 0 is a reference speed (m/s): the motor only supplies, clip(K_t (u_m - v_w), 0, F_max).  `u_m` < 0 is a
    brake share: clip(u_m K_b v_w, -F_max, F_max) (paper, App. actuators; docs/errata.md row 13).
    """
    # every law's line has numbers of the throttle's kind: single ones, or one for each lane
    drives, zero = u_m >= 0.0, 0.0 * u_m
    slope = where(drives, -K_t, u_m * K_b)
    return MotorLine(zero, max(u_m, 0.0), slope, where(drives, 0.0, -F_max), zero + F_max)


@njit_inline
def force_controlled_line(u_m: float, K: float, u_0: float, K_v: float, K_b: float, F_max: float) -> MotorLine:
    """Motor force where the throttle sets a force, K (u_m - u_0) - K_v v_w, as a line in the wheel's speed v_w (m/s).

    That holds for a throttle `u_m` above its dead zone u_0; from 0 to u_0 there is no force, and u_m < 0 is a brake
    share, u_m K_b v_w.  All is limited to +-F_max.
    """
    drives, zero = u_m > u_0, 0.0 * u_m
    slope = where(drives, -K_v, min(u_m, 0.0) * K_b)
    return MotorLine(where(drives, K * (u_m - u_0), 0.0), zero, slope, zero - F_max, zero + F_max)


@njit_inline
def speed_following_line(u_m: float, K: float, F_max: float) -> MotorLine:
    """Force of a wheel that turns at the measured speed `u_m` (m/s), as a line in its contact's speed v_w (m/s).

    clip(K (u_m - v_w), -F_max, F_max): what is left between the two is slip, which a tyre and what holds it answer by
    a force, forward and backward, driving and braking alike.  The car follows within m/K seconds.
    """
    zero = 0.0 * u_m
    return MotorLine(zero, u_m, zero - K, zero - F_max, zero + F_max)


@njit_inline
def drag_force(v_w: float, R_1: float, R_2: float) -> float:
    """Drag force R_1 v_w + R_2 v_w |v_w| (N) against rolling at v_w (m/s) (paper, F_d; docs/errata.md row 6).

    Where R_2 < 0, as in the paper, the drag falls with the speed; beyond -R_1/R_2 it is 0, and does not push.
    """
    per_speed = multiply_add(abs(v_w), R_2, R_1)
    return v_w * where(R_1 > 0.0, max(per_speed, 0.0), per_speed)
