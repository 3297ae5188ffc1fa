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
        order = np.argsort(time_s, kind="stable")
        odd.append(
            Irregularity(
                f"{what} order", "fixed", int(late.sum()), _where(time_s, late), "samples put in the order of time"
            )
        )
        time_s, values = time_s[order], values[order]
    time_s, values, duplicates = _without_duplicates(time_s, values, what)
    return _Cleaned(time_s, values, odd + duplicates)


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
