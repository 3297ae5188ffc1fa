"""One step of the compiled EKF: prediction between two events, and update by what is measured at one.

Between events mean, covariance and transition matrix are integrated together by RK4:
    x' = f(x),   P' = F P + P F^T + Q,   Phi' = F Phi.
At an event the measured quantities enter one after the other, which for a diagonal R is the joint update without a
matrix inverse.

A row of a matrix stands in memory as eight numbers, the last of which is always zero, whole vectors of LANES numbers:
the processor computes these at once, and of F only those elements are multiplied that are not always zero.
"""

import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.lane_access import load_lanes, store_lanes
from bcid.compiled.lanes import LANES, multiply_add
from bcid.compiled.njit import njit, njit_inline
from bcid.estimate.process import (
    BETAF,
    BETAR,
    DELTA,
    N_MEASURED,
    N_STATE,
    PX,
    PY,
    THETA,
    VF,
    Chassis,
    fill_measurement,
    fill_state_rate,
)  # fmt: skip
from bcid.physics.kinematics import wrap_angle

# Longest step of the integration (s).
MAX_STEP_S = 0.02
# Numbers of a row in memory, and of a matrix.
ROW = 8
SIZE = N_STATE * ROW
# Measured quantities that are elements of the state, and their places there: x, y, yaw, steering.  An array: the index
# of a tuple is checked, and since that may raise, references to every array are counted at each event, for half as
# long again as the sums take.
PLACES = np.array([PX, PY, THETA, DELTA])


class Workspace(NamedTuple):
    """What a step of the filter works on, allocated once for a whole pass: that costs more than the sums."""

    x: Floats  # (7,) mean
    P: Floats  # (56,) covariance, by rows of 8
    Phi: Floats  # (56,) transition matrix since the last event
    Q: Floats  # (56,) spectral density of the process noise
    # moments at one of an RK4 step's stages, and their rates
    x_at: Floats
    P_at: Floats
    Phi_at: Floats
    x_rate: Floats
    P_rate: Floats
    Phi_rate: Floats
    # moments at the end of the step, as far as they are summed up
    x_next: Floats
    P_next: Floats
    Phi_next: Floats
    A: Floats  # (7, 7) F at the stage, and its product with P (56,)
    AP: Floats
    J: Floats  # (3, 3)
    z: Floats  # (6,) expected measurements, and their Jacobian (6, 7)
    C: Floats
    PC: Floats  # (8,)
    shift: Floats  # (8,)


@njit
def allocate_workspace(Q: Floats) -> Workspace:
    """A new `Workspace` for the process noise `Q` (7, 7), all else filled with zeros."""
    n = N_STATE
    w = Workspace(
        np.zeros(n), np.zeros(SIZE), np.zeros(SIZE), np.zeros(SIZE),
        np.zeros(n), np.zeros(SIZE), np.zeros(SIZE), np.zeros(n), np.zeros(SIZE), np.zeros(SIZE),
        np.zeros(n), np.zeros(SIZE), np.zeros(SIZE),
        np.zeros((n, n)), np.zeros(SIZE), np.zeros((3, 3)),
        np.zeros(N_MEASURED), np.zeros((N_MEASURED, n)), np.zeros(ROW), np.zeros(ROW),
    )  # fmt: skip
    for i in range(n):
        for j in range(n):
            w.Q[i * ROW + j] = Q[i, j]
    return w


@njit
def set_moments(w: Workspace, x: Floats, variances: Floats) -> None:
    """Begin anew at the mean `x` (7,) with uncorrelated `variances` (7,), and the transition matrix 1."""
    w.P[:], w.Phi[:] = 0.0, 0.0
    for i in range(N_STATE):
        w.x[i], w.P[i * ROW + i], w.Phi[i * ROW + i] = x[i], variances[i], 1.0


