"""From the filter's states to twists and kinematic states with their standard deviations."""

from __future__ import annotations

import math

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.estimate.process import BETAF, BETAR, DELTA, VF, Chassis, twist_jacobian
from bcid.physics.kinematics import body_twist, wrap

STANDSTILL_MPS = 0.05


@njit
def twists(x: Floats, c: Chassis) -> Floats:
    """v_x, v_y, yaw rate (M, 3) of states (M, 7)."""
    out = np.empty((len(x), 3))
    for k in range(len(x)):
        out[k, 0], out[k, 1], out[k, 2] = body_twist(x[k, VF], x[k, BETAF], x[k, BETAR], c.l_f, c.l_r)
    return out


@njit
def twist_covariances(x: Floats, P: Floats, c: Chassis) -> Floats:
    """Covariances (M, 3, 3) of the twists, to first order."""
    out = np.empty((len(x), 3, 3))
    for k in range(len(x)):
        J = twist_jacobian(x[k], c)
        inner = np.ascontiguousarray(P[k, VF : BETAR + 1, VF : BETAR + 1])
        out[k] = np.dot(np.dot(J, inner), J.T)
    return out


@njit
def kinematic_states(x: Floats) -> Floats:
    """v_f >= 0, alpha_f, alpha_r, delta (M, 4); errata 15.

    A v_f below zero turns beta_f by pi, except at standstill, where the angles mean nothing.
    """
    out = np.empty((len(x), 4))
    for k in range(len(x)):
        turn = math.pi if x[k, VF] < -STANDSTILL_MPS else 0.0
        out[k, 0] = abs(x[k, VF])
        out[k, 1] = wrap(x[k, BETAF] + turn - x[k, DELTA])
        out[k, 2] = math.atan(math.tan(x[k, BETAR]))
        out[k, 3] = x[k, DELTA]
    return out


def kinematic_sd(P: Floats) -> Floats:
    """Standard deviations (M, 4) of v_f, alpha_f, alpha_r, delta."""
    alpha_f = P[:, BETAF, BETAF] + P[:, DELTA, DELTA] - 2 * P[:, BETAF, DELTA]
    variances = np.column_stack([P[:, VF, VF], alpha_f, P[:, BETAR, BETAR], P[:, DELTA, DELTA]])
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)))
