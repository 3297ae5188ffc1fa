"""The optimal control problem of docs/mpc.md, by multiple shooting, solved by IPOPT from a warm start."""

import math
from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import casadi as ca
import numpy as np
import scene
from exported import Predictor


class ProblemSettings(NamedTuple):
    """Horizon, weights and limits of the problem; symbols as in docs/mpc.md."""

    blocks: int = 30  # N, commands of a plan
    hold: int = 2  # periods of the model that a command is held
    w_heading: float = 0.5  # m/rad, what heading counts beside position
    w_speed: float = 0.1  # s^2/m
    w_end: float = 10.0  # by which the horizon's end counts more
    w_change: tuple[float, float] = (0.005, 0.01)  # m/rad^2 and s^2/m, of changes between commands
    w_touch: float = 100.0  # by which what is too near a wall or a pillar counts more than distance
    smooth: float = 0.03  # m and rad, below which distances count as squares
    max_steering: float = math.radians(115.0)
    max_steering_rate: float = 1.4  # rad/s
    throttle: tuple[float, float] = (-0.5, 0.8)  # share of the brake, m/s
    max_throttle_rate: float = 4.0  # m/s^2
    iterations: int = 10  # of IPOPT, from a plan that goes on
    first_iterations: int = 60  # from a guess
    guesses: int = 3  # from which the first plan is sought


class Plan(NamedTuple):
    """Commands (2, N), the states (n, N + 1) that the model predicts under them, and what they cost."""

    u: np.ndarray
    z: np.ndarray
    cost: float


class ParkingProblem:
    """Commands that park the car which a model predicts, from any state of it."""

    def __init__(self, model: Predictor, settings: ProblemSettings | None = None) -> None:
        self.model, self.settings = model, settings or ProblemSettings()
        self.period_s = self.settings.hold * model.period_s
        z, u = ca.SX.sym("z", len(model.states)), ca.SX.sym("u", 2)
        z_next = z
        for _ in range(self.settings.hold):
            z_next = model.step(z_next, u)
        self.block = ca.Function("block", [z, u], [z_next])
        self.stage = ca.Function("stage", [z], [_stage_cost(z, model.motion, self.settings)])
        self.room = ca.Function("room", [z], [_room_left(z)])
        self._build()

    def _build(self) -> None:
        """Write cost and constraints over all states, commands and slacks, and make IPOPT's solvers of them."""
        n, s = len(self.model.states), self.settings
        z, u, slack = ca.MX.sym("z", n, s.blocks + 1), ca.MX.sym("u", 2, s.blocks), ca.MX.sym("slack", s.blocks)
        z_0, u_before = ca.MX.sym("z_0", n), ca.MX.sym("u_before", 2)
        changes = u - ca.horzcat(u_before, u[:, :-1])
        weight = np.ones(s.blocks)
        weight[-1] = s.w_end
        cost = ca.dot(self.stage.map(s.blocks)(z[:, 1:]).T, weight) + s.w_touch * ca.sum1(slack + slack**2)
        cost = cost / s.blocks + ca.dot(ca.sum2(changes**2), ca.DM(s.w_change))
        self._cost = ca.Function("cost", [z, u, slack, u_before], [cost])

        gaps = z[:, 1:] - self.block.map(s.blocks)(z[:, :-1], u)
        room = self.room.map(s.blocks)(z[:, 1:])
        room += ca.repmat(slack.T, room.size1(), 1)
        nlp = {
            "x": ca.veccat(z, u, slack), "p": ca.veccat(z_0, u_before), "f": cost,
            "g": ca.veccat(z[:, 0] - z_0, gaps, changes, room),
        }  # fmt: skip
        none, rate = np.zeros(z.numel()), self.period_s * np.tile([s.max_steering_rate, s.max_throttle_rate], s.blocks)
        far = np.full(z.numel(), np.inf)
        low, high = ([sign * s.max_steering, limit] for sign, limit in zip((-1.0, 1.0), s.throttle, strict=True))
        self._bounds = {
            "lbg": np.concatenate([none, -rate, np.zeros(room.numel())]),
            "ubg": np.concatenate([none, rate, np.full(room.numel(), np.inf)]),
            "lbx": np.concatenate([-far, np.tile(low, s.blocks), np.zeros(s.blocks)]),
            "ubx": np.concatenate([far, np.tile(high, s.blocks), np.full(s.blocks, np.inf)]),
        }
        self._solvers = {count: _make_solver(nlp, count) for count in (s.iterations, s.first_iterations)}

    def evaluate(self, z_0: np.ndarray, u_before: np.ndarray, u: np.ndarray) -> Plan:
        """What the commands `u` (2, N) lead to from the state `z_0` (n,), after the command `u_before` (2,)."""
        z = np.empty((len(z_0), u.shape[1] + 1))
        z[:, 0] = z_0
        for k in range(u.shape[1]):
            z[:, k + 1] = np.asarray(self.block(z[:, k], u[:, k])).ravel()
        return Plan(u, z, float(self._cost(z, u, self._slack(z), u_before)))

    def improve(self, plan: Plan, u_before: np.ndarray, first: bool = False) -> Plan:
        """The plan at which IPOPT ends that begins with `plan`, rolled out; `plan` itself where that costs less."""
        s, n = self.settings, plan.z.size
        guess = np.concatenate([plan.z.ravel("F"), plan.u.ravel("F"), self._slack(plan.z)])
        solver = self._solvers[s.first_iterations if first else s.iterations]
        answer = solver(x0=guess, p=np.concatenate([plan.z[:, 0], u_before]), **self._bounds)
        u = np.asarray(answer["x"])[n : n + plan.u.size].reshape(plan.u.shape, order="F")
        limit = np.array([s.max_steering, *s.throttle])
        u = np.clip(u, [[-limit[0]], [limit[1]]], [[limit[0]], [limit[2]]])
        better = self.evaluate(plan.z[:, 0], u_before, u)
        return better if better.cost < plan.cost else plan

    def begin(self, z_0: np.ndarray, u_before: np.ndarray) -> Plan:
        """A plan without one before it: the best that IPOPT makes of the cheapest few of a family of guesses."""
        guesses = sorted((self.evaluate(z_0, u_before, u) for u in self._guess()), key=lambda plan: plan.cost)
        found = [self.improve(plan, u_before, first=True) for plan in guesses[: self.settings.guesses]]
        return min(found, key=lambda plan: plan.cost)

    def _guess(self) -> Iterator[np.ndarray]:
        """Commands (2, N): the wheel is turned to one side, held there, and turned straight, while the throttle waits.

        They differ in side and angle, in how long the angle is held, and in when the car begins to move.
        """
        s = self.settings
        turn = self.period_s * s.max_steering_rate
        time = np.arange(1, s.blocks + 1)
        for angle, held, wait in product((-1.0, -0.75, 0.0, 0.75, 1.0), (8, 12, 16, 20), (2, 5)):
            ramp = np.minimum(turn * time, np.maximum(turn * (held - time) + s.max_steering, 0.0))
            steering = np.sign(angle) * np.minimum(ramp, abs(angle) * s.max_steering)
            yield np.stack([steering, np.where(time > wait, 0.8 * s.throttle[1], 0.0)])

    def go_on(self, plan: Plan, z_0: np.ndarray, u_before: np.ndarray) -> Plan:
        """The plan one command later, from the state `z_0` (n,) at which the car then is: `plan` shifted, improved."""
        u = np.column_stack([plan.u[:, 1:], plan.u[:, -1]])
        return self.improve(self.evaluate(z_0, u_before, u), u_before)

    def _slack(self, z: np.ndarray) -> np.ndarray:
        """How far (N,) the states `z` (n, N + 1) after the first are too near something (m)."""
        return np.maximum(-np.asarray(self.room(z[:, 1:])).min(axis=0), 0.0)


