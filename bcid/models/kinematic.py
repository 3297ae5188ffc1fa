"""What the kinematic models share: the carry [v_f, alpha_f, alpha_r, delta] and the twist it gives.

The slip angles and the front wheel's speed evolve by a fitted map, delta by the steering's own law,
and the twist follows from the extended kinematic model (paper, fkin; errata 1).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bcid.compiled import njit
from bcid.models.interface import FitTask, Floats
from bcid.physics.kinematics import body_twist

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


@njit
def twist_of(state: Floats, c: Frame) -> tuple[float, float, float]:
    """v_x, v_y, yaw rate of [v_f, alpha_f, alpha_r, delta]: beta_f = delta + alpha_f, beta_r = alpha_r."""
    return body_twist(state[0], state[3] + state[1], max(-SLIP_LIMIT, min(SLIP_LIMIT, state[2])), c.l_f, c.l_r)


@njit
def joined(state: Floats, command: Floats) -> Floats:
    """[v_f, alpha_f, alpha_r, delta, u_s, u_m]: the input of the fitted maps."""
    x = np.empty(6)
    x[:4] = state
    x[4:] = command
    return x
