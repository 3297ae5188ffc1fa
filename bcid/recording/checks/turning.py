"""How a car turns and how fast it drives, on an even grid: what servo, tyres and the commands' clock are judged by.

Filters are no longer than the noise of yaw and position demands, and than the car takes to drive its own length.
"""

import functools
from typing import NamedTuple

import numpy as np
from scipy.ndimage import convolve1d
from scipy.signal import savgol_coeffs, savgol_filter

from bcid.aliases import Bools, Floats, Ints
from bcid.recording.checks.known import commands_known_at, poses_known_at
from bcid.recording.checks.limits import SERVO as LIMITS
from bcid.recording.checks.pose_noise import white_noise_sd
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

GRID_HZ = 100.0


class TurningData(NamedTuple):
    """What of a recording the fit sees, on a uniform grid of N rows."""

    time_s: Floats
    speed: Floats  # of the front hub, m/s
    speed_rate: Floats  # m/s^2
    heading: Floats  # of the hub's motion in the body frame, rad
    turn: Floats  # filtered yaw rate, rad/s
    restart: Bools
    rows: Ints  # that count
    half_window: int  # of the yaw's filter
    command_s: Floats
    u_s: Floats
    noise: float  # of a filtered yaw rate by the poses' noise, rad/s

    @property
    def step_s(self) -> float:
        """The grid's step (s)."""
        return float(self.time_s[1] - self.time_s[0])


def filter_length(noise: float, rate_hz: float, wanted: float) -> float:
    """Length (s) of a differentiating filter at `rate_hz` (Hz) that lets white noise pass as `wanted` per second."""
    return float((np.sqrt(12.0 / rate_hz) * noise / max(wanted, 1e-12)) ** (2.0 / 3.0))


def prepare_turning(recording: Recording, vehicle: Vehicle, lag_s: float = 0.0) -> TurningData | None:
    """The speed and turning of a recording on a uniform grid, filtered no longer than its noise demands.

    Rows count where the motion is known, and commands that act `lag_s` (s) later than stamped are.  None where it is
    too short, or moves in no stretch that is long enough.
    """
    t, pose = recording.poses.time_s, recording.poses.values
    grid_hz = min(GRID_HZ, recording.rate_hz)
    time_s = np.arange(t[0], t[-1], 1.0 / grid_hz)
    if len(time_s) < LIMITS.min_rows:
        return None
    x, y, yaw = (np.interp(time_s, t, column) for column in pose.T)
    L = vehicle.body.wheelbase_m
    way = np.hypot(np.diff(x, prepend=x[0]), np.diff(y, prepend=y[0])) * grid_hz
    known = poses_known_at(recording, time_s, 0.5 / grid_hz)
    if not known.any():
        return None
    usual_speed = float(np.quantile(np.abs(savgol_filter(way, 11, 1))[known], 0.7))
    if usual_speed <= 0.0:
        return None
    turning = max(float(np.std((np.diff(yaw) * grid_hz)[known[1:] & known[:-1]])), 1e-3)
    yaw_noise, place_noise = white_noise_sd(yaw, known), max(white_noise_sd(x, known), white_noise_sd(y, known))
    shortest, longest = 4.0 / grid_hz, min(LIMITS.max_filter_s, max(L / usual_speed, 0.1))
    window_s = float(np.clip(filter_length(yaw_noise, grid_hz, LIMITS.noise_share * turning), shortest, longest))
    speed_window_s = filter_length(place_noise, grid_hz, LIMITS.noise_share * usual_speed)
    speed_window_s = float(np.clip(speed_window_s, max(window_s, 6.0 / grid_hz), max(longest, 6.0 / grid_hz)))
    half, speed_half = (max(2, round(w * grid_hz / 2)) for w in (window_s, speed_window_s))
    step_s = 1.0 / grid_hz
    rates = np.column_stack([filtered_rate(column, speed_half, step_s) for column in (x, y, yaw)])
    v_x = np.cos(yaw) * rates[:, 0] + np.sin(yaw) * rates[:, 1]
    v_fy = np.cos(yaw) * rates[:, 1] - np.sin(yaw) * rates[:, 0] + vehicle.body.cog_to_front_m * rates[:, 2]
    speed = np.hypot(v_x, v_fy)
    usable = speed > LIMITS.min_speed_share * float(np.quantile(speed[known], 0.95))
    usable &= poses_known_at(recording, time_s, max(half, speed_half) / grid_hz)
    usable &= commands_known_at(recording, vehicle, time_s, lag_s)
    restart, rows = _stretches(usable, grid_hz, max(half, speed_half))
    if len(rows) < LIMITS.min_rows:
        return None
    limit = vehicle.steering.max_angle_rad
    return TurningData(
        time_s, speed, filtered_rate(speed, speed_half, step_s),
        np.unwrap(np.arctan2(v_fy, v_x)), filtered_rate(yaw, half, 1.0 / grid_hz), restart, rows, half,
        recording.commands.time_s, np.clip(recording.commands.values[:, 0], -limit, limit),
        yaw_noise * float(np.sqrt(12.0 * grid_hz / (2 * half + 1) ** 3) * np.sqrt(grid_hz)),
    )  # fmt: skip


