"""Those who drive a small car in a room: six ways of driving, and a guard that turns the car away from the walls.

A driver looks at the car's state when a command is due and wishes an angle and a throttle; all remember things from one
command to the next.  A driver's throttle follows the wanted speed along a line between the throttles of a slow and of a
fast car (`Handling`), as somebody knows the car who has driven it.
"""

import math
from typing import NamedTuple

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.simulation.car import Plant
from bcid.simulation.driver import SimulatedArena

DRIVERS = ("pursuit", "laps", "steps", "slalom", "stop-and-go", "hand")
DRAWS = 8  # uniform numbers for each command
MEMORY = 10  # what a driver remembers, and the guard behind it
GUARD_LEFT, GUARD_STEER, GUARD_THROTTLE = 7, 8, 9  # s, rad, share: places in the memory
GUARD_HOLDS_S = 0.35
LOOK_S, LOOK_STEP_S = 2.2, 0.05  # ahead of who holds an angle
ESCAPE_LOOK_S = 3.2
PATH_LOOK_S = 1.8  # of who follows a path, and turns with it
KEEPING_SIDE_M = 1.0
ESCAPES = 4  # full lock either way, slowly, and braking
AIM_M = 0.7  # ahead of the car, on a lap
NEAR_TARGET_M = 0.5
SPEED_GAIN = 0.12  # of the throttle's range for each m/s that the car is too slow
SPEED_RATE = 1.2  # 1/s, at which the car is expected to reach the wanted speed
BRAKE_RATE = 2.5


class Handling(NamedTuple):
    """What drivers know of a car, and how one drives it on a day."""

    slow: float  # m/s
    fast: float
    slow_throttle: float  # that keeps it so slow
    fast_throttle: float
    lock: float  # rad, the largest angle commanded
    wheelbase: float  # m, with which its turns are reckoned
    most_sideways: float  # m/s^2 that the tyres hold
    pace: float  # 0 to 1: how fast of what the car can
    rhythm: float  # 0 to 1: how often things change


@njit
def throttle_for(speed: float, h: Handling) -> float:
    """Throttle that keeps about so much `speed` (m/s)."""
    share = (speed - h.slow) / (h.fast - h.slow)
    return min(h.slow_throttle + share * (h.fast_throttle - h.slow_throttle), 1.0)


@njit
def _body_motion(s: Floats) -> tuple[float, float, float]:
    """Heading (rad), and velocity along and across the body (m/s) in the plant's state `s`."""
    cos_h, sin_h = math.cos(s[2]), math.sin(s[2])
    return s[2], cos_h * s[3] + sin_h * s[4], cos_h * s[4] - sin_h * s[3]


@njit
def room_at(x: float, y: float, a: SimulatedArena) -> float:
    """Distance (m) of a point from the walls' margin, below 0 beyond it."""
    return min(0.5 * a.length - abs(x), 0.5 * a.width - abs(y)) - a.margin


@njit
def room_ahead(
    s: Floats, steer: float, speed: float, braking: bool, look: float, p: Plant, h: Handling, a: SimulatedArena
) -> tuple[float, float]:
    """Smallest distance (m) of the CoG from the walls' margin in the next `look` seconds, and at their end.

    Predicted is a car that is steered to `steer` (rad), gets to `speed` (m/s) by itself or by `braking`, rolls without
    slip, and turns no faster than its tyres hold.
    """
    heading, along, _ = _body_motion(s)
    x, y, angle, turn = s[0], s[1], s[6], s[5]
    nearest, room = 1e9, 0.0
    for _ in range(int(look / LOOK_STEP_S)):
        angle += max(-p.servo_rate * LOOK_STEP_S, min(p.servo_rate * LOOK_STEP_S, 0.5 * (steer - angle)))
        along += LOOK_STEP_S * (BRAKE_RATE if braking else SPEED_RATE) * (speed - along)
        most = h.most_sideways / max(abs(along), 0.2)
        turn += 0.4 * (max(-most, min(most, along * math.tan(angle) / h.wheelbase)) - turn)
        aside = p.rear_lever * turn
        x += LOOK_STEP_S * (math.cos(heading) * along - math.sin(heading) * aside)
        y += LOOK_STEP_S * (math.sin(heading) * along + math.cos(heading) * aside)
        heading += LOOK_STEP_S * turn
        room = room_at(x, y, a)
        nearest = min(nearest, room)
    return nearest, room


