"""What is asked of the controllers: a corner of the arena, and when the car counts as parked.

Metres and radians in the world frame of the logs.  All of this was chosen with the augmented model in place of the car,
and written down before any drive that is counted; one drive of the linear model had been seen by then, and the guesses
for first plans, the horizon and the most iterations were changed after it.
"""

import math
from typing import NamedTuple

import numpy as np

WALLS = (-6.0, 6.0, -3.5, 3.5)
"""Least and largest x, least and largest y (m) of the arena that the logs were driven in."""
PILLARS = ((5.00, 1.00, 0.25),)
"""x, y and radius (m) of pillars: one stands where the nose would swing through if the car did not back off."""
DISCS = (0.54, -0.33)
"""How far ahead of the centre of gravity (m) the discs lie that stand for the car's body: at its axles."""
DISC_RADIUS = 0.35
KEPT_FREE = 0.05
"""Distance (m) from walls and pillars that a plan keeps."""

START = (4.80, 2.35, 0.0)
"""The middle of the starts: nose to the wall x = 6, the wall y = 3.5 to the left."""
START_SPREAD = (0.10, 0.10, math.radians(10.0))
"""Starts are drawn evenly within this distance of START, to either side."""
GOAL = (4.20, 0.60, -0.5 * math.pi)
"""The pose to stand at: turned by a right angle, some way ahead after backing off."""


class Tolerance(NamedTuple):
    """When the car counts as parked: all three at once, of the true motion."""

    position: float = 0.05  # m
    heading: float = math.radians(3.0)  # rad
    speed: float = 0.05  # m/s of the centre of gravity


TOLERANCE = Tolerance()
TIME_LIMIT_S = 15.0
"""A drive that is not parked by then has failed."""


def draw_start(seed: int) -> np.ndarray:
    """The pose (3,) at which the drive `seed` starts."""
    return np.asarray(START) + np.asarray(START_SPREAD) * np.random.default_rng([seed, 7]).uniform(-1.0, 1.0, 3)


def goal_errors(pose: np.ndarray) -> tuple[float, float]:
    """Distance (m) and difference in heading (rad, 0 to pi) of a pose (3,) from the goal."""
    turn = abs(math.remainder(pose[2] - GOAL[2], 2.0 * math.pi))
    return math.hypot(pose[0] - GOAL[0], pose[1] - GOAL[1]), turn


def measure_clearance(pose: np.ndarray) -> float:
    """Distance (m) of the car's body at `pose` (3,) from the nearest wall or pillar; negative where it has hit one."""
    distances = []
    for ahead in DISCS:
        x, y = pose[0] + ahead * math.cos(pose[2]), pose[1] + ahead * math.sin(pose[2])
        distances += [x - WALLS[0], WALLS[1] - x, y - WALLS[2], WALLS[3] - y]
        distances += [math.hypot(x - a, y - b) - r for a, b, r in PILLARS]
    return min(distances) - DISC_RADIUS
