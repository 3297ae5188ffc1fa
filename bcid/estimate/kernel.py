"""The compiled EKF and its Rauch-Tung-Striebel smoother.

Between events mean, covariance and transition matrix are integrated together by RK4:
    x' = f(x),   P' = F P + P F^T + Q,   Phi' = F Phi.
At an event the measured quantities enter one after the other, which for a diagonal R is the joint
update without a matrix inverse.
"""

import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_inline
from bcid.estimate.process import DELTA, N_MEASURED, N_STATE, Chassis, fill_measurement, fill_state_rate
from bcid.physics.kinematics import wrap_angle
from bcid.physics.steering import steering_step

# Longest step of the integration (s).
MAX_STEP_S = 0.02


class Events(NamedTuple):
    """Everything that happens on the time axis of a recording, in order; M events."""

    time_s: Floats  # (M,)
    u_s: Floats  # (M,) command from this event on
    z: Floats  # (M, 6) measured quantities, NaN where there is none
    restart: Floats  # (M,) 1 where a new stretch begins: the state is taken from x_0 there
    x_0: Floats  # (M, 7) initial states, used where restart
    P_0: Floats  # (7,) initial variances


class FilterPass(NamedTuple):
    """States, covariances and innovations of one forward pass of the filter over M events."""

    x_prior: Floats  # (M, 7)
    P_prior: Floats  # (M, 7, 7)
    x: Floats  # (M, 7) after the update
    P: Floats  # (M, 7, 7)
    Phi: Floats  # (M, 7, 7) transition from the previous event's x to x_prior
    nis: Floats  # (M,) normalised innovation squared
    dof: Floats  # (M,) how many quantities were measured
    log_likelihood: float


@njit_inline
def _add_products(A: Floats, B: Floats, C: Floats, AB: Floats, AC: Floats) -> None:
    """Add the matrix products A B to `AB` and A C to `AC` in place (all 7x7), skipping the many zeros of A."""
    for i in range(N_STATE):
        for k in range(N_STATE):
            a = A[i, k]
            if a != 0.0:
                for j in range(N_STATE):
                    AB[i, j] += a * B[k, j]
                    AC[i, j] += a * C[k, j]


class Workspace(NamedTuple):
    """Arrays that a step of the filter works on, allocated once for a whole pass: that costs more than the sums."""

    rate: Floats  # (7,)
    A: Floats  # (7, 7) and its products with P and Phi
    AP: Floats
    APhi: Floats
    J: Floats  # (3, 3)
    x_0: Floats  # moments at the start of an RK4 step
    P_0: Floats
    Phi_0: Floats
    x: Floats  # moments at one of its stages
    P: Floats
    Phi: Floats
    z: Floats  # (6,) expected measurements, and their Jacobian
    C: Floats  # (6, 7)
    PC: Floats  # (7,)
    shift: Floats  # (7,)


@njit
def _allocate_workspace() -> Workspace:
    """A new `Workspace`, the scratch arrays of the filter's steps, filled with zeros."""
    n, square = N_STATE, (N_STATE, N_STATE)
    return Workspace(
        np.zeros(n), np.zeros(square), np.zeros(square), np.zeros(square), np.zeros((3, 3)),
        np.zeros(n), np.zeros(square), np.zeros(square), np.zeros(n), np.zeros(square), np.zeros(square),
        np.zeros(N_MEASURED), np.zeros((N_MEASURED, n)), np.zeros(n), np.zeros(n),
    )  # fmt: skip


@njit_inline
def _copy_matrix(source: Floats, target: Floats) -> None:
    """Copy `source` (7, 7) into `target` element by element, which compiles to faster code than a slice assignment."""
    for i in range(N_STATE):
        for j in range(N_STATE):
            target[i, j] = source[i, j]


