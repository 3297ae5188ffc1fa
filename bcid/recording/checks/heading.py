"""The mounting of the tracked body: poses whose yaw jumped away, for some samples or for good, are left out.

Stretches between the jumps of the yaw (`yaw_jumps`) that differ by no constant are of one mounting.  The one whose yaw
fits the way that the car goes is kept, or else the one that lasts longest.
"""

import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.errors import InputRefused
from bcid.recording.checks.pose_noise import wrap_angles
from bcid.recording.checks.rowwise import find_runs
from bcid.recording.checks.samples import Samples, note_rows, throttle_at
from bcid.recording.checks.yaw_jumps import YawJumps, find_yaw_jumps, label_levels
from bcid.recording.limits import HEADING as LIMITS
from bcid.vehicle import Vehicle

COURSE_S = 0.1  # over which the direction of motion is taken
COMPARED_S = 0.2  # before and after a jump of the yaw, in which it is compared with the path
BESIDE = 4  # samples beside an excursion that may belong to a wrap that was resampled
MOST_OF_A_TURN = 1.9 * math.pi  # in one step: the yaw wraps as it should
SET_ANEW = "the path turns with the yaw from one sample to the next: the tracking's axes were set anew: split there"


class Excursion(NamedTuple):
    """Rows from `first` to before `end` whose yaw is off by `size` (rad), of a `kind` of irregularity."""

    kind: str
    first: int
    end: int
    size: float


def drop_turned_poses(
    poses: Samples, commands: Samples, vehicle: Vehicle, breaks_s: list[float], source: str
) -> tuple[Samples, list[float]]:
    """The poses of one mounting of the tracked body, and the times (s) at which new segments begin.

    Those are left out whose yaw jumped away, for a while or for good.  Where the path turned with the yaw, the
    tracking's axes were set anew: nothing is left out, but a segment begins, as at the `breaks_s` known so far.

    Raises:
        InputRefused: over `HEADING.max_jump_share` of the steps are jumps.
    """
    time_s, yaw = poses.time_s, poses.values[:, 2]
    if len(yaw) < 3:
        return poses, breaks_s
    angle = _angles_to_course(poses, vehicle)
    jumps = find_yaw_jumps(time_s, yaw, vehicle.body.wheelbase_m)
    jumps = _add_jumps_over_gaps(poses, jumps, angle, vehicle.body.wheelbase_m)
    if len(jumps.rows) > LIMITS.max_jump_share * len(yaw):
        cause = f"{len(jumps.rows)} of {len(yaw)} steps of the yaw are faster than a car turns"
        step = "check the tracked body: markers that look alike from several sides, or two bodies of one name"
        raise InputRefused(source, "yaw", cause, step)
    of_path = _mark_turns_of_path(poses, jumps, angle, breaks_s)
    turns, jumps = jumps.select(of_path), jumps.select(~of_path)
    levels = label_levels(jumps, time_s)
    driven = np.where(throttle_at(time_s, commands) > 0.0, angle, np.nan)
    kept = _choose_level(levels, driven)
    excursions = _find_excursions(poses, levels, kept, jumps)
    at_turn = np.isin(np.arange(len(yaw)), turns.rows)
    noted = [*poses.irregularities, *note_rows(time_s, at_turn, "yaw jump", "excluded", SET_ANEW)]
    for kind in dict.fromkeys(e.kind for e in excursions):
        alike = [e for e in excursions if e.kind == kind]
        # a step for good has its own size and time
        for group in [[e] for e in alike] if kind == "mounting" else [alike]:
            rows = np.zeros(len(yaw), dtype=bool)
            for e in group:
                rows[e.first : e.end] = True
            largest = max(group, key=lambda e: abs(e.size))
            noted += note_rows(time_s, rows, kind, "excluded", _explain(largest, time_s))
    kept_s = time_s[levels == kept]
    begins = (float(kept_s[k]) for k in np.searchsorted(kept_s, time_s[at_turn]) if 0 < k < len(kept_s))
    return Samples(kept_s, poses.values[levels == kept], noted), sorted({*breaks_s, *begins})


