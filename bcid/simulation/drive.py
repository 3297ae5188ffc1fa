"""One drive: driver, plant and motion capture together."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.driver import DRAWS, Arena, decide, pursue
from bcid.simulation.dynamics import STEPS_PER_S, Inputs, N, advanced

COMMAND_HZ = 20
TRUTH_HZ = 10
ROUGHNESS_TIME_S = 0.3


class Drive(NamedTuple):
    """What happened and what was seen of it."""

    command_time: Floats  # (M,) s
    command: Floats  # (M, 2) steering rad, throttle m/s or brake share
    frame: npt.NDArray[np.int64]  # (F,) motion-capture frames, dropped ones included
    pose: Floats  # (F, 3) measured x, y, yaw; NaN where dropped
    truth: Floats  # (K, 8) at 10 Hz: time, x, y, yaw, v_x, v_y, yaw rate, wheel angle of the servo


@njit
def _held(commands: Floats, column: int, now: float, delay: float) -> tuple[float, float]:
    """The command in force at `now` as it was `delay` earlier, and when it changes next."""
    row = math.floor((now - delay) * COMMAND_HZ + 1e-6)
    return float(commands[max(row, 0), column]), (row + 1) / COMMAND_HZ + delay


@njit
def _run(
    p: Plant, arena: Arena, duration: float, uniform: Floats, normal: Floats, given: Floats, pursues: bool
) -> tuple[Floats, Floats]:
    """Fine states (S + 1, N) and commands (M, 2); `given` commands (M, 2) replace the driver where there are any.

    The driver draws targets, or follows a path by what it sees.
    """
    per_command = STEPS_PER_S // COMMAND_HZ
    count = round(duration * COMMAND_HZ)
    commands = np.zeros((count, 2))
    states = np.zeros((count * per_command + 1, N))
    s, play = states[0].copy(), 0.0
    steer, throttle, left = 0.0, 0.0, 0.5
    push = np.zeros(3)
    keep = math.exp(-1.0 / (STEPS_PER_S * ROUGHNESS_TIME_S))
    fresh = math.sqrt(1.0 - keep * keep)
    for m in range(count):
        if len(given):
            commands[m] = given[m]
        elif pursues:
            commands[m] = pursue(s, m / COMMAND_HZ, p, arena)
        else:
            steer, throttle, left = decide(s, steer, throttle, left, uniform[m], p, arena)
            left -= 1.0 / COMMAND_HZ
            commands[m, 0], commands[m, 1] = steer, throttle
        for k in range(m * per_command, (m + 1) * per_command):
            now = k / STEPS_PER_S
            push = keep * push + fresh * normal[k]
            end = (k + 1) / STEPS_PER_S
            while end - now > 1e-9:  # a fine step is divided where a delayed command changes
                steer_now, steer_until = _held(commands, 0, now, p.steering_delay)
                drive_now, drive_until = _held(commands, 1, now, p.motor_delay)
                until = min(end, steer_until, drive_until)
                inputs = Inputs(
                    now, duration, steer_now, drive_now,
                    p.rough_force * push[0], p.rough_force * push[1], p.rough_moment * push[2],
                )  # fmt: skip
                s, play = advanced(s, play, inputs, until - now, p)
                now = until
            states[k + 1] = s
    return states, commands


def slow_circles(duration: float) -> Floats:
    """Commands (duration * 20, 2) of slow circles to the left, that neither saturate, nor limit, nor brake anything."""
    t = np.arange(round(duration * COMMAND_HZ)) / COMMAND_HZ
    return np.column_stack([0.62 + 0.06 * np.sin(0.21 * t), 0.72 + 0.08 * np.sin(0.13 * t)])


def drive(
    plant: Plant, sensor: Sensor, duration: float, seed: int, arena: Arena | None = None, given: Floats | None = None,
    pursues: bool = False,
) -> Drive:  # fmt: skip
    """A drive of `duration` seconds from rest at the arena's middle.

    `given` commands (duration * 20, 2) are driven instead of the driver's own; one that pursues follows a path in a
    closed loop instead of drawing its targets.
    """
    rng = np.random.default_rng(seed)
    count = round(duration * COMMAND_HZ)
    uniform = rng.random((count, DRAWS))
    normal = rng.standard_normal((count * (STEPS_PER_S // COMMAND_HZ), 3))
    states, commands = _run(
        plant, arena or Arena(), duration, uniform, normal, np.empty((0, 2)) if given is None else given, pursues
    )
    frame, pose = _capture(states, sensor, duration, rng)
    rows = np.arange(0, len(states), STEPS_PER_S // TRUTH_HZ)
    return Drive(np.arange(count) / COMMAND_HZ, commands, frame, pose, _truth(states[rows], rows / STEPS_PER_S))


def _truth(s: Floats, time: Floats) -> Floats:
    cos_h, sin_h = np.cos(s[:, 2]), np.sin(s[:, 2])
    along, across = cos_h * s[:, 3] + sin_h * s[:, 4], cos_h * s[:, 4] - sin_h * s[:, 3]
    return np.column_stack([time, s[:, :3], along, across, s[:, 5], s[:, 6]])


def _capture(
    states: Floats, sensor: Sensor, duration: float, rng: np.random.Generator
) -> tuple[npt.NDArray[np.int64], Floats]:
    frame = np.arange(math.floor(duration * sensor.rate_hz * (1.0 + sensor.clock_drift) + 1e-9) + 1)
    seen_at = frame / sensor.rate_hz / (1.0 + sensor.clock_drift) - sensor.pose_latency
    fine = np.arange(len(states)) / STEPS_PER_S
    x, y, heading = (np.interp(seen_at, fine, states[:, c]) for c in range(3))
    cos_h, sin_h = np.cos(heading), np.sin(heading)
    x = x + cos_h * sensor.marker_offset_x - sin_h * sensor.marker_offset_y
    y = y + sin_h * sensor.marker_offset_x + cos_h * sensor.marker_offset_y
    grown = 1.0 + sensor.pose_scale + sensor.lens_distortion * (x * x + y * y)
    pose = np.column_stack([grown * x, grown * y, heading + sensor.body_yaw_misalignment])
    pose += rng.standard_normal(pose.shape) * [sensor.position_noise, sensor.position_noise, sensor.yaw_noise]
    for start in rng.uniform(0.5, duration, rng.poisson(sensor.dropouts_per_minute * duration / 60.0)):
        length = rng.uniform(1.0 / sensor.rate_hz, sensor.longest_dropout)
        pose[(frame >= start * sensor.rate_hz) & (frame < (start + length) * sensor.rate_hz)] = np.nan
    return frame, pose
