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

from bcid.compiled import njit
from bcid.estimate.process import DELTA, N_MEASURED, N_STATE, Chassis, F, Floats, H, f, h
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


@njit
def rk4_moments(
    x: Floats, P: Floats, Phi: Floats, u_s: float, c: Chassis, Q: Floats, step: float
) -> tuple[Floats, Floats, Floats]:
    """Mean, covariance and transition after one RK4 step of `step` seconds."""
    k_x, k_P, k_Phi = np.zeros(N_STATE), np.zeros((N_STATE, N_STATE)), np.zeros((N_STATE, N_STATE))
    sum_x, sum_P, sum_Phi = k_x.copy(), k_P.copy(), k_Phi.copy()
    for stage in range(4):
        ahead = 0.0 if stage == 0 else (step if stage == 3 else 0.5 * step)
        weight = step / 6.0 if stage in (0, 3) else step / 3.0
        x_s, P_s, Phi_s = x + ahead * k_x, P + ahead * k_P, Phi + ahead * k_Phi
        A = F(x_s, u_s, c)
        AP = np.dot(A, P_s)
        k_x, k_P, k_Phi = f(x_s, u_s, c), AP + AP.T + Q, np.dot(A, Phi_s)
        sum_x += weight * k_x
        sum_P += weight * k_P
        sum_Phi += weight * k_Phi
    return x + sum_x, P + sum_P, Phi + sum_Phi


@njit
def predict(x: Floats, P: Floats, u_s: float, c: Chassis, Q: Floats, dt: float) -> tuple[Floats, Floats, Floats]:
    """Mean, covariance and transition over `dt`, in steps of at most MAX_STEP_S."""
    Phi = np.eye(N_STATE)
    steps = max(1, math.ceil(dt / MAX_STEP_S - 1e-9))
    for _ in range(steps):
        x, P, Phi = rk4_moments(x, P, Phi, u_s, c, Q, dt / steps)
    return x, P, Phi


@njit
def update(x: Floats, P: Floats, z: Floats, R: Floats, c: Chassis) -> tuple[Floats, Floats, float, int, float]:
    """Posterior mean and covariance, NIS, number of measured quantities, log-likelihood.

    h and H are evaluated once at the prior; `R` (6,) holds the variances.
    """
    expected, C = h(x, c), H(x, c)
    shift = np.zeros(N_STATE)
    nis, dof, log_likelihood = 0.0, 0, 0.0
    for i in range(N_MEASURED):
        if np.isnan(z[i]):
            continue
        residual = z[i] - expected[i]
        if i == 2:
            residual = wrap(residual)
        residual -= np.dot(C[i], shift)
        PC = np.dot(P, C[i])
        S = np.dot(C[i], PC) + R[i]
        K = PC / S
        shift = shift + K * residual
        P = P - np.outer(K, PC)
        nis += residual * residual / S
        dof += 1
        log_likelihood -= 0.5 * (residual * residual / S + math.log(2.0 * math.pi * S))
    return x + shift, 0.5 * (P + P.T), nis, dof, log_likelihood


@njit
def run_filter(events: Events, c: Chassis, Q: Floats, R: Floats) -> Filtered:
    """The forward pass over all events; `Q` (7, 7) is the noise's spectral density."""
    M = len(events.time_s)
    x_prior, x_post = np.zeros((M, N_STATE)), np.zeros((M, N_STATE))
    P_prior, P_post = np.zeros((M, N_STATE, N_STATE)), np.zeros((M, N_STATE, N_STATE))
    Phis = np.zeros((M, N_STATE, N_STATE))
    nis, dof = np.zeros(M), np.zeros(M)
    total = 0.0
    x, P = events.x_0[0].copy(), np.diag(events.P_0)
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
            dt = events.time_s[k] - events.time_s[k - 1]
            x, P, Phi = predict(x, P, events.u_s[k - 1], c, Q, dt)
        x_prior[k], P_prior[k], Phis[k] = x, P, Phi
        x, P, nis[k], dof[k], log_likelihood = update(x, P, events.z[k], R, c)
        x_post[k], P_post[k] = x, P
        total += log_likelihood
    return Filtered(x_prior, P_prior, x_post, P_post, Phis, nis, dof, total)


@njit
def run_smoother(filtered: Filtered, restart: Floats) -> tuple[Floats, Floats]:
    """Smoothed means (M, 7) and covariances (M, 7, 7), backwards from each stretch's end."""
    x, P = filtered.x.copy(), filtered.P.copy()
    for k in range(len(x) - 2, -1, -1):
        if restart[k + 1] > 0.0:
            continue
        cross = np.dot(filtered.P[k], filtered.Phi[k + 1].T)
        C = np.linalg.solve(filtered.P_prior[k + 1], cross.T).T
        x[k] = filtered.x[k] + np.dot(C, x[k + 1] - filtered.x_prior[k + 1])
        gained = P[k + 1] - filtered.P_prior[k + 1]
        smoothed = filtered.P[k] + np.dot(np.dot(C, gained), C.T)
        P[k] = 0.5 * (smoothed + smoothed.T)
    return x, P
