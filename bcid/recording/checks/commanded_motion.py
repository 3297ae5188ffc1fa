"""The motion of a car and its commands on one coarse grid, on which the one is compared with the other."""

from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from bcid.aliases import Bools, Floats, Ints
from bcid.recording.checks.known import commands_known_at, poses_known_at
from bcid.recording.checks.limits import AGREEMENT as LIMITS
from bcid.recording.checks.pose_noise import white_noise_sd
from bcid.recording.checks.raw_motion import moves_backward, reverses_by_motor
from bcid.recording.checks.turning import TurningData
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

GRID_HZ = 25.0


class CommandedMotion(NamedTuple):
    """N rows at GRID_HZ."""

    time_s: Floats
    speed: Floats  # of the front hub, m/s; below zero where the car reverses
    turn: Floats  # yaw rate, rad/s
    pull: Floats  # rate of the speed, m/s^2
    use: Bools  # rows at which the motion is known and fast enough
    known: Bools  # rows at which a command is known, and the servo under it, and no brake of its own is on
    commands: Floats  # (N, 2) steering (rad) and throttle
    pull_noise: float  # of `pull` by the noise of the positions, m/s^2

    @property
    def top_speed(self) -> float:
        """The speed (m/s) that the car passes in a twentieth of its motion."""
        return max(float(np.quantile(np.abs(self.speed[self.use]), 0.95)), 1e-9) if self.use.any() else 1e-9

    def commands_at(self, lag_s: float) -> tuple[Floats, Bools]:
        """The commands (N, 2) that act `lag_s` (s) later than stamped in each row, and where (N,) they are known."""
        at, under = command_rows(self.known, np.arange(len(self.time_s)), round(lag_s * GRID_HZ))
        return self.commands[at], under


def command_rows(known: Bools, rows: Ints, lag: int) -> tuple[Ints, Bools]:
    """The rows (K,) of the commands that act at `rows` (K,), `lag` rows later than stamped, and where they are `known`.

    Of commands outside the recording the nearest row is given, and they are not known.  `known` is (N,).
    """
    at = rows - lag
    inside = (at >= 0) & (at < len(known))
    at = np.clip(at, 0, len(known) - 1)
    return at, inside & known[at]


def compare_on_grid(recording: Recording, data: TurningData, vehicle: Vehicle) -> CommandedMotion:
    """Motion and commands of a recording at GRID_HZ.

    The speed is signed by the direction in which the car moves, but for wheels that turn so far that the car moves
    backward while they roll forward.
    """
    time_s = np.arange(data.time_s[0], data.time_s[-1], 1.0 / GRID_HZ)
    known = np.zeros(len(data.time_s))
    known[data.rows] = 1.0
    speed = np.interp(time_s, data.time_s, data.speed)
    if reverses_by_motor(vehicle):
        heading = np.interp(time_s, data.time_s, data.heading)
        seen = poses_known_at(recording, time_s)
        speed = np.where(moves_backward(heading, np.where(seen, speed, 0.0)), -speed, speed)
    free = recording.driven.held_at(time_s)[:, 2] <= 0.0  # of a brake, which is no part of the throttle
    return CommandedMotion(
        time_s, speed, np.interp(time_s, data.time_s, data.turn), smoothed(speed, derivative=True),
        away_from_unknown(np.interp(time_s, data.time_s, known) > 0.99),
        free & commands_known_at(recording, vehicle, time_s),
        recording.commands.held_at(time_s), _pull_noise(recording),
    )  # fmt: skip


def _pull_noise(recording: Recording) -> float:
    """Noise (m/s^2) of a second derivative over `AGREEMENT.pull_window_s`, by the noise of the recorded positions."""
    t, rate_hz = recording.poses.time_s, recording.rate_hz
    grid = np.arange(t[0], t[-1], 1.0 / rate_hz)
    known = poses_known_at(recording, grid, 0.5 / rate_hz)
    noise = max(white_noise_sd(np.interp(grid, t, column), known) for column in recording.poses.values[:, :2].T)
    count = max(3.0, LIMITS.pull_window_s * rate_hz)
    return noise * float(np.sqrt(720.0 / count)) / LIMITS.pull_window_s**2


def away_from_unknown(known: Bools) -> Bools:
    """Rows (N,) at GRID_HZ which `smoothed` makes of rows that are `known` (N,) alone."""
    width = 2 * round(0.5 * LIMITS.pull_window_s * GRID_HZ) + 1
    return np.asarray(np.convolve(known, np.ones(width), mode="same") > width - 0.5)


def smoothed(values: Floats, derivative: bool = False) -> Floats:
    """Values (N,) at GRID_HZ, or their rate per second, smoothed over `AGREEMENT.pull_window_s`."""
    width = 2 * round(0.5 * LIMITS.pull_window_s * GRID_HZ) + 1
    return np.asarray(savgol_filter(values, width, 1, deriv=int(derivative), delta=1.0 / GRID_HZ))
