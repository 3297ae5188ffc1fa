"""Poses that lie on a straight line between their neighbours: written by an export or a script, measured by nobody.

Noise bends every measured path from sample to sample.  Where several rows in turn do not bend at all, a gap has been
filled; where all rows but each second, third … are straight, a table was filled up to a higher rate.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.recording.checks.pose_noise import rounding_step
from bcid.recording.checks.rowwise import find_runs, lengths_of_rows
from bcid.recording.checks.samples import Samples, note_rows
from bcid.recording.limits import INTERPOLATION as LIMITS

COMPARED, COMPARED_DECIMALS = 2000, 6  # bends, in the largest of them


class PathBends(NamedTuple):
    """Where the path of a body in motion is straight from row to row, and where it is not."""

    straight: Bools  # (N,)
    corner: Bools  # (N,)


def drop_interpolated_poses(poses: Samples) -> Samples:
    """The poses x, y, yaw (N, 3) without those that straight lines between measured ones have put in.

    Rows that stand still are repeats, and judged elsewhere.  A simulator that changes its speed at even times looks
    like a table that was filled up: its corners hold all that it says.
    """
    bends = _find_bends(poses.time_s, poses.values[:, :2])
    corners, straight = find_runs(bends.corner), bends.straight.sum()
    if straight <= LIMITS.min_straight_share * (straight + bends.corner.sum()):
        return _drop_filled_gaps(poses, bends)
    return _thin_filled_table(poses, bends, corners) if _are_evenly_spaced(corners) else poses


def _thin_filled_table(poses: Samples, bends: PathBends, corners: Ints) -> Samples:
    """The poses of a table that was filled up, if its `corners` (C, 2) are measured ones: these, and as many at rest.

    Where a measured pose fell between two rows, both of them bend: nothing is left out there, with a warning.
    """
    time_s, straight, apart = poses.time_s, bends.straight, np.diff(corners[:, 0])
    usual = np.abs(apart - np.median(apart)) <= 1
    rate_hz = 1.0 / (float(apart[usual].mean()) * float(np.median(np.diff(time_s))))
    text = f"on straight lines between poses that come at {rate_hz:.3g} Hz"
    if np.median(np.diff(corners, axis=1)) > 1:
        text = f"{text}, of which few are rows: log the poses as they are measured"
        noted = note_rows(time_s, straight, "pose interpolated", "warning", text)
        return poses._replace(irregularities=[*poses.irregularities, *noted])
    row = np.arange(len(time_s))
    after = row - np.maximum.accumulate(np.where(bends.corner, row, 0))
    at_rest = ~straight & ~bends.corner
    between = at_rest & (after % int(np.median(apart)) != 0)
    return poses.without(straight | between, "pose interpolated", "fixed", f"{text}: these count")


def _drop_filled_gaps(poses: Samples, bends: PathBends) -> Samples:
    """The poses without straight lines over gaps: told only where noise is seen, as a smooth path may be straight.

    Where single rows are straight as well, digits make them so.
    """
    runs = find_runs(bends.straight)
    gaps = runs[runs[:, 1] - runs[:, 0] >= LIMITS.min_filled_rows]
    filled = np.zeros(len(bends.straight), dtype=bool)
    for a, b in gaps:
        filled[a:b] = True
    single = (bends.straight & ~filled).sum()
    by_chance = single > LIMITS.max_single_share * bends.corner.sum()
    if not len(gaps) or by_chance or not _bends_by_noise(poses, bends.corner):
        return poses
    text = f"a straight line over {len(gaps)} gaps: nothing was measured there"
    return poses.without(filled, "pose gap filled", "excluded", text)


def _find_bends(time_s: Floats, xy: Floats) -> PathBends:
    """Where the path through positions (N, 2) in m at times (N,) in s bends, if its digits show it.

    A line is straight by time, as by `numpy.interp`, or by row.
    """
    bends = PathBends(np.zeros(len(xy), dtype=bool), np.zeros(len(xy), dtype=bool))
    step, dt = np.diff(xy, axis=0), np.diff(time_s)
    far = lengths_of_rows(step)
    moving = (far[:-1] > 0.0) & (far[1:] > 0.0)
    by_row = 0.5 * lengths_of_rows(step[1:] - step[:-1])
    share = (dt[:-1] / (dt[:-1] + dt[1:]))[:, None]
    bend = np.minimum(by_row, lengths_of_rows(share * step[1:] - (1.0 - share) * step[:-1]))
    rounding = LIMITS.rounding_steps * rounding_step(xy)
    clear = by_row[moving & (by_row > rounding)]
    if len(clear) < LIMITS.min_bends:
        return bends
    usual = float(np.quantile(clear, LIMITS.usual_quantile))
    if _is_coarse(clear):  # of digits that are no decimals, as of an encoder's ticks
        rounding = max(rounding, LIMITS.rounding_steps * float(np.quantile(clear, LIMITS.digit_quantile)))
    if usual > LIMITS.min_bend_by_rounding * rounding:
        least = max(LIMITS.max_straight_share * usual, rounding)
        # at rest a path is as straight as rounding lets it be
        going = moving & (np.minimum(far[:-1], far[1:]) > LIMITS.min_step_by_bend * least)
        bends.straight[1:-1] = going & (bend <= least)
        bends.corner[1:-1] = moving & (bend > least)
    return bends


def _is_coarse(bends: Floats) -> bool:
    """Whether bends (n,) in m are multiples of a digit: few of them are different."""
    some = bends[:: max(1, len(bends) // COMPARED)]
    alike = np.unique(np.round(some / bends.max(), COMPARED_DECIMALS))
    return len(alike) < LIMITS.max_coarse_share * len(some)


def _are_evenly_spaced(corners: Ints) -> bool:
    """Whether the runs (C, 2) of rows that are corners are of one row, or of two, and come at one rate."""
    rows, apart = np.diff(corners, axis=1)[:, 0], np.diff(corners[:, 0])
    if not len(apart):
        return False
    at_one_rate = np.abs(apart - np.median(apart)) <= 1
    return bool(min((rows <= 2).mean(), at_one_rate.mean()) > LIMITS.min_regular_share)


def _bends_by_noise(poses: Samples, corner: Bools) -> bool:
    """Whether a path bends at its `corner` rows (N,) by white noise, whose third differences are 1.8 times its second.

    Those of a smooth path are far smaller, and those of one whose acceleration is noise 1.4 times.  Differences by row
    as well as by time must show it, as a stamp's jitter looks like noise, too.
    """
    known = corner[1:-2] & corner[2:-1]
    if not known.any():
        return False
    xy, time_s = poses.values[:, :2], poses.time_s
    ratios = []
    for t in (np.arange(len(xy), dtype=float), time_s):
        second, third = (lengths_of_rows(_divided_difference(xy, t, order))[: len(known)] for order in (2, 3))
        ratios.append(np.median(third[known]) / np.median(second[known]) * np.median(np.diff(t)))
    return bool(min(ratios) > LIMITS.min_noise_ratio)


def _divided_difference(xy: Floats, t: Floats, order: int) -> Floats:
    """The difference quotient (N - order, 2) of positions (N, 2) by `t` (N,): of whole numbers the plain difference."""
    for k in range(1, order + 1):
        xy = np.diff(xy, axis=0) * (k / (t[k:] - t[:-k]))[:, None]
    return xy
