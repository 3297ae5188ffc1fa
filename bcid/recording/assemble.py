"""From raw streams to a `Recording`: every irregularity is fixed, excluded or refused, and counted."""

import numpy as np
from scipy.ndimage import median_filter

from bcid.aliases import Floats
from bcid.errors import InputRefused, Problems
from bcid.recording.checks import attitude, clock, contacts, lost, mounting, plausibility, samples, tracking, verdict
from bcid.recording.checks.heading import drop_turned_poses, face_forward
from bcid.recording.checks.held import drop_frozen_poses, drop_held_poses
from bcid.recording.checks.interpolated import drop_interpolated_poses
from bcid.recording.checks.samples import Samples
from bcid.recording.formats.raw import RawTake
from bcid.recording.limits import MOTION
from bcid.recording.limits import STREAM as LIMITS
from bcid.recording.measured_speed import let_measured_speed_run
from bcid.recording.types import Irregularity, Recording, Stream, command_source_path
from bcid.vehicle import Vehicle


def _move_to_cog(pose: Floats, vehicle: Vehicle) -> Floats:
    """Poses [x, y, theta] (N, 3) of the CoG: theta = yaw - yaw_offset_rad, position less R(theta) marker_offset_m."""
    theta = pose[:, 2] - (vehicle.mocap.yaw_offset_rad or 0.0)
    lever = attitude.rotate_vectors(np.array(vehicle.mocap.marker_offset_m or (0.0, 0.0)), theta)
    return np.column_stack([pose[:, :2] - lever, theta])


def _clean_streams(raw: RawTake) -> tuple[Samples, Samples, dict[str, Samples]]:
    """Samples of poses, of commands and of each further channel by name: only finite ones, in increasing time."""
    problems, clean = Problems(), dict[str, Samples]()
    first, last = raw.sources[0].path, command_source_path(raw.sources)
    streams = {
        "pose": (raw.pose_time_s, raw.pose, first), "command": (raw.command_time_s, raw.command, last),
        **{name: (time_s, values[:, None], last) for name, (time_s, values) in raw.channels.items()},
    }  # fmt: skip
    for name, (time_s, values, source) in streams.items():
        with problems.gather_refusals():
            clean[name] = samples.clean_samples(time_s, values, name, source)
    problems.raise_if_any(first)
    return lost.drop_lost_poses(clean.pop("pose")), _drop_placeholders(clean.pop("command")), clean


def _drop_placeholders(commands: Samples) -> Samples:
    """The commands without steering angles that nothing computes, such as -9999, which stands for none."""
    beyond = np.abs(commands.values[:, 0]) > MOTION.least_placeholder
    if beyond.mean() > MOTION.max_placeholder_share:  # the whole column is in another unit, which is refused
        return commands
    largest = float(np.abs(commands.values[:, 0]).max())
    text = f"steering beyond {MOTION.least_placeholder:g} rad, up to {largest:.4g}, which stands for none"
    return commands.without(beyond, "steering command", "excluded", text)


def _check_yaw_unit(time_s: Floats, yaw: Floats, source: str) -> None:
    """Raise `InputRefused` where the yaw (N,), as rad, turns faster than a car or steps by about 360: it is degrees."""
    far = max(1, round(LIMITS.yaw_rate_window_s / float(np.median(np.diff(time_s)))))
    step = np.abs(np.diff(yaw))
    # single wrong samples say nothing of the unit
    smooth = median_filter(yaw, LIMITS.yaw_filter_samples, mode="nearest")
    usual = float(np.quantile(np.abs(smooth[far:] - smooth[:-far]) / (time_s[far:] - time_s[:-far]), 0.9))
    wraps = (step > LIMITS.min_wrap_step) & (step < LIMITS.max_wrap_step)
    # one wrong cell steps away and back
    lasting = wraps & ~np.r_[wraps[1:], False] & ~np.r_[False, wraps[:-1]]
    if lasting.any() or usual > LIMITS.max_yaw_rate_radps:
        cause = f"the yaw turns by up to {step.max():.3g} at once, usually {usual:.3g} a second: degrees?"
        raise InputRefused(source, "yaw", cause, "log it in rad, or map it with gain = 0.017453")


def _mean_rate(time_s: Floats) -> float:
    """Mean rate (Hz) of samples at the times (N,) in s, gaps aside."""
    steps = np.diff(time_s)
    return 1.0 / float(steps[steps <= LIMITS.max_usual_steps * np.median(steps)].mean())


