"""From paths at integration steps to the mean poses that a take holds.

Between two steps a coordinate runs by Hermite's cubic through its values and rates at both, and a mean over poses is a
weighted sum: a mean pose is linear in the path.  So its weights are found once for LANES segments, and applied to all
coordinates, and to all their derivatives.
"""

import numpy as np

from bcid.aliases import Floats, Ints, Switches
from bcid.compiled.lane_access import load_lanes, store_lanes
from bcid.compiled.lanes import LANES
from bcid.compiled.njit import njit
from bcid.effects.measurement import body_yaw_misalignment, pose_scale
from bcid.likelihood.lane_rollout import PATH_RATE, PATH_SIZE, LaneSegments, SegmentLayout


@njit
def observe_means(
    out: Floats, place: Ints, begin: int, path: Floats, count: int, lanes: LaneSegments, layout: SegmentLayout, h: float
) -> None:
    """Write the mean x, y, yaw of C paths at the rows of the segments in the first `count` lanes to `out`.

    They are its columns (N, 3, begin + C) from `begin` on; the rows of a lane begin at `place` (LANES,).  `path`
    (steps + 1, C PATH_SIZE, LANES) holds x, y, yaw and their rates of C paths, or of C derivatives of one, at steps of
    `h` s.  A row averages the poses within 0.05 s.
    """
    n, steps, paths = path.shape[1], len(path) - 1, path.shape[1] // PATH_SIZE
    flat, mean = path.reshape(path.size), np.empty(LANES)
    weights = np.zeros((steps + 1, 2, LANES))  # of value and rate at each step
    by_step, stamp = weights.reshape(weights.size), layout.first_stamp[lanes.s]
    rows = layout.first[lanes.s + 1] - layout.first[lanes.s]
    for r in range(rows[:count].max()):
        low, high = _row_weights(weights, r, stamp, count, lanes, layout, h)
        for k in range(paths):
            for j in range(3):
                total = 0.0 * load_lanes(by_step, 0)
                for i in range(low, high + 1):
                    at = (i * n + k * PATH_SIZE + j) * LANES
                    total += load_lanes(by_step, 2 * i * LANES) * load_lanes(flat, at)
                    total += load_lanes(by_step, (2 * i + 1) * LANES) * load_lanes(flat, at + PATH_RATE * LANES)
                store_lanes(total, mean, 0)
                for lane in range(count):
                    if r < rows[lane]:
                        out[place[lane] + r, j, begin + k] = mean[lane]
        weights[low : high + 1] = 0.0


@njit
def _row_weights(
    weights: Floats, r: int, stamp: Ints, count: int, lanes: LaneSegments, layout: SegmentLayout, h: float
) -> tuple[int, int]:
    """Add the weights of row `r` of `count` segments to `weights` (steps + 1, 2, LANES), zeros before.

    Returns the first and the last step that has any.  `stamp` (LANES,) is the first pose of the row in each segment,
    and is moved on to the next row's.
    """
    low, high = len(weights) - 1, 0
    for lane in range(count):
        s = lanes.s[lane]
        begin, row = layout.zero_s[s] + lanes.begin[lane], layout.first[s] + r
        while stamp[lane] < layout.first_stamp[s + 1] and layout.row[stamp[lane]] == row:
            j = stamp[lane]
            at = (layout.stamp_s[j] - begin) / h
            i = min(max(int(np.ceil(at)) - 1, 0), len(weights) - 2)
            u, share = at - i, layout.share[j]
            v = 1.0 - u
            weights[i, 0, lane] += share * (1.0 + 2.0 * u) * v * v
            weights[i, 1, lane] += share * u * v * v * h
            weights[i + 1, 0, lane] += share * u * u * (3.0 - 2.0 * u)
            weights[i + 1, 1, lane] -= share * u * u * v * h
            low, high = min(low, i), max(high, i + 1)
            stamp[lane] += 1
    return low, high


@njit
def apply_tracking(poses: Floats, e: Switches) -> None:
    """Change `poses` (n, 3), x, y (m), yaw (rad), by the scale and the misalignment of the tracking in `e`."""
    for i in range(len(poses)):
        poses[i, 0], poses[i, 1] = pose_scale(poses[i, 0], poses[i, 1], e.pose_scale__kappa)
        poses[i, 2] = body_yaw_misalignment(poses[i, 2], e.body_yaw_misalignment__psi)
