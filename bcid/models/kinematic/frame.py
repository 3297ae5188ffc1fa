"""What the kinematic models share: the carry [v_f, alpha_f, alpha_r, delta] and the twist it gives.

The slip angles and the front wheel's speed evolve by a fitted map, delta by the steering's own law,
and the twist follows from the extended kinematic model (paper, fkin; errata 1).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from bcid.aliases import Floats
from bcid.compiled.njit import njit_inline
from bcid.models.interface import FitTask
from bcid.physics.elementary import clip
from bcid.physics.kinematics import body_twist
from bcid.physics.steering import steering_step

LESS = 1.0 - 1e-12  # so that rounding gains nothing either
INPUTS = 6  # of the fitted maps: see `fill`
SLIP_LIMIT = 0.49 * math.pi  # tan(alpha_r) stays finite in a rollout


class Frame(NamedTuple):
    """What the kinematic models know of the car, SI."""

    l_f: float
    l_r: float
    T_s: float
    d: float
    period: float
    follow: float = 1.0  # 1 where the throttle is a reference speed, 0 where it sets a force


def frame_of(task: FitTask) -> Frame:
    """The vehicle's geometry, and the steering constants that the estimates were made with."""
    facts, body = task.estimates[0].facts, task.vehicle.body
    follow = 1.0 if task.vehicle.motor.law == "speed" else 0.0
    return Frame(body.cog_to_front_m, body.cog_to_rear_m, facts["T_s"], facts["d"], task.period_s, follow)


State = tuple[float, float, float, float]  # v_f, alpha_f, alpha_r, delta


@njit_inline
def twist_of(v_f: float, alpha_f: float, alpha_r: float, delta: float, c: Frame) -> tuple[float, float, float]:
    """v_x, v_y, yaw rate: beta_f = delta + alpha_f, beta_r = alpha_r."""
    return body_twist(v_f, delta + alpha_f, clip(alpha_r, -SLIP_LIMIT, SLIP_LIMIT), c.l_f, c.l_r)


@njit_inline
def moved(after: Floats, delta: float, u_s: float, c: Frame) -> State:
    """The state a period later, from what a fitted map says of [v_f, alpha_f, alpha_r] and the servo by itself."""
    return max(after[0], 0.0), after[1], after[2], steering_step(delta, u_s, c.T_s, c.d, c.period)


@njit_inline
def doubled_energy(state: State, c: Frame) -> float:
    """Twice the kinetic energy per mass (m^2/s^2), with l_f l_r for the square of the radius of gyration.

    That is the body whose axles' loads move as if they were by themselves; a kinematic model knows no inertia.
    """
    v_x, v_y, yaw_rate = twist_of(state[0], state[1], state[2], state[3], c)
    return v_x * v_x + v_y * v_y + c.l_f * c.l_r * yaw_rate * yaw_rate


@njit_inline
def without_gain(before: State, after: State, c: Frame) -> State:
    """`after` with v_f, to which the twist is proportional, lowered until no kinetic energy is gained."""
    had, has = doubled_energy(before, c), doubled_energy(after, c)
    kept = LESS * math.sqrt(had / has) if has > had else 1.0
    return kept * after[0], after[1], after[2], after[3]


@njit_inline
def fill(x: Floats, state: State, u_s: float, u_m: float) -> None:
    """The input of the fitted maps, [v_f, alpha_f, alpha_r, delta, u_s, u_m], into x."""
    x[0], x[1], x[2], x[3], x[4], x[5] = state[0], state[1], state[2], state[3], u_s, u_m