def mend_poses(poses: Samples, commands: Samples, vehicle: Vehicle, source: str) -> tuple[Samples, list[float]]:
    """The poses x, y, yaw (N, 3) that the tracking measured of one body, and the times (s) where new segments begin.

    Raises:
        InputRefused: the body swaps or jumps all the time, or lengths or yaw are in another unit.
    """
    poses = drop_frozen_poses(poses, commands)
    poses, breaks = tracking.split_at_jumps(poses, commands, vehicle, source)
    _check_yaw_unit(poses.time_s, poses.values[:, 2], source)
    return drop_turned_poses(poses, commands, vehicle, breaks, source)


def assemble_recording(raw: RawTake, vehicle: Vehicle) -> Recording:
    """A `Recording` from unchecked streams: mended, moved to the CoG, and split at jumps and contacts (bumps, crashes).

    Whatever is mended, left out or doubtful is listed as an irregularity, with its count and place.

    Raises:
        InputRefused: empty or mostly broken streams, or values that no such car can have, with all problems that do
            not follow from each other.
    """
    source, command_log = raw.sources[0].path, command_source_path(raw.sources)
    poses, commands, channels = _clean_streams(raw)
    offset, hold_s = vehicle.clock.offset_s, vehicle.command.max_hold_s
    problems, beyond, breaks = Problems(), list[Irregularity](), list[float]()
    with problems.gather_refusals():
        samples.check_pose_times(poses.time_s, source)
    with problems.gather_refusals():
        samples.check_command_times(commands, hold_s, command_log, raw.several_command_publishers)
    # where stamps are not seconds, speeds and the overlap of the streams are not known
    if not problems:
        with problems.gather_refusals():
            samples.check_streams_overlap(poses.time_s, commands.time_s + offset, source, raw.sources[0].format)
        count = len(poses.time_s)
        poses = drop_interpolated_poses(drop_held_poses(poses))
        rate = raw.rate_hz or 1.0 / float(np.median(np.diff(poses.time_s)))
        if len(poses.time_s) < count:
            rate = _mean_rate(poses.time_s)
            with problems.gather_refusals():
                samples.check_pose_times(poses.time_s, source)
        with problems.gather_refusals():
            poses, breaks = mend_poses(poses, commands, vehicle, source)
            if any(i.kind == "body axes" for i in raw.irregularities):
                poses = face_forward(poses, commands, vehicle)
    misread = Problems()
    with misread.gather_refusals():
        beyond = plausibility.check_commands(commands.values, vehicle, command_log)
    if problems:
        Problems([*problems, *misread]).raise_if_any(source)
    pose = _move_to_cog(np.column_stack([poses.values[:, :2], np.unwrap(poses.values[:, 2])]), vehicle)
    rows = [np.searchsorted(poses.time_s, at, side="right") for _, at in samples.find_set_backs(raw.pose_time_s)]
    breaks = [*breaks, *(float(poses.time_s[row]) for row in rows if row < len(poses.time_s))]
    # in a table, whose rows hold both, a missing row is noted as a pose
    one_table = np.array_equal(raw.pose_time_s, raw.command_time_s)
    step_s = hold_s if one_table else samples.longest_command_step(commands.time_s, hold_s)
    recording = Recording(
        name=raw.name,
        sources=raw.sources,
        poses=Stream(poses.time_s, pose),
        commands=Stream(commands.time_s + offset, commands.values),
        rate_hz=rate,
        hold_s=hold_s,
        breaks_s=tuple(sorted({*breaks, *(t for t in raw.splits_s if t <= poses.time_s[-1])})),
        channels={name: Stream(c.time_s + offset, c.values) for name, c in channels.items()},
        irregularities=(
            *raw.irregularities, *poses.irregularities, *commands.irregularities,
            *samples.find_gaps(poses.time_s, LIMITS.gap_steps / rate, "pose"),
            *samples.find_gaps(commands.time_s, step_s, "command"),
            *samples.find_uncovered_ends(poses.time_s, commands.time_s + offset, hold_s, step_s),
            *beyond,
        ),
    )  # fmt: skip
    if misread:
        verdict.raise_likely_cause(recording, vehicle)
        misread.raise_if_any(source)
    recording = contacts.split_at_contacts(plausibility.check_plausibility(recording, vehicle))
    recording, turning, lag_s = verdict.judge_recording(mounting.warn_of_yaw_offset(recording, vehicle), vehicle)
    return let_measured_speed_run(clock.estimate_clock(recording, vehicle, turning, lag_s), vehicle)