def _make_solver(nlp: dict[str, ca.MX], iterations: int) -> ca.Function:
    """IPOPT on the problem `nlp`, which ends after so many iterations at the latest."""
    ipopt = {
        "print_level": 0, "sb": "yes", "max_iter": iterations, "mu_strategy": "adaptive",
        "tol": 1e-4, "acceptable_tol": 1e-2, "acceptable_iter": 3,
    }  # fmt: skip
    return ca.nlpsol("parking", "ipopt", nlp, {"print_time": False, "error_on_fail": False, "ipopt": ipopt})


def _stage_cost(z: ca.SX, motion: slice, s: ProblemSettings) -> ca.SX:
    """What a state costs (m): its distance from the goal in position and heading, and its speed."""
    gap = z[:2] - ca.DM(scene.GOAL[:2])
    # the gap in heading where it is small, and the same after a whole turn
    turn = 2.0 * ca.sin(0.5 * (z[2] - scene.GOAL[2]))
    distances = [ca.sqrt(part + s.smooth**2) - s.smooth for part in (ca.sumsqr(gap), turn**2)]
    return distances[0] + s.w_heading * distances[1] + s.w_speed * ca.sumsqr(z[motion])


def _room_left(z: ca.SX) -> ca.SX:
    """Distances (m) of the car's discs from each wall and pillar, beyond what a plan keeps free."""
    room = []
    for ahead in scene.DISCS:
        x, y = z[0] + ahead * ca.cos(z[2]), z[1] + ahead * ca.sin(z[2])
        room += [x - scene.WALLS[0], scene.WALLS[1] - x, y - scene.WALLS[2], scene.WALLS[3] - y]
        # never quite zero, where the root has no derivative
        room += [ca.sqrt((x - a) ** 2 + (y - b) ** 2 + 1e-6) - r for a, b, r in scene.PILLARS]
    return ca.vertcat(*room) - (scene.DISC_RADIUS + scene.KEPT_FREE)
