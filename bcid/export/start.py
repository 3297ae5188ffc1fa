"""Where a vehicle's slip angles start whose past is not known."""

from __future__ import annotations

from bcid.physics.kinematics import kinematic_state

SLOWEST_SLIP_MPS = 0.1
"""Speed (m/s) below which slip angles start at 0, as those of a vehicle at rest: they are singular there."""


def slips_at_start(
    v_x: float, v_y: float, yaw_rate: float, delta: float, l_f: float, l_r: float
) -> tuple[float, float, float]:
    """The front wheel's speed v_f (m/s) and the slip angles alpha_f, alpha_r (rad) of a vehicle that starts.

    They are those of `bcid.physics.kinematics.kinematic_state`, whose arguments these are, but for slow wheels: alpha_f
    is 0 where v_f is below 0.1 m/s, and alpha_r where |v_x| is.
    """
    v_f, alpha_f, alpha_r = kinematic_state(v_x, v_y, yaw_rate, delta, l_f, l_r)
    if v_f < SLOWEST_SLIP_MPS:
        return v_f, 0.0, 0.0
    if abs(v_x) < SLOWEST_SLIP_MPS:
        return v_f, alpha_f, 0.0
    return v_f, alpha_f, alpha_r
