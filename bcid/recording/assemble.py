"""From raw streams to a `Recording`: every irregularity is fixed, excluded or refused, and counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused, Problems
from bcid.recording.checks.attitude import rotated
from bcid.recording.checks.clock import estimate_clock
from bcid.recording.checks.contacts import contacts
from bcid.recording.checks.mounting import LARGE_YAW, yaw_offset
from bcid.recording.checks.plausibility import check_commands, check_plausible
from bcid.recording.checks.samples import Samples, cleaned, where
from bcid.recording.checks.tracking import commands_in_turn, split_at_jumps, unfrozen, unheld, without_flips
from bcid.recording.formats.raw import RawTake
from bcid.recording.types import Irregularity, Recording, Stream, log_of
from bcid.vehicle import Vehicle

MIN_RATE_HZ, MAX_RATE_HZ = 2.0, 2000.0
LONGEST_HOLE_S = 600.0
MAX_YAW_RATE, YAW_OVER_S = 40.0, 0.05  # rad/s, over so long that noise does not count
REGULAR = 0.95  # share of the steps between commands that are no longer than usual


def _to_cog(pose: Floats, vehicle: Vehicle) -> Floats:
    """The CoG's pose from the tracked body's: yaw offset and lever arm undone, where the file states them."""
    theta = pose[:, 2] - (vehicle.mocap.yaw_offset_rad or 0.0)
    lever = rotated(np.array(vehicle.mocap.marker_offset_m or (0.0, 0.0)), theta)
    return np.column_stack([pose[:, :2] - lever, theta])


def _cleaned(raw: RawTake) -> tuple[Samples, Samples, dict[str, Samples]]:
    """Poses, commands and further channels, each in the order of time."""
    problems, clean = Problems(), dict[str, Samples]()
    first, last = raw.sources[0].path, log_of(raw.sources)
    streams = {
        "pose": (raw.pose_time_s, raw.pose, first), "command": (raw.command_time_s, raw.command, last),
        **{name: (time_s, values[:, None], last) for name, (time_s, values) in raw.channels.items()},
    }  # fmt: skip
    for name, (time_s, values, source) in streams.items():
        with problems.gathered():
            clean[name] = cleaned(time_s, values, name, source)
    problems.refuse(first)
    return clean.pop("pose"), clean.pop("command"), clean


def _check_pose_times(pose_s: Floats, source: str) -> None:
    """Raise `InputRefused` where the stamps cannot be seconds of one take."""
    if len(pose_s) < 10:
        raise InputRefused(source, "pose", f"only {len(pose_s)} poses remain", "record a longer take")
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


def _check_command_times(commands: Samples, hold_s: float, source: str) -> None:
    """Raise `InputRefused` where commands come too rarely to be held, or from two sources."""
    step = float(np.median(np.diff(commands.time_s))) if len(commands.time_s) > 1 else 0.0
    if step > hold_s:
        cause = f"commands come every {step:.3g} s, but hold for {hold_s:g} s only"
        raise InputRefused(source, "command times", cause, "log them in seconds, or set command.max_hold_s")
    if commands_in_turn(commands):
        cause = "two sources of commands come in turn: several publishers on the topic, or two stretches mixed"
        raise InputRefused(source, "command", cause, "record the one that the car obeys")


def _check_yaw(time_s: Floats, yaw: Floats, source: str) -> None:
    """Raise `InputRefused` where the yaw wraps at 360 or turns as no car does."""
    far = max(1, round(YAW_OVER_S / float(np.median(np.diff(time_s)))))
    step = np.abs(np.diff(yaw))
    usual = float(np.quantile(np.abs(yaw[far:] - yaw[:-far]) / (time_s[far:] - time_s[:-far]), 0.9))
    if np.any((step > 350.0) & (step < 370.0)) or usual > MAX_YAW_RATE:
        cause = f"the yaw turns by up to {step.max():.3g} at once, usually {usual:.3g} a second: degrees?"
        raise InputRefused(source, "yaw", cause, "log it in rad, or map it with gain = 0.017453")


def _longest_step(raw: RawTake, time_s: Floats, longest_s: float) -> float:
    """The step (s) beyond which a command is missing: half more than the usual one, where there is a usual one.

    In a table, whose rows hold both, a row that is missing is told as a pose.
    """
    if len(time_s) < 2 or np.array_equal(raw.pose_time_s, raw.command_time_s):
        return longest_s
    step = np.diff(time_s)
    limit = 1.5 * float(np.median(step))
    return min(limit, longest_s) if (step <= limit).mean() > REGULAR else longest_s


def _gaps(time_s: Floats, longest_s: float, what: str) -> list[Irregularity]:
    steps = np.diff(time_s)
    wide = np.r_[False, steps > longest_s]
    if not wide.any():
        return []
    text = f"{steps[steps > longest_s].sum():.2f} s in all, the longest {steps.max():.3f} s"
    return [Irregularity(f"{what} gap", "warning", int(wide.sum()), where(time_s, wide), text)]


def _ends(pose_s: Floats, command_s: Floats, hold_s: float, step_s: float) -> list[Irregularity]:
    """Word of parts of the take in which only one of the streams is there.

    Poses may begin and end within `hold_s` of the commands, and commands within `step_s` of the poses: where they come
    later or stop earlier, their log may be cut.
    """
    streams = {"pose": pose_s, "command": command_s}
    found = []
    for one, other in (("command", "pose"), ("pose", "command")):
        (first, last), (begin, end) = ((streams[s][0], streams[s][-1]) for s in (one, other))
        found += [(one, "begin", first, first - begin, f"after the first {other}")]
        found += [(one, "end", last, end - last, f"before the last {other}")]
    return [
        Irregularity(f"{one} {edge}", "warning", 1, f"{at:.3f} s", f"the {one}s {edge} {apart:.2f} s {where}")
        for one, edge, at, apart, where in found
        if apart > (step_s if one == "command" else hold_s)
    ]


def _check_overlap(pose_s: Floats, command_s: Floats, source: str) -> None:
    """Raise `InputRefused` where poses and commands are of different times."""
    (first, last), (begin, end) = ((t[0], t[-1]) for t in (pose_s, command_s))
    if min(last, end) <= max(first, begin):
        cause = (
            f"poses ({first:.3f} to {last:.3f} s) and commands ({begin:.3f} to {end:.3f} s) do not overlap in time: "
            "two takes, or simulated time and a wall clock"
        )
        step = 'check that both belong to one take; for MCAP, name the time base: topics.time = "log"'
        raise InputRefused(source, "time", cause, step)


def _parted_at_contacts(recording: Recording) -> Recording:
    """The recording with breaks before and behind every contact: no estimate, fit or judgement goes across one."""
    first, odd, breaks = recording.poses.time_s[0], list[Irregularity](), set(recording.breaks_s)
    for c in contacts(recording):
        if any(first + c.begin_s <= at <= first + c.end_s for at in recording.breaks_s):
            continue  # the track jumps there, whatever the car does
        text = f"at ({c.x_m:.2f}, {c.y_m:.2f}) m, {c.acceleration:.0f} m/s² that no tyre gives: stands apart"
        odd.append(Irregularity(c.kind, "excluded", 1, f"{first + c.begin_s:.3f} to {first + c.end_s:.3f} s", text))
        breaks |= {float(first + c.begin_s), float(first + c.end_s)}
    return replace(recording, breaks_s=tuple(sorted(breaks)), irregularities=(*recording.irregularities, *odd))


def _told_askew(recording: Recording, vehicle: Vehicle) -> Recording:
    """The recording with word of a tracked body that surely sits askew on the car."""
    offset = yaw_offset(recording, vehicle)
    if offset is None or not (offset.low > LARGE_YAW or offset.high < -LARGE_YAW):
        return recording
    text = (
        f"the tracked yaw is {offset.low:.3f} to {offset.high:.3f} rad off the way that the rear axle goes: "
        f"mocap.yaw_offset_rad = {offset.rad:.3f} would undo it"
    )
    odd = Irregularity("yaw offset", "warning", 1, recording.sources[0].path, text)
    return replace(recording, irregularities=(*recording.irregularities, odd))


def _of_the_car(poses: Samples, commands: Samples, vehicle: Vehicle, source: str) -> tuple[Samples, list[float]]:
    """The poses that are the car's, and where stretches begin."""
    poses, breaks = split_at_jumps(unfrozen(poses, commands), commands, vehicle, source)
    poses = without_flips(poses, commands)
    _check_yaw(poses.time_s, poses.values[:, 2], source)
    return poses, breaks


