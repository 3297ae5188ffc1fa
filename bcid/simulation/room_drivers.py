"""Those who drive a small car in a room, in six ways.

A driver looks at the car's state when a command is due and wishes an angle and a throttle; all remember things from one
command to the next.  A guard turns the car away from the walls.
"""

import math

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.simulation.car import Plant
from bcid.simulation.driver import SimulatedArena
from bcid.simulation.handling import Handling, keep_speed, steer_at, throttle_for
from bcid.simulation.room_guard import GUARD_MEMORY, keep_off_walls

DRIVERS = ("pursuit", "laps", "steps", "slalom", "stop-and-go", "hand")
FOLLOWING = 2  # of them, the first: they go to places
DRAWS = 8  # uniform numbers for each command, the last two for the guard
OWN_MEMORY = 6
MEMORY = OWN_MEMORY + GUARD_MEMORY  # what a driver remembers, and the guard behind it
AIM_M = 0.7  # ahead of the car, on a lap
LAP_POINTS = 120
NEAR_TARGET_M = 0.5


@njit
def _pursue(s: Floats, mine: Floats, u: Floats, step: float, h: Handling, a: SimulatedArena) -> tuple[float, float]:
    """Steering (rad) and throttle of a driver who goes to points drawn in the room, one after the other."""
    mine[2] -= step
    if mine[2] <= 0.0 or math.hypot(mine[0] - s[0], mine[1] - s[1]) < NEAR_TARGET_M:
        mine[2], mine[3] = 2.0 + 3.0 * u[2], h.slow + (h.fast - h.slow) * h.pace * u[3]
        # the one of two that lies farther ahead: what is close behind would be circled
        farthest = -1e9
        for k in range(2):
            x, y = (u[2 * k + 4] - 0.5) * (a.length - 2.5 * a.margin), (u[2 * k + 5] - 0.5) * (a.width - 2.5 * a.margin)
            ahead = math.cos(s[2]) * (x - s[0]) + math.sin(s[2]) * (y - s[1])
            if ahead > farthest:
                farthest, mine[0], mine[1] = ahead, x, y
    steer = steer_at(s, mine[0], mine[1], h)
    return steer, keep_speed(s, mine[3], steer, h)


@njit
def _lap(s: Floats, mine: Floats, time: float, step: float, h: Handling, a: SimulatedArena) -> tuple[float, float]:
    """Steering (rad) and throttle of a driver of laps: an oval, or on a slow day an eight, now faster, now slower."""
    half_x, half_y = 0.5 * a.length - 1.6 * a.margin, 0.5 * a.width - 1.5 * a.margin
    eight = h.rhythm > 0.5
    best, aim_x, aim_y = 1e9, 0.0, 0.0
    for k in range(LAP_POINTS):
        phase = 2.0 * math.pi * k / LAP_POINTS
        x, y = half_x * math.cos(phase), half_y * math.sin(2.0 * phase if eight else phase)
        gap_x, gap_y = x - s[0], y - s[1]
        astray = abs(math.hypot(gap_x, gap_y) - AIM_M)
        # where paths cross, the one that goes the car's way; what lies behind is none
        way_x, way_y = -half_x * math.sin(phase), half_y * (2.0 * math.cos(2.0 * phase) if eight else math.cos(phase))
        astray += 2.0 * AIM_M if way_x * math.cos(s[2]) + way_y * math.sin(s[2]) < 0.0 else 0.0
        astray += 2.0 * AIM_M if gap_x * math.cos(s[2]) + gap_y * math.sin(s[2]) < 0.0 else 0.0
        if astray < best:
            best, aim_x, aim_y = astray, x, y
    quick = 0.5 + 0.5 * math.sin(0.35 * time) * math.sin(0.13 * time + 1.0)
    steer = steer_at(s, aim_x, aim_y, h)
    return steer, keep_speed(s, h.slow + (h.fast - h.slow) * h.pace * quick, steer, h)


@njit
def _step(mine: Floats, u: Floats, step: float, h: Handling) -> tuple[float, float]:
    """Steering (rad) and throttle of a driver who sets throttles in steps and ramps, and holds drawn angles."""
    mine[0], mine[1] = mine[0] - step, mine[1] - step
    if mine[0] <= 0.0:
        mine[0] = (1.0 + 2.5 * u[0]) * (1.3 - 0.6 * h.rhythm)
        level = throttle_for(h.slow + (h.fast - h.slow) * h.pace * u[1], h)
        if mine[2] == 0.0 or u[2] < 0.6:
            mine[2], mine[3] = level, 0.0
        else:
            mine[3] = (level - mine[2]) / mine[0]
    if mine[1] <= 0.0:
        mine[1] = 0.8 + 2.5 * u[3]
        mine[4] = h.lock * (0.15 + 0.85 * u[4]) * (1.0 if u[5] < 0.5 else -1.0)
    mine[2] += step * mine[3]
    return mine[4], min(mine[2], 1.0)