def face_forward(poses: Samples, commands: Samples, vehicle: Vehicle) -> Samples:
    """The poses with a yaw turned by quarters, so that the car goes the way it points; for a body without a forward.

    They stay as they are where this is not known, or the vehicle file states how the body is mounted.
    """
    if vehicle.mocap.yaw_offset_rad is not None or len(poses.time_s) < 3:
        return poses
    angle = _angles_to_course(poses, vehicle)[throttle_at(poses.time_s, commands) > 0.0]
    quarters = round(_mean_direction(angle) / (0.5 * math.pi)) if np.isfinite(angle).any() else 0
    if quarters == 0:
        return poses
    everywhere = np.ones(len(poses.time_s), dtype=bool)
    text = f"its yaw is turned by {90 * quarters} degrees, so that the car goes the way it points"
    noted = [*poses.irregularities, *note_rows(poses.time_s, everywhere, "body axes", "fixed", text)]
    return Samples(poses.time_s, np.add(poses.values, [0.0, 0.0, 0.5 * math.pi * quarters]), noted)


def _mark_turns_of_path(poses: Samples, jumps: YawJumps, angle: Floats, breaks_s: list[float]) -> Bools:
    """Mask (J,) of the jumps at which the path turned with the yaw, so that the `angle` (N,) between both stayed.

    Only jumps between lasting stretches can show it.  Where the car stands, a jump of the position (`breaks_s`) does.
    """
    time_s, half = poses.time_s, _course_rows(poses.time_s)
    edges = np.r_[0, jumps.rows, len(time_s)]
    turned = np.zeros(len(jumps.rows), dtype=bool)
    for k, (row, size) in enumerate(zip(jumps.rows, jumps.sizes, strict=True)):
        if min(time_s[row - 1] - time_s[edges[k]], time_s[edges[k + 2] - 1] - time_s[row]) < LIMITS.min_mounting_s:
            continue
        change = _change_across(row, half, time_s, angle)
        leaps = bool(np.isin(time_s[row], breaks_s))
        share = LIMITS.max_turn_share_at_leap if leaps else LIMITS.max_turn_share
        turned[k] = leaps if np.isnan(change) else abs(math.remainder(change, math.tau)) < share * abs(size)
    return turned


def _add_jumps_over_gaps(poses: Samples, jumps: YawJumps, angle: Floats, wheelbase_m: float) -> YawJumps:
    """The `jumps` and those over gaps, where yaw and path, on straight lines from both sides, part by as much.

    The car may have turned meanwhile, by a dt^2 / 4 beyond those lines, but then its path turned, too: `angle` (N,),
    from the yaw to the path, would stay.
    """
    time_s, yaw, half = poses.time_s, np.unwrap(poses.values[:, 2]), _course_rows(poses.time_s)
    step_s = np.diff(time_s)
    acceleration = LIMITS.gap_grip_mps2 / wheelbase_m
    extra = []
    for row in np.setdiff1d(np.flatnonzero(step_s > LIMITS.max_flip_steps * np.median(step_s)) + 1, jumps.rows):
        size = math.remainder(_change_across(row, 0, time_s, yaw), math.tau)
        change = _change_across(row, half, time_s, angle)
        slack = LIMITS.min_gap_jump_rad + 0.25 * acceleration * step_s[row - 1] ** 2
        if abs(size) > slack and abs(math.remainder(change + size, math.tau)) < LIMITS.max_turn_share * abs(size):
            extra.append((row, size, slack))
    if not extra:
        return jumps
    rows, sizes, slacks = (np.r_[a, b] for a, b in zip(jumps, zip(*extra, strict=True), strict=True))
    order = np.argsort(rows)
    return YawJumps(rows[order].astype(np.int64), sizes[order], slacks[order])


def _change_across(row: int, margin: int, time_s: Floats, angle: Floats) -> float:
    """Change (rad) of an angle (N,) from before the `row` to it, at the middle; NaN where too little is known.

    Straight lines through what is known within COMPARED_S meet there, but for `margin` rows on either side.
    """
    middle_s = 0.5 * (time_s[row - 1] + time_s[row])
    first = int(np.searchsorted(time_s, time_s[row - 1] - COMPARED_S - 0.5 * COURSE_S))
    end = int(np.searchsorted(time_s, time_s[row] + COMPARED_S + 0.5 * COURSE_S))
    sides = (slice(first, max(row - margin, 0)), slice(row + margin, end))
    before, after = (_angle_at(middle_s, time_s[side], angle[side]) for side in sides)
    return after - before


def _angle_at(at_s: float, time_s: Floats, angle: Floats) -> float:
    """The angle (rad) at the time `at_s` (s) by a straight line through angles (N,) at times (N,); NaN for a few."""
    known = np.isfinite(angle)
    if known.sum() < 3:
        return math.nan
    slope, height = np.polyfit(time_s[known] - at_s, np.unwrap(angle[known]), 1)
    return float(height) if math.isfinite(slope) else math.nan


