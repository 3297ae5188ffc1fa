"""The EKF's model: x = [p_x, p_y, theta, v_f, beta_f, beta_r, delta] (paper, App. stateEst).

The heading angles of the wheels walk randomly while the car rolls; near standstill, where they
cannot be observed, gamma pulls them to the steering angle and to zero.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.compiled import njit, njit_inline
from bcid.physics.elementary import sincos
from bcid.physics.kinematics import body_twist, pose_rate
from bcid.physics.steering import steering_rate

Floats = npt.NDArray[np.float64]

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
def f(x: Floats, u_s: float, c: Chassis) -> Floats:
    """X' without noise (paper, f_kalman_rewrite, with errata 1, 4, 5)."""
    v_x, v_y, omega = body_twist(x[VF], x[BETAF], x[BETAR], c.l_f, c.l_r)
    p_x_rate, p_y_rate = pose_rate(x[THETA], v_x, v_y)
    pull = ETA * at_rest(x[VF])
    rate = np.zeros(N_STATE)
    rate[PX] = p_x_rate
    rate[PY] = p_y_rate
    rate[THETA] = omega
    rate[BETAF] = pull * (x[DELTA] - x[BETAF])
    rate[BETAR] = -pull * x[BETAR]
    rate[DELTA] = steering_rate(u_s, x[DELTA], c.T_s, c.d)
    return rate


@njit_inline
def twist_jacobian(x: Floats, c: Chassis) -> Floats:
    """d[v_x, v_y, omega] / d[v_f, beta_f, beta_r] (3, 3)."""
    (sin_f, cos_f), (sin_r, cos_r) = sincos(x[BETAF]), sincos(x[BETAR])
    tan_r = sin_r / cos_r
    v_f, wheelbase = x[VF], c.l_f + c.l_r
    d_tan = 1.0 + tan_r * tan_r
    J = np.zeros((3, 3))
    J[0, 0] = cos_f
    J[0, 1] = -sin_f * v_f
    J[1, 0] = (c.l_r * sin_f + c.l_f * cos_f * tan_r) / wheelbase
    J[1, 1] = (c.l_r * cos_f - c.l_f * sin_f * tan_r) / wheelbase * v_f
    J[1, 2] = c.l_f * cos_f * d_tan / wheelbase * v_f
    J[2, 0] = (sin_f - cos_f * tan_r) / wheelbase
    J[2, 1] = (cos_f + sin_f * tan_r) / wheelbase * v_f
    J[2, 2] = -cos_f * d_tan / wheelbase * v_f
    return J


@njit_inline
def F(x: Floats, u_s: float, c: Chassis) -> Floats:
    """df/dx (7, 7)."""
    J = twist_jacobian(x, c)
    v_x, v_y, _ = body_twist(x[VF], x[BETAF], x[BETAR], c.l_f, c.l_r)
    sin_t, cos_t = sincos(x[THETA])
    out = np.zeros((N_STATE, N_STATE))
    out[PX, THETA] = -sin_t * v_x - cos_t * v_y
    out[PY, THETA] = cos_t * v_x - sin_t * v_y
    for j in range(3):
        out[PX, VF + j] = cos_t * J[0, j] - sin_t * J[1, j]
        out[PY, VF + j] = sin_t * J[0, j] + cos_t * J[1, j]
        out[THETA, VF + j] = J[2, j]
    rest = at_rest(x[VF])
    pull, d_pull = ETA * rest, -20.0 * ETA * rest * (1.0 - rest)
    out[BETAF, VF] = d_pull * (x[DELTA] - x[BETAF])
    out[BETAF, BETAF] = -pull
    out[BETAF, DELTA] = pull
    out[BETAR, VF] = -d_pull * x[BETAR]
    out[BETAR, BETAR] = -pull
    if abs(u_s - x[DELTA]) < c.d * c.T_s:
        out[DELTA, DELTA] = -1.0 / c.T_s
    return out


@njit
def h(x: Floats, c: Chassis) -> Floats:
    """The six quantities that may be measured (MEASURED): pose, steering angle, yaw rate, wheel speed."""
    v_x, _, omega = body_twist(x[VF], x[BETAF], x[BETAR], c.l_f, c.l_r)
    z = np.empty(N_MEASURED)
    z[0], z[1], z[2] = x[PX], x[PY], x[THETA]
    z[3] = x[DELTA]
    z[4] = omega
    z[5] = x[VF] * math.cos(x[BETAF] - x[DELTA]) if c.front_driven else v_x
    return z


@njit
def H(x: Floats, c: Chassis) -> Floats:
    """dh/dx (6, 7)."""
    J = twist_jacobian(x, c)
    out = np.zeros((N_MEASURED, N_STATE))
    out[0, PX] = out[1, PY] = out[2, THETA] = out[3, DELTA] = 1.0
    for j in range(3):
        out[4, VF + j] = J[2, j]
    if c.front_driven:
        slip = x[BETAF] - x[DELTA]
        out[5, VF] = math.cos(slip)
        out[5, BETAF] = -x[VF] * math.sin(slip)
        out[5, DELTA] = x[VF] * math.sin(slip)
    else:
        out[5, VF] = J[0, 0]
        out[5, BETAF] = J[0, 1]
    return out