@njit_inline
def _rk4_step(x: Floats, P: Floats, Phi: Floats, u_s: float, c: Chassis, Q: Floats, step: float, w: Workspace) -> None:
    """Advance mean x (7,), covariance P and transition matrix Phi (7, 7) of the EKF in place by one RK4 step.

    x' = f(x, u_s), P' = F P + P F^T + Q, Phi' = F Phi over `step` seconds, under the steering command `u_s` (rad) and
    the process noise's spectral density `Q` (7, 7); `w` holds scratch arrays.
    """
    _copy_matrix(P, w.P_0)
    _copy_matrix(Phi, w.Phi_0)
    for i in range(N_STATE):
        w.x_0[i], w.rate[i] = x[i], 0.0
        for j in range(N_STATE):
            w.AP[i, j], w.APhi[i, j] = 0.0, 0.0
    for stage in range(4):
        ahead = 0.0 if stage == 0 else (step if stage == 3 else 0.5 * step)
        weight = step / 6.0 if stage in (0, 3) else step / 3.0
        for i in range(N_STATE):
            w.x[i] = w.x_0[i] + ahead * w.rate[i]
            for j in range(N_STATE):
                w.P[i, j] = w.P_0[i, j] + ahead * (w.AP[i, j] + w.AP[j, i] + Q[i, j])
                w.Phi[i, j] = w.Phi_0[i, j] + ahead * w.APhi[i, j]
        fill_state_rate(w.x, u_s, c, w.rate, w.A, w.J)
        for i in range(N_STATE):
            for j in range(N_STATE):
                w.AP[i, j], w.APhi[i, j] = 0.0, 0.0
        _add_products(w.A, w.P, w.Phi, w.AP, w.APhi)
        for i in range(N_STATE):
            x[i] += weight * w.rate[i]
            for j in range(N_STATE):
                P[i, j] += weight * (w.AP[i, j] + w.AP[j, i] + Q[i, j])
                Phi[i, j] += weight * w.APhi[i, j]


@njit_inline
def _predict(x: Floats, P: Floats, Phi: Floats, u_s: float, c: Chassis, Q: Floats, dt: float, w: Workspace) -> None:
    """EKF prediction over `dt` seconds: advance mean x (7,) and covariance P (7, 7) in place, and fill in Phi (7, 7).

    Phi is set to the transition matrix over dt.  RK4 steps are at most MAX_STEP_S long; `u_s` (rad) is the steering
    command, `Q` (7, 7) the process noise's spectral density, and `w` holds scratch arrays.
    """
    for i in range(N_STATE):
        for j in range(N_STATE):
            Phi[i, j] = 1.0 if i == j else 0.0
    steps = max(1, math.ceil(dt / MAX_STEP_S - 1e-9))
    for _ in range(steps):
        _rk4_step(x, P, Phi, u_s, c, Q, dt / steps, w)


@njit_inline
def _update(x: Floats, P: Floats, z: Floats, R: Floats, c: Chassis, w: Workspace) -> tuple[float, int, float]:
    """EKF measurement update of mean x (7,) and covariance P (7, 7) in place by `z` (6,): NIS, count, log-likelihood.

    `z` holds x, y, yaw, steering, yaw rate, wheel speed, NaN where nothing was measured, and `R` (6,) their variances;
    h and H are evaluated once at the prior.  Returns the normalised innovation squared (NIS), the number of quantities
    measured and their log-likelihood; `w` holds scratch arrays.
    """
    fill_measurement(x, c, w.z, w.C, w.J)
    for j in range(N_STATE):
        w.shift[j] = 0.0
    nis, dof, log_likelihood = 0.0, 0, 0.0
    for i in range(N_MEASURED):
        if np.isnan(z[i]):
            continue
        residual = z[i] - w.z[i]
        if i == 2:
            residual = wrap_angle(residual)
        S = R[i]
        for j in range(N_STATE):
            w.PC[j] = 0.0
            for k in range(N_STATE):
                w.PC[j] += P[j, k] * w.C[i, k]
            residual -= w.C[i, j] * w.shift[j]
            S += w.C[i, j] * w.PC[j]
        for j in range(N_STATE):
            K = w.PC[j] / S
            w.shift[j] += K * residual
            for k in range(N_STATE):
                P[j, k] -= K * w.PC[k]
        nis += residual * residual / S
        dof += 1
        log_likelihood -= 0.5 * (residual * residual / S + math.log(2.0 * math.pi * S))
    for j in range(N_STATE):
        x[j] += w.shift[j]
        for k in range(j):
            P[j, k] = P[k, j] = 0.5 * (P[j, k] + P[k, j])
    return nis, dof, log_likelihood


