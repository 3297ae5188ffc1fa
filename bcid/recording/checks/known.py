"""Where the motion of a recording is known, and where its commands are: away from gaps, breaks and uncovered ends.

What is interpolated over a gap has no noise, no speed and no turn of the car's, and a command that is held over one is
not the one that the car obeyed: neither may enter a figure by which a take is judged.
"""

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.recording.checks.limits import KNOWN as LIMITS
from bcid.recording.checks.samples import longest_command_step
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle


def poses_known_at(recording: Recording, time_s: Floats, margin_s: float = 0.0) -> Bools:
    """Whether the motion is known at times (N,) in s: over `margin_s` (s) away from each gap of the poses and break."""
    pose_s = recording.poses.time_s
    wide = np.flatnonzero(np.diff(pose_s) > LIMITS.max_gap_periods / recording.rate_hz)
    gaps = [*zip(pose_s[wide], pose_s[wide + 1], strict=True), *((at, at) for at in recording.breaks_s)]
    return _outside(time_s, gaps, margin_s, margin_s)


def commands_known_at(recording: Recording, vehicle: Vehicle, time_s: Floats, lag_s: float = 0.0) -> Bools:
    """Whether commands that act `lag_s` (s) later than stamped, and the servo under them, are known at times (N,) in s.

    A command is lost from where the next one is overdue; the servo is known again once it can have run to any angle.
    """
    command_s = recording.commands.time_s + lag_s
    held_s = min(recording.hold_s, max(LIMITS.short_command_gap_s, longest_command_step(command_s, recording.hold_s)))
    wide = np.flatnonzero(np.diff(command_s) > held_s)
    gaps = list(zip(command_s[wide] + held_s, command_s[wide + 1], strict=True))
    begins_late = command_s[0] - recording.poses.time_s[0] > held_s
    settle_s = settling_s(recording, vehicle)
    after_start = _outside(time_s, [(-np.inf, command_s[0])], 0.0, settle_s) if begins_late else time_s >= command_s[0]
    ended = time_s > command_s[-1] + recording.hold_s
    return np.asarray(after_start & ~ended & _outside(time_s, gaps, 0.0, settle_s))


def settling_s(recording: Recording, vehicle: Vehicle) -> float:
    """Time (s) within which a servo forgets any angle: it runs from one side to the other, as far as it is steered."""
    given = vehicle.steering
    if given.time_constant_s is None or given.max_rate_radps is None:
        return LIMITS.unknown_servo_s
    largest = min(given.max_angle_rad, float(np.abs(recording.commands.values[:, 0]).max()))
    return LIMITS.settled_constants * given.time_constant_s + 2.0 * largest / given.max_rate_radps


def _outside(time_s: Floats, gaps: list[tuple[float, float]], before_s: float, after_s: float) -> Bools:
    """Whether times (N,) in s lie outside all `gaps`, each widened by `before_s` and `after_s` (s)."""
    outside = np.ones(len(time_s), dtype=bool)
    for start, stop in gaps:
        outside &= (time_s < start - before_s) | (time_s > stop + after_s)
    return outside
