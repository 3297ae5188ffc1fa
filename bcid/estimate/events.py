"""What the filter works on: a recording's poses, commands and further channels as events, and the output grid."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.estimate.command_parts import cut_into_parts, shift_to_commands
from bcid.estimate.kernel import Events
from bcid.estimate.limits import LIMITS
from bcid.estimate.process import BETAF, DELTA, MEASURED, N_MEASURED, N_STATE, THETA, VF, Chassis
from bcid.physics.steering import steering_step
from bcid.recording.types import Recording, Stream
from bcid.vehicle import Vehicle

# Variances of the state at a stretch's start, SI and rad.
P_0 = (1e-4, 1e-4, 1e-4, 0.25, 0.25, 0.04, 0.04)
# Time (s) over which poses give the initial velocity, and the speed below which they give no course: the wheel then
# heads where it is steered.
INITIAL_VELOCITY_S, MIN_COURSE_SPEED_MPS = 0.25, 0.05
QUANTITY_OF_CHANNEL = {
    "measured_steering_rad": "steering", "yaw_rate_radps": "yaw_rate", "wheel_speed_mps": "wheel_speed"
}  # fmt: skip
TIME_DECIMALS = 7


def build_chassis(vehicle: Vehicle, T_s: float, d: float) -> Chassis:
    """The EKF's constants: l_f, l_r (m) and driven axle of the vehicle; T_s (s), d (rad/s) of its steering."""
    body, front_driven = vehicle.body, vehicle.front_share >= LIMITS.front_driven_share
    return Chassis(body.cog_to_front_m, body.cog_to_rear_m, T_s, d, front_driven)


class Timeline(NamedTuple):
    """The events of a recording, and which of them are rows of the output grid."""

    events: Events
    grid: npt.NDArray[np.int64]  # event index of each grid row
    segment: npt.NDArray[np.int64]  # of each grid row
    parts: Floats  # (K, W, 4) duration (s) and command of each part of the period after a grid row


def hold_commands(commands: Stream, time_s: Floats) -> tuple[Floats, Floats]:
    """The latest command [u_s, u_m] (N, 2) at or before each of the times `time_s` (N,), and its age (N,) in s.

    Times before the first command get the first command, with an infinite age.
    """
    stamps = np.round(commands.time_s, TIME_DECIMALS)  # as the events' times are
    rows = np.searchsorted(stamps, np.round(time_s, TIME_DECIMALS), side="right") - 1
    age = np.where(rows >= 0, time_s - stamps[np.maximum(rows, 0)], np.inf)
    return commands.values[np.maximum(rows, 0)], age


def build_timeline(
    recording: Recording, vehicle: Vehicle, period_s: float, max_gap_s: float, T_s: float, d: float
) -> Timeline:
    """The filter's events (all times of poses, commands, other channels and grid rows), and the grid for its output.

    The grid has a row every `period_s` from the recording's time zero, or from the time at which it is in step with
    the commands (`shift_to_commands`).  Rows inside pose gaps longer than `max_gap_s`,
    or where the last command is older than `recording.hold_s`, are left out and end a segment; the filter predicts
    through gaps all the same.  `T_s` (s) and `d` (rad/s) are the steering's time constant and rate limit.
    """
    pose_s = np.round(recording.poses.time_s, TIME_DECIMALS)
    first, last = pose_s[0], pose_s[-1]
    limit = vehicle.steering.max_angle_rad
    commands = recording.driven
    command_s, driven = np.round(commands.time_s, TIME_DECIMALS), commands.values.copy()
    driven[:, 0] = np.clip(driven[:, 0], -limit, limit)
    shift = shift_to_commands(command_s, driven, period_s)
    periods = np.arange(np.ceil((first - shift) / period_s - 1e-6), np.floor((last - shift) / period_s + 1e-6) + 1)
    grid_s = np.round(periods * period_s + shift, TIME_DECIMALS)
    extra = [np.round(s.time_s, TIME_DECIMALS) for s in (recording.commands, *recording.channels.values())]
    time_s = np.unique(np.concatenate([pose_s, grid_s, *extra]))
    time_s = time_s[(time_s >= first) & (time_s <= last)]
    z, restart = _measurement_table(recording, time_s, pose_s), np.zeros(len(time_s))
    starts = np.searchsorted(time_s, np.round([first, *recording.breaks_s], TIME_DECIMALS))
    restart[starts] = 1.0
    u_s = np.clip(hold_commands(recording.commands, time_s)[0][:, 0], -limit, limit)
    x_0 = np.zeros((len(time_s), N_STATE))
    for k in starts:
        x_0[k] = _initial_state(recording, vehicle, float(time_s[k]))
    x_0[starts, DELTA] = u_s[starts]
    x_0[starts[0], DELTA] = _steering_angle_at(recording, vehicle, float(first), T_s, d)
    slow = x_0[starts, VF] <= MIN_COURSE_SPEED_MPS
    x_0[starts[slow], BETAF] = x_0[starts[slow], DELTA]
    events = Events(time_s, u_s, z, restart, x_0, np.array(P_0))

    grid = np.searchsorted(time_s, grid_s)
    _, age = hold_commands(recording.commands, grid_s)
    usable = (age <= recording.hold_s) & ~_mark_pose_gaps(recording, grid_s, max_gap_s)
    stretch = np.searchsorted(starts, grid, side="right")
    new = np.r_[True, (np.diff(stretch) > 0) | ~usable[:-1] | ~usable[1:]]
    segment, parts = np.cumsum(new), cut_into_parts(command_s, driven, grid_s[usable], period_s)
    return Timeline(events, grid[usable], segment[usable], parts)


