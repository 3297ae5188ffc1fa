"""The simulated car over a strip of magnets: a law that neither the package nor its simulation has."""

from __future__ import annotations

import math

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import COMMAND_HZ, ROUGHNESS_TIME_S, TRUTH_HZ, Drive, capture_poses, sample_truth
from bcid.simulation.driver import DRAWS_PER_DECISION, SimulatedArena, choose_target
from bcid.simulation.dynamics import STATE_SIZE, STEPS_PER_S, advance_plant
from bcid.simulation.wheels import PlantInputs

STRIP_AT, STRIP_REACH = 1.0, 1.5  # m


@njit
def _drive_over_strip(
    p: Plant, arena: SimulatedArena, stiffness: float, duration: float, uniform: Floats, normal: Floats
) -> tuple[Floats, Floats]:
    """States (S + 1, STATE_SIZE) and commands (M, 2) of a driver at random over magnets, pulled along the room's x."""
    per_command, count = STEPS_PER_S // COMMAND_HZ, round(duration * COMMAND_HZ)
    commands, states = np.zeros((count, 2)), np.zeros((count * per_command + 1, STATE_SIZE))
    s, play, steer, throttle, left, floor = states[0].copy(), 0.0, 0.0, 0.0, 0.5, np.zeros(3)
    keep = math.exp(-1.0 / (STEPS_PER_S * ROUGHNESS_TIME_S))
    for m in range(count):
        steer, throttle, left = choose_target(s, steer, throttle, left, uniform[m], p, arena)
        left -= 1.0 / COMMAND_HZ
        commands[m, 0], commands[m, 1] = steer, throttle
        for k in range(m * per_command, (m + 1) * per_command):
            floor = keep * floor + math.sqrt(1.0 - keep * keep) * normal[k]
            away = s[0] - STRIP_AT
            force = -stiffness * away / math.exp((away / STRIP_REACH) ** 2)
            ahead, left_of = force * math.cos(s[2]), -force * math.sin(s[2])
            inputs = PlantInputs(
                k / STEPS_PER_S, duration, steer, throttle,
                ahead + p.rough_force * floor[0], left_of + p.rough_force * floor[1], p.rough_moment * floor[2],
            )  # fmt: skip
            s, play = advance_plant(s, play, inputs, 1.0 / STEPS_PER_S, p)
            states[k + 1] = s
    return states, commands


def drive_over_strip(stiffness: float, seconds: float, seed: int) -> Drive:
    """A drive over magnets of a `stiffness` (N/m), seen at 60 poses a second."""
    rng, sensor = np.random.default_rng(seed), Sensor()
    count = round(seconds * COMMAND_HZ)
    uniform = rng.random((count, DRAWS_PER_DECISION))
    normal = rng.standard_normal((count * (STEPS_PER_S // COMMAND_HZ), 3))
    states, commands = _drive_over_strip(Plant(), SimulatedArena(), stiffness, seconds, uniform, normal)
    frame, pose = capture_poses(states, sensor, seconds, rng)
    rows = np.arange(0, len(states), STEPS_PER_S // TRUTH_HZ)
    truth = sample_truth(states[rows], rows / STEPS_PER_S)
    return Drive(np.arange(count) / COMMAND_HZ, commands, frame, pose, truth)
