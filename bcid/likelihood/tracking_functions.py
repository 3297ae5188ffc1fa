"""What the tracking does without a name: smooth functions of place and time added to the poses that are seen.

Function j is c_j cos(k_j . s + phi_j) of s = (p_x, p_y, t), and moves the seen pose in one of TRACKING_DIRECTIONS.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints

TRACKING_INPUTS = ("p_x", "p_y", "t")
TRACKING_DIRECTIONS = ("seen_x", "seen_y", "seen_yaw", "seen_along", "seen_across", "seen_late")
"""Metres in the world, rad, metres along and across the body, and seconds by which a pose is seen late."""

AMOUNT, INTO, SHIFT, FIRST_WAVE = 0, 1, 2, 3  # columns of the table of functions: c_j, direction, phi_j, then k_j
TRACKING_COLUMNS = FIRST_WAVE + len(TRACKING_INPUTS)
NO_TRACKING = np.zeros((0, TRACKING_COLUMNS))


class SeenRows(NamedTuple):
    """When the rows of a take were seen."""

    time_s: Floats  # (N,) since the recording began
    first: Ints  # (S + 1,) segment s has the rows first[s] to first[s + 1]


def tracking_changes(functions: Floats, poses: Floats, rows: SeenRows) -> Floats:
    """Changes (N, 3, M) of seen poses x, y (m), yaw (rad) by a unit of each of M `functions`, at predicted `poses`."""
    if not len(functions) or not len(poses):
        return np.zeros((*poses.shape, len(functions)))
    s = np.column_stack([poses[:, 0], poses[:, 1], rows.time_s])
    values = np.cos(s @ functions[:, FIRST_WAVE:].T + functions[:, SHIFT])
    units = _unit_changes(poses, rows)
    return np.asarray(values[:, None, :] * units[:, :, functions[:, INTO].astype(int)])


def _unit_changes(poses: Floats, rows: SeenRows) -> Floats:
    """Changes (N, 3, 6) of poses by a unit of each direction."""
    units = np.zeros((*poses.shape, len(TRACKING_DIRECTIONS)))
    cos_t, sin_t = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    for c in range(3):
        units[:, c, c] = 1.0
    units[:, 0, 3], units[:, 1, 3] = cos_t, sin_t
    units[:, 0, 4], units[:, 1, 4] = -sin_t, cos_t
    units[:, :, 5] = -_rates(poses, rows)
    return units


def _rates(poses: Floats, rows: SeenRows) -> Floats:
    """Rates (N, 3) of poses, by differences to the rows before and after of the same segment; 0 where it has one row.

    Between two neighbours they are of second order, as of a parabola through three points; at ends of first order.
    """
    ends = np.zeros(len(poses) - 1, dtype=bool)  # between the last row of a segment and the first of the next
    ends[rows.first[1:-1] - 1] = True
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = np.diff(poses, axis=0) / np.diff(rows.time_s)[:, None]
    slope[ends] = 0.0
    gap = np.where(ends, 0.0, np.diff(rows.time_s))
    before, after = np.r_[0.0, gap], np.r_[gap, 0.0]
    left, right = np.vstack([np.zeros(3), slope]), np.vstack([slope, np.zeros(3)])
    whole = before + after
    shares = np.divide(after, whole, out=np.zeros_like(whole), where=whole > 0.0)[:, None]
    # the nearer neighbour counts more; where there is but one, it is all there is
    inner = ((before > 0.0) & (after > 0.0))[:, None]
    return np.where(inner, shares * left + (1.0 - shares) * right, left + right)
