"""The compiled EKF over a recording's events, and its Rauch-Tung-Striebel smoother; a step is in `filter_step`."""

import math
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_inline
from bcid.estimate.filter_step import ROW, allocate_workspace, predict, set_moments, store_matrix, update
from bcid.estimate.process import DELTA, N_STATE, Chassis
from bcid.physics.steering import steering_step


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


@njit
def run_filter(events: Events, c: Chassis, Q: Floats, R: Floats) -> FilterPass:
    """The EKF's forward pass over M events: states, covariances, innovations and log-likelihood.

    `Q` (7, 7) is the process noise's spectral density, `R` (6,) the variances of x, y, yaw, steering, yaw rate and
    wheel speed.  At events marked `restart` the state begins anew from `events.x_0`, but for the steering angle.
    """
    return filter_block(events, 0, len(events.time_s), np.zeros(N_STATE), np.zeros((N_STATE, N_STATE)), 0.0, c, Q, R)


@njit
def filter_block(
    events: Events, first: int, end: int, x: Floats, P: Floats, total: float, c: Chassis, Q: Floats, R: Floats
) -> FilterPass:
    """The forward pass over the events from `first` to before `end`, as it is within a pass over all of them.

    `x` (7,) and `P` (7, 7) are mean and covariance after the event before `first`, and `total` is the log-likelihood up
    to there, to which that of the block is added; they are not used where `first` is 0.
    """
    M, n = end - first, N_STATE * N_STATE
    x_prior, x_post, nis, dof = np.empty((M, N_STATE)), np.empty((M, N_STATE)), np.empty(M), np.empty(M)
    # one number more than the matrices need, as `store_matrix` asks
    P_prior, P_post, Phis = np.empty(M * n + 1), np.empty(M * n + 1), np.empty(M * n + 1)
    w = allocate_workspace(Q)
    for i in range(N_STATE):
        w.x[i] = x[i]
        for j in range(N_STATE):
            w.P[i * ROW + j] = P[i, j]
    for k in range(first, end):
        row = k - first
        if events.restart[k] > 0.0:
            # the steering knows nothing of a lost pose: delta goes on, the rest starts anew
            delta, variance = events.x_0[k, DELTA], events.P_0[DELTA]
            if k > 0:
                dt = events.time_s[k] - events.time_s[k - 1]
                delta, variance = steering_step(w.x[DELTA], events.u_s[k - 1], c.T_s, c.d, dt), w.P[DELTA * ROW + DELTA]
            set_moments(w, events.x_0[k], events.P_0)
            w.x[DELTA], w.P[DELTA * ROW + DELTA] = delta, variance
        elif k == 0:
            set_moments(w, events.x_0[0], events.P_0)
        else:
            predict(events.u_s[k - 1], c, events.time_s[k] - events.time_s[k - 1], w)
        store_matrix(w.P, P_prior, row * n)
        store_matrix(w.Phi, Phis, row * n)
        for i in range(N_STATE):
            x_prior[row, i] = w.x[i]
        nis[row], dof[row], log_likelihood = update(events.z[k], R, c, w)
        store_matrix(w.P, P_post, row * n)
        for i in range(N_STATE):
            x_post[row, i] = w.x[i]
        total += log_likelihood
    shape = (M, N_STATE, N_STATE)
    return FilterPass(
        x_prior, P_prior[:-1].reshape(shape), x_post, P_post[:-1].reshape(shape), Phis[:-1].reshape(shape),
        nis, dof, total,
    )  # fmt: skip


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