@njit
def _steer_at(s: Floats, x: float, y: float, h: Handling) -> float:
    """Angle (rad) of a wheel that is turned to the point (x, y) (m), within the lock."""
    bearing = math.atan2(y - s[1], x - s[0]) - s[2]
    return max(-h.lock, min(h.lock, 0.9 * math.atan2(math.sin(bearing), math.cos(bearing))))


@njit
def _keep_speed(s: Floats, speed: float, steer: float, h: Handling) -> float:
    """Throttle that brings a car in the state `s` to the wanted `speed` (m/s), or to what tyres hold at `steer` (rad).

    It is a brake share where the car is far too fast.
    """
    held = math.sqrt(1.3 * h.most_sideways * h.wheelbase / max(math.tan(abs(steer)), 1e-3))
    along, speed = _body_motion(s)[1], min(speed, held)
    if along > speed + 0.4:
        return -0.4
    reach = h.fast_throttle - h.slow_throttle
    return max(0.0, min(throttle_for(speed, h) + SPEED_GAIN * reach * (speed - along), 1.0))


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
    steer = _steer_at(s, mine[0], mine[1], h)
    return steer, _keep_speed(s, mine[3], steer, h)


@njit
def _lap(s: Floats, mine: Floats, time: float, step: float, h: Handling, a: SimulatedArena) -> tuple[float, float]:
    """Steering (rad) and throttle of a driver of laps: an oval, or on a slow day an eight, now faster, now slower."""
    half_x, half_y = 0.5 * a.length - 1.6 * a.margin, 0.5 * a.width - 1.5 * a.margin
    eight = h.rhythm > 0.5
    best, aim_x, aim_y = 1e9, 0.0, 0.0
    for k in range(120):
        phase = 2.0 * math.pi * k / 120
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
    steer = _steer_at(s, aim_x, aim_y, h)
    return steer, _keep_speed(s, h.slow + (h.fast - h.slow) * h.pace * quick, steer, h)


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
def speed_at_throttle(throttle: float, h: Handling) -> float:
    """Speed (m/s) to which a car comes at a `throttle` held: the way back of `throttle_for`, 0 at none or braking."""
    share = (throttle - h.slow_throttle) / (h.fast_throttle - h.slow_throttle)
    return max(h.slow + share * (h.fast - h.slow), 0.0) if throttle > 0.0 else 0.0


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
    mine[GUARD_LEFT] -= step
    if mine[GUARD_LEFT] > 0.0:
        steer, throttle = mine[GUARD_STEER], mine[GUARD_THROTTLE]
    held = mine[GUARD_STEER] if mine[GUARD_LEFT] > -GUARD_HOLDS_S else 0.0
    if room_at(s[0], s[1], a) < 0.0:  # back from where one should not be
        back = _steer_at(s, 0.0, 0.0, h)
        if abs(back) >= h.lock and held != 0.0:
            back = math.copysign(h.lock, held)
        mine[GUARD_LEFT], mine[GUARD_STEER] = 0.0, back
        return back, _keep_speed(s, h.slow, back, h)
    look = PATH_LOOK_S if driver < 2 and mine[GUARD_LEFT] <= 0.0 else LOOK_S
    room, _ = room_ahead(s, steer, speed_at_throttle(throttle, h), throttle < 0.0, look, p, h, a)
    if room >= 0.0:
        return steer, throttle
    along, slow, best = _body_motion(s)[1], throttle_for(h.slow + 0.4 * (h.fast - h.slow) * u[6], h), -1e9
    for k in range(ESCAPES):
        angle = (1.0 if k % 2 == 0 else -1.0) * h.lock
        press = -0.4 if k >= 2 and along > h.slow else slow
        nearest, last = room_ahead(s, angle, speed_at_throttle(press, h), press < 0.0, ESCAPE_LOOK_S, p, h, a)
        # who turned one way keeps turning that way: one and then the other would lead straight on
        worth = nearest + 0.5 * last + (KEEPING_SIDE_M if angle * held > 0.0 else 0.0)
        if worth > best:
            best, steer, throttle = worth, angle, press
    mine[GUARD_LEFT], mine[GUARD_STEER], mine[GUARD_THROTTLE] = GUARD_HOLDS_S * (0.7 + 0.6 * u[7]), steer, throttle
    return steer, throttle
