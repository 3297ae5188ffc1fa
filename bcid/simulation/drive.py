"""One drive: driver, plant and motion capture together."""

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.driver import DRAWS_PER_DECISION, SimulatedArena, choose_target, follow_path
from bcid.simulation.dynamics import STATE_SIZE, STEPS_PER_S, advance_plant
from bcid.simulation.wheels import PlantInputs

COMMAND_HZ = 20
TRUTH_HZ = 10
ROUGHNESS_TIME_S = 0.3
SAME_TIME_S = 1e-9
SHAKE_S = 0.9  # in which shaking cameras swing once


class Drive(NamedTuple):
    """A simulated drive: what happened and what was seen of it."""

    command_time: Floats  # (M,) s
    command: Floats  # (M, 2) steering rad, throttle m/s or brake share
    frame: npt.NDArray[np.int64]  # (F,) motion-capture frames, dropped ones included
    pose: Floats  # (F, 3) measured x, y, yaw; NaN where dropped
    truth: Floats  # (K, 8) at 10 Hz: time, x, y, yaw, v_x, v_y, yaw rate, wheel angle of the servo


@njit
def _delayed_command(commands: Floats, column: int, now: float, delay: float) -> tuple[float, float]:
    """Command that acts at `now` (s) after a `delay` (s), and the time (s) at which the next one begins to act.

    It is read from `column` of `commands` (M, 2): column 0 is steering (rad), 1 throttle; the rows follow each other
    at COMMAND_HZ.
    """
    row = math.floor((now - delay) * COMMAND_HZ + 1e-6)
    return float(commands[max(row, 0), column]), (row + 1) / COMMAND_HZ + delay