@njit
def run_filter(events: Events, c: Chassis, Q: Floats, R: Floats) -> FilterPass:
    """The EKF's forward pass over M events: states, covariances, innovations and log-likelihood.

    `Q` (7, 7) is the process noise's spectral density, `R` (6,) the variances of x, y, yaw, steering, yaw rate and
    wheel speed.  At events marked `restart` the state begins anew from `events.x_0`, but for the steering angle.
    """
    M = len(events.time_s)
    x_prior, x_post = np.zeros((M, N_STATE)), np.zeros((M, N_STATE))
    P_prior, P_post = np.zeros((M, N_STATE, N_STATE)), np.zeros((M, N_STATE, N_STATE))
    Phis = np.zeros((M, N_STATE, N_STATE))
    nis, dof = np.zeros(M), np.zeros(M)
    total, at = 0.0, _allocate_workspace()
    x, P, Phi = events.x_0[0].copy(), np.diag(events.P_0), np.eye(N_STATE)
    for k in range(M):
        if events.restart[k] > 0.0:
            # the steering knows nothing of a lost pose: delta goes on, the rest starts anew
            delta, variance = events.x_0[k, DELTA], events.P_0[DELTA]
            if k > 0:
                dt = events.time_s[k] - events.time_s[k - 1]
                delta, variance = steering_step(x[DELTA], events.u_s[k - 1], c.T_s, c.d, dt), P[DELTA, DELTA]
            x, P = events.x_0[k].copy(), np.diag(events.P_0)
            x[DELTA], P[DELTA, DELTA] = delta, variance
            Phi = np.eye(N_STATE)
        else:
            _predict(x, P, Phi, events.u_s[k - 1], c, Q, events.time_s[k] - events.time_s[k - 1], at)
        _copy_matrix(P, P_prior[k])
        _copy_matrix(Phi, Phis[k])
        for i in range(N_STATE):
            x_prior[k, i] = x[i]
        nis[k], dof[k], log_likelihood = _update(x, P, events.z[k], R, c, at)
        _copy_matrix(P, P_post[k])
        for i in range(N_STATE):
            x_post[k, i] = x[i]
        total += log_likelihood
    return FilterPass(x_prior, P_prior, x_post, P_post, Phis, nis, dof, total)


@njit_inline
def _solve_by_cholesky(A: Floats, X: Floats, L: Floats) -> bool:
    """Replace X by A^-1 X (7x7), faster than LAPACK's call; false, X unchanged, where A is not positive definite.

    `L` (7, 7) is overwritten by the Cholesky factor of A, with its diagonal inverted.
    """
    for i in range(N_STATE):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j and not s > 0.0:
                return False
            L[i, j] = 1.0 / math.sqrt(s) if i == j else s * L[j, j]  # of the diagonal, the inverse
    for i in range(N_STATE):
        for k in range(i):
            for j in range(N_STATE):
                X[i, j] -= L[i, k] * X[k, j]
        for j in range(N_STATE):
            X[i, j] *= L[i, i]
    for i in range(N_STATE - 1, -1, -1):
        for k in range(i + 1, N_STATE):
            for j in range(N_STATE):
                X[i, j] -= L[k, i] * X[k, j]
        for j in range(N_STATE):
            X[i, j] *= L[i, i]
    return True


@njit
def run_smoother(filtered: FilterPass, restart: Floats) -> tuple[Floats, Floats]:
    """Smoothed means (M, 7) and covariances (M, 7, 7): the Rauch-Tung-Striebel recursion backward over a filter's pass.

    `restart` (M,) is 1 at events where the filter began anew; nothing is carried back over them, nor over events whose
    prior covariance is not positive definite.
    """
    x, P = filtered.x.copy(), filtered.P.copy()
    square = (N_STATE, N_STATE)
    L, G, ahead = np.empty(square), np.empty(square), np.empty(square)  # made once: they cost more than the sums
    for k in range(len(x) - 2, -1, -1):
        if restart[k + 1] > 0.0:
            continue
        Phi, P_k, later, prior = filtered.Phi[k + 1], filtered.P[k], P[k + 1], filtered.P_prior[k + 1]
        for i in range(N_STATE):
            for j in range(N_STATE):
                G[i, j], ahead[i, j] = 0.0, 0.0
            for m in range(N_STATE):
                phi = Phi[i, m]
                if phi != 0.0:  # half of them are zero
                    for j in range(N_STATE):
                        G[i, j] += phi * P_k[m, j]
        # G becomes the gain's transpose.  Where the rear axle stands and the front one circles it, the slip angles
        # have no direction and P may cease to be a covariance: nothing is carried back over such an event
        if not _solve_by_cholesky(prior, G, L):
            continue
        for i in range(N_STATE):
            for m in range(N_STATE):
                gained = later[i, m] - prior[i, m]
                for j in range(N_STATE):
                    ahead[i, j] += gained * G[m, j]
        for i in range(N_STATE):
            for m in range(N_STATE):
                x[k, i] += G[m, i] * (x[k + 1, m] - filtered.x_prior[k + 1, m])
                for j in range(i + 1):
                    P[k, i, j] += G[m, i] * ahead[m, j]
        for i in range(N_STATE):
            for j in range(i):
                P[k, j, i] = P[k, i, j]
    return x, P