@njit_inline
def store_matrix(M: Floats, target: Floats, at: int) -> None:
    """Write `M` (56,), rows of 8, to `target` from place `at` on as rows of 7; the number behind it becomes zero."""
    for i in range(N_STATE):
        # the row's zero is overwritten by the next row
        for part in range(0, ROW, LANES):
            store_lanes(load_lanes(M, i * ROW + part), target, at + i * N_STATE + part)


@njit_inline
def _multiply_by_jacobian(A: Floats, B: Floats, AB: Floats) -> None:
    """Write the product of F in `A` (7, 7) and `B` (56,) to `AB` (56,), whose row VF is zero and stays so."""
    for at in range(0, ROW, LANES):
        theta, v_f, beta_f = (
            load_lanes(B, THETA * ROW + at), load_lanes(B, VF * ROW + at), load_lanes(B, BETAF * ROW + at)
        )  # fmt: skip
        beta_r, delta = load_lanes(B, BETAR * ROW + at), load_lanes(B, DELTA * ROW + at)
        for i in (PX, PY):
            wheels = multiply_add(beta_r, A[i, BETAR], multiply_add(beta_f, A[i, BETAF], v_f * A[i, VF]))
            store_lanes(multiply_add(theta, A[i, THETA], wheels), AB, i * ROW + at)
        turning = multiply_add(beta_r, A[THETA, BETAR], multiply_add(beta_f, A[THETA, BETAF], v_f * A[THETA, VF]))
        store_lanes(turning, AB, THETA * ROW + at)
        pulled = multiply_add(delta, A[BETAF, DELTA], multiply_add(beta_f, A[BETAF, BETAF], v_f * A[BETAF, VF]))
        store_lanes(pulled, AB, BETAF * ROW + at)
        store_lanes(multiply_add(beta_r, A[BETAR, BETAR], v_f * A[BETAR, VF]), AB, BETAR * ROW + at)
        store_lanes(delta * A[DELTA, DELTA], AB, DELTA * ROW + at)


@njit_inline
def _fill_rates(x: Floats, P: Floats, Phi: Floats, u_s: float, c: Chassis, w: Workspace) -> None:
    """Fill in the rates of mean `x`, covariance `P` and transition matrix `Phi` under the command `u_s` (rad)."""
    fill_state_rate(x, u_s, c, w.x_rate, w.A, w.J)
    _multiply_by_jacobian(w.A, P, w.AP)
    _multiply_by_jacobian(w.A, Phi, w.Phi_rate)
    for i in range(N_STATE):
        for j in range(i + 1):
            rate = w.AP[i * ROW + j] + w.AP[j * ROW + i] + w.Q[i * ROW + j]
            w.P_rate[i * ROW + j] = w.P_rate[j * ROW + i] = rate


@njit_inline
def _copy_moments(x: Floats, P: Floats, Phi: Floats, x_to: Floats, P_to: Floats, Phi_to: Floats) -> None:
    """Copy mean (7,), covariance and transition matrix (56,), element by element: a slice assignment takes longer."""
    for i in range(N_STATE):
        x_to[i] = x[i]
    for at in range(0, SIZE, LANES):
        store_lanes(load_lanes(P, at), P_to, at)
        store_lanes(load_lanes(Phi, at), Phi_to, at)


@njit_inline
def _rk4_step(u_s: float, c: Chassis, step: float, w: Workspace) -> None:
    """Advance mean, covariance and transition matrix of `w` by one RK4 step of `step` seconds.

    x' = f(x, u_s), P' = F P + P F^T + Q, Phi' = F Phi, under the steering command `u_s` (rad).
    """
    _copy_moments(w.x, w.P, w.Phi, w.x_at, w.P_at, w.Phi_at)
    _copy_moments(w.x, w.P, w.Phi, w.x_next, w.P_next, w.Phi_next)
    for stage in range(4):
        _fill_rates(w.x_at, w.P_at, w.Phi_at, u_s, c, w)
        weight = step * (1.0 / 6.0) if stage in (0, 3) else step * (1.0 / 3.0)
        ahead = step if stage == 2 else 0.5 * step
        for i in range(N_STATE):
            w.x_next[i] += weight * w.x_rate[i]
            w.x_at[i] = w.x[i] + ahead * w.x_rate[i]
        for at in range(0, SIZE, LANES):
            P_rate, Phi_rate = load_lanes(w.P_rate, at), load_lanes(w.Phi_rate, at)
            store_lanes(multiply_add(P_rate, weight, load_lanes(w.P_next, at)), w.P_next, at)
            store_lanes(multiply_add(Phi_rate, weight, load_lanes(w.Phi_next, at)), w.Phi_next, at)
            store_lanes(multiply_add(P_rate, ahead, load_lanes(w.P, at)), w.P_at, at)
            store_lanes(multiply_add(Phi_rate, ahead, load_lanes(w.Phi, at)), w.Phi_at, at)
    _copy_moments(w.x_next, w.P_next, w.Phi_next, w.x, w.P, w.Phi)


