"""What keeps a small car in its room: a wish that leads to a wall is exchanged for what stays clear longest."""

import math

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.simulation.car import Plant
from bcid.simulation.driver import SimulatedArena
from bcid.simulation.handling import (
    BRAKE_SHARE,
    Handling,
    body_motion,
    keep_speed,
    speed_at_throttle,
    steer_at,
    throttle_for,
)

LEFT, STEER, THROTTLE = 0, 1, 2  # what the guard remembers: s that are left, rad, share
GUARD_MEMORY = 3
HOLDS_S = 0.35
LOOK_S, LOOK_STEP_S = 2.2, 0.05  # ahead of who holds an angle
PATH_LOOK_S = 1.8  # of who follows a path, and turns with it
ESCAPE_LOOK_S = 3.2
ESCAPES = 4  # full lock either way, slowly, and braking
KEEPING_SIDE_M = 1.0
SPEED_RATE, BRAKE_RATE = 1.2, 2.5  # 1/s, at which the car is expected to reach a speed, and to stop
SERVO_STEP, TURN_STEP = 0.5, 0.4  # of the way to the angle, and to the turn, in each LOOK_STEP_S


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
    heading, along, _ = body_motion(s)
    x, y, angle, turn = s[0], s[1], s[6], s[5]
    nearest, room = 1e9, 0.0
    for _ in range(int(look / LOOK_STEP_S)):
        angle += max(-p.servo_rate * LOOK_STEP_S, min(p.servo_rate * LOOK_STEP_S, SERVO_STEP * (steer - angle)))
        along += LOOK_STEP_S * (BRAKE_RATE if braking else SPEED_RATE) * (speed - along)
        most = h.most_sideways / max(abs(along), 0.2)
        turn += TURN_STEP * (max(-most, min(most, along * math.tan(angle) / h.wheelbase)) - turn)
        aside = p.rear_lever * turn
        x += LOOK_STEP_S * (math.cos(heading) * along - math.sin(heading) * aside)
        y += LOOK_STEP_S * (math.sin(heading) * along + math.cos(heading) * aside)
        heading += LOOK_STEP_S * turn
        room = room_at(x, y, a)
        nearest = min(nearest, room)
    return nearest, room


@njit
def _come_back(s: Floats, guard: Floats, held: float, h: Handling) -> tuple[float, float]:
    """Steering (rad) and throttle of a car beyond the walls' margin: to the room's middle, on the side it turns to.

    `held` (rad) is the angle at which the guard has held the wheel, 0 if it has not; `guard` its memory.
    """
    back = steer_at(s, 0.0, 0.0, h)
    if abs(back) >= h.lock and held != 0.0:
        back = math.copysign(h.lock, held)
    guard[LEFT], guard[STEER] = 0.0, back
    return back, keep_speed(s, h.slow, back, h)


@njit
def keep_off_walls(
    steer: float, throttle: float, follows_path: bool, s: Floats, guard: Floats, u: Floats, step: float, p: Plant,
    h: Handling, a: SimulatedArena,
) -> tuple[float, float]:  # fmt: skip
    """Steering (rad) and throttle that are commanded where a driver wishes `steer` and `throttle`.

    Args:
        steer: wish, rad.
        throttle: wish, a share.
        follows_path: whether the wish changes with the place, so that it need not be safe for as long.
        s: the plant's state.
        guard: what the guard remembers (GUARD_MEMORY,), changed in place.
        u: two uniform numbers.
        step: time until the next command, s.
        p: the car.
        h: how it is handled.
        a: the room.
    """
    guard[LEFT] -= step
    look = PATH_LOOK_S if follows_path and guard[LEFT] <= 0.0 else LOOK_S
    if guard[LEFT] > 0.0:
        steer, throttle = guard[STEER], guard[THROTTLE]
    held = guard[STEER] if guard[LEFT] > -HOLDS_S else 0.0
    if room_at(s[0], s[1], a) < 0.0:
        return _come_back(s, guard, held, h)
    if room_ahead(s, steer, speed_at_throttle(throttle, h), throttle < 0.0, look, p, h, a)[0] >= 0.0:
        return steer, throttle
    along, slow, best = body_motion(s)[1], throttle_for(h.slow + 0.4 * (h.fast - h.slow) * u[0], h), -1e9
    for k in range(ESCAPES):
        angle = (1.0 if k % 2 == 0 else -1.0) * h.lock
        press = -BRAKE_SHARE if k >= 2 and along > h.slow else slow
        nearest, last = room_ahead(s, angle, speed_at_throttle(press, h), press < 0.0, ESCAPE_LOOK_S, p, h, a)
        # who turned one way keeps turning that way: one and then the other would lead straight on
        worth = nearest + 0.5 * last + (KEEPING_SIDE_M if angle * held > 0.0 else 0.0)
        if worth > best:
            best, steer, throttle = worth, angle, press
    guard[LEFT], guard[STEER], guard[THROTTLE] = HOLDS_S * (0.7 + 0.6 * u[1]), steer, throttle
    return steer, throttle