def _measurement_table(recording: Recording, time_s: Floats, pose_s: Floats) -> Floats:
    """Measurements (M, 6) x, y, yaw, steering, yaw rate, wheel speed at the event times `time_s`; NaN where none is.

    The poses enter at the events of their times `pose_s`, which are among `time_s` (M,).
    """
    z = np.full((len(time_s), N_MEASURED), np.nan)
    z[np.searchsorted(time_s, pose_s), :3] = recording.poses.values
    for name, stream in recording.channels.items():
        if name not in QUANTITY_OF_CHANNEL:
            continue
        stamps = np.round(stream.time_s, TIME_DECIMALS)
        inside = (stamps >= time_s[0]) & (stamps <= time_s[-1])
        rows = np.searchsorted(time_s, stamps[inside])
        z[rows, MEASURED.index(QUANTITY_OF_CHANNEL[name])] = stream.values[inside, 0]
    return z


def _mark_pose_gaps(recording: Recording, time_s: Floats, max_gap_s: float) -> npt.NDArray[np.bool_]:
    """Mask (K,) of the times `time_s` (K,) that lie inside a gap: two poses over `max_gap_s` apart, or a break."""
    t = recording.poses.time_s
    after = np.clip(np.searchsorted(t, time_s - 1e-7), 1, len(t) - 1)
    width = t[after] - t[after - 1]
    strictly = (time_s > t[after - 1] + 1e-7) & (time_s < t[after] - 1e-7)
    before_jump = np.isin(t[after], recording.breaks_s)
    return strictly & ((width > max_gap_s) | before_jump)


def _steering_angle_at(recording: Recording, vehicle: Vehicle, start_s: float, T_s: float, d: float) -> float:
    """Steering angle (rad) at `start_s` after the commands before it, by time constant T_s (s) and rate limit d."""
    stamps, limit = recording.commands.time_s, vehicle.steering.max_angle_rad
    u_s = np.clip(recording.commands.values[:, 0], -limit, limit)
    before = stamps < start_s
    edges = np.append(stamps[before], start_s)
    delta = float(u_s[0])
    for u, dt in zip(u_s[before], np.diff(edges), strict=True):
        delta = steering_step(delta, u, T_s, d, dt)
    return delta


def _initial_state(recording: Recording, vehicle: Vehicle, start_s: float) -> Floats:
    """The EKF's state (7,) [p_x, p_y, theta, v_f, beta_f, beta_r, delta] at `start_s`, the time of a pose.

    Position and yaw are that pose's; v_f and beta_f come from a line through the poses of the next INITIAL_VELOCITY_S,
    and are 0 where these are slower than MIN_COURSE_SPEED_MPS; beta_r and delta are 0.
    """
    t, pose = recording.poses.time_s, recording.poses.values
    first = int(np.searchsorted(t, start_s - 1e-6))
    stop = max(int(np.searchsorted(t, start_s + INITIAL_VELOCITY_S)), first + 2)
    stop = min([stop, len(t), *(int(np.searchsorted(t, b)) for b in recording.breaks_s if b > start_s + 1e-6)])
    x = np.zeros(N_STATE)
    x[:3] = pose[first]
    if stop - first < 2:
        return x
    p_x, p_y, yaw_rate = np.polyfit(t[first:stop] - t[first], pose[first:stop], 1)[0]
    cos_t, sin_t = np.cos(x[THETA]), np.sin(x[THETA])
    v_x, v_y = cos_t * p_x + sin_t * p_y, cos_t * p_y - sin_t * p_x
    v_fy = v_y + vehicle.body.cog_to_front_m * yaw_rate
    speed = float(np.hypot(v_x, v_fy))
    if speed > MIN_COURSE_SPEED_MPS:
        x[VF], x[BETAF] = speed, np.arctan2(v_fy, v_x)
    return x
