"""The table of functions without a name: what they depend on, and in which directions they act.

Function j of the table is c_j cos(k_j . s + phi_j), s being the quantities in INPUTS (`bcid.effects.remainder`).
"""

from typing import NamedTuple

INPUTS = ("v_x", "omega", "v_fx", "alpha_f", "alpha_r", "delta", "delta_rate", "u_m", "p_x", "p_y", "t")
"""What the functions depend on: m/s and rad/s of the body, the front hub's speed along the wheel (m/s), slip angles
(rad), the wheel's angle and the servo's rate (rad, rad/s), the throttle, the place on the floor (m), the time (s).
"""

OF_THE_CAR = 8
"""So many of INPUTS come first that are the car's own; place and time follow."""

DIRECTIONS = (
    "body_x", "front_along", "front_across", "rear_across", "yaw", "world_x", "world_y", "driven_along", "rolling",
    "wheel_angle",
)  # fmt: skip
"""In which a function acts: as a force over the mass (m/s^2) along or across the body, a wheel or the floor, or the way
that the car rolls, as a moment over the inertia (rad/s^2), or as a change of the steered wheel's angle (rad)."""

BODY_X, FRONT_ALONG, FRONT_ACROSS, REAR_ACROSS, YAW, WORLD_X, WORLD_Y, DRIVEN_ALONG, ROLLING, WHEEL_ANGLE = range(10)
COEFFICIENT, DIRECTION, PHASE, WAVE = 0, 1, 2, 3  # columns of the table of functions; the last and those behind it: k_j
COLUMNS = WAVE + len(INPUTS)
ROLLING_V = 0.05  # m/s, well above which a car rolls: where dry friction has its full size
MOST = 224
"""Functions that a fit may hold."""
SETS = 3  # a fit's, and those of a simulation that was itself fitted beside another's
ROOM = SETS * MOST
"""Functions that the table has room for, in so many sets, each over ranges of its own."""


class RemainderInputs(NamedTuple):
    """The quantities on which a remainder's functions depend, in the order of INPUTS."""

    v_x: float
    omega: float
    v_fx: float
    alpha_f: float
    alpha_r: float
    delta: float
    delta_rate: float
    u_m: float
    p_x: float
    p_y: float
    t: float