def liveliest(data: TurningData, seconds: float) -> TurningData:
    """The part of a take of at most `seconds` (s) in which the car turns most variedly."""
    count = round(seconds / data.step_s)
    if count >= len(data.time_s):
        return data
    counts = np.zeros(len(data.time_s))
    counts[data.rows] = (data.turn[data.rows] - data.turn[data.rows].mean()) ** 2
    total = np.r_[0.0, np.cumsum(counts)]
    begin = int(np.argmax(total[count:] - total[:-count]))
    part = slice(begin, begin + count)
    restart = data.restart[part].copy()
    restart[0] = True
    settled = round(LIMITS.settle_s / data.step_s) + data.half_window
    rows = data.rows[(data.rows >= begin + settled) & (data.rows < begin + count - data.half_window)] - begin
    return data._replace(
        time_s=data.time_s[part], speed=data.speed[part], speed_rate=data.speed_rate[part],
        heading=data.heading[part], turn=data.turn[part], restart=restart, rows=rows,
    )  # fmt: skip


def split_at_blocks(rows: Ints, time_s: Floats, block_s: float) -> list[Ints]:
    """The ascending `rows` (K,) of times (N,) in s in groups, one for each block of `block_s` (s) that has any."""
    block = np.floor_divide(time_s[rows], block_s)
    return np.split(rows, np.flatnonzero(np.diff(block)) + 1) if len(rows) else []


def _stretches(usable: Bools, grid_hz: float, half: int) -> tuple[Bools, Ints]:
    """Rows (N,) at which the car is put back to its measured motion, and the rows that count, behind each of these."""
    start = usable & ~np.r_[False, usable[:-1]]
    every, stretch = np.arange(len(usable)), max(1, round(LIMITS.stretch_s * grid_hz))
    age = (every - np.maximum.accumulate(np.where(start, every, -1))) % (stretch + 1)
    restart = start | (age == 0)
    settle = round(LIMITS.settle_s * grid_hz) + half
    ahead = np.flatnonzero(restart)
    to_next = np.r_[ahead, len(usable)][np.searchsorted(ahead, every, side="right")] - every
    inside = np.convolve(usable, np.ones(2 * half + 1), mode="same") > 2 * half + 0.5
    rows = np.flatnonzero(usable & inside & (age >= settle) & (to_next > half))
    return restart, rows[(rows > half) & (rows < len(usable) - half)]


def filtered_rate(yaw: Floats, half: int, step_s: float) -> Floats:
    """Yaw rate (N,) in rad/s of a `yaw` (N,) in rad, `step_s` (s) apart, by a quadratic filter of 2 `half` + 1 rows."""
    size = 2 * half + 1
    if len(yaw) < size:
        return np.asarray(savgol_filter(yaw, size, 2, deriv=1, delta=step_s))
    inner, first, last = _rate_filter(half, step_s)
    rate = convolve1d(yaw, inner, mode="constant")
    rate[:half], rate[len(yaw) - half :] = first @ yaw[:size], last @ yaw[-size:]
    return np.asarray(rate)


@functools.lru_cache(maxsize=64)
def _rate_filter(half: int, step_s: float) -> tuple[Floats, Floats, Floats]:
    """The quadratic filter of `filtered_rate`: its weights (2 half + 1,), and those of the first and last rows.

    The latter (half, 2 half + 1) are of the parabola through the first and the last 2 half + 1 values.
    """
    at = np.arange(-half, half + 1) * step_s
    parabola = np.linalg.pinv(np.column_stack([np.ones(len(at)), at, at * at]))
    rates = parabola[1] + 2.0 * at[:, None] * parabola[2]
    return savgol_coeffs(2 * half + 1, 2, deriv=1, delta=step_s), rates[:half], rates[half + 1 :]