def assemble(raw: RawTake, vehicle: Vehicle) -> Recording:
    """The recording in `raw` as the vehicle file describes its car.

    Raises:
        InputRefused: empty or mostly broken streams, or values no such car can have; what is wrong in ways that do not
            hang together is told at once.
    """
    source, log = raw.sources[0].path, log_of(raw.sources)
    poses, commands, channels = _cleaned(raw)
    offset, hold_s = vehicle.clock.offset_s if vehicle.clock else 0.0, vehicle.command.max_hold_s
    problems, beyond, breaks = Problems(), list[Irregularity](), list[float]()
    with problems.gathered():
        _check_pose_times(poses.time_s, source)
    with problems.gathered():
        _check_command_times(commands, hold_s, log)
    if not problems:  # where stamps are no seconds, nothing can be told of speeds, or of both streams
        with problems.gathered():
            _check_overlap(poses.time_s, commands.time_s + offset, source)
        poses = unheld(poses)
        rate = raw.rate_hz or 1.0 / float(np.median(np.diff(poses.time_s)))
        with problems.gathered():
            poses, breaks = _of_the_car(poses, commands, vehicle, source)
    with problems.gathered():
        beyond = check_commands(commands.values, vehicle, log)
    problems.refuse(source)
    pose = _to_cog(np.column_stack([poses.values[:, :2], np.unwrap(poses.values[:, 2])]), vehicle)
    step_s = _longest_step(raw, commands.time_s, hold_s)
    recording = Recording(
        name=raw.name,
        sources=raw.sources,
        poses=Stream(poses.time_s, pose),
        commands=Stream(commands.time_s + offset, commands.values),
        rate_hz=rate,
        hold_s=hold_s,
        breaks_s=tuple(sorted({*breaks, *raw.splits_s})),
        channels={name: Stream(c.time_s + offset, c.values) for name, c in channels.items()},
        irregularities=(
            *raw.irregularities, *poses.odd, *commands.odd,
            *_gaps(poses.time_s, 1.5 / rate, "pose"),
            *_gaps(commands.time_s, step_s, "command"),
            *_ends(poses.time_s, commands.time_s + offset, hold_s, step_s),
            *beyond,
        ),
    )  # fmt: skip
    parted = _parted_at_contacts(check_plausible(recording, vehicle))
    return estimate_clock(_told_askew(parted, vehicle), vehicle)
