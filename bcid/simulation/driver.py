"""A driver that keeps the car inside the arena with the whole range of its steering.

It draws a target at random, holds it for a while, and predicts a rolling wheel's path; a target that would come too
near the wall is exchanged for the drawn candidate that stays clear longest.
"""

import math
from typing import NamedTuple

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.simulation.car import Plant

LOOK_S = 2.4
LOOK_STEP_S = 0.1
CANDIDATES = 8
PATH_POINTS = 240
AHEAD_M = 1.0
PURSUIT_GAIN, PURSUIT_LOCK = 1.3, 1.3  # rad
DRAWS_PER_DECISION = 4 * (CANDIDATES + 1)


class SimulatedArena(NamedTuple):
    """A rectangle about the origin, and how near its walls the CoG may come (m)."""

    length: float = 12.0
    width: float = 7.0
    margin: float = 0.8


@njit
def draw_target(u: Floats, p: Plant) -> tuple[float, float, float]:
    """Steering (rad), throttle (m/s or brake share) and holding time (s) of a random target of the simulated driver.

    `u` holds four uniform draws; a fifth of the targets steer to near full lock, and a tenth brake.
    """
    # Box-Muller gives the moderate angles, a fifth are near full lock
    normal = math.sqrt(-2.0 * math.log(1.0 - u[0])) * math.cos(2.0 * math.pi * u[1])
    steer = 0.8 * normal
    if u[2] < 0.2:
        steer = math.copysign(1.5 + 0.5 * u[1], normal)
    steer = max(-0.995 * p.angle_limit, min(0.995 * p.angle_limit, steer))
    share = (u[2] * 7.0) % 1.0
    throttle = p.top_speed
    if share > 0.65:
        throttle = p.top_speed * (0.3 + 0.7 * ((share - 0.65) / 0.25)) if share < 0.9 else -0.1 - 0.7 * u[1]
    hold = 0.8 + 2.7 * u[3] if throttle > 0.0 else 0.3 + 0.7 * u[3]
    return steer, throttle, hold


@njit
def wall_clearance(s: Floats, steer: float, throttle: float, p: Plant, arena: SimulatedArena) -> float:
    """Smallest distance (m) of the CoG from the walls' margin, predicted for LOOK_S seconds from the state `s` on.

    It is negative beyond the margin.  Predicted is the path of a wheel that rolls without slip and is steered
    towards `steer` (rad) under `throttle` (m/s or brake share).
    """
    x, y, heading, angle = s[0], s[1], s[2], s[6]
    along = math.cos(heading) * s[3] + math.sin(heading) * s[4]
    hub = math.cos(heading) * s[4] - math.sin(heading) * s[3] + p.front_lever * s[5]
    speed = math.hypot(along, hub)
    wheelbase = p.front_lever + p.rear_lever
    nearest = 1e9
    for _ in range(int(LOOK_S / LOOK_STEP_S)):
        angle += LOOK_STEP_S * max(-p.servo_rate, min(p.servo_rate, (steer - angle) / p.servo_time))
        gain = 0.8 if throttle > speed else (0.3 if throttle >= 0.0 else -2.0 * throttle)
        speed += LOOK_STEP_S * gain * (max(throttle, 0.0) - speed)
        turn = speed * math.sin(angle) / wheelbase
        forward, sideways = speed * math.cos(angle), p.rear_lever * turn
        x += LOOK_STEP_S * (math.cos(heading) * forward - math.sin(heading) * sideways)
        y += LOOK_STEP_S * (math.sin(heading) * forward + math.cos(heading) * sideways)
        heading += LOOK_STEP_S * turn
        room = min(0.5 * arena.length - abs(x), 0.5 * arena.width - abs(y)) - arena.margin
        nearest = min(nearest, room)
    return nearest


@njit
def choose_target(
    s: Floats, steer: float, throttle: float, left: float, u: Floats, p: Plant, arena: SimulatedArena
) -> tuple[float, float, float]:
    """Steering (rad), throttle (m/s or brake share) and time left (s) of the driver's present target or a new one.

    A new one is drawn when the time is up.  A target that would lead within the walls' margin is replaced by the
    candidate that stays farthest from it.  `u` holds DRAWS_PER_DECISION uniform numbers, `s` the plant's state.
    """
    if left <= 0.0:
        steer, throttle, left = draw_target(u[:4], p)
    room = wall_clearance(s, steer, throttle, p, arena)
    if room >= 0.0:
        return steer, throttle, left
    for c in range(CANDIDATES):
        # the first candidates are full lock either way, which turns nearly on the spot
        if c < 2:
            new_steer, new_throttle, hold = (1.0 - 2.0 * c) * 0.99 * p.angle_limit, 0.7 * p.top_speed, 0.5
        else:
            new_steer, new_throttle, hold = draw_target(u[4 * c + 4 : 4 * c + 8], p)
        new_room = wall_clearance(s, new_steer, new_throttle, p, arena)
        if new_room > room:
            room, steer, throttle, left = new_room, new_steer, new_throttle, hold
    return steer, throttle, left


@njit
def follow_path(s: Floats, time: float, p: Plant, arena: SimulatedArena) -> tuple[float, float]:
    """Steering (rad) and throttle (m/s or brake share) of a driver that follows a figure of eight in a closed loop.

    From the plant's state `s`, the driver steers at the point of the path that is about AHEAD_M before the front
    wheel.  The throttle corrects the speed towards one that rises and falls with `time` (s).  What disturbs the car
    thus shows in the commands, too.
    """
    half_x, half_y = 0.5 * arena.length - 1.5 * arena.margin, 0.5 * arena.width - 1.5 * arena.margin
    cos_h, sin_h = math.cos(s[2]), math.sin(s[2])
    hub_x, hub_y = s[0] + p.front_lever * cos_h, s[1] + p.front_lever * sin_h
    best, aim_x, aim_y = 1e9, 0.0, 0.0
    for k in range(PATH_POINTS):
        phase = 2.0 * math.pi * k / PATH_POINTS
        x, y = half_x * math.sin(phase), half_y * math.sin(2.0 * phase)
        gap = math.hypot(x - hub_x, y - hub_y)
        # where the paths cross, the one that goes the car's way; what lies behind is none
        along = half_x * math.cos(phase) * cos_h + 2.0 * half_y * math.cos(2.0 * phase) * sin_h
        astray = abs(gap - AHEAD_M) + (2.0 * AHEAD_M if along < 0.0 else 0.0)
        astray += 2.0 * AHEAD_M if (x - hub_x) * cos_h + (y - hub_y) * sin_h < 0.0 else 0.0
        if astray < best:
            best, aim_x, aim_y = astray, x, y
    bearing = math.atan2(aim_y - hub_y, aim_x - hub_x) - s[2]
    steer = math.atan2(math.sin(bearing), math.cos(bearing))
    steer = max(-PURSUIT_LOCK, min(PURSUIT_LOCK, PURSUIT_GAIN * steer))
    speed = math.hypot(s[3], s[4])
    wanted = p.top_speed * (0.6 + 0.3 * math.sin(0.37 * time) * math.sin(0.11 * time))
    if speed > wanted + 0.08:
        return steer, -0.4
    return steer, max(0.0, min(p.top_speed, wanted + 1.5 * (wanted - speed)))
