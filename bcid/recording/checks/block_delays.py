"""By how much the commands act later than stamped in each block of a take: a fit, and what its residuals say beyond."""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.recording.checks.steering_fit import NAMES, SteeringFit, predicted_turn
from bcid.recording.checks.turning import TurningData, split_at_blocks
from bcid.vehicle import Vehicle

DELAY = NAMES.index("delay_s")
DERIVATIVE_STEP_S = 5e-3  # of the numerical derivative by the delay


class BlockDelays(NamedTuple):
    """What each of B blocks of a take says of the delay of the commands."""

    middle_s: Floats  # (B,)
    delay_s: Floats  # (B,)
    information: Floats  # (B,) sum of squared derivatives (rad/s^2) by the delay


def block_delays(
    data: TurningData, vehicle: Vehicle, fit: SteeringFit, block_s: float, min_share: float
) -> BlockDelays:  # fmt: skip
    """The delay of each block of `block_s` (s): that of the `fit`, and what its residuals say beyond, by a Newton step.

    Blocks with less information than the share `min_share` of the usual one are left out.
    """
    sides = []
    for sign in (1.0, -1.0):
        theta = fit.theta.copy()
        theta[DELAY] += sign * DERIVATIVE_STEP_S
        sides.append(predicted_turn(theta, data, vehicle)[data.rows])
    slope = (sides[0] - sides[1]) / (2.0 * DERIVATIVE_STEP_S)
    left = data.turn[data.rows] - 0.5 * (sides[0] + sides[1])
    t = data.time_s[data.rows]
    found = [
        (float(t[rows].mean()), float(slope[rows] @ left[rows]), float(slope[rows] @ slope[rows]))
        for rows in split_at_blocks(np.arange(len(t)), t, block_s)
    ]
    middle, across, square = np.array(found).reshape(len(found), 3).T
    told = square > min_share * np.median(square)
    return BlockDelays(middle[told], fit.value("delay_s") + across[told] / square[told], square[told])
