"""From raw streams to a `Recording`: every irregularity is fixed, excluded or refused, and counted."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.errors import InputRefused
from bcid.recording.clock import estimate_clock
from bcid.recording.orientation import rotated
from bcid.recording.plausibility import check_plausible
from bcid.recording.raw import RawTake
from bcid.recording.types import Floats, Irregularity, Recording, Stream
from bcid.vehicle import Vehicle

MAX_SPEED_MPS = 100.0
MAX_NON_FINITE = 0.05
MIN_RATE_HZ, MAX_RATE_HZ = 2.0, 2000.0
LONGEST_HOLE_S = 600.0
MAX_YAW_RATE = 40.0  # rad/s
LATE_SAMPLES = 10  # that arrive out of order; more is a clock that was set back
FROZEN_S = 0.25  # that a pose may stand to the last digit while the throttle is on
FLIP = 0.2  # rad about half a turn between two samples
MAX_JUMPS = 0.05  # share of the pose steps; more is no tracking failure but a wrong unit


class _Cleaned(NamedTuple):
    time_s: Floats
    values: Floats
    odd: list[Irregularity]


def _where(time_s: Floats, rows: npt.NDArray[np.bool_]) -> str:
    hit = time_s[rows]
    first, last = float(np.nanmin(hit)), float(np.nanmax(hit))
    return f"{first:.3f} s" if len(hit) == 1 else f"{first:.3f} to {last:.3f} s"


def _clean(time_s: Floats, values: Floats, what: str, source: str) -> _Cleaned:
    """Rows with finite cells in strictly increasing time; what was dropped is counted."""
    odd: list[Irregularity] = []
    if len(time_s) == 0:
        raise InputRefused(source, what, "holds no samples", "record the take again")
    infinite = np.isinf(values).any(axis=1) | ~np.isfinite(time_s)
    if infinite.mean() > MAX_NON_FINITE:
        raise InputRefused(
            source, what, f"{infinite.mean():.0%} of the rows are not finite numbers", "export the take again"
        )
    blank = ~np.isfinite(values).all(axis=1) | infinite
    if blank.all():
        raise InputRefused(source, what, "holds no finite sample", "export the take again")
    if blank.any():
        text = f"blank samples in {int(np.sum(np.diff(np.r_[0, blank]) == 1))} runs: gaps"
        odd.append(Irregularity(f"{what} dropout", "excluded", int(blank.sum()), _where(time_s, blank), text))
    time_s, values = time_s[~blank], values[~blank]
    if np.any(np.diff(time_s) < 0):
        late = np.r_[False, np.diff(time_s) < 0]
        _check_overlap(time_s, late, what, source)
        order = np.argsort(time_s, kind="stable")
        odd.append(
            Irregularity(
                f"{what} order", "fixed", int(late.sum()), _where(time_s, late), "samples put in the order of time"
            )
        )
        time_s, values = time_s[order], values[order]
    time_s, values, duplicates = _without_duplicates(time_s, values, what)
    return _Cleaned(time_s, values, odd + duplicates)


def _check_overlap(time_s: Floats, late: npt.NDArray[np.bool_], what: str, source: str) -> None:
    """Raise `InputRefused` where the clock steps back: two stretches of the same times cannot be put in order."""
    step = float(np.median(np.abs(np.diff(time_s))))
    far = np.r_[0.0, -np.diff(time_s)] > 0.5 * LATE_SAMPLES * step
    for row in np.flatnonzero(late & far):
        again = int((time_s[:row] > time_s[row]).sum())
        ahead = int((time_s[row:] < time_s[row - 1]).sum())
        if min(again, ahead) > LATE_SAMPLES:
            back = time_s[row - 1] - time_s[row]
            cause = f"the clock steps back by {back:.3f} s at {time_s[row - 1]:.3f} s: {again} samples have times twice"
            raise InputRefused(source, f"{what} times", cause, "cut the recording there, or use the other time base")


def _unfrozen(poses: _Cleaned, commands: _Cleaned) -> _Cleaned:
    """The poses without those that only repeat the last one while the throttle is on: the tracking held it."""
    time_s, values = poses.time_s, poses.values
    same = np.r_[False, (np.diff(values, axis=0) == 0.0).all(axis=1)]
    edges = np.flatnonzero(np.diff(np.r_[False, same, False].astype(int)))
    frozen = np.zeros(len(time_s), dtype=bool)
    row = np.searchsorted(commands.time_s, time_s, side="right") - 1
    throttle = np.where(row >= 0, commands.values[np.maximum(row, 0), 1], 0.0)
    for a, b in edges.reshape(-1, 2):
        if time_s[b - 1] - time_s[a - 1] > FROZEN_S and throttle[a:b].min() > 0.0:
            frozen[a:b] = True
    if not frozen.any():
        return poses
    text = "the same pose again and again while the throttle is on: held by the tracking"
    odd = Irregularity("frozen pose", "excluded", int(frozen.sum()), _where(time_s, frozen), text)
    return _Cleaned(time_s[~frozen], values[~frozen], [*poses.odd, odd])


def _without_flips(poses: _Cleaned) -> _Cleaned:
    """The poses without stretches whose yaw is turned by 180 degrees: markers that look the same both ways."""
    yaw = poses.values[:, 2]
    step = np.diff(poses.time_s)
    half = np.abs(np.abs(np.angle(np.exp(1j * np.diff(yaw)))) - math.pi) < FLIP
    half &= step < 3.0 * float(np.median(step))  # over a gap the car may have turned round
    if not half.any():
        return poses
    turned = np.r_[0, np.cumsum(half)] % 2 == 1
    if turned.mean() > 0.5:
        turned = ~turned
    text = "the yaw jumps by 180 degrees: symmetric markers; the shorter part is left out"
    odd = Irregularity("yaw flip", "excluded", int(turned.sum()), _where(poses.time_s, turned), text)
    return _Cleaned(poses.time_s[~turned], poses.values[~turned], [*poses.odd, odd])


def _without_duplicates(time_s: Floats, values: Floats, what: str) -> tuple[Floats, Floats, list[Irregularity]]:
    """One row per stamp: equal values merge, contradicting ones are all dropped."""
    _, first, inverse, counts = np.unique(time_s, return_index=True, return_inverse=True, return_counts=True)
    if (counts == 1).all():
        return time_s, values, []
    same = np.isclose(values, values[first][inverse], rtol=0, atol=0).all(axis=1)
    contradicting = np.bincount(inverse, weights=~same) > 0
    repeated = (counts > 1) & ~contradicting
    odd = []
    if repeated.any():
        n = int((counts[repeated] - 1).sum())
        odd.append(
            Irregularity(f"{what} duplicate", "fixed", n, _where(time_s[first], repeated), "same stamp, same value")
        )
    if contradicting.any():
        n = int(counts[contradicting].sum())
        text = "same stamp, other value: all dropped"
        odd.append(Irregularity(f"{what} duplicate", "excluded", n, _where(time_s[first], contradicting), text))
    keep = first[~contradicting]
    return time_s[keep], values[keep], odd


def _to_cog(pose: Floats, vehicle: Vehicle) -> Floats:
    """The CoG's pose from the tracked body's: yaw offset and lever arm undone, where the file states them."""
    theta = pose[:, 2] - (vehicle.mocap.yaw_offset_rad or 0.0)
    lever = rotated(np.array(vehicle.mocap.marker_offset_m or (0.0, 0.0)), theta)
    return np.column_stack([pose[:, :2] - lever, theta])


def _breaks(time_s: Floats, pose: Floats, limit_mps: float) -> tuple[list[float], list[Irregularity]]:
    """Times at which the pose jumps faster than any car moves: a new stretch begins there."""
    speed = np.hypot(*np.diff(pose[:, :2], axis=0).T) / np.diff(time_s)
    jumps = np.flatnonzero(speed > limit_mps) + 1
    odd = [
        Irregularity(
            "pose jump", "excluded", 1, f"{time_s[j]:.3f} s",
            f"{math.dist(pose[j, :2], pose[j - 1, :2]):.3f} m in {time_s[j] - time_s[j - 1]:.3f} s: split there",
        )
        for j in jumps
    ]  # fmt: skip
    return [float(time_s[j]) for j in jumps], odd


def _check_times(pose_s: Floats, command_s: Floats, hold_s: float, source: str) -> None:
    """Raise `InputRefused` where the stamps cannot be seconds of one take."""
    step = float(np.median(np.diff(pose_s)))
    if not MIN_RATE_HZ < 1.0 / step < MAX_RATE_HZ:
        cause = f"poses come every {step:.3g} s: are the times in seconds?"
        raise InputRefused(source, "time", cause, "map the time column in seconds")
    span = float(pose_s[-1] - pose_s[0])
    if span > LONGEST_HOLE_S + 10.0 * step * len(pose_s):
        widest = int(np.argmax(np.diff(pose_s)))
        cause = (
            f"{len(pose_s)} poses spread over {span:.3g} s: a clock jump or a zero stamp near {pose_s[widest]:.3f} s"
        )
        raise InputRefused(source, "time", cause, "cut the take there, or correct its stamps")
    if len(command_s) > 1 and np.median(np.diff(command_s)) > hold_s:
        cause = f"commands come every {np.median(np.diff(command_s)):.3g} s, but hold for {hold_s:g} s only"
        raise InputRefused(source, "command times", cause, "log them in seconds, or set command.max_hold_s")


def _check_yaw(time_s: Floats, yaw: Floats, source: str) -> None:
    """Raise `InputRefused` where the yaw wraps at 360 or turns as no car does."""
    step = np.abs(np.diff(yaw))
    usual = float(np.quantile(step / np.diff(time_s), 0.9))
    if np.any((step > 350.0) & (step < 370.0)) or usual > MAX_YAW_RATE:
        cause = f"the yaw turns by up to {step.max():.3g} at once, usually {usual:.3g} a second: degrees?"
        raise InputRefused(source, "yaw", cause, "log it in rad, or map it with gain = 0.017453")


def _gaps(time_s: Floats, longest_s: float, what: str) -> list[Irregularity]:
    steps = np.diff(time_s)
    wide = np.r_[False, steps > longest_s]
    if not wide.any():
        return []
    text = f"{steps[steps > longest_s].sum():.2f} s in all, the longest {steps.max():.3f} s"
    return [Irregularity(f"{what} gap", "warning", int(wide.sum()), _where(time_s, wide), text)]


def assemble(raw: RawTake, vehicle: Vehicle) -> Recording:
    """The recording in `raw` as the vehicle file describes its car.

    Raises:
        InputRefused: empty or mostly broken streams, or values no such car can have.
    """
    source = raw.sources[0].path
    poses = _clean(raw.pose_time_s, raw.pose, "pose", source)
    commands = _clean(raw.command_time_s, raw.command, "command", raw.sources[-1].path)
    if len(poses.time_s) < 10:
        raise InputRefused(source, "pose", f"only {len(poses.time_s)} poses remain", "record a longer take")
    _check_times(poses.time_s, commands.time_s, vehicle.command.max_hold_s, source)
    poses = _without_flips(_unfrozen(poses, commands))
    _check_yaw(poses.time_s, poses.values[:, 2], source)
    yaw = np.unwrap(poses.values[:, 2])
    pose = _to_cog(np.column_stack([poses.values[:, :2], yaw]), vehicle)
    rate = raw.rate_hz or 1.0 / float(np.median(np.diff(poses.time_s)))
    limit = vehicle.mocap.max_speed_mps or MAX_SPEED_MPS
    breaks, jumps = _breaks(poses.time_s, pose, limit)
    if len(breaks) > MAX_JUMPS * len(pose):
        raise InputRefused(
            source, "pose", f"{len(breaks)} of {len(pose)} pose steps are faster than {limit:g} m/s: "
            "lengths in mm or cm?",
            "set the unit (mocap.length_unit, or a gain in [columns]), or mocap.max_speed_mps",
        )  # fmt: skip
    offset = vehicle.clock.offset_s if vehicle.clock else 0.0
    recording = Recording(
        name=raw.name,
        sources=raw.sources,
        poses=Stream(poses.time_s, pose),
        commands=Stream(commands.time_s + offset, commands.values),
        rate_hz=rate,
        hold_s=vehicle.command.max_hold_s,
        breaks_s=tuple(breaks),
        channels={
            name: Stream(c.time_s + offset, c.values)
            for name, (t, v) in raw.channels.items()
            for c in [_clean(t, v[:, None], name, raw.sources[-1].path)]
        },
        irregularities=(
            *raw.irregularities, *poses.odd, *commands.odd, *jumps,
            *_gaps(poses.time_s, 1.5 / rate, "pose"),
            *_gaps(commands.time_s, vehicle.command.max_hold_s, "command"),
        ),
    )  # fmt: skip
    overlap = min(recording.poses.time_s[-1], recording.commands.time_s[-1]) - max(
        recording.poses.time_s[0], recording.commands.time_s[0]
    )
    if overlap <= 0:
        raise InputRefused(
            source,
            "time",
            "poses and commands do not overlap in time",
            "check that both belong to one take and one time base",
        )
    checked = check_plausible(recording, vehicle)
    return estimate_clock(checked, vehicle)
