"""Failures of the tracking in a pose stream: other bodies, ghosts, and jumps of the position."""

import itertools
import math

import numpy as np
from scipy.ndimage import median_filter

from bcid.aliases import Bools, Floats, Ints
from bcid.errors import InputRefused
from bcid.recording.checks.attitude import rotate_vectors
from bcid.recording.checks.pose_noise import written_digits
from bcid.recording.checks.samples import Samples, note_rows, sources_alternate, throttle_at
from bcid.recording.checks.yaw_jumps import steady_rates
from bcid.recording.limits import POSE as LIMITS
from bcid.vehicle import Vehicle

NEIGHBOURS = 11  # pose steps whose median a step is compared with


def _find_jumps(poses: Samples, vehicle: Vehicle) -> Ints:
    """Rows whose pose lies farther from the one before than the vehicle can drive in that time (`mocap.max_speed_mps`).

    Rows are also marked where the speed from pose to pose far exceeds the median of its neighbours
    (`POSE.jump_factor`, `jump_speed_mps`, `jump_acceleration_mps2`).
    """
    step_s = np.diff(poses.time_s)
    # two stamps that nearly coincide give no speed
    step_s = np.maximum(step_s, 0.5 * float(np.median(step_s)))
    limit = vehicle.mocap.max_speed_mps or LIMITS.max_speed_mps
    speed = np.hypot(*np.diff(poses.values[:, :2], axis=0).T) / step_s
    around = median_filter(speed, NEIGHBOURS, mode="nearest")
    # coarse digits make steps of their own
    digit = float(written_digits(poses.values[:, :2]).max())
    scatter = 1.4826 * float(np.median(np.abs(speed - around)))
    noise = LIMITS.jump_noise_factor * scatter + LIMITS.max_digits * digit / step_s
    sudden = speed > np.maximum(LIMITS.jump_factor * around, LIMITS.jump_speed_mps) + noise
    sudden &= speed - around > LIMITS.jump_acceleration_mps2 * step_s
    if np.quantile(around, 0.95) > limit:
        # the whole take is too fast, not some samples
        sudden |= speed > limit
    return np.flatnonzero(sudden | (speed > limit + noise)) + 1


def split_at_jumps(poses: Samples, commands: Samples, vehicle: Vehicle, source: str) -> tuple[Samples, list[float]]:
    """The poses without outliers and ghosts, and the times (s) of the first poses left after each jump.

    A ghost is a part of the poses beside a jump that stands still while the throttle is on: another body taken for
    the car, or the last pose of a body that the tracking lost.

    Raises:
        InputRefused: two bodies alternate, or over `POSE.max_jump_share` of the steps are jumps.
    """
    if sources_alternate(poses.values[:, :2]):
        cause = "two bodies alternate: several publishers on the topic, a label that swaps, or two stretches mixed"
        raise InputRefused(source, "pose", cause, "record one body a topic, or name it in the vehicle file")
    time_s, xy = poses.time_s, poses.values[:, :2]
    jumps = _find_jumps(poses, vehicle)
    if len(jumps) > LIMITS.max_jump_share * len(xy):
        raise InputRefused(
            source, "pose", f"{len(jumps)} of {len(xy)} pose steps are faster than the car: "
            "lengths in mm or cm, a body that swaps, or two stretches of time mixed?",
            "set the unit (mocap.length_unit, or a gain in [columns]), or mocap.max_speed_mps; check the body",
        )  # fmt: skip
    left_out = _find_outliers_and_ghosts(poses, commands, jumps, vehicle)
    away, mended = _find_returns(poses, jumps)
    known = np.any([np.zeros(len(time_s), dtype=bool), *left_out.values()], axis=0)
    left_out["away by a jump and back by another: another body, or another point of it"] = away & ~known
    noted = [i for reason, rows in left_out.items() for i in note_rows(time_s, rows, "tracking", "excluded", reason)]
    kept = ~(known | away)
    # where the track goes on after an outlier as before it, nothing is split
    jumps = np.setdiff1d(jumps, mended)
    at_jump = np.isin(np.arange(len(time_s)), jumps)
    far = max((math.dist(xy[j], xy[j - 1]) for j in jumps), default=0.0)
    text = f"by up to {far:.3f} m from one sample to the next: split there"
    noted += note_rows(time_s, at_jump, "pose jump", "excluded", text)
    kept_s = time_s[kept]
    breaks = sorted({float(kept_s[k]) for k in np.searchsorted(kept_s, time_s[jumps]) if 0 < k < len(kept_s)})
    return Samples(kept_s, poses.values[kept], [*poses.irregularities, *noted]), breaks


