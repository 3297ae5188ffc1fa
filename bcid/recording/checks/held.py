"""Poses that the tracking repeats to the last digit: a moving body never measures the same twice.

A repeat is a measurement only where the car stood, or where it moved by less than the digits in which poses are
written.  A car that stood goes on from where it was; one that was hidden has moved meanwhile.
"""

import math

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.recording.checks.pose_noise import white_noise, wrap_angles, written_digits
from bcid.recording.checks.rowwise import find_runs
from bcid.recording.checks.samples import Samples, note_rows, throttle_at
from bcid.recording.limits import POSE as LIMITS

STEPS_AFTER = 3  # of which the longest shows how a car goes on


def drop_held_poses(poses: Samples) -> Samples:
    """The poses without repetitions, where a table or topic of higher rate repeats each until the next one comes."""
    changed = np.r_[True, (np.diff(poses.values, axis=0) != 0.0).any(axis=1)]
    changes = np.flatnonzero(changed)
    if len(changes) < 3:
        return poses
    samples = np.diff(changes)
    most = float(np.quantile(samples, LIMITS.regular_quantile))
    mean = float(np.minimum(samples, most).mean())
    # runs of other lengths are failures of the tracking
    regular = most <= math.ceil(mean) + 1
    if mean < LIMITS.min_held_samples or not regular or _moves_by_digits(poses.values[changes]):
        return poses
    age = np.arange(len(changed)) - np.maximum.accumulate(np.where(changed, np.arange(len(changed)), 0))
    # longer runs are those of a car that stands, or of the tracking
    again = (age > 0) & ((age <= most) | (age % max(1, round(mean)) != 0))
    text = f"each pose is held for {mean:.3g} samples: the first of them counts"
    return poses.without(again, "pose held", "fixed", text)


def _moves_by_digits(values: Floats) -> bool:
    """Whether successive different poses (N, 3) lie but a digit apart, so that a repeat says nothing."""
    far = _change(values[:-1], values[1:]) > _blur_by_digits(values)
    return bool(far.any(axis=1).mean() < 0.5)


def _blur_by_digits(values: Floats) -> Floats:
    """Changes (n,) of the columns of poses (N, 3) up to which a repeat is one of coarse digits; 0 for fine columns."""
    digits = written_digits(values)
    return np.where(digits > 0.0, LIMITS.max_digits * digits + LIMITS.max_digit_noises * white_noise(values), 0.0)


def _change(before: Floats, after: Floats) -> Floats:
    """Sizes of the changes of x, y (m) and yaw (rad) from poses `before` (..., 3) to poses `after` (..., 3)."""
    change = after - before
    return np.asarray(np.abs(np.concatenate([change[..., :2], wrap_angles(change[..., 2:])], axis=-1)))


def drop_frozen_poses(poses: Samples, commands: Samples) -> Samples:
    """The poses without those that repeat the one before to the last digit while the car moves on, however few.

    Where a car went on from there after over `POSE.max_repeat_s`, it stood, as at a wall: such poses are kept, with a
    warning if the throttle was on.
    """
    time_s, values = poses.time_s, poses.values
    frozen, stands = np.zeros(len(time_s), dtype=bool), np.zeros(len(time_s), dtype=bool)
    throttle = throttle_at(time_s, commands)
    same = np.r_[False, (np.diff(values, axis=0) == 0.0).all(axis=1)]
    blurred = _blur_by_digits(values)
    way = np.hypot(*np.diff(values[:, :2], axis=0).T)
    usual = float(np.quantile(way[way > 0.0], LIMITS.usual_quantile)) if (way > 0.0).any() else 0.0
    for a, b in find_runs(same):
        lasts = time_s[b - 1] - time_s[a - 1] > LIMITS.max_repeat_s
        pushed = bool(throttle[a:b].min() > 0.0)
        # at the end of the take, the motion before it shows how far the car may have gone
        far = _change(values[a - 1], values[b] if b < len(values) else values[max(0, 2 * a - b - 2)])
        if (far <= blurred).all():
            continue
        if not _stood(way, a, b, usual, lasts, pushed):
            # where the body jumped to what is held, the first of it is no measurement either
            jumped = a >= 2 and not same[a - 2] and way[a - 2] > LIMITS.max_step_to_held * usual
            frozen[a - 1 if jumped else a : b] = True
        elif lasts and pushed:
            stands[a:b] = True
    turned = _held_yaw(time_s, values) & ~frozen
    text = "the same pose again, to the last digit, while the car moves on: held by the tracking"
    noted = [
        *poses.irregularities,
        *note_rows(time_s, frozen, "frozen pose", "excluded", text),
        *note_rows(time_s, turned, "frozen yaw", "excluded", "the same yaw, to the last digit, while the path turns"),
        *note_rows(
            time_s, stands, "pose stands", "warning",
            "the same pose again and again while the throttle is on: it goes on from there, as from a wall",
        ),
    ]  # fmt: skip
    kept = ~frozen & ~turned
    return Samples(time_s[kept], values[kept], noted)


def _stood(way: Floats, a: int, b: int, usual: float, lasts: bool, pushed: bool) -> bool:
    """Whether a car that repeats the pose of row a - 1 in the rows a to b - 1 stood there, by its steps `way` (N - 1,).

    `usual` is the length of a step in motion (m); the repeats are `lasts` for long and `pushed` by the throttle.
    """
    slow_before = a < 2 or way[a - 2] <= LIMITS.max_rest_step * usual
    if b > len(way):
        return slow_before or (lasts and not pushed)
    after = float(way[b : b + STEPS_AFTER].max(initial=0.0))
    if lasts:
        return bool(way[b - 1] <= LIMITS.max_resume_steps * max(usual, after))
    return bool(slow_before and way[b - 1] <= LIMITS.max_start_steps * after)


def _held_yaw(time_s: Floats, values: Floats) -> Bools:
    """Mask (N,) of poses (N, 3) that repeat a yaw to the last digit for long while the path turns."""
    held = np.zeros(len(time_s), dtype=bool)
    clear = LIMITS.min_path_noises * float(np.hypot(*(white_noise(values) + written_digits(values))[:2]))
    for a, b in find_runs(np.r_[False, np.diff(values[:, 2]) == 0.0]):
        if time_s[b - 1] - time_s[a - 1] <= LIMITS.max_repeat_s or b - a > LIMITS.max_held_yaw_share * len(held):
            continue
        first, _, last = np.diff(values[np.linspace(a - 1, b - 1, 4).astype(int), :2], axis=0)
        turn = abs(math.remainder(math.atan2(last[1], last[0]) - math.atan2(first[1], first[0]), math.tau))
        held[a:b] = turn > LIMITS.min_path_turn_rad and min(math.hypot(*first), math.hypot(*last)) > clear
    return held
