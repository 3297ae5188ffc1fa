"""One drive of a tricycle in a hall, forward and backward, as its logger and the tracking write it down.

The log holds the steering command and, in the throttle's place, the speed of the driven wheel as its encoder saw it.
"""

import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.simulation.car import Sensor
from bcid.simulation.drive import ROUGHNESS_TIME_S, TRUTH_HZ, Drive, capture_poses, sample_truth
from bcid.simulation.driver import SimulatedArena
from bcid.simulation.dynamics import STEPS_PER_S
from bcid.simulation.tricycle import (
    RIM,
    SERVO,
    TRICYCLE_STATE_SIZE,
    Tricycle,
    TricycleInputs,
    advance_tricycle,
)

HALL = SimulatedArena(length=18.0, width=12.0, margin=1.2)
"""A hall with tracking, m."""

COMMAND_RATES_HZ = (10.0, 12.0, 16.0, 20.0)
"""Rates of logs that divide the plant's fine steps."""

LOOK_S, LOOK_STEP_S = 3.0, 0.1  # of the path that a driver foresees
CANDIDATES = 10
TARGET_DRAWS = 4  # uniform numbers of one target
DRAWS = TARGET_DRAWS * (1 + CANDIDATES)
LOCK_SHARE = 0.95


class Encoder(NamedTuple):
    """How the driven wheel's speed comes into the log."""

    late_s: float = 0.0  # the log's value is the rim's speed so long before its stamp; below zero after it
    noise: float = 0.0  # m/s


class TricycleHandling(NamedTuple):
    """How a tricycle is driven."""

    slow: float = 0.3  # m/s
    fast: float = 1.5
    reverse_share: float = 0.0  # of the targets


EXACT_ENCODER, USUAL_HANDLING = Encoder(), TricycleHandling()


@njit
def _draw_target(u: Floats, p: Tricycle, h: TricycleHandling) -> tuple[float, float, float]:
    """Steering (rad), speed (m/s) and time (s) for which they are held, from four uniform numbers."""
    steer = LOCK_SHARE * p.angle_limit * (2.0 * u[0] - 1.0) * (1.0 if u[1] < 0.35 else 0.45)
    speed = h.slow + (h.fast - h.slow) * (u[1] * 7.0 % 1.0)
    # turning sharply at speed slides or tips
    speed /= 1.0 + 0.8 * abs(steer) * speed
    return steer, -speed if u[2] < h.reverse_share else speed, 1.0 + 3.5 * u[3]


@njit
def _clearance(s: Floats, steer: float, speed: float, p: Tricycle, hall: SimulatedArena) -> float:
    """Smallest distance (m) to the hall's margin of a tricycle that rolls without slip for LOOK_S from `s` on."""
    x, y, heading, angle, rim = s[0], s[1], s[2], s[SERVO], s[RIM]
    nearest = 1e9
    for _ in range(int(LOOK_S / LOOK_STEP_S)):
        angle += LOOK_STEP_S * max(-p.servo_rate, min(p.servo_rate, (steer - angle) / p.servo_time))
        rim += LOOK_STEP_S * max(-p.rim_acceleration, min(p.rim_acceleration, (speed - rim) / p.rim_time))
        turn = rim * math.sin(angle) / (p.front_lever + p.rear_lever)
        forward, sideways = rim * math.cos(angle), p.rear_lever * turn
        x += LOOK_STEP_S * (math.cos(heading) * forward - math.sin(heading) * sideways)
        y += LOOK_STEP_S * (math.sin(heading) * forward + math.cos(heading) * sideways)
        heading += LOOK_STEP_S * turn
        nearest = min(nearest, 0.5 * hall.length - abs(x) - hall.margin, 0.5 * hall.width - abs(y) - hall.margin)
    return nearest


