"""The motion of a recording straight from its poses: speed, yaw rate and direction, and the commanded steering angle.

It is good enough to judge units, signs and clocks by; the velocities that models see come from the EKF.
"""

from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from bcid.aliases import Bools, Floats
from bcid.compiled.njit import njit
from bcid.physics.steering import steering_step
from bcid.recording.checks.known import poses_known_at
from bcid.recording.checks.limits import AGREEMENT
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

GRID_HZ = 100.0  # highest rate of the grid
WINDOW_S = 0.26  # of the differentiating filter
SUBSTEPS = 8  # of the steering actuator in a step of the grid
DEFAULT_TIME_CONSTANT_S = 0.15
DEFAULT_RATE_RADPS = 3.0


def reverses_by_motor(vehicle: Vehicle) -> bool:
    """Whether motion backward is that of a motor that drives backward, and not of wheels that are turned by so much.

    The vehicle file says so, or its steering does not reach `AGREEMENT.max_reversing_angle_rad`.
    """
    return vehicle.motor.reverses or vehicle.steering.max_angle_rad < AGREEMENT.max_reversing_angle_rad


class RawMotion(NamedTuple):
    """Motion on a uniform grid of N rows; rows near gaps and breaks are not `good`."""

    time_s: Floats
    v_f: Floats  # speed of the front axle's midpoint (m/s)
    beta_f: Floats  # its direction in the body frame (rad)
    yaw_rate: Floats  # rad/s
    good: Bools
    window_s: float  # of the filter

    @property
    def step_s(self) -> float:
        """The grid's step (s); 0 where it has fewer than two rows."""
        return float(self.time_s[1] - self.time_s[0]) if len(self.time_s) > 1 else 0.0


def differentiate_poses(recording: Recording, vehicle: Vehicle, window_s: float = WINDOW_S) -> RawMotion:
    """Speed, direction (body frame) and yaw rate of the front axle by a quadratic Savitzky-Golay filter of the poses.

    Rows are on a grid of the pose rate, at most 100 Hz.  The filter is `window_s` long, or five rows if these are
    longer; a recording no longer than that has a motion without rows.
    """
    t, pose = recording.poses.time_s, recording.poses.values
    grid_hz = min(GRID_HZ, recording.rate_hz)
    grid = np.arange(t[0], t[-1], 1.0 / grid_hz)
    half = max(2, round(window_s * grid_hz / 2))
    if len(grid) <= 2 * half + 1:
        empty = np.empty(0)
        return RawMotion(empty, empty, empty, empty, np.empty(0, dtype=bool), 0.0)
    smooth = np.column_stack([np.interp(grid, t, column) for column in pose.T])
    rates = savgol_filter(smooth, 2 * half + 1, 2, deriv=1, delta=1.0 / grid_hz, axis=0)
    cos_t, sin_t = np.cos(smooth[:, 2]), np.sin(smooth[:, 2])
    v_x = cos_t * rates[:, 0] + sin_t * rates[:, 1]
    v_fy = cos_t * rates[:, 1] - sin_t * rates[:, 0] + vehicle.body.cog_to_front_m * rates[:, 2]
    good = poses_known_at(recording, grid, half / grid_hz)
    return RawMotion(grid, np.hypot(v_x, v_fy), np.arctan2(v_fy, v_x), rates[:, 2], good, 2 * half / grid_hz)


def moves_backward(direction: Floats, speed: Floats) -> Bools:
    """Whether a car moves backward in each row (N,), by the `direction` (N,) in rad of its motion in the body frame.

    Most of a drive's motion, weighted by the `speed` (N,), lies along one axis, the car's, however the tracked body
    sits on it.  Forward is the side near the body's own x axis, or if that lies across, the side of most motion.
    """
    axis = 0.5 * float(np.angle(np.sum(speed * np.exp(2j * direction))))
    along = np.cos(direction - axis)
    across = abs(axis) > np.pi / 4.0
    side = -1.0 if across and float(np.sum(speed * np.sign(along))) < 0.0 else 1.0
    return np.asarray(side * along < 0.0)


def commanded_steering_angle(
    recording: Recording, vehicle: Vehicle, time_s: Floats, T_s: float | None = None, d: float | None = None
) -> Floats:
    """Steering angle (N,) in rad that the commands alone give at the times (N,) in s of a uniform grid.

    The actuator starts at the first command; its time constant `T_s` (s) and rate limit `d` (rad/s) are the vehicle
    file's, or defaults, where None.
    """
    T_s = T_s or vehicle.steering.time_constant_s or DEFAULT_TIME_CONSTANT_S
    d = d or vehicle.steering.max_rate_radps or DEFAULT_RATE_RADPS
    step_s = float(time_s[1] - time_s[0]) / SUBSTEPS
    middle_s = time_s[0] + step_s * (np.arange(SUBSTEPS * len(time_s)) + 0.5)
    limit = vehicle.steering.max_angle_rad
    u_s = np.clip(recording.commands.held_at(middle_s)[:, 0], -limit, limit)
    return _actuator_response(u_s, T_s, d, step_s)[::SUBSTEPS]


@njit
def _actuator_response(u_s: Floats, T_s: float, d: float, step_s: float) -> Floats:
    """Steering angle (N,) in rad of an actuator under commands u_s (N,) in rad, `step_s` seconds apart.

    T_s (s) is its time constant and d (rad/s) its rate limit; it starts at the first command.
    """
    angle = np.empty(len(u_s))
    delta = u_s[0]
    for k in range(len(u_s)):
        angle[k] = delta
        delta = steering_step(delta, u_s[k], T_s, d, step_s)
    return angle
