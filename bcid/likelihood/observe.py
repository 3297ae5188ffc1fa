"""From paths at integration steps to the mean poses that a take holds.

Between two steps a coordinate runs by Hermite's cubic through its values and rates at both, and a mean over poses is a
weighted sum: a mean pose is linear in the path.  So its weights are found once for LANES segments, and applied to all
coordinates, and to all their derivatives.  A row can be observed as soon as the path has reached the last step that it
needs; of derivatives, which are many, only the steps that are still needed are kept.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints, Switches
from bcid.compiled.lane_access import load_lanes, store_lanes
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit, njit_inline
from bcid.effects.measurement import body_yaw_misalignment, pose_scale
from bcid.likelihood.lane_rollout import PATH_RATE, PATH_SIZE, LaneSegments, SegmentLayout


class RowSpans(NamedTuple):
    """Which integration steps the rows of LANES segments need, row r of all of them together."""

    low: Ints  # (rows,) the first
    high: Ints  # (rows,) the last
    kept: int  # how many steps must be kept, if rows are observed one after the other


@njit
def row_spans(count: int, lanes: LaneSegments, layout: SegmentLayout, h: float) -> RowSpans:
    """The integration steps, of `h` s, that the rows of the segments in the first `count` lanes need."""
    rows = layout.first[lanes.s + 1] - layout.first[lanes.s]
    most = rows[:count].max()
    low, high = np.full(most, layout.steps), np.ones(most, dtype=np.int64)
    for lane in range(count):
        s = lanes.s[lane]
        begin, first, end = layout.zero_s[s] + lanes.begin[lane], layout.first[s], layout.first_stamp[s + 1]
        for j in range(layout.first_stamp[s], end):
            # a row's first and last pose say where it lies
            r = layout.row[j] - first
            if j == layout.first_stamp[s] or layout.row[j - 1] != layout.row[j]:
                low[r] = min(low[r], _step_before((layout.stamp_s[j] - begin) / h, layout.steps))
            if j + 1 == end or layout.row[j + 1] != layout.row[j]:
                high[r] = max(high[r], _step_before((layout.stamp_s[j] - begin) / h, layout.steps) + 1)
    kept = 1
    # a row that waits for one before it begins no earlier than that one, and needs no more
    for r in range(most):
        kept = max(kept, high[r] - low[r] + 1)
    return RowSpans(low, high, kept)


@njit_inline
def _step_before(at: float, steps: int) -> int:
    """The integration step, of so many `steps`, within which or at whose end the instant `at` (in steps) lies."""
    return min(max(int(np.ceil(at)) - 1, 0), steps - 1)


class RowReader(NamedTuple):
    """What is needed to observe rows one after the other."""

    weights: Floats  # flat, (steps + 1, 2, LANES), of value and rate at each step; zeros between two rows
    stamp: Ints  # (LANES,) the first pose of the row to be observed next
    place: Ints  # (LANES,) where a lane's rows begin in what is written
    rows: Ints  # (LANES,) how many each lane has
    mean: Floats  # flat, (3, C, LANES), the means of a row


@njit
def row_reader(place: Ints, C: int, lanes: LaneSegments, layout: SegmentLayout) -> RowReader:
    """A reader of `C` paths that stands before the first row; a lane's rows begin at `place` of what is written."""
    rows, weights = layout.first[lanes.s + 1] - layout.first[lanes.s], np.zeros((layout.steps + 1) * 2 * LANES)
    return RowReader(weights, layout.first_stamp[lanes.s], place, rows, np.empty(3 * C * LANES))