@njit
def _simulate(
    p: Plant, arena: SimulatedArena, duration: float, uniform: Floats, normal: Floats, given_commands: Floats,
    follows_path: bool,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Simulate plant and driver: states (S + 1, STATE_SIZE) at STEPS_PER_S, and commands (M, 2) at COMMAND_HZ.

    Commands are steering (rad) and throttle.  `given_commands` (M, 2) replace the driver where there are any; else
    the driver follows a path in a closed loop, or draws targets from the rows of `uniform` (M, DRAWS_PER_DECISION).
    The rows of `normal` (S, 3) drive the floor's random force and moment.
    """
    per_command = STEPS_PER_S // COMMAND_HZ
    count = round(duration * COMMAND_HZ)
    commands = np.zeros((count, 2))
    states = np.zeros((count * per_command + 1, STATE_SIZE))
    s, play = states[0].copy(), 0.0
    steer, throttle, left = 0.0, 0.0, 0.5
    push = np.zeros(3)
    keep = math.exp(-1.0 / (STEPS_PER_S * ROUGHNESS_TIME_S))
    fresh = math.sqrt(1.0 - keep * keep)
    for m in range(count):
        if len(given_commands):
            commands[m] = given_commands[m]
        elif follows_path:
            commands[m] = follow_path(s, m / COMMAND_HZ, p, arena)
        else:
            steer, throttle, left = choose_target(s, steer, throttle, left, uniform[m], p, arena)
            left -= 1.0 / COMMAND_HZ
            commands[m, 0], commands[m, 1] = steer, throttle
        for k in range(m * per_command, (m + 1) * per_command):
            now = k / STEPS_PER_S
            push = keep * push + fresh * normal[k]
            end = (k + 1) / STEPS_PER_S
            # a fine step is divided where a delayed command changes
            while end - now > SAME_TIME_S:
                steer_now, steer_until = _delayed_command(commands, 0, now, p.steering_delay)
                drive_now, drive_until = _delayed_command(commands, 1, now, p.motor_delay)
                until = min(end, steer_until, drive_until)
                inputs = PlantInputs(
                    now, duration, steer_now, drive_now,
                    p.rough_force * push[0], p.rough_force * push[1], p.rough_moment * push[2],
                )  # fmt: skip
                s, play = advance_plant(s, play, inputs, until - now, p)
                now = until
            states[k + 1] = s
    return states, commands


def slow_circle_commands(duration: float) -> Floats:
    """Steering (rad) and throttle (m/s), (20 duration, 2) at 20 Hz, of slow left circles within all actuator limits."""
    t = np.arange(round(duration * COMMAND_HZ)) / COMMAND_HZ
    return np.column_stack([0.62 + 0.06 * np.sin(0.21 * t), 0.72 + 0.08 * np.sin(0.13 * t)])


def simulate_drive(
    plant: Plant, sensor: Sensor, duration: float, seed: int, arena: SimulatedArena | None = None,
    given_commands: Floats | None = None, follows_path: bool = False,
) -> Drive:  # fmt: skip
    """Simulate a drive of `duration` seconds from rest at the arena's middle, as the motion capture records it.

    `given_commands` (20 duration, 2), steering (rad) and throttle (m/s or brake share) at 20 Hz, replace the driver,
    who else draws targets at random, or with `follows_path` steers along a path in a closed loop.  Driver, floor and
    measurement noise are drawn from `seed`.
    """
    rng = np.random.default_rng(seed)
    count = round(duration * COMMAND_HZ)
    uniform = rng.random((count, DRAWS_PER_DECISION))
    normal = rng.standard_normal((count * (STEPS_PER_S // COMMAND_HZ), 3))
    given = np.empty((0, 2)) if given_commands is None else given_commands
    states, commands = _simulate(plant, arena or SimulatedArena(), duration, uniform, normal, given, follows_path)
    frame, pose = capture_poses(states, sensor, duration, rng)
    rows = np.arange(0, len(states), STEPS_PER_S // TRUTH_HZ)
    return Drive(np.arange(count) / COMMAND_HZ, commands, frame, pose, sample_truth(states[rows], rows / STEPS_PER_S))


def sample_truth(s: Floats, time: Floats) -> Floats:
    """True motion (K, 8) from plant states (K, STATE_SIZE) at `time` (K,) (s).

    Columns are time, x, y (m), yaw (rad), v_x, v_y (m/s, body frame), yaw rate (rad/s), servo angle (rad).
    """
    cos_h, sin_h = np.cos(s[:, 2]), np.sin(s[:, 2])
    along, across = cos_h * s[:, 3] + sin_h * s[:, 4], cos_h * s[:, 4] - sin_h * s[:, 3]
    return np.column_stack([time, s[:, :3], along, across, s[:, 5], s[:, 6]])


def capture_poses(
    states: Floats, sensor: Sensor, duration: float, rng: np.random.Generator
) -> tuple[npt.NDArray[np.int64], Floats]:
    """Frame numbers (F,) and measured poses (F, 3) of the motion capture: x, y (m), yaw (rad), NaN where dropped."""
    frame = np.arange(math.floor(duration * sensor.rate_hz * (1.0 + sensor.clock_drift) + 1e-9) + 1)
    seen_at = frame / sensor.rate_hz / (1.0 + sensor.clock_drift) - sensor.pose_latency
    fine = np.arange(len(states)) / STEPS_PER_S
    x, y, heading = (np.interp(seen_at, fine, states[:, c]) for c in range(3))
    cos_h, sin_h = np.cos(heading), np.sin(heading)
    x = x + cos_h * sensor.marker_offset_x - sin_h * sensor.marker_offset_y
    y = y + sin_h * sensor.marker_offset_x + cos_h * sensor.marker_offset_y
    grown = 1.0 + sensor.pose_scale + sensor.lens_distortion * (x * x + y * y)
    pose = np.column_stack([grown * x, grown * y, heading + sensor.body_yaw_misalignment])
    if sensor.camera_shake != 0.0:
        pose[:, 0] += sensor.camera_shake * np.sin(2.0 * np.pi * frame / sensor.rate_hz / SHAKE_S)
    pose += rng.standard_normal(pose.shape) * [sensor.position_noise, sensor.position_noise, sensor.yaw_noise]
    for start in rng.uniform(0.5, duration, rng.poisson(sensor.dropouts_per_minute * duration / 60.0)):
        length = rng.uniform(1.0 / sensor.rate_hz, sensor.longest_dropout)
        pose[(frame >= start * sensor.rate_hz) & (frame < (start + length) * sensor.rate_hz)] = np.nan
    return frame, pose
