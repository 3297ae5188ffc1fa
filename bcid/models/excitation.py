"""What a set of takes cannot show, whatever is fitted to them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bcid.errors import InputRefused
from bcid.estimate.types import Estimate

LEAST_SPEED = 0.05  # m/s
LEAST_YAW_RATE = 0.02  # rad/s
OF_MOTION = "K_t, R_1, R_2 and all others"
OF_TURNING = "C_f, C_r, F_f_max, F_r_max and I_z"


def check_excited(estimates: Sequence[Estimate]) -> None:
    """Raise `InputRefused`, naming the constants, where no fit could find them: the car stands, or never turns."""
    twist = np.concatenate([e.twist for e in estimates])
    speed, yaw_rate = np.quantile(np.hypot(twist[:, 0], twist[:, 1]), 0.95), np.quantile(np.abs(twist[:, 2]), 0.95)
    place, next_step = "motion", "drive curves at several speeds (`bcid plan` writes commands), or add such a take"
    names = ", ".join(e.name for e in estimates)
    if speed < LEAST_SPEED:
        raise InputRefused(names, place, f"the car stands: {OF_MOTION} cannot be identified", next_step)
    if yaw_rate < LEAST_YAW_RATE:
        raise InputRefused(names, place, f"straight driving only: {OF_TURNING} cannot be identified", next_step)
