"""What to drive next: the manoeuvres that fit the floor, as commands.

A pattern of commands may follow a route, whose steering is found under the car and then written down, so that all
manoeuvres are commands alone.  Each ends with the brake and fits the arena when the car drives it from its start
pose; patterns too wide are driven slower, or cut short, or left out.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.effects.constants import Constants
from bcid.effects.entry import Units
from bcid.effects.motion import steering_chain
from bcid.effects.table import off
from bcid.experiment.patterns import COMMAND_HZ, LONGEST_S, PATTERNS, Envelope, Order, held
from bcid.experiment.simulate import STILL, states
from bcid.likelihood.hypothesis import BUMPER_CAR, Setting
from bcid.likelihood.predict import half_steps
from bcid.physics.car import Car, advance, integration_step, motor_force
from bcid.physics.kinematics import pose_rate, wrap
from bcid.physics.motor import drag

STOP_S = 2.0  # full brake at the end
LEAST_S = 18.0
SPEEDS = (1.0, 0.85, 0.7, 0.55, 0.4, 0.3)  # shares of the top speed, tried in turn
LENGTHS = (1.0, 0.85, 0.7, 0.55)  # shares of the pattern
HEADINGS = 12  # over half a turn
REACHED_M = 0.5  # a way point this near is passed
SPEED_MPS = 2.0  # of a vehicle of which nothing else is known


class Arena(NamedTuple):
    """A rectangle on the floor along its axes, and how near its walls the CoG may come (m)."""

    length: float = 12.0
    width: float = 7.0
    margin: float = 0.8
    x: float = 0.0  # of its middle
    y: float = 0.0

    @property
    def reach(self) -> Floats:
        """How far (2,) the CoG may be from the middle."""
        return 0.5 * np.array([self.length, self.width]) - self.margin

    @property
    def middle(self) -> Floats:
        """(2,)."""
        return np.array([self.x, self.y])


ARENA = Arena()
FASTEST = 100.0  # m/s: no car of an arena is faster


@dataclass(frozen=True)
class Drive:
    """Commands that keep the car inside the arena when it sets out from rest at `start`."""

    name: str
    purpose: str
    command_s: Floats  # (n,) at COMMAND_HZ
    command: Floats  # (n, 2) steering rad, throttle
    start: Floats  # (3,) x, y (m), yaw (rad)

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return len(self.command) / COMMAND_HZ


class Commanded(Protocol):
    """Whatever holds commands to be driven."""

    @property
    def command_s(self) -> Floats:
        """Times (n,)."""

    @property
    def command(self) -> Floats:
        """Steering and throttle (n, 2)."""


def top_speed(car: Car, top: float) -> float:
    """The speed (m/s) that the throttle `top` reaches straight on; FASTEST at most."""
    from scipy.optimize import brentq

    def excess(v: float) -> float:
        return float(motor_force(top, v, car) - max(drag(v, car.R_1, car.R_2), 1e-2 * car.m * v))

    if excess(0.0) <= 0.0:
        return 0.0
    if excess(FASTEST) > 0.0:  # a motor that hardly gives way, where nothing else brakes
        return FASTEST
    return float(brentq(excess, 0.0, FASTEST, xtol=1e-3))


def usual_throttle(car: Car, units: Units = BUMPER_CAR) -> float:
    """The largest throttle of a car of which only the size and the speed of driving are known."""
    return 1.0 if car.sets_force > 0.0 else SPEED_MPS * units.m / units.s


def catalogue(car: Car, angle_limit: float, top: float, arena: Arena = ARENA) -> list[Drive]:
    """The manoeuvres that fit `arena` when this car drives them with throttles up to `top`.

    `top` is a speed (m/s), or a unit throttle where the throttle sets a force.
    """
    radius = 0.76 * float(arena.reach.min())
    if radius <= 0.0:
        return []
    gripping = math.sqrt(0.5 * (car.F_f_max + car.F_r_max) / car.m * radius)
    e = Envelope(car, angle_limit, top, min(top_speed(car, top), gripping), radius)
    drives = (_placed(pattern, e, arena) for pattern in PATTERNS) if e.speed > 0.0 else ()
    return [d for d in drives if d is not None]


def _placed(pattern: Callable[[Envelope], Order], e: Envelope, arena: Arena) -> Drive | None:
    """The pattern as fast and then as long as it fits; None where it does not."""
    name, purpose = pattern.__name__.replace("_", "-"), (pattern.__doc__ or "").strip().rstrip(".")
    for share in SPEEDS:
        order = pattern(e._replace(speed=share * e.speed))
        for length in LENGTHS:
            count = round(min(length * len(order.command), LONGEST_S * COMMAND_HZ))
            if count < LEAST_S * COMMAND_HZ:
                break
            command, start = order.command[:count], np.zeros(3)
            if len(order.route):
                route = order.route * arena.reach + arena.middle
                start = np.array([*route[0], math.atan2(*(route[1] - route[0])[::-1])])
                command = _steered(command, route, start, e.car, e.angle_limit)
            command = np.vstack([command, held((STOP_S, float(command[-1, 0]), -1.0))])
            path = _path(command, start, e)
            found = _moved_inside(path, arena) if not len(order.route) else start if inside(path, arena) else None
            if found is not None:
                return Drive(name, purpose, np.arange(len(command)) / COMMAND_HZ, command, found)
    return None


@njit
def _steered(command: Floats, route: Floats, start: Floats, p: Car, limit: float) -> Floats:
    """The commands with the front wheel pointed at one way point after the other, until the last is reached."""
    out = command.copy()
    x, y, theta = start
    state = (0.0, 0.0, 0.0, command[0, 0])
    goal, h = 1, 1.0 / COMMAND_HZ
    for k in range(len(command)):
        while goal < len(route) and math.hypot(route[goal, 0] - x, route[goal, 1] - y) < REACHED_M:
            goal += 1
        if goal == len(route):
            return out[: max(k, 1)]
        bearing = wrap(math.atan2(route[goal, 1] - y, route[goal, 0] - x) - theta)
        out[k, 0] = min(max(bearing + command[k, 0], -limit), limit)
        state = advance(state, out[k, 0], out[k, 1], p, h)
        rate_x, rate_y = pose_rate(theta, state[0], state[1])
        x, y, theta = x + h * rate_x, y + h * rate_y, theta + h * state[2]
    return out


def _path(command: Floats, start: Floats, e: Envelope) -> Floats:
    """States (n + 1, 6) of the bare car that drives these commands from rest."""
    T = len(command) / COMMAND_HZ
    times = np.arange(len(command)) / COMMAND_HZ
    h = integration_step(e.car)
    chain = steering_chain(times, command, 0.0, half_steps(T, h), h, e.car, e.angle_limit, off())
    return states(Setting(e.car, off(), chain, Constants()), T, STILL, 0, np.r_[start, 0.0, 0.0, 0.0])


def inside(path: Floats, arena: Arena) -> bool:
    """Whether the CoG keeps its margin to the walls on a path (n, 2 or more)."""
    return bool((np.abs(path[:, :2] - arena.middle) <= arena.reach).all())


def _moved_inside(path: Floats, arena: Arena) -> Floats | None:
    """The start pose of a path from the origin that has it in the middle of the arena, or None if it is too wide."""
    for yaw in np.linspace(0.0, np.pi, HEADINGS, endpoint=False):
        turned = path[:, :2] @ np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        low, high = turned.min(axis=0), turned.max(axis=0)
        if (high - low <= 2.0 * arena.reach).all():
            return np.array([*(arena.middle - 0.5 * (low + high)), yaw])
    return None


def write_commands(path: Path, drive: Commanded) -> None:
    """The commands file of a drive or a plan: `time_s,steering_rad,throttle_mps`, a row every 0.05 s."""
    rows = np.column_stack([drive.command_s, drive.command])
    lines = [f"{t:.3f},{steering:.5f},{throttle:.5f}" for t, steering, throttle in rows]
    path.write_text("\n".join(["time_s,steering_rad,throttle_mps", *lines, ""]), encoding="utf-8")