def _find_returns(poses: Samples, jumps: Ints) -> tuple[Bools, Ints]:
    """Mask (N,) of longer stretches between a jump away and one back, and the `jumps` (rows) beside short ones.

    The jump back undoes the jump away on the floor, as of another body, or on the car, as of another point of it.
    """
    time_s, xy, yaw = poses.time_s, poses.values[:, :2], poses.values[:, 2]
    away, mended = np.zeros(len(time_s), dtype=bool), list[int]()
    if len(jumps) < 2:
        return away, np.array(mended, dtype=np.int64)
    step_s = np.diff(time_s)
    is_jump = np.isin(np.arange(1, len(time_s)), jumps)
    velocity = np.column_stack([steady_rates(v, is_jump) for v in (np.diff(xy, axis=0) / step_s[:, None]).T])
    leap = (np.diff(xy, axis=0) - velocity * step_s[:, None])[jumps - 1]
    on_car = rotate_vectors(leap, -yaw[jumps])
    edges = np.r_[0, jumps, len(time_s)]
    for k in range(len(jumps) - 1):
        before, a, b, after = edges[k : k + 4]
        left = min(math.hypot(*(leap[k] + leap[k + 1])), math.hypot(*(on_car[k] + on_car[k + 1])))
        if left > LIMITS.max_return_share * math.hypot(*leap[k]) or away[before:a].any():
            continue
        if time_s[b - 1] - time_s[a] < LIMITS.max_outlier_s:
            mended += [int(a), int(b)]
        else:
            away[a:b] = b - a < LIMITS.max_excursion_share * (after - before)
    return away, np.array(mended, dtype=np.int64)


def _find_outliers_and_ghosts(poses: Samples, commands: Samples, jumps: Ints, vehicle: Vehicle) -> dict[str, Bools]:
    """Masks (N,) of poses to leave out, by the reason in words: outliers, ghosts, and poses held by the tracking.

    `jumps` are rows whose pose jumps away from the one before.  An outlier is a short stretch between two jumps; a
    ghost is a part beside a jump that stands still while the throttle is on, such as another body taken for the car;
    a held pose is one that the tracking repeats to the last digit.
    """
    time_s, xy = poses.time_s, poses.values[:, :2]
    size = LIMITS.ghost_size * vehicle.body.wheelbase_m
    driven = throttle_at(time_s, commands) > 0.0
    left_out = dict[str, Bools]()

    def leave_out(i: int, j: int, reason: str) -> None:
        """Mark the rows from i to before j as left out for this reason."""
        left_out.setdefault(reason, np.zeros(len(time_s), dtype=bool))[i:j] = True

    for a, b in itertools.pairwise([0, *jumps, len(time_s)]):
        begins, ends = a > 0, b < len(time_s)
        if begins and ends and time_s[b - 1] - time_s[a] < LIMITS.max_outlier_s:
            leave_out(a, b, "an outlier between two jumps")
            continue
        for i, j in _find_standing_parts(xy, a, b, begins, ends, size):
            min_s = LIMITS.max_outlier_s if (i, j) == (a, b) else LIMITS.min_ghost_s
            # to the last digit: the tracking held the pose, whatever the throttle does
            held = bool((xy[i:j] == xy[i]).all())
            if time_s[j - 1] - time_s[i] >= min_s and (held or driven[i:j].mean() > LIMITS.min_driven_share):
                leave_out(i, j, "held by the tracking" if held else "stands still while the throttle is on: a ghost")
    return left_out


def _find_standing_parts(xy: Floats, a: int, b: int, begins: bool, ends: bool, size: float) -> list[tuple[int, int]]:
    """Row ranges (first, end) at either end of a stretch where the position xy (N, 2) stands still within `size` (m).

    The stretch is rows `a` to `b` (excluded) of xy; only its ends at a jump count: `begins` after one, `ends` before.
    """
    parts = []
    for within in (size, 0.0):
        first, last = _count_still_samples(xy[a:b], within), _count_still_samples(xy[a:b][::-1], within)
        if first == b - a:
            return [(a, b)] if begins or ends else []
        parts += ([(a, a + first)] if begins else []) + ([(b - last, b)] if ends else [])
    return list(dict.fromkeys(parts))


def _count_still_samples(xy: Floats, size: float) -> int:
    """The number of samples at the start of the positions xy (N, 2) that lie within `size` (m) of the first one."""
    far = np.hypot(*(xy - xy[0]).T) > size
    return int(np.argmax(far)) if far.any() else len(xy)