@njit
def _choose_target(
    s: Floats, held: tuple[float, float, float], u: Floats, p: Tricycle, h: TricycleHandling, hall: SimulatedArena
) -> tuple[float, float, float]:
    """Steering (rad), speed (m/s) and time left (s): those `held`, new ones when time is up, or what keeps off walls.

    `u` (DRAWS,) are uniform numbers.  A target whose path leaves the hall's margin gives way to the candidate that
    stays farthest within; the first two turn at full lock.
    """
    steer, speed, left = held
    if left <= 0.0:
        steer, speed, left = _draw_target(u[:TARGET_DRAWS], p, h)
    room = _clearance(s, steer, speed, p, hall)
    if room >= 0.0:
        return steer, speed, left
    for c in range(CANDIDATES):
        new = _draw_target(u[TARGET_DRAWS * (c + 1) : TARGET_DRAWS * (c + 2)], p, h)
        if c < 2:
            new = ((1.0 - 2.0 * c) * LOCK_SHARE * p.angle_limit, math.copysign(0.5, speed), 1.5)
        new_room = _clearance(s, new[0], new[1], p, hall)
        if new_room > room:
            room, (steer, speed, left) = new_room, new
    return steer, speed, left


@njit
def _drive_tricycle(
    p: Tricycle, h: TricycleHandling, hall: SimulatedArena, start: Floats, per_command: int, uniform: Floats,
    normal: Floats,
) -> tuple[Floats, Floats]:  # fmt: skip
    """States (S + 1, TRICYCLE_STATE_SIZE) at STEPS_PER_S from rest at `start` (x, y, heading), and targets (M, 2).

    Targets, steering (rad) and speed (m/s), are chosen every `per_command` steps by the rows of `uniform` (M, DRAWS).
    The rows of `normal` (S, 3) drive the floor's random force and moment.
    """
    states, targets = np.zeros((len(normal) + 1, TRICYCLE_STATE_SIZE)), np.zeros((len(uniform), 2))
    states[0, :3] = start
    held, push, s = (0.0, 0.0, 0.0), np.zeros(3), states[0].copy()
    keep = math.exp(-1.0 / (STEPS_PER_S * ROUGHNESS_TIME_S))
    fresh = math.sqrt(1.0 - keep * keep)
    for k in range(len(normal)):
        if k % per_command == 0:
            held = _choose_target(s, held, uniform[k // per_command], p, h, hall)
            held = (held[0], held[1], held[2] - per_command / STEPS_PER_S)
            targets[k // per_command] = held[0], held[1]
        push = keep * push + fresh * normal[k]
        inputs = TricycleInputs(
            held[0], held[1], p.rough_force * push[0], p.rough_force * push[1], p.rough_moment * push[2]
        )
        s = advance_tricycle(s, inputs, 1.0 / STEPS_PER_S, p)
        states[k + 1] = s
    return states, targets


def simulate_tricycle(
    tricycle: Tricycle, sensor: Sensor, duration: float, seed: int, command_hz: float,
    handling: TricycleHandling = USUAL_HANDLING, encoder: Encoder = EXACT_ENCODER, hall: SimulatedArena = HALL,
) -> Drive:  # fmt: skip
    """Simulate a drive of `duration` seconds from rest near the hall's middle, as log and tracking hold it.

    Args:
        tricycle: the vehicle.
        sensor: the tracking.
        duration: length of the take, s.
        seed: of driver, floor and noise.
        command_hz: rate of the log, one of COMMAND_RATES_HZ: steering commands as given, and the encoder's speeds.
        handling: how it is driven.
        encoder: how the wheel's speed comes into the log.
        hall: in which it is driven.
    """
    rng = np.random.default_rng(seed)
    per_command = round(STEPS_PER_S / command_hz)
    fine = round(duration * STEPS_PER_S)
    count = fine // per_command + 1
    start = np.array([*rng.uniform(-1.0, 1.0, 2), rng.uniform(-np.pi, np.pi)])
    uniform, normal = rng.random((count, DRAWS)), rng.standard_normal((fine, 3))
    states, targets = _drive_tricycle(tricycle, handling, hall, start, per_command, uniform, normal)
    command_s = np.arange(count) * per_command / STEPS_PER_S
    rim = np.interp(command_s - encoder.late_s, np.arange(len(states)) / STEPS_PER_S, states[:, RIM])
    logged = rim + encoder.noise * rng.standard_normal(count)
    frame, pose = capture_poses(states, sensor, duration, rng)
    rows = np.arange(0, len(states), STEPS_PER_S // TRUTH_HZ)
    truth = sample_truth(states[rows], rows / STEPS_PER_S)
    return Drive(command_s, np.column_stack([targets[:, 0], logged]), frame, pose, truth)
