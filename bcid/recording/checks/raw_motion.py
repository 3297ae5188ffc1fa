"""A first look at the motion, straight from the poses: speed, yaw rate and the front wheel's course.

Good enough to judge units, signs and clocks; the velocities that models see come from the EKF.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.signal import savgol_filter

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.physics.steering import steering_step
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

GRID_HZ = 100.0
WINDOW_S = 0.26
SUBSTEPS = 8
DEFAULT_TIME_CONSTANT_S = 0.15
DEFAULT_RATE_RADPS = 3.0


class Course(NamedTuple):
    """On a uniform grid; rows near gaps and jumps are marked as not `good`."""

    time_s: Floats
    v_f: Floats  # speed of the front axle's midpoint (m/s)
    beta_f: Floats  # its direction in the body frame (rad)
    yaw_rate: Floats  # rad/s
    good: npt.NDArray[np.bool_]
    window_s: float  # of the filter


def course(recording: Recording, vehicle: Vehicle, window_s: float = WINDOW_S) -> Course:
    """Speed, direction and yaw rate by a quadratic Savitzky-Golay filter over `window_s`, or five poses if longer."""
    t, pose = recording.poses.time_s, recording.poses.values
    grid_hz = min(GRID_HZ, recording.rate_hz)
    grid = np.arange(t[0], t[-1], 1.0 / grid_hz)
    half = max(2, round(window_s * grid_hz / 2))
    if len(grid) <= 2 * half + 1:
        empty = np.empty(0)
        return Course(empty, empty, empty, empty, np.empty(0, dtype=bool), 0.0)
    smooth = np.column_stack([np.interp(grid, t, column) for column in pose.T])
    rates = savgol_filter(smooth, 2 * half + 1, 2, deriv=1, delta=1.0 / grid_hz, axis=0)
    cos_t, sin_t = np.cos(smooth[:, 2]), np.sin(smooth[:, 2])
    v_x = cos_t * rates[:, 0] + sin_t * rates[:, 1]
    v_fy = cos_t * rates[:, 1] - sin_t * rates[:, 0] + vehicle.body.cog_to_front_m * rates[:, 2]
    return Course(
        grid,
        np.hypot(v_x, v_fy),
        np.arctan2(v_fy, v_x),
        rates[:, 2],
        _far_from_holes(recording, grid, half / grid_hz),
        2 * half / grid_hz,
    )


def _far_from_holes(recording: Recording, grid: Floats, margin_s: float) -> npt.NDArray[np.bool_]:
    t = recording.poses.time_s
    good = np.ones(len(grid), dtype=bool)
    wide = np.flatnonzero(np.diff(t) > 2.5 / recording.rate_hz)
    holes = [(t[i], t[i + 1]) for i in wide] + [(b, b) for b in recording.breaks_s]
    for start, stop in holes:
        good &= (grid < start - margin_s) | (grid > stop + margin_s)
    return good


def commanded_angle(
    recording: Recording, vehicle: Vehicle, time_s: Floats, T_s: float | None = None, d: float | None = None
) -> Floats:
    """Steering angle (rad) that the commands alone give at `time_s` (uniform grid), from rest at the first command.

    Time constant `T_s` (s) and rate limit `d` (rad/s) are the vehicle file's, or documented defaults, unless given.
    """
    T_s = T_s or vehicle.steering.time_constant_s or DEFAULT_TIME_CONSTANT_S
    d = d or vehicle.steering.max_rate_radps or DEFAULT_RATE_RADPS
    step_s = float(time_s[1] - time_s[0]) / SUBSTEPS
    middle_s = time_s[0] + step_s * (np.arange(SUBSTEPS * len(time_s)) + 0.5)
    rows = np.searchsorted(recording.commands.time_s, middle_s, side="right") - 1
    limit = vehicle.steering.max_angle_rad
    u_s = np.clip(recording.commands.values[np.maximum(rows, 0), 0], -limit, limit)
    return _follow(u_s, T_s, d, step_s)[::SUBSTEPS]


@njit
def _follow(u_s: Floats, T_s: float, d: float, step_s: float) -> Floats:
    angle = np.empty(len(u_s))
    delta = u_s[0]
    for k in range(len(u_s)):
        angle[k] = delta
        delta = steering_step(delta, u_s[k], T_s, d, step_s)
    return angle
