"""Drives under commands that are given beforehand, at times of their own: no arena, no driver who sees the car."""

import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.simulation.car import Plant
from bcid.simulation.drive import ROUGHNESS_TIME_S, SAME_TIME_S
from bcid.simulation.dynamics import STATE_SIZE, STEPS_PER_S, advance_plant
from bcid.simulation.wheels import PlantInputs


class OpenLoopDrive(NamedTuple):
    """A drive without a driver: when it was measured, the measured poses, and the true states at those times."""

    time_s: Floats  # (F,)
    pose: Floats  # (F, 3) x m, y m, yaw rad
    states: Floats  # (F, STATE_SIZE) of the plant


@njit
def _integrate(p: Plant, duration: float, command_s: Floats, command: Floats, normal: Floats) -> Floats:
    """States (S + 1, STATE_SIZE) of the plant at STEPS_PER_S under the `command` (M, 2) held from `command_s` (M,) on.

    The rows of `normal` (S, 3) drive the floor's random force and moment.
    """
    count = len(normal)
    states = np.zeros((count + 1, STATE_SIZE))
    s, play, row = states[0].copy(), 0.0, 0
    push = np.zeros(3)
    keep = math.exp(-1.0 / (STEPS_PER_S * ROUGHNESS_TIME_S))
    fresh = math.sqrt(1.0 - keep * keep)
    for k in range(count):
        now, end = k / STEPS_PER_S, (k + 1) / STEPS_PER_S
        push = keep * push + fresh * normal[k]
        while end - now > SAME_TIME_S:
            while row + 1 < len(command_s) and command_s[row + 1] <= now + SAME_TIME_S:
                row += 1
            until = min(end, command_s[row + 1]) if row + 1 < len(command_s) else end
            inputs = PlantInputs(
                now, duration, command[row, 0], command[row, 1],
                p.rough_force * push[0], p.rough_force * push[1], p.rough_moment * push[2],
            )  # fmt: skip
            s, play = advance_plant(s, play, inputs, until - now, p)
            now = until
        states[k + 1] = s
    return states


def simulate_open_loop(
    plant: Plant, command_s: Floats, command: Floats, pose_s: Floats, noise: tuple[float, float], seed: int
) -> OpenLoopDrive:
    """Simulate a car from rest under commands that act from their own times on, and measure its poses.

    Args:
        plant: the car.
        command_s: times (M,) in s at which the commands begin to act, whatever their rate.
        command: steering (rad) and throttle (M, 2).
        pose_s: times (F,) in s at which poses are measured, from 0 on.
        noise: standard deviations of a measured position (m) and yaw (rad).
        seed: of the floor's random force and of the noise.
    """
    rng = np.random.default_rng(seed)
    duration = float(pose_s[-1])
    normal = rng.standard_normal((math.ceil(duration * STEPS_PER_S), 3))
    fine = _integrate(plant, duration, command_s, command, normal)
    at_s = np.arange(len(fine)) / STEPS_PER_S
    states = np.column_stack([np.interp(pose_s, at_s, column) for column in fine.T])
    pose = states[:, :3] + rng.standard_normal((len(pose_s), 3)) * [noise[0], noise[0], noise[1]]
    return OpenLoopDrive(pose_s, pose, states)