@njit
def _weave(mine: Floats, u: Floats, step: float, h: Handling) -> tuple[float, float]:
    """Steering (rad) and throttle of a slalom whose period and depth change, at a throttle that swells slowly."""
    mine[0] -= step
    if mine[0] <= 0.0:
        mine[0] = 3.0 + 4.0 * u[0]
        mine[1] = 2.0 * math.pi / ((1.0 + 2.6 * u[1]) * (1.3 - 0.6 * h.rhythm))
        mine[2], mine[3] = h.lock * (0.4 + 0.6 * u[2]), 0.35 * h.lock * (2.0 * u[3] - 1.0)
    mine[4] += step * mine[1]
    mine[5] += step * 2.0 * math.pi / (7.0 + 5.0 * h.rhythm)
    speed = h.slow + (h.fast - h.slow) * h.pace * (0.5 + 0.5 * math.sin(mine[5]))
    steer = mine[3] + mine[2] * math.sin(mine[4])
    return max(-h.lock, min(h.lock, steer)), throttle_for(speed, h)


@njit
def _stop_and_go(mine: Floats, u: Floats, step: float, h: Handling) -> tuple[float, float]:
    """Steering (rad) and throttle of a driver who speeds up, then brakes or lets roll, and stands now and then."""
    mine[0], mine[1] = mine[0] - step, mine[1] - step
    if mine[0] <= 0.0:
        goes = mine[2] <= 0.0
        mine[0] = (1.2 + 1.8 * u[0]) if goes else (0.4 + 1.0 * u[0])
        quick = throttle_for(h.slow + (h.fast - h.slow) * (0.3 + 0.7 * h.pace * u[1]), h)
        mine[2] = quick if goes else (-0.15 - 0.6 * u[2] if u[3] < 0.65 else 0.0)
    if mine[1] <= 0.0:
        mine[1] = 0.7 + 2.0 * u[4]
        mine[3] = h.lock * (2.0 * u[5] - 1.0)
    return mine[3], mine[2]


@njit
def _handle(mine: Floats, u: Floats, step: float, h: Handling) -> tuple[float, float]:
    """Steering (rad) and throttle of a hand on two sticks: smooth noise, the throttle now and then let go."""
    for column, lasts in ((0, 0.8), (1, 1.8)):
        keep = math.exp(-step / (lasts * (1.3 - 0.6 * h.rhythm)))
        normal = math.sqrt(-2.0 * math.log(1.0 - u[2 * column])) * math.cos(2.0 * math.pi * u[2 * column + 1])
        mine[column] = keep * mine[column] + math.sqrt(1.0 - keep * keep) * normal
    if mine[2] <= 0.0 and u[4] < 0.12 * step:
        mine[2] = 0.4 + u[5]
    mine[2] -= step
    steer = max(-h.lock, min(h.lock, 0.6 * h.lock * mine[0]))
    middle, reach = h.slow + 0.5 * (h.fast - h.slow) * h.pace, 0.4 * (h.fast - h.slow) * h.pace
    speed = max(0.6 * h.slow, min(h.fast, middle + reach * mine[1]))
    return steer, throttle_for(speed, h) if mine[2] <= 0.0 else 0.0


@njit
def _wish(
    driver: int, s: Floats, mine: Floats, u: Floats, time: float, step: float, h: Handling, a: SimulatedArena
) -> tuple[float, float]:
    """Steering (rad) and throttle that the driver with this number among DRIVERS wishes."""
    if driver == 0:
        return _pursue(s, mine, u, step, h, a)
    if driver == 1:
        return _lap(s, mine, time, step, h, a)
    if driver == 2:
        return _step(mine, u, step, h)
    if driver == 3:
        return _weave(mine, u, step, h)
    if driver == 4:
        return _stop_and_go(mine, u, step, h)
    return _handle(mine, u, step, h)


@njit
def decide(
    driver: int, s: Floats, mine: Floats, u: Floats, time: float, step: float, p: Plant, h: Handling, a: SimulatedArena
) -> tuple[float, float]:
    """Steering (rad) and throttle that are commanded at `time` (s): the driver's wish, or what keeps off the walls.

    Args:
        driver: number among DRIVERS.
        s: the plant's state.
        mine: what the driver remembers (MEMORY,), changed in place.
        u: uniform numbers (DRAWS,).
        time: now, s.
        step: time until the next command, s.
        p: the car.
        h: how it is handled.
        a: the room.
    """
    steer, throttle = _wish(driver, s, mine, u, time, step, h, a)
    return keep_off_walls(steer, throttle, driver < FOLLOWING, s, mine[OWN_MEMORY:], u[6:], step, p, h, a)
