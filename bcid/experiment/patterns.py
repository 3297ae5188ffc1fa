"""The catalogue's patterns: commands in shares of what the car and the floor allow.

A pattern's docstring is its purpose in words.  Some also follow a route, whose steering is found with the car.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.physics.car import Car
from bcid.physics.motor import drag_force

COMMAND_HZ = 20
NO_ROUTE = np.empty((0, 2))


class Envelope(NamedTuple):
    """What a pattern may use: the car, its largest steering angle and throttle, a speed, a radius."""

    car: Car
    angle_limit: float  # rad
    max_throttle: float  # m/s, or 1 where the throttle sets a force
    speed: float  # m/s that a share of 1 means
    radius: float  # m, of a circle that fits the floor well

    def throttle(self, share: float) -> float:
        """The throttle that holds a share of the speed, straight on."""
        v, p = share * self.speed, self.car
        rolling = drag_force(v, p.R_1, p.R_2)
        wanted = p.u_0 + (rolling + p.K_v * v) / p.K_t if p.sets_force > 0.0 else v + rolling / p.K_t
        return float(min(max(wanted, 0.0), self.max_throttle))

    def circle(self, share: float = 1.0) -> float:
        """The steering angle (rad) of a circle with a share of the radius, without slip."""
        wheelbase = self.car.l_f + self.car.l_r
        return min(math.atan2(wheelbase, math.sqrt(max((share * self.radius) ** 2 - self.car.l_r**2, 1e-6))),
                   self.lock(0.9))  # fmt: skip

    def lock(self, share: float, most: float = math.inf) -> float:
        """A share of the largest steering angle, at most `most` (rad)."""
        return min(share * self.angle_limit, most)

    def turn_s(self, angle: float, share: float, turns: float) -> float:
        """Time (s) of so many turns at a steering angle (rad) and a share of the speed, without slip."""
        rate = share * self.speed * math.sin(angle) / (self.car.l_f + self.car.l_r)
        return 2.0 * math.pi * turns / max(rate, 1e-3)


class Commands(NamedTuple):
    """Commands at COMMAND_HZ; where there is a route, the steering is added to what the route needs."""

    command: Floats  # (n, 2) steering rad, throttle
    route: Floats = NO_ROUTE  # (W, 2) way points in shares of the arena's reach


def hold_commands(*pieces: tuple[float, float, float], route: Floats = NO_ROUTE) -> Commands:
    """Piecewise constant commands at COMMAND_HZ: each piece (seconds, steering in rad, throttle) is held in turn.

    `route` holds way points (W, 2), 0 at the arena's middle and +-1 at its margins in x and y; where given, a later
    stage adds the steering that follows them.
    """
    held = [np.tile([s, u], (max(round(t * COMMAND_HZ), 1), 1)) for t, s, u in pieces]
    return Commands(np.concatenate(held), route)


def _steer_over_time(
    seconds: float, steer: Callable[[Floats], Floats], throttle: float, route: Floats = NO_ROUTE
) -> Commands:
    """Commands over `seconds` with the steering (rad) a function `steer` of time (s) and a constant throttle.

    `route` holds way points (W, 2), 0 at the arena's middle and +-1 at its margins in x and y; where given, a later
    stage adds the steering that follows them.
    """
    t = np.arange(round(seconds * COMMAND_HZ)) / COMMAND_HZ
    return Commands(np.column_stack([steer(t), np.full(len(t), throttle)]), route)


def coast_down(e: Envelope) -> Commands:
    """Accelerate and coast at zero throttle: circling left, circling right, then at a large steering angle."""
    wide, far, up = e.circle(0.9), e.lock(0.7, 1.4), e.throttle(1.0)
    return hold_commands((4, wide, up), (8, wide, 0), (4, -wide, up), (8, -wide, 0), (5, -wide, up), (7, -far, 0))


def steady_circles_slow(e: Envelope) -> Commands:
    """A steady circle to the left, then one to the right, at half of the top speed that car and floor allow."""
    return hold_commands((13, e.circle(0.9), e.throttle(0.5)), (13, -e.circle(0.9), e.throttle(0.5)))


def steady_circles_fast(e: Envelope) -> Commands:
    """A steady circle to the left, then one to the right, at the top speed that car and floor allow."""
    return hold_commands((13, e.circle(0.9), e.throttle(1.0)), (13, -e.circle(0.9), e.throttle(1.0)))


def small_steering_steps(e: Envelope) -> Commands:
    """Steering steps of at most +-0.1 rad about the angle of a steady circle, circling left, then right."""
    middle, step, up = e.circle(), e.lock(0.25, 0.1), e.throttle(0.8)
    left = [(1.5, middle + hand * step, up) for hand in (1, -1) * 5]
    return hold_commands(*left, *((t, -s, u) for t, s, u in left))


def large_steering_steps(e: Envelope) -> Commands:
    """Steering steps from side to side at constant throttle, so large that the servo runs at its rate limit."""
    angle, up = e.lock(0.6, 1.3), e.throttle(0.7)
    return hold_commands(*((t, hand * angle, up) for k in (1, -1) for t, hand in ((2.8, k), (1.8, -k)) * 3))


def steering_sweep(e: Envelope) -> Commands:
    """A steering sine of growing frequency (0.2 to 2.5 Hz) about the angle of a steady circle, at constant throttle."""
    size, seconds, low, high = e.lock(0.4, 0.35), 30.0, 0.2, 2.5
    growth = math.log(high / low)
    return _steer_over_time(
        seconds,
        lambda t: e.circle() + size * np.sin(2 * np.pi * low * seconds / growth * np.expm1(growth * t / seconds)),
        e.throttle(0.8),
    )


def throttle_steps(e: Envelope) -> Commands:
    """Throttle steps up and down, each held for 2.7 s, circling left, then right."""
    shares = (0.4, 1.0, 0.6, 1.0, 0.2, 0.8)
    return hold_commands(*((2.7, hand * e.circle(), e.throttle(s)) for hand in (1, -1) for s in shares))


def throttle_noise(e: Envelope) -> Commands:
    """A random binary sequence of a high and a low throttle, each held for 0.5 s or more, circling left, then right."""
    bits = np.random.default_rng(5).random(60) < 0.5
    return hold_commands(
        *((0.5, e.circle() * (1 if k < 30 else -1), e.throttle(1.0 if b else 0.3)) for k, b in enumerate(bits))
    )


def brake_pulses(e: Envelope) -> Commands:
    """Accelerate and brake by a short pulse, four times and harder each time, circling left, then right."""
    pulses = ((0.7, 0.2), (0.6, 0.4), (0.5, 0.7), (0.5, 1.0))
    return hold_commands(*(
        p for hand in (1, -1) for t, brake in pulses
        for p in ((3.0, hand * e.circle(), e.throttle(1.0)), (t, hand * e.circle(), -brake))
    ))  # fmt: skip


def slalom(e: Envelope) -> Commands:
    """A steering sine (period 2.2 s) superposed on laps of an oval, at constant throttle."""
    corners = [(-0.5, -0.7), (0.5, -0.7), (0.95, 0.0), (0.5, 0.7), (-0.5, 0.7), (-0.95, 0.0)]
    return _steer_over_time(
        30.0, lambda t: e.lock(0.5, 0.4) * np.sin(2 * np.pi * t / 2.2), e.throttle(0.8), np.array(corners * 4)
    )


def figure_of_eight(e: Envelope) -> Commands:
    """Full circles to the left and to the right in alternation, at constant throttle."""
    angle, up = e.circle(0.65), e.throttle(0.9)
    turn = e.turn_s(angle, 0.85, 1.0)
    return hold_commands(*((turn, hand * angle, up) for hand in (1, -1) * max(round(16.0 / turn), 1)))


def full_lock(e: Envelope) -> Commands:
    """Turns at nearly full steering lock, left and right in alternation, at three throttles."""
    angle = e.lock(0.98)
    return hold_commands(*((4.5, hand * angle, e.throttle(s)) for s in (0.5, 1.0, 0.7) for hand in (1, -1)))


def steering_reversals(e: Envelope) -> Commands:
    """Steering reversed in alternation at constant throttle, each angle held for 1, 3/4, 1/2, then 3/4 of a turn."""
    angle, up = e.lock(0.5, 0.9), e.throttle(1.0)
    turns = (1.0, 0.75, 0.5, 0.75) * 3
    whole = hold_commands(*((e.turn_s(angle, 0.8, n), (-1) ** k * angle, up) for k, n in enumerate(turns)))
    return Commands(whole.command[: 30 * COMMAND_HZ])


def four_headings(e: Envelope) -> Commands:
    """Along the floor's four walls one way round, across its middle, then along the walls the other way round."""
    a, b, c, d = (-0.75, -0.75), (0.75, -0.75), (0.75, 0.75), (-0.75, 0.75)
    across = [(0.0, 0.0), (-0.7, 0.1), (-0.4, 0.65)]
    return hold_commands((38, 0, e.throttle(0.9)), route=np.array([a, b, c, d, a, b, *across, c, b, a, d]))


def lawn_mower(e: Envelope) -> Commands:
    """To and fro along six parallel lanes that cover the whole floor."""
    lanes = np.repeat(np.linspace(-0.85, 0.85, 6), 2)
    ends = np.resize([-0.75, 0.75, 0.75, -0.75], len(lanes))
    return hold_commands((38, 0, e.throttle(0.95)), route=np.column_stack([ends, lanes]))


def begin_and_end(e: Envelope) -> Commands:
    """Equal starts and circles at the beginning and at the end, with a rest between, to show changes with time."""
    bend, fast, slow = e.circle(0.65), e.throttle(1.0), e.throttle(0.5)
    laps = ((4, bend, fast), (3, bend, slow), (4, -bend, fast), (2, -bend, -0.6))
    return hold_commands(*laps, (9, bend, 0), *laps)


PATTERNS: tuple[Callable[[Envelope], Commands], ...] = (
    coast_down, steady_circles_slow, steady_circles_fast, small_steering_steps, large_steering_steps, steering_sweep,
    throttle_steps, throttle_noise, brake_pulses, slalom, figure_of_eight, full_lock, steering_reversals,
    four_headings, lawn_mower, begin_and_end,
)  # fmt: skip
"""The catalogue of patterns."""
