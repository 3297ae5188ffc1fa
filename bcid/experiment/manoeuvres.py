"""What to drive next: the manoeuvres that fit the floor, as commands.

A pattern of commands may follow a route, whose steering is found with the car and then recorded, so that all
manoeuvres are commands alone.  Each ends with the brake and fits the arena when the car drives it from its start
pose; patterns too wide are driven more slowly, or cut short, or left out.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.effects.actuators import actuator_chain
from bcid.effects.constants import Constants
from bcid.effects.table import effect_switches
from bcid.experiment.limits import EXPERIMENT_LIMITS
from bcid.experiment.patterns import COMMAND_HZ, PATTERNS, Commands, Envelope, hold_commands
from bcid.experiment.simulate import NO_NOISE, simulate_states
from bcid.likelihood.prediction_inputs import PredictionInputs, covering_steps
from bcid.physics.car import Car, advance_period, integration_step, motor_force
from bcid.physics.kinematics import pose_rate, wrap_angle
from bcid.physics.motor import drag_force

STOP_S = 2.0  # full brake at the end
SPEED_SHARES = (1.0, 0.85, 0.7, 0.55, 0.4, 0.3)  # of the top speed, tried in turn
LENGTH_SHARES = (1.0, 0.85, 0.7, 0.55)  # of the pattern
HEADINGS = 12  # over half a turn
CIRCLE_SHARE = 0.76  # radius of the patterns' circles over the arena's smaller reach
GRIP_SHARE = 0.5  # of the largest side force, on such a circle at full speed
LEAST_DRAG = 1e-2  # 1/s: at least this times mass and speed brakes a car that speeds up
WAY_POINT_RADIUS_M = 0.5  # a way point this near is passed


class Arena(NamedTuple):
    """A rectangle on the floor along its axes, and how near to its walls the CoG may come (m)."""

    length: float = 12.0  # m along x
    width: float = 7.0  # m along y
    margin: float = 0.8
    x: float = 0.0  # m, of its middle
    y: float = 0.0

    @property
    def reach(self) -> Floats:
        """Largest distances (2,) in m of the CoG from the middle, along x and y."""
        return 0.5 * np.array([self.length, self.width]) - self.margin

    @property
    def middle(self) -> Floats:
        """Middle (2,) of the rectangle in m."""
        return np.array([self.x, self.y])


ARENA = Arena()
MAX_SPEED_MPS = 100.0  # no car of an arena is faster


@dataclass(frozen=True)
class PlannedDrive:
    """Commands that keep the car inside the arena when it sets out from rest at the pose `start`."""

    name: str
    purpose: str
    command_s: Floats  # (n,) at COMMAND_HZ
    command: Floats  # (n, 2) steering rad, throttle
    start: Floats  # (3,) x, y (m), yaw (rad)

    @property
    def seconds(self) -> float:
        """Duration (s) of the drive, its stop included."""
        return len(self.command) / COMMAND_HZ

    @property
    def initial_state(self) -> Floats:
        """State (6,) at rest in the start pose."""
        return np.concatenate([self.start, np.zeros(3)])


def top_speed(car: Car, throttle: float) -> float:
    """Speed (m/s) of a car in straight, steady driving at constant `throttle`, where motor force equals drag.

    The drag is at least LEAST_DRAG m v, and the speed at most MAX_SPEED_MPS.
    """
    from scipy.optimize import brentq

    def excess(v: float) -> float:
        """Force (N) left to speed up at the speed v (m/s)."""
        return float(motor_force(throttle, v, car) - max(drag_force(v, car.R_1, car.R_2), LEAST_DRAG * car.m * v))

    if excess(0.0) <= 0.0:
        return 0.0
    if excess(MAX_SPEED_MPS) > 0.0:  # a motor that hardly gives way, where nothing else brakes
        return MAX_SPEED_MPS
    return float(brentq(excess, 0.0, MAX_SPEED_MPS, xtol=1e-3))


def feasible_drives(car: Car, angle_limit: float, max_throttle: float, arena: Arena = ARENA) -> list[PlannedDrive]:
    """Adapt each command pattern of the catalogue (slalom, coast-down ...) to the car and the arena.

    A pattern is slowed down or shortened until the simulated car stays inside the arena, or else left out.
    `max_throttle` is a speed (m/s), or 1 where the throttle sets a force; `angle_limit` is the steering limit (rad).
    """
    radius = CIRCLE_SHARE * float(arena.reach.min())
    if radius <= 0.0:
        return []
    cornering = math.sqrt(GRIP_SHARE * (car.F_f_max + car.F_r_max) / car.m * radius)
    e = Envelope(car, angle_limit, max_throttle, min(top_speed(car, max_throttle), cornering), radius)
    drives = (_fit_into_arena(pattern, e, arena) for pattern in PATTERNS) if e.speed > 0.0 else ()
    return [d for d in drives if d is not None]


def _fit_into_arena(pattern: Callable[[Envelope], Commands], e: Envelope, arena: Arena) -> PlannedDrive | None:
    """Slow down and shorten a command pattern until the simulated car stays inside the arena, ending with a stop.

    The highest of SPEED_SHARES that fits at any of LENGTH_SHARES is taken, at the greatest of these that fits; None
    if none does at a length of `min_drive_s` or more.  The start pose centres the path in the arena, or lies at the
    first way point of the pattern's route.
    """
    name, purpose = pattern.__name__.replace("_", "-"), (pattern.__doc__ or "").strip().rstrip(".")
    for share in SPEED_SHARES:
        whole = pattern(e._replace(speed=share * e.speed))
        for length in LENGTH_SHARES:
            count = round(min(length * len(whole.command), EXPERIMENT_LIMITS.max_drive_s * COMMAND_HZ))
            if count < EXPERIMENT_LIMITS.min_drive_s * COMMAND_HZ:
                break
            command, start = whole.command[:count], np.zeros(3)
            if len(whole.route):
                route = whole.route * arena.reach + arena.middle
                start = np.array([*route[0], math.atan2(*(route[1] - route[0])[::-1])])
                command = _steer_along_route(command, route, start, e.car, e.angle_limit)
            command = np.vstack([command, hold_commands((STOP_S, float(command[-1, 0]), -1.0)).command])
            path = _base_car_path(command, start, e)
            pose = start if len(whole.route) and stays_inside(path, arena) else None
            if not len(whole.route):
                pose = _find_start_pose(path, arena)
            if pose is not None:
                return PlannedDrive(name, purpose, np.arange(len(command)) / COMMAND_HZ, command, pose)
    return None


@njit
def _steer_along_route(command: Floats, route: Floats, start: Floats, p: Car, limit: float) -> Floats:
    """Commands (n, 2), steering (rad) and throttle, with which a simulated car follows way points `route` (W, 2) in m.

    The steering is the bearing of the next way point from the car, plus that in `command`, limited to +-`limit` (rad).
    The car `p` starts from rest at the pose `start` (3,); the commands end where the last way point is reached.
    """
    out = command.copy()
    x, y, theta = start
    state = (0.0, 0.0, 0.0, command[0, 0])
    goal, h = 1, 1.0 / COMMAND_HZ
    for k in range(len(command)):
        while goal < len(route) and math.hypot(route[goal, 0] - x, route[goal, 1] - y) < WAY_POINT_RADIUS_M:
            goal += 1
        if goal == len(route):
            return out[: max(k, 1)]
        bearing = wrap_angle(math.atan2(route[goal, 1] - y, route[goal, 0] - x) - theta)
        out[k, 0] = min(max(bearing + command[k, 0], -limit), limit)
        state = advance_period(state, out[k, 0], out[k, 1], p, h)
        rate_x, rate_y = pose_rate(theta, state[0], state[1])
        x, y, theta = x + h * rate_x, y + h * rate_y, theta + h * state[2]
    return out


def _base_car_path(command: Floats, start: Floats, e: Envelope) -> Floats:
    """Simulate the base model (no effects, no noise) under commands (m, 2) at COMMAND_HZ, from rest at pose `start`.

    Returns its states (n + 1, 6), p_x, p_y, theta (world), v_x, v_y (body), omega, at n integration steps.
    """
    T, times, h = len(command) / COMMAND_HZ, np.arange(len(command)) / COMMAND_HZ, integration_step(e.car)
    chain = actuator_chain(times, command, 0.0, covering_steps(T, h), h, e.car, e.angle_limit, effect_switches())
    inputs = PredictionInputs(e.car, effect_switches(), chain, Constants())
    return simulate_states(inputs, T, NO_NOISE, 0, np.r_[start, np.zeros(3)])


def stays_inside(path: Floats, arena: Arena) -> bool:
    """Whether the car's CoG never comes nearer to a wall than `arena.margin`.

    Columns 0 and 1 of `path` hold its world coordinates x and y (m).
    """
    return bool((np.abs(path[:, :2] - arena.middle) <= arena.reach).all())


def _find_start_pose(path: Floats, arena: Arena) -> Floats | None:
    """Start pose x, y (m), yaw (rad) from which a path lies centred within the arena's margins; None if too wide.

    `path` (n, 6), x and y in columns 0 and 1, was driven from the origin; HEADINGS yaws over half a turn are tried.
    """
    for yaw in np.linspace(0.0, np.pi, HEADINGS, endpoint=False):
        turned = path[:, :2] @ np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
        low, high = turned.min(axis=0), turned.max(axis=0)
        if (high - low <= 2.0 * arena.reach).all():
            return np.array([*(arena.middle - 0.5 * (low + high)), yaw])
    return None


def write_commands(path: Path, command_s: Floats, command: Floats) -> None:
    """Write commands (n, 2) at times (n,) (s) as a CSV file with columns time_s, steering_rad and throttle_mps."""
    rows = np.column_stack([command_s, command])
    lines = [f"{t:.3f},{steering:.5f},{throttle:.5f}" for t, steering, throttle in rows]
    path.write_text("\n".join(["time_s,steering_rad,throttle_mps", *lines, ""]), encoding="utf-8")
