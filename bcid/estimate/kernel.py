"""The compiled EKF and its Rauch-Tung-Striebel smoother.

Between events mean, covariance and transition matrix are integrated together by RK4:
    x' = f(x),   P' = F P + P F^T + Q,   Phi' = F Phi.
At an event the measured quantities enter one after the other, which for a diagonal R is the joint
update without a matrix inverse.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_inline
from bcid.estimate.process import DELTA, N_MEASURED, N_STATE, Chassis, flow, seen
from bcid.physics.kinematics import wrap
from bcid.physics.steering import steering_step

MAX_STEP_S = 0.02


class Events(NamedTuple):
    """Everything that happens on the time axis, in order; M events."""

    time_s: Floats  # (M,)
    u_s: Floats  # (M,) command from this event on
    z: Floats  # (M, 6) measured quantities, NaN where there is none
    restart: Floats  # (M,) 1 where a new stretch begins: the state is taken from x_0 there
    x_0: Floats  # (M, 7) initial states, used where restart
    P_0: Floats  # (7,) initial variances


class Filtered(NamedTuple):
    """One forward pass."""

    x_prior: Floats  # (M, 7)
    P_prior: Floats  # (M, 7, 7)
    x: Floats  # (M, 7) after the update
    P: Floats  # (M, 7, 7)
    Phi: Floats  # (M, 7, 7) transition from the previous event's x to x_prior
    nis: Floats  # (M,) normalised innovation squared
    dof: Floats  # (M,) how many quantities were measured
    log_likelihood: float


@njit_inline
def _added_products(A: Floats, B: Floats, C: Floats, AB: Floats, AC: Floats) -> None:
    """Adds A B and A C to their places; two thirds of A, the Jacobian of f, are nothing."""
    for i in range(N_STATE):
        for k in range(N_STATE):
            a = A[i, k]
            if a != 0.0:
                for j in range(N_STATE):
                    AB[i, j] += a * B[k, j]
                    AC[i, j] += a * C[k, j]


class Desk(NamedTuple):
    """What a step works on: made once for a whole pass, for making it costs more than the sums."""

    rate: Floats  # (7,)
    A: Floats  # (7, 7) and its products with P and Phi
    AP: Floats
    APhi: Floats
    J: Floats  # (3, 3)
    x_0: Floats  # where a step of RK4 begins
    P_0: Floats
    Phi_0: Floats
    x: Floats  # and where a stage of it is
    P: Floats
    Phi: Floats
    z: Floats  # (6,) what is expected, and its slope
    C: Floats  # (6, 7)
    PC: Floats  # (7,)
    shift: Floats  # (7,)


@njit
def _desk() -> Desk:
    n, square = N_STATE, (N_STATE, N_STATE)
    return Desk(
        np.zeros(n), np.zeros(square), np.zeros(square), np.zeros(square), np.zeros((3, 3)),
        np.zeros(n), np.zeros(square), np.zeros(square), np.zeros(n), np.zeros(square), np.zeros(square),
        np.zeros(N_MEASURED), np.zeros((N_MEASURED, n)), np.zeros(n), np.zeros(n),
    )  # fmt: skip


@njit_inline
def _copy(of: Floats, to: Floats) -> None:
    """Fills `to` (7, 7): an assignment to a slice takes longer."""
    for i in range(N_STATE):
        for j in range(N_STATE):
            to[i, j] = of[i, j]


@njit_inline
def _rk4_step(x: Floats, P: Floats, Phi: Floats, u_s: float, c: Chassis, Q: Floats, step: float, at: Desk) -> None:
    """Mean, covariance and transition one RK4 step of `step` seconds on, in place."""
    _copy(P, at.P_0)
    _copy(Phi, at.Phi_0)
    for i in range(N_STATE):
        at.x_0[i], at.rate[i] = x[i], 0.0
        for j in range(N_STATE):
            at.AP[i, j], at.APhi[i, j] = 0.0, 0.0
    for stage in range(4):
        ahead = 0.0 if stage == 0 else (step if stage == 3 else 0.5 * step)
        weight = step / 6.0 if stage in (0, 3) else step / 3.0
        for i in range(N_STATE):
            at.x[i] = at.x_0[i] + ahead * at.rate[i]
            for j in range(N_STATE):
                at.P[i, j] = at.P_0[i, j] + ahead * (at.AP[i, j] + at.AP[j, i] + Q[i, j])
                at.Phi[i, j] = at.Phi_0[i, j] + ahead * at.APhi[i, j]
        flow(at.x, u_s, c, at.rate, at.A, at.J)
        for i in range(N_STATE):
            for j in range(N_STATE):
                at.AP[i, j], at.APhi[i, j] = 0.0, 0.0
        _added_products(at.A, at.P, at.Phi, at.AP, at.APhi)
        for i in range(N_STATE):
            x[i] += weight * at.rate[i]
            for j in range(N_STATE):
                P[i, j] += weight * (at.AP[i, j] + at.AP[j, i] + Q[i, j])
                Phi[i, j] += weight * at.APhi[i, j]


@njit_inline
def _predict(x: Floats, P: Floats, Phi: Floats, u_s: float, c: Chassis, Q: Floats, dt: float, at: Desk) -> None:
    """Mean, covariance and transition over `dt`, in steps of at most MAX_STEP_S, in place."""
    for i in range(N_STATE):
        for j in range(N_STATE):
            Phi[i, j] = 1.0 if i == j else 0.0
    steps = max(1, math.ceil(dt / MAX_STEP_S - 1e-9))
    for _ in range(steps):
        _rk4_step(x, P, Phi, u_s, c, Q, dt / steps, at)


@njit_inline
def _update(x: Floats, P: Floats, z: Floats, R: Floats, c: Chassis, at: Desk) -> tuple[float, int, float]:
    """Posterior mean and covariance in place; NIS, number of measured quantities, log-likelihood.

    h and H are evaluated once at the prior; `R` (6,) holds the variances.
    """
    seen(x, c, at.z, at.C, at.J)
    for j in range(N_STATE):
        at.shift[j] = 0.0
    nis, dof, log_likelihood = 0.0, 0, 0.0
    for i in range(N_MEASURED):
        if np.isnan(z[i]):
            continue
        residual = z[i] - at.z[i]
        if i == 2:
            residual = wrap(residual)
        S = R[i]
        for j in range(N_STATE):
            at.PC[j] = 0.0
            for k in range(N_STATE):
                at.PC[j] += P[j, k] * at.C[i, k]
            residual -= at.C[i, j] * at.shift[j]
            S += at.C[i, j] * at.PC[j]
        for j in range(N_STATE):
            K = at.PC[j] / S
            at.shift[j] += K * residual
            for k in range(N_STATE):
                P[j, k] -= K * at.PC[k]
        nis += residual * residual / S
        dof += 1
        log_likelihood -= 0.5 * (residual * residual / S + math.log(2.0 * math.pi * S))
    for j in range(N_STATE):
        x[j] += at.shift[j]
        for k in range(j):
            P[j, k] = P[k, j] = 0.5 * (P[j, k] + P[k, j])
    return nis, dof, log_likelihood


@njit
def run_filter(events: Events, c: Chassis, Q: Floats, R: Floats) -> Filtered:
    """The forward pass over all events; `Q` (7, 7) is the noise's spectral density."""
    M = len(events.time_s)
    x_prior, x_post = np.zeros((M, N_STATE)), np.zeros((M, N_STATE))
    P_prior, P_post = np.zeros((M, N_STATE, N_STATE)), np.zeros((M, N_STATE, N_STATE))
    Phis = np.zeros((M, N_STATE, N_STATE))
    nis, dof = np.zeros(M), np.zeros(M)
    total, at = 0.0, _desk()
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
        _copy(P, P_prior[k])
        _copy(Phi, Phis[k])
        for i in range(N_STATE):
            x_prior[k, i] = x[i]
        nis[k], dof[k], log_likelihood = _update(x, P, events.z[k], R, c, at)
        _copy(P, P_post[k])
        for i in range(N_STATE):
            x_post[k, i] = x[i]
        total += log_likelihood
    return Filtered(x_prior, P_prior, x_post, P_post, Phis, nis, dof, total)


@njit_inline
def _solve(A: Floats, X: Floats, L: Floats) -> bool:
    """Turns X into A^-1 X by Cholesky (LAPACK's call costs more than the work); whether A is positive definite."""
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
def run_smoother(filtered: Filtered, restart: Floats) -> tuple[Floats, Floats]:
    """Smoothed means (M, 7) and covariances (M, 7, 7), backwards from each stretch's end."""
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
                if phi != 0.0:  # half of them are nothing
                    for j in range(N_STATE):
                        G[i, j] += phi * P_k[m, j]
        # G becomes the gain's transpose.  Where the rear axle stands and the front one circles it, the slip angles
        # have no direction and P may cease to be a covariance: nothing is carried back over such an event
        if not _solve(prior, G, L):
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
