"""The EKF's model: x = [p_x, p_y, theta, v_f, beta_f, beta_r, delta] (paper, App. stateEst).

The heading angles of the wheels walk randomly while the car rolls; near standstill, where they
cannot be observed, gamma pulls them to the steering angle and to zero.
"""

import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_inline
from bcid.physics.elementary import sincos
from bcid.physics.kinematics import body_twist, pose_rate, wrap_angle
from bcid.physics.steering import steering_rate

PX, PY, THETA, VF, BETAF, BETAR, DELTA = range(7)
N_STATE = 7
MEASURED = ("x", "y", "yaw", "steering", "yaw_rate", "wheel_speed")
N_MEASURED = len(MEASURED)
ETA = 20.0
"""Pole of the heading angles at standstill (1/s; paper, App. stateEst)."""

STANDSTILL_MPS = 0.05
"""Speed (m/s) below which a negative v_f does not turn the heading angle: at standstill it means nothing."""


class Chassis(NamedTuple):
    """The car's constants in the EKF's process model, SI."""

    l_f: float
    l_r: float
    T_s: float
    d: float
    front_driven: bool  # which wheel a measured wheel speed belongs to


@njit_inline
def standstill_weight(v_f: float) -> float:
    """1 - gamma(v_f), gamma = (tanh(10 v_f - 1) + 1)/2, v_f in m/s: 0.88 at rest, 0 rolling (docs/errata.md row 10)."""
    # as the logistic function that it is
    return 1.0 / (1.0 + math.exp(20.0 * v_f - 2.0))


@njit_inline
def fill_twist_jacobian(x: Floats, c: Chassis, J: Floats) -> None:
    """Write the Jacobian d[v_x, v_y, omega]/d[v_f, beta_f, beta_r] into the zeroed `J` (3, 3) (docs/errata.md row 1).

    `x` (7,) is the EKF's state [p_x, p_y, theta, v_f, beta_f, beta_r, delta].
    """
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


@njit_inline
def fill_state_rate(x: Floats, u_s: float, c: Chassis, rate: Floats, A: Floats, J: Floats) -> None:
    """Write the EKF's state rate x' without noise into `rate` (7,) and its Jacobian F = dx'/dx into `A` (7, 7).

    `x` is [p_x, p_y, theta, v_f, beta_f, beta_r, delta], `u_s` the steering command (rad) (paper, App. F, 2nd equation;
    docs/errata.md rows 1, 4, 5).  `A` and `J` (3, 3; scratch for `fill_twist_jacobian`) must come zeroed: elements that
    are always zero are not written.
    """
    v_x, v_y, omega = body_twist(x[VF], x[BETAF], x[BETAR], c.l_f, c.l_r)
    fill_twist_jacobian(x, c, J)
    sin_t, cos_t = sincos(x[THETA])
    rest = standstill_weight(x[VF])
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
    """Process model of the EKF: the rate x' (7,) of x = [p_x, p_y, theta, v_f, beta_f, beta_r, delta], without noise.

    `u_s` (rad) is the steering command, `c` the car's constants (paper, App. F State Estimation, 2nd equation).
    """
    rate = np.zeros(N_STATE)
    fill_state_rate(x, u_s, c, rate, np.zeros((N_STATE, N_STATE)), np.zeros((3, 3)))
    return rate


@njit
def F(x: Floats, u_s: float, c: Chassis) -> Floats:
    """Jacobian dx'/dx (7, 7) of the EKF's process model `f` at the state `x` (7,) and steering command u_s (rad)."""
    A = np.zeros((N_STATE, N_STATE))
    fill_state_rate(x, u_s, c, np.zeros(N_STATE), A, np.zeros((3, 3)))
    return A


@njit_inline
def fill_measurement(x: Floats, c: Chassis, z: Floats, C: Floats, J: Floats) -> None:
    """Write the measurements h(x) expected at the EKF's state `x` (7,) into `z` (6,), and H = dh/dx into `C` (6, 7).

    `z` holds x, y, yaw, steering angle, yaw rate, wheel speed.  `C` and `J` (3, 3; scratch for `fill_twist_jacobian`)
    must come zeroed: elements that are always zero are not written.
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
    """Measurement model of the EKF: the measurements (6,) expected at the state `x` (7,), in the order of MEASURED.

    These are x, y (m), yaw, steering angle (rad), yaw rate (rad/s), and the speed (m/s) of the driven axle's wheel.
    """
    z = np.zeros(N_MEASURED)
    fill_measurement(x, c, z, np.zeros((N_MEASURED, N_STATE)), np.zeros((3, 3)))
    return z


@njit
def H(x: Floats, c: Chassis) -> Floats:
    """Jacobian dh/dx (6, 7) of the EKF's measurement model `h` at the state `x` (7,)."""
    C = np.zeros((N_MEASURED, N_STATE))
    fill_measurement(x, c, np.zeros(N_MEASURED), C, np.zeros((3, 3)))
    return C


@njit
def twists(x: Floats, c: Chassis) -> Floats:
    """Twists (M, 3), v_x, v_y (m/s, body frame) and yaw rate (rad/s), of the EKF's states x (M, 7)."""
    out = np.empty((len(x), 3))
    for k in range(len(x)):
        out[k, 0], out[k, 1], out[k, 2] = body_twist(x[k, VF], x[k, BETAF], x[k, BETAR], c.l_f, c.l_r)
    return out


@njit
def twist_covariances(x: Floats, P: Floats, c: Chassis) -> Floats:
    """Covariances J P J^T (M, 3, 3) of v_x, v_y, yaw rate, to first order, of EKF states x (M, 7), P (M, 7, 7)."""
    out, J = np.empty((len(x), 3, 3)), np.zeros((3, 3))
    for k in range(len(x)):
        fill_twist_jacobian(x[k], c, J)
        inner = np.ascontiguousarray(P[k, VF : BETAR + 1, VF : BETAR + 1])
        out[k] = np.dot(np.dot(J, inner), J.T)
    return out


@njit
def kinematic_states(x: Floats) -> Floats:
    """Kinematic states (M, 4) v_f >= 0 (m/s), alpha_f, alpha_r, delta (rad) of the EKF's states x (M, 7).

    Where the car drives backward (v_f < -STANDSTILL_MPS), v_f is made positive and pi is added to the course angle
    beta_f (docs/errata.md row 15).
    """
    out = np.empty((len(x), 4))
    for k in range(len(x)):
        turn = math.pi if x[k, VF] < -STANDSTILL_MPS else 0.0
        out[k, 0] = abs(x[k, VF])
        out[k, 1] = wrap_angle(x[k, BETAF] + turn - x[k, DELTA])
        out[k, 2] = math.atan(math.tan(x[k, BETAR]))
        out[k, 3] = x[k, DELTA]
    return out


def kinematic_sd(P: Floats) -> Floats:
    """Standard deviations (M, 4) of v_f (m/s), alpha_f, alpha_r, delta (rad) under EKF covariances P (M, 7, 7)."""
    alpha_f = P[:, BETAF, BETAF] + P[:, DELTA, DELTA] - 2 * P[:, BETAF, DELTA]
    variances = np.column_stack([P[:, VF, VF], alpha_f, P[:, BETAR, BETAR], P[:, DELTA, DELTA]])
    return np.asarray(np.sqrt(np.maximum(variances, 0.0)))
