"""The EKF's model: x = [p_x, p_y, theta, v_f, beta_f, beta_r, delta] (paper, App. stateEst).

The heading angles of the wheels walk randomly while the car rolls; near standstill, where they
cannot be observed, gamma pulls them to the steering angle and to zero.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_inline
from bcid.physics.elementary import sincos
from bcid.physics.kinematics import body_twist, pose_rate
from bcid.physics.steering import steering_rate

PX, PY, THETA, VF, BETAF, BETAR, DELTA = range(7)
N_STATE = 7
MEASURED = ("x", "y", "yaw", "steering", "yaw_rate", "wheel_speed")
N_MEASURED = len(MEASURED)
ETA = 20.0  # 1/s, pole of the heading angles at standstill (paper)


class Chassis(NamedTuple):
    """What the process model knows of the car, SI."""

    l_f: float
    l_r: float
    T_s: float
    d: float
    front_driven: bool  # which wheel a measured wheel speed belongs to


@njit
def at_rest(v_f: float) -> float:
    """1 - gamma: 0.88 at standstill, 0 while rolling (paper; errata 10)."""
    return 1.0 - 0.5 * (math.tanh(10.0 * v_f - 1.0) + 1.0)


@njit_inline
def fill_twist_jacobian(x: Floats, c: Chassis, J: Floats) -> None:
    """`twist_jacobian` into J, whose upper right corner is nothing."""
    (sin_f, cos_f), (sin_r, cos_r) = sincos(x[BETAF]), sincos(x[BETAR])
    tan_r = sin_r / cos_r
    v_f, wheelbase = x[VF], c.l_f + c.l_r
    d_tan = 1.0 + tan_r * tan_r
    J[0, 0] = cos_f
    J[0, 1] = -sin_f * v_f
    J[1, 0] = (c.l_r * sin_f + c.l_f * cos_f * tan_r) / wheelbase
    J[1, 1] = (c.l_r * cos_f - c.l_f * sin_f * tan_r) / wheelbase * v_f
    J[1, 2] = c.l_f * cos_f * d_tan / wheelbase * v_f
    J[2, 0] = (sin_f - cos_f * tan_r) / wheelbase
    J[2, 1] = (cos_f + sin_f * tan_r) / wheelbase * v_f
    J[2, 2] = -cos_f * d_tan / wheelbase * v_f


@njit
def twist_jacobian(x: Floats, c: Chassis) -> Floats:
    """d[v_x, v_y, omega] / d[v_f, beta_f, beta_r] (3, 3)."""
    J = np.zeros((3, 3))
    fill_twist_jacobian(x, c, J)
    return J


@njit_inline
def flow(x: Floats, u_s: float, c: Chassis, rate: Floats, A: Floats, J: Floats) -> None:
    """Fills `rate` (7,) with x' without noise (paper, f_kalman_rewrite, with errata 1, 4, 5) and A with F = dx'/dx.

    A and J (`fill_twist_jacobian`) must come zeroed: what is always nothing in them is not written.
    """
    v_x, v_y, omega = body_twist(x[VF], x[BETAF], x[BETAR], c.l_f, c.l_r)
    fill_twist_jacobian(x, c, J)
    sin_t, cos_t = sincos(x[THETA])
    rest = at_rest(x[VF])
    pull, d_pull = ETA * rest, -20.0 * ETA * rest * (1.0 - rest)
    rate[PX], rate[PY] = pose_rate(x[THETA], v_x, v_y)
    rate[THETA] = omega
    rate[BETAF] = pull * (x[DELTA] - x[BETAF])
    rate[BETAR] = -pull * x[BETAR]
    rate[DELTA] = steering_rate(u_s, x[DELTA], c.T_s, c.d)
    A[PX, THETA] = -rate[PY]
    A[PY, THETA] = rate[PX]
    for j in range(3):
        A[PX, VF + j] = cos_t * J[0, j] - sin_t * J[1, j]
        A[PY, VF + j] = sin_t * J[0, j] + cos_t * J[1, j]
        A[THETA, VF + j] = J[2, j]
    A[BETAF, VF] = d_pull * (x[DELTA] - x[BETAF])
    A[BETAF, BETAF] = -pull
    A[BETAF, DELTA] = pull
    A[BETAR, VF] = -d_pull * x[BETAR]
    A[BETAR, BETAR] = -pull
    A[DELTA, DELTA] = -1.0 / c.T_s if abs(u_s - x[DELTA]) < c.d * c.T_s else 0.0


@njit
def f(x: Floats, u_s: float, c: Chassis) -> Floats:
    """X' (7,): see `flow`."""
    rate = np.zeros(N_STATE)
    flow(x, u_s, c, rate, np.zeros((N_STATE, N_STATE)), np.zeros((3, 3)))
    return rate


@njit
def F(x: Floats, u_s: float, c: Chassis) -> Floats:
    """df/dx (7, 7): see `flow`."""
    A = np.zeros((N_STATE, N_STATE))
    flow(x, u_s, c, np.zeros(N_STATE), A, np.zeros((3, 3)))
    return A


@njit_inline
def seen(x: Floats, c: Chassis, z: Floats, C: Floats, J: Floats) -> None:
    """Fills z with the six quantities that may be measured (MEASURED) and C with H = dz/dx.

    C and J (`fill_twist_jacobian`) must come zeroed: what is always nothing in them is not written.
    """
    v_x, _, omega = body_twist(x[VF], x[BETAF], x[BETAR], c.l_f, c.l_r)
    fill_twist_jacobian(x, c, J)
    z[0], z[1], z[2], z[3], z[4] = x[PX], x[PY], x[THETA], x[DELTA], omega
    C[0, PX] = C[1, PY] = C[2, THETA] = C[3, DELTA] = 1.0
    for j in range(3):
        C[4, VF + j] = J[2, j]
    if c.front_driven:
        sin_s, cos_s = sincos(x[BETAF] - x[DELTA])
        z[5] = x[VF] * cos_s
        C[5, VF], C[5, BETAF], C[5, DELTA] = cos_s, -x[VF] * sin_s, x[VF] * sin_s
    else:
        z[5] = v_x
        C[5, VF], C[5, BETAF] = J[0, 0], J[0, 1]


@njit
def h(x: Floats, c: Chassis) -> Floats:
    """The six quantities that may be measured (6,): see `seen`."""
    z = np.zeros(N_MEASURED)
    seen(x, c, z, np.zeros((N_MEASURED, N_STATE)), np.zeros((3, 3)))
    return z


@njit
def H(x: Floats, c: Chassis) -> Floats:
    """dh/dx (6, 7): see `seen`."""
    C = np.zeros((N_MEASURED, N_STATE))
    seen(x, c, np.zeros(N_MEASURED), C, np.zeros((3, 3)))
    return C