@njit_inline
def predict(u_s: float, c: Chassis, dt: float, w: Workspace) -> None:
    """Predict the moments in `w` over `dt` seconds, its transition matrix anew, under the steering command `u_s` (rad).

    RK4 steps are at most MAX_STEP_S long.
    """
    for i in range(SIZE):
        w.Phi[i] = 0.0
    for i in range(N_STATE):
        w.Phi[i * ROW + i] = 1.0
    steps = max(1, math.ceil(dt / MAX_STEP_S - 1e-9))
    for _ in range(steps):
        _rk4_step(u_s, c, dt / steps, w)


@njit_inline
def update(z: Floats, R: Floats, c: Chassis, w: Workspace) -> tuple[float, int, float]:
    """Update mean and covariance in `w` by the measurements `z` (6,): NIS, their count, log-likelihood.

    `z` holds x, y, yaw, steering, yaw rate, wheel speed, NaN where nothing was measured, and `R` (6,) their variances;
    h and H are evaluated once at the prior.  Returns the normalised innovation squared (NIS), the number of quantities
    measured and their log-likelihood.
    """
    if not (np.isnan(z[4]) and np.isnan(z[5])):
        fill_measurement(w.x, c, w.z, w.C, w.J)
    for j in range(ROW):
        w.shift[j] = 0.0
    nis, dof, determinant = 0.0, 0, 1.0
    for i in range(N_MEASURED):
        if np.isnan(z[i]):
            continue
        if i < len(PLACES):
            place = PLACES[i]
            residual, S = z[i] - w.x[place] - w.shift[place], R[i] + w.P[place * ROW + place]
            if i == 2 and abs(z[i] - w.x[place]) > math.pi:
                residual = wrap_angle(z[i] - w.x[place]) - w.shift[place]
            for at in range(0, ROW, LANES):
                store_lanes(load_lanes(w.P, place * ROW + at), w.PC, at)
        else:
            residual, S = z[i] - w.z[i], R[i]
            for j in range(N_STATE):
                w.PC[j] = 0.0
                for k in range(VF, N_STATE):
                    w.PC[j] += w.P[j * ROW + k] * w.C[i, k]
            for j in range(N_STATE):
                residual -= w.C[i, j] * w.shift[j]
                S += w.C[i, j] * w.PC[j]
        inverse_S = 1.0 / S
        for at in range(0, ROW, LANES):
            PC = load_lanes(w.PC, at)
            store_lanes(multiply_add(PC, inverse_S * residual, load_lanes(w.shift, at)), w.shift, at)
            for j in range(N_STATE):
                row = load_lanes(w.P, j * ROW + at)
                store_lanes(multiply_add(PC, -inverse_S * w.PC[j], row), w.P, j * ROW + at)
        nis += residual * residual * inverse_S
        dof += 1
        determinant *= 2.0 * math.pi * S
    for j in range(N_STATE):
        w.x[j] += w.shift[j]
        for k in range(j):
            w.P[j * ROW + k] = w.P[k * ROW + j] = 0.5 * (w.P[j * ROW + k] + w.P[k * ROW + j])
    return nis, dof, -0.5 * (nis + math.log(determinant))
