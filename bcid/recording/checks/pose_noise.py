"""How finely poses are known: the white noise of a pose stream, and the digits that it is written in."""

import math

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.recording.limits import POSE as LIMITS

GAUSSIAN_MAD = 1.4826  # standard deviations in a median absolute deviation
THIRD_DIFFERENCE = math.sqrt(20.0)  # standard deviations of white noise in that of its third differences
MOST_DECIMALS = 8  # of metres in which poses are written
MAX_DECIMAL_ERROR = 1e-4  # of a number of such decimals, by the arithmetic
DOUBLE_STEPS = 8.0  # by which arithmetic errs that turns and scales
ROUNDED_DECIMALS = 9  # of changes, beyond which they are errors of the arithmetic


def wrap_angles(angle: Floats) -> Floats:
    """The angles (N,) in rad, each brought into [-pi, pi] by full turns."""
    return np.asarray(np.angle(np.exp(1j * angle)))


def white_noise_sd(values: Floats, known: Bools) -> float:
    """Standard deviation of the white noise in evenly sampled smooth `values` (N,), by their third differences.

    Their median size is reached neither by a steady motion and its change, nor by some outliers.  Only differences of
    four rows that are all `known` (N,) count: a straight line over a gap has no noise.
    """
    third = np.diff(values, 3)[known[:-3] & known[1:-2] & known[2:-1] & known[3:]]
    return float(GAUSSIAN_MAD * np.median(np.abs(third)) / THIRD_DIFFERENCE) if len(third) else 0.0


def white_noise(pose: Floats) -> Floats:
    """Standard deviations (3,) of the white noise of x, y (m) and yaw (rad) in poses (N, 3) of an even rate.

    Repeats of a pose do not count; 0 of a few poses.
    """
    pose = pose[np.r_[True, (np.diff(pose, axis=0) != 0.0).any(axis=1)]]
    known = np.ones(len(pose), dtype=bool)
    return np.array([white_noise_sd(column, known) for column in (pose[:, 0], pose[:, 1], np.unwrap(pose[:, 2]))])


def rounding_step(values: Floats) -> float:
    """The step of decimals, or of floats of 32 or 64 bits, to which all `values` (N, n) are rounded, however fine.

    Values that were turned or scaled by something else have that of floats; `written_digits` finds any coarse one.
    """
    largest = float(np.abs(values).max(initial=0.0))
    for decimals in range(MOST_DECIMALS + 1):
        scaled = values * 10.0**decimals
        if (np.abs(scaled - np.round(scaled)) < MAX_DECIMAL_ERROR).all():
            return float(10.0**-decimals)
    single = bool((values.astype(np.float32) == values).all())
    return largest * float(np.finfo(np.float32).eps if single else DOUBLE_STEPS * np.finfo(np.float64).eps)


def written_digits(values: Floats) -> Floats:
    """The steps (n,) between neighbouring values that the columns of `values` (N, n) are written in; 0 for fine ones.

    The changes of a coarse column are few different multiples of its digit, those of a fine one nearly all different.
    Where all are one digit, the column often stays as well, which a steady motion does not.
    """
    steps = np.abs(np.diff(values, axis=0)).round(ROUNDED_DECIMALS)
    # a pose that is held changes in no column
    rows = (steps > 0.0).any(axis=1) if values.shape[1] > 1 else np.ones(len(steps), dtype=bool)
    digits = np.zeros(values.shape[1])
    for k, step in enumerate(steps[rows].T):
        moved = step[step > 0.0]
        different = len(np.unique(moved))
        steady = different == 1 and len(moved) > LIMITS.min_steady_share * len(step)
        if different < LIMITS.max_coarse_share * len(moved) and not steady:
            digits[k] = np.quantile(moved, LIMITS.digit_quantile)
    return digits