def _explain(excursion: Excursion, time_s: Floats) -> str:
    """What happened to the yaw in an excursion, of samples at the times (N,) in s, and what was made of it."""
    size = f"{abs(excursion.size):.3g} rad"
    if excursion.kind == "yaw flip":
        return "the yaw jumps by 180 degrees: symmetric markers; what would drive backwards is left out"
    if excursion.kind == "yaw wrap":
        return (
            "the yaw runs through its whole range at once: resampled by straight lines where it wraps from pi to -pi; "
            "these samples are left out: unwrap the yaw before it is resampled"
        )
    if excursion.kind == "yaw jump":
        return f"by up to {size} from one sample to the next, faster than a car turns, and back: left out"
    at = excursion.first if excursion.first > 0 else excursion.end
    return (
        f"the tracked body's mounting changed at {time_s[at]:.3f} s, its yaw by {excursion.size:+.3f} rad at once: "
        "a marker was knocked, or the body defined anew; one side is left out: record both as takes of their own"
    )


def _find_excursions(poses: Samples, levels: Ints, kept: int, jumps: YawJumps) -> list[Excursion]:
    """The runs of rows whose level (N,) is not the `kept` one, each with the kind of what happened to the yaw there."""
    time_s, yaw = poses.time_s, poses.values[:, 2]
    found = []
    for first, end in find_runs(levels != kept):
        # the jump into it, or, at the take's start, the one out of it
        k = int(np.searchsorted(jumps.rows, first if first > 0 else end))
        size = float(jumps.sizes[k])
        lasts = time_s[end - 1] - time_s[first] > LIMITS.min_mounting_s
        if first > 0 and end < len(yaw) and _runs_through_a_turn(yaw[max(0, first - BESIDE) : end + BESIDE]):
            kind = "yaw wrap"
        elif abs(abs(size) - math.pi) < LIMITS.flip_tolerance_rad and end - first > 1:
            kind = "yaw flip"
        elif lasts and (first == 0 or end == len(yaw)):
            kind = "mounting"
        else:
            kind = "yaw jump"
        found.append(Excursion(kind, int(first), int(end), size))
    return found


def _runs_through_a_turn(yaw: Floats) -> bool:
    """Whether a yaw (N,) in rad goes one full turn one way, as where straight lines join both ends of its range."""
    step = np.diff(yaw)
    far = step[np.abs(step) > LIMITS.min_jump_rad]
    whole = abs(abs(float(far.sum())) - 2.0 * math.pi) < LIMITS.wrap_tolerance_rad
    return whole and bool((far > 0.0).all() or (far < 0.0).all()) and float(np.abs(far).max()) < MOST_OF_A_TURN


def _choose_level(levels: Ints, angle: Floats) -> int:
    """The level whose samples are kept, by the level (N,) of each: the most frequent one, or one that fits much better.

    A level fits by the `angle` (N,) between its yaw and the way that the car goes, NaN where it is not known.
    """
    count = np.bincount(levels)
    longest = int(np.argmax(count))
    lasting = np.flatnonzero(count > LIMITS.min_mounting_share * count[longest])
    off = {k: abs(_mean_direction(angle[levels == k])) for k in map(int, lasting)}
    best = min(off, key=off.__getitem__)
    return best if off[longest] - off[best] > LIMITS.max_misfit_rad else longest


def _mean_direction(angle: Floats) -> float:
    """Mean direction (rad) of the finite ones among angles (N,); half a turn where there are none."""
    known = angle[np.isfinite(angle)]
    return float(np.angle(np.exp(1j * known).sum())) if len(known) else math.pi


def _course_rows(time_s: Floats) -> int:
    """Rows before and after a pose, between which the direction of motion is taken, by the times (N,) in s."""
    return max(1, round(0.5 * COURSE_S / float(np.median(np.diff(time_s)))))


def _angles_to_course(poses: Samples, vehicle: Vehicle) -> Floats:
    """Angles (N,) in rad from the car's yaw to the way it goes; NaN where it is slow or this is unknown."""
    time_s, values, half = poses.time_s, poses.values, _course_rows(poses.time_s)
    angle = np.full(len(time_s), np.nan)
    if len(time_s) <= 2 * half:
        return angle
    way = values[2 * half :, :2] - values[: -2 * half, :2]
    far = np.hypot(*way.T)
    course = np.arctan2(way[:, 1], way[:, 0]) - values[half:-half, 2] + (vehicle.mocap.yaw_offset_rad or 0.0)
    angle[half:-half] = np.where(far > LIMITS.min_heading_step * np.quantile(far, 0.95), wrap_angles(course), np.nan)
    return angle