@njit
def observe_means(
    out: Floats, place: Ints, path: Floats, count: int, lanes: LaneSegments, layout: SegmentLayout, h: float
) -> None:
    """Write the mean x, y, yaw of a path at the rows of the segments in the first `count` lanes to `out` (N, 3, 1).

    The rows of a lane begin at `place` (LANES,).  `path` (steps + 1, PATH_SIZE, LANES) holds x, y, yaw and their rates
    at steps of `h` s.  A row averages the poses within 0.05 s.
    """
    reader = row_reader(place, 1, lanes, layout)
    flat = path.reshape(path.size)
    for r in range(reader.rows[:count].max()):
        observe_row(out, 0, 1, r, flat, 1, reader, count, lanes, layout, h)


@njit
def observe_row(
    out: Floats, begin: int, end: int, r: int, path: Floats, C: int, reader: RowReader, count: int, lanes: LaneSegments,
    layout: SegmentLayout, h: float,
) -> None:  # fmt: skip
    """Write the mean x, y, yaw of paths at row `r` of the segments in the first `count` lanes to `out`.

    They are its columns (N, 3, ...) from `begin` to `end`.  `path`, flat, (kept, C, PATH_SIZE, LANES), holds x, y, yaw
    and their rates of C paths, or of C derivatives of one, at the steps of `h` s that were kept, step i at i modulo
    their number; the first of them are written.
    """
    weights, mean, n = reader.weights, reader.mean, C * PATH_SIZE * LANES
    low, high = _row_weights(weights, r, reader.stamp, count, lanes, layout, h)
    first = low * n % len(path)
    for k in range(end - begin):
        for j in range(3):
            total, at = 0.0 * load_lanes(weights, 0), first + (k * PATH_SIZE + j) * LANES
            for i in range(low, high + 1):
                total += load_lanes(weights, 2 * i * LANES) * load_lanes(path, at)
                total += load_lanes(weights, (2 * i + 1) * LANES) * load_lanes(path, at + PATH_RATE * LANES)
                at += n
                if at >= len(path):
                    at -= len(path)
            store_lanes(total, mean, (j * C + k) * LANES)
    for lane in range(count):
        if r < reader.rows[lane]:
            for j in range(3):
                to = out[reader.place[lane] + r, j]
                for k in range(end - begin):
                    to[begin + k] = mean[(j * C + k) * LANES + lane]
    weights[2 * low * LANES : 2 * (high + 1) * LANES] = 0.0


@njit
def _row_weights(
    weights: Floats, r: int, stamp: Ints, count: int, lanes: LaneSegments, layout: SegmentLayout, h: float
) -> tuple[int, int]:
    """Add the weights of row `r` of `count` segments to `weights`, flat, (steps + 1, 2, LANES), zeros before.

    Returns the first and the last step that has any.  `stamp` (LANES,) is the first pose of the row in each segment,
    and is moved on to the next row's.
    """
    low, high = layout.steps, 0
    for lane in range(count):
        s = lanes.s[lane]
        begin, row = layout.zero_s[s] + lanes.begin[lane], layout.first[s] + r
        while stamp[lane] < layout.first_stamp[s + 1] and layout.row[stamp[lane]] == row:
            j = stamp[lane]
            at = (layout.stamp_s[j] - begin) / h
            i, share = _step_before(at, layout.steps), layout.share[j]
            u = at - i
            v, k = 1.0 - u, 2 * i * LANES + lane
            weights[k] += share * (1.0 + 2.0 * u) * v * v
            weights[k + LANES] += share * u * v * v * h
            weights[k + 2 * LANES] += share * u * u * (3.0 - 2.0 * u)
            weights[k + 3 * LANES] -= share * u * u * v * h
            low, high = min(low, i), max(high, i + 1)
            stamp[lane] += 1
    return low, high


@njit
def apply_tracking(poses: Floats, e: Switches) -> None:
    """Change `poses` (n, 3), x, y (m), yaw (rad), by the scale and the misalignment of the tracking in `e`."""
    for i in range(len(poses)):
        poses[i, 0], poses[i, 1] = pose_scale(poses[i, 0], poses[i, 1], e.pose_scale__kappa)
        poses[i, 2] = body_yaw_misalignment(poses[i, 2], e.body_yaw_misalignment__psi)
