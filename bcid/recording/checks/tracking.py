"""Failures of the tracking in a pose stream: held, frozen and flipped poses, other bodies, ghosts and jumps."""

import itertools
import math

import numpy as np
from scipy.ndimage import median_filter

from bcid.aliases import Bools, Floats, Ints
from bcid.errors import InputRefused
from bcid.recording.checks.samples import Samples, note_rows, sources_alternate
from bcid.recording.limits import POSE as LIMITS
from bcid.vehicle import Vehicle

NEIGHBOURS = 11  # pose steps whose median a step is compared with


def drop_held_poses(poses: Samples) -> Samples:
    """The poses without repetitions, where a table or topic of higher rate repeats each until the next one comes."""
    new = np.r_[True, (np.diff(poses.values, axis=0) != 0.0).any(axis=1)]
    changes = np.flatnonzero(new)
    if len(changes) < 3 or np.median(np.diff(changes)) < LIMITS.min_held_samples:
        return poses
    text = f"each pose is held for {np.median(np.diff(changes)):.0f} samples: the first of them counts"
    return poses.without(~new, "pose held", "fixed", text)


def drop_frozen_poses(poses: Samples, commands: Samples) -> Samples:
    """The poses without runs of the same pose, to the last digit, for over `POSE.max_repeat_s` under throttle.

    Such a pose is held by the tracking while the car moves on.  Where the next pose is close to it, the car stood, as
    at a wall: these poses are kept with a warning.
    """
    time_s, values = poses.time_s, poses.values
    same = np.r_[False, (np.diff(values, axis=0) == 0.0).all(axis=1)]
    edges = np.flatnonzero(np.diff(np.r_[False, same, False].astype(int)))
    frozen, stands = np.zeros(len(time_s), dtype=bool), np.zeros(len(time_s), dtype=bool)
    throttle = _throttle_at(time_s, commands)
    usual = float(np.quantile(np.hypot(*np.diff(values[:, :2], axis=0).T), 0.9))
    for a, b in edges.reshape(-1, 2):
        # a car that pushes against a wall goes on from where it stood, one that was hidden has moved meanwhile
        moved = b == len(values) or math.dist(values[b, :2], values[b - 1, :2]) > LIMITS.max_resume_steps * usual
        if time_s[b - 1] - time_s[a - 1] > LIMITS.max_repeat_s and throttle[a:b].min() > 0.0:
            (frozen if moved else stands)[a:b] = True
    text = "the same pose again and again while the throttle is on: "
    kept = poses.without(frozen, "frozen pose", "excluded", text + "held by the tracking")
    noted = note_rows(time_s, stands, "pose stands", "warning", text + "it goes on from there, as from a wall")
    return kept._replace(irregularities=[*kept.irregularities, *noted])


def drop_yaw_flips(poses: Samples, commands: Samples) -> Samples:
    """The poses without stretches whose yaw is off by 180 degrees, as symmetric markers cause.

    Jumps of the yaw by 180 degrees divide the poses into two alternating sets; the set in which the car would drive
    backward under throttle is dropped.
    """
    yaw = poses.values[:, 2]
    step = np.diff(poses.time_s)
    half = np.abs(np.abs(np.angle(np.exp(1j * np.diff(yaw)))) - math.pi) < LIMITS.flip_tolerance_rad
    # over a gap the car may have turned round
    half &= step < LIMITS.max_flip_steps * float(np.median(step))
    if not half.any():
        return poses
    turned = np.r_[0, np.cumsum(half)] % 2 == 1
    if _forward_alignment(poses, commands, turned) > _forward_alignment(poses, commands, ~turned):
        turned = ~turned
    text = "the yaw jumps by 180 degrees: symmetric markers; what would drive backwards is left out"
    return poses.without(turned, "yaw flip", "excluded", text)


def _forward_alignment(poses: Samples, commands: Samples, rows: Bools) -> float:
    """Mean cosine between yaw and motion under throttle in the marked rows: 1 forward, -1 backward, 0 unknown."""
    step = np.diff(poses.values[:, :2], axis=0)
    far = np.hypot(*step.T)
    use = rows[1:] & rows[:-1] & (far > LIMITS.min_heading_step * np.quantile(far, 0.95))
    use &= _throttle_at(poses.time_s[1:], commands) > 0.0
    if not use.any():
        return 0.0
    return float(np.cos(np.arctan2(step[use, 1], step[use, 0]) - poses.values[1:][use, 2]).mean())


def _throttle_at(time_s: Floats, commands: Samples) -> Floats:
    """Throttle u_m (N,) (m/s, a brake share below 0) of the latest command at each time (N,); 0 before the first."""
    row = np.searchsorted(commands.time_s, time_s, side="right") - 1
    return np.where(row >= 0, commands.values[np.maximum(row, 0), 1], 0.0)


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
    noise = LIMITS.jump_noise_factor * (1.4826 * float(np.median(np.abs(speed - around))))
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
    noted = [i for reason, rows in left_out.items() for i in note_rows(time_s, rows, "tracking", "excluded", reason)]
    at_jump = np.isin(np.arange(len(time_s)), jumps)
    kept = ~np.any([np.zeros(len(time_s), dtype=bool), *left_out.values()], axis=0)
    far = max((math.dist(xy[j], xy[j - 1]) for j in jumps), default=0.0)
    text = f"by up to {far:.3f} m from one sample to the next: split there"
    noted += note_rows(time_s, at_jump, "pose jump", "excluded", text)
    kept_s = time_s[kept]
    breaks = sorted({float(kept_s[k]) for k in np.searchsorted(kept_s, time_s[jumps]) if 0 < k < len(kept_s)})
    return Samples(kept_s, poses.values[kept], [*poses.irregularities, *noted]), breaks


def _find_outliers_and_ghosts(poses: Samples, commands: Samples, jumps: Ints, vehicle: Vehicle) -> dict[str, Bools]:
    """Masks (N,) of poses to leave out, by the reason in words: outliers, ghosts, and poses held by the tracking.

    `jumps` are rows whose pose jumps away from the one before.  An outlier is a short stretch between two jumps; a
    ghost is a part beside a jump that stands still while the throttle is on, such as another body taken for the car;
    a held pose is one that the tracking repeats to the last digit.
    """
    time_s, xy = poses.time_s, poses.values[:, :2]
    size = LIMITS.ghost_size * vehicle.body.wheelbase_m
    driven = _throttle_at(time_s, commands) > 0.0
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
