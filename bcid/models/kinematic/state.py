"""What the kinematic models share: the state [v_f, alpha_f, alpha_r, delta], its step, and the twist it gives.

The slip angles and the front wheel's speed evolve by a fitted map, delta by the steering's own law,
and the twist follows from the extended kinematic model (paper, fkin; errata 1).
"""

from __future__ import annotations

import math
from typing import ClassVar, NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit_inline
from bcid.models.interface import CompiledModel, FitTask, History
from bcid.physics.elementary import clip
from bcid.physics.kinematics import body_twist
from bcid.physics.steering import steering_step

# Factor on a capped speed, so that rounding gains no energy either.
ROUNDING_MARGIN = 1.0 - 1e-12
# Bound of |alpha_r| (rad) that keeps its tangent finite in a rollout.
SLIP_LIMIT = 0.49 * math.pi


class KinematicCar(NamedTuple):
    """What the kinematic models know of the car: levers, steering and period."""

    l_f: float  # m
    l_r: float  # m
    T_s: float  # s, steering time constant
    d: float  # rad/s, steering rate limit
    period: float  # s
    follow: float = 1.0  # 1 where the throttle is a speed, 0 where it sets a force

    @classmethod
    def from_task(cls, task: FitTask) -> KinematicCar:
        """The vehicle's levers, with the steering constants that the estimates were made with."""
        (T_s, d), body = task.estimates[0].steering_constants(), task.vehicle.body
        follow = 0.0 if task.vehicle.motor.law == "force" else 1.0
        return cls(body.cog_to_front_m, body.cog_to_rear_m, T_s, d, task.period_s, follow)


KinematicState = tuple[float, float, float, float]
"""[v_f, alpha_f, alpha_r, delta], in m/s and rad."""


class KinematicModel(CompiledModel):
    """Base class of models of the kinematic state; their carry is [v_f, alpha_f, alpha_r, delta]."""

    car: KinematicCar
    input_count: ClassVar[int] = 6  # of the fitted map, see `fill_input`

    @property
    def period_s(self) -> float:  # type: ignore[override]  # never written
        """The time (s) by which a step advances."""
        return self.car.period

    def init(self, history: History) -> Floats:
        """The carry [v_f, alpha_f, alpha_r, delta] at the history's last row."""
        return np.array(history.kinematic[-1])


@njit_inline
def kinematic_twist(state: KinematicState, c: KinematicCar) -> tuple[float, float, float]:
    """v_x, v_y (m/s), yaw rate (rad/s) of the centre of gravity in the kinematic state [v_f, alpha_f, alpha_r, delta].

    The front and rear wheels move at the angles beta_f = delta + alpha_f and beta_r = alpha_r to the body's axis
    (paper, fkin; docs/errata.md row 1); `c` holds the lever arms l_f, l_r.
    """
    v_f, alpha_f, alpha_r, delta = state
    return body_twist(v_f, delta + alpha_f, clip(alpha_r, -SLIP_LIMIT, SLIP_LIMIT), c.l_f, c.l_r)


@njit_inline
def next_state(after: Floats, delta: float, parts: Floats, k: int, c: KinematicCar) -> KinematicState:
    """The kinematic state [v_f (m/s), alpha_f, alpha_r, delta (rad)] one period later, from a map's output `after`.

    `after` (3,), by a fitted map, holds the first three, of which v_f is raised to 0 if negative; `delta` (rad)
    follows the commands in the parts of period `k`, `parts` (N, W, 4), by the servo's law, a first-order lag with a
    rate limit.
    """
    return max(after[0], 0.0), after[1], after[2], follow_commands(delta, parts, k, c)


@njit_inline
def follow_commands(delta: float, parts: Floats, k: int, c: KinematicCar) -> float:
    """Steering angle (rad) after period `k` of the commands `parts` (N, W, 4); `delta` (rad) is that before it."""
    for j in range(parts.shape[1]):
        if parts[k, j, 0] > 0.0:
            delta = steering_step(delta, parts[k, j, 1], c.T_s, c.d, parts[k, j, 0])
    return delta


@njit_inline
def doubled_energy(state: KinematicState, c: KinematicCar) -> float:
    """Twice the kinetic energy per mass (m^2/s^2) of a car in a kinematic state: v_x^2 + v_y^2 + l_f l_r w^2.

    Kinematic models have no moment of inertia: I_z = m l_f l_r is assumed, that of two masses on the axles.
    """
    v_x, v_y, yaw_rate = kinematic_twist(state, c)
    return v_x * v_x + v_y * v_y + c.l_f * c.l_r * yaw_rate * yaw_rate


@njit_inline
def cap_energy(before: KinematicState, after: KinematicState, c: KinematicCar) -> KinematicState:
    """The kinematic state `after`, v_f lowered where its kinetic energy (`doubled_energy`) exceeds that of `before`.

    The twist is proportional to v_f, so that the factor is the root of the ratio of energies.
    """
    energy_before, energy_after = doubled_energy(before, c), doubled_energy(after, c)
    factor = ROUNDING_MARGIN * math.sqrt(energy_before / energy_after) if energy_after > energy_before else 1.0
    return factor * after[0], after[1], after[2], after[3]


@njit_inline
def fill_input(x: Floats, state: KinematicState, u_s: float, u_m: float) -> None:
    """Fill x (6,) with a kinematic model's perceptron input, [v_f, alpha_f, alpha_r, delta, u_s, u_m] in SI units."""
    x[0], x[1], x[2], x[3], x[4], x[5] = state[0], state[1], state[2], state[3], u_s, u_m
