"""Rigid-body kinematics of a vehicle with one steered front axle and one rear axle."""

import math

from bcid.compiled.lanes import multiply_add
from bcid.compiled.njit import njit, njit_inline
from bcid.physics.elementary import sincos


@njit_inline
def body_twist(v_f: float, beta_f: float, beta_r: float, l_f: float, l_r: float) -> tuple[float, float, float]:
    """Twist v_x, v_y (m/s, body), yaw rate w (rad/s) of the CoG from front wheel speed and both axles' heading angles.

    `v_f` (m/s) is the speed of the front wheel, `beta_f`, `beta_r` (rad) are the directions in which the axles move
    in the body frame: v_x = v_f cos(beta_f), v_y + l_f w = v_f sin(beta_f), v_y - l_r w = v_x tan(beta_r) (paper,
    extended kinematic model; docs/errata.md row 1).
    """
    (sin_f, cos_f), (sin_r, cos_r) = sincos(beta_f), sincos(beta_r)
    v_x = cos_f * v_f
    v_fy = sin_f * v_f
    v_ry = v_x * (sin_r / cos_r)
    # a loop divides once, not in every step
    inverse_wheelbase = 1.0 / (l_f + l_r)
    return v_x, (l_r * v_fy + l_f * v_ry) * inverse_wheelbase, (v_fy - v_ry) * inverse_wheelbase


@njit_inline
def wheel_velocity(v_x: float, v_y: float, yaw_rate: float, lever: float, delta: float) -> tuple[float, float]:
    """Velocity of a wheel's contact point along and across the wheel (m/s), from the CoG's body-frame twist.

    `lever` is the wheel's distance ahead of the CoG (m), `delta` its angle to the body (rad): a rotation by -delta
    (paper, App. slip; docs/errata.md row 3).
    """
    v_across = multiply_add(lever, yaw_rate, v_y)
    sin_d, cos_d = sincos(delta)
    return multiply_add(cos_d, v_x, sin_d * v_across), multiply_add(cos_d, v_across, -sin_d * v_x)


@njit_inline
def pose_rate(theta: float, v_x: float, v_y: float) -> tuple[float, float]:
    """World velocity (m/s) of the CoG: v_x, v_y (m/s, body) rotated by `theta` (rad) (docs/errata.md rows 4 and 5)."""
    sin_t, cos_t = sincos(theta)
    return cos_t * v_x - sin_t * v_y, sin_t * v_x + cos_t * v_y


@njit_inline
def wrap_angle(angle: float) -> float:
    """The equivalent of `angle` (rad) in (-pi, pi]."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)


@njit
def kinematic_state(
    v_x: float, v_y: float, yaw_rate: float, delta: float, l_f: float, l_r: float
) -> tuple[float, float, float]:
    """Front wheel speed v_f >= 0 (m/s) and slip angles alpha_f, alpha_r (rad) from body-frame twist and wheel angle.

    v_f = hypot(v_x, v_fy) and alpha_f = atan2(v_fy, v_x) - delta, wrapped, with v_fy = v_y + l_f w;
    tan(alpha_r) = (v_y - l_r w)/v_x (docs/errata.md row 15).  alpha_r is singular at v_x = 0: mask it for
    |v_x| < 0.1 m/s wherever it is quoted.
    """
    v_fy = v_y + l_f * yaw_rate
    v_f = math.hypot(v_x, v_fy)
    alpha_f = wrap_angle(math.atan2(v_fy, v_x) - delta)
    v_ry = v_y - l_r * yaw_rate
    alpha_r = math.atan(v_ry / v_x) if v_x != 0.0 else math.copysign(0.5 * math.pi, v_ry)
    return v_f, alpha_f, alpha_r
