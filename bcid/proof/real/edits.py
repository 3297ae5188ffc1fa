"""Edits that make an effect of known size in a real recording, by changing its poses or commands."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from bcid.aliases import Floats
from bcid.recording.types import Recording, Stream


def _restamp_poses(recording: Recording, stamp: Callable[[Floats], Floats]) -> Recording:
    """A copy of the recording with the times (s) of its poses, and of the breaks after gaps in them, mapped by `stamp`.

    Breaks are pose times at which a new segment begins.
    """
    breaks = tuple(stamp(np.array(recording.breaks_s, dtype=float)).tolist())
    return replace(recording, poses=Stream(stamp(recording.poses.time_s), recording.poses.values), breaks_s=breaks)


def _scale_and_turn_poses(recording: Recording, factor: float = 1.0, turn: float = 0.0) -> Recording:
    """A copy of the recording with pose positions (m) multiplied by `factor`, and `turn` (rad) added to the yaw."""
    values = recording.poses.values * [factor, factor, 1.0] + [0.0, 0.0, turn]
    return replace(recording, poses=Stream(recording.poses.time_s, values))


def _move_tracked_point(recording: Recording, d: float) -> Recording:
    """A copy of the recording as tracked at a point `d` (m) further forward: positions plus d [cos(yaw), sin(yaw)]."""
    x, y, yaw = recording.poses.values.T
    values = np.column_stack([x + d * np.cos(yaw), y + d * np.sin(yaw), yaw])
    return replace(recording, poses=Stream(recording.poses.time_s, values))


def _map_steering_commands(recording: Recording, angle: Callable[[Floats], Floats]) -> Recording:
    """A copy of the recording with each steering command u (rad) replaced by `angle`(u)."""
    values = recording.commands.values.copy()
    values[:, 0] = angle(values[:, 0])
    return replace(recording, commands=Stream(recording.commands.time_s, values))


def _advance_command(recording: Recording, tau: float, column: int) -> Recording:
    """A copy of the recording with one command logged `tau` (s) earlier, so that the car seems to react later by `tau`.

    Column 0 is steering, 1 throttle.  A command holds until the next; the last `tau` seconds are dropped.
    """
    t, values = recording.commands.time_s, recording.commands.values
    times = np.union1d(t, t - tau)
    times = times[(times >= t[0]) & (times <= t[-1] - tau)]
    now = values[np.searchsorted(t, times, side="right") - 1].copy()
    now[:, column] = values[np.searchsorted(t, times + tau, side="right") - 1, column]
    return replace(recording, commands=Stream(times, now))


EDITS: Mapping[str, Callable[[Recording, float], Recording]] = {
    "pose_latency": lambda take, tau: _restamp_poses(take, lambda t: t + tau),
    "clock_drift": lambda take, drift: _restamp_poses(take, lambda t: t + drift * (t - take.poses.time_s[0])),
    "marker_offset": _move_tracked_point,
    "body_yaw_misalignment": lambda take, psi: _scale_and_turn_poses(take, turn=psi),
    "pose_scale": lambda take, kappa: _scale_and_turn_poses(take, factor=1.0 + kappa),
    "steering_offset": lambda take, o: _map_steering_commands(take, lambda u: u - o),
    "steering_side_gain": lambda take, a: _map_steering_commands(take, lambda u: u / (1.0 + a * np.sign(u))),
    "steering_delay": lambda take, tau: _advance_command(take, tau, 0),
    "motor_delay": lambda take, tau: _advance_command(take, tau, 1),
}
"""By effect, the edit after which the car in a recording has the effect of the given size."""
