"""The EKF on filterpy's `ExtendedKalmanFilter`, and a textbook smoother, which the compiled kernel must match.

filterpy's own `predict` is linear and its `rts_smoother` predicts the mean as F x, which is wrong here; so the
prediction is overridden and the smoother written out.
"""

import math

import numpy as np
from filterpy.kalman import ExtendedKalmanFilter

from bcid.aliases import Floats, Ints
from bcid.estimate.blockwise import ForwardPass
from bcid.estimate.filter_step import MAX_STEP_S
from bcid.estimate.kernel import Events, FilterPass
from bcid.estimate.process import DELTA, N_MEASURED, N_STATE, Chassis, F, H, f, h
from bcid.physics.steering import steering_step

# Mean (7,), covariance (7, 7) and transition matrix (7, 7).
_Moments = tuple[Floats, Floats, Floats]


def _predict(x: Floats, P: Floats, u_s: float, c: Chassis, Q: Floats, dt: float) -> _Moments:
    """EKF prediction: mean (7,), covariance and transition matrix (7, 7) after `dt` s, by RK4 in NumPy.

    `u_s` (rad) is the steering command, `Q` (7, 7) the process noise's spectral density.
    """

    def rate(moments: _Moments) -> _Moments:
        x, P, Phi = moments
        A = F(x, u_s, c)
        return f(x, u_s, c), A @ P + P @ A.T + Q, A @ Phi

    def along(m: _Moments, k: _Moments, s: float) -> _Moments:
        return m[0] + s * k[0], m[1] + s * k[1], m[2] + s * k[2]

    moments = (x, P, np.eye(N_STATE))
    steps = max(1, math.ceil(dt / MAX_STEP_S - 1e-9))
    s = dt / steps
    for _ in range(steps):
        k1 = rate(moments)
        k2 = rate(along(moments, k1, s / 2))
        k3 = rate(along(moments, k2, s / 2))
        k4 = rate(along(moments, k3, s))
        for k, weight in ((k1, s / 6), (k2, s / 3), (k3, s / 3), (k4, s / 6)):
            moments = along(moments, k, weight)
    return moments


def run_filter(events: Events, c: Chassis, Q: Floats, R: Floats) -> FilterPass:
    """The EKF's forward pass by the package filterpy, slow, to check the compiled `kernel.run_filter` against.

    `Q` (7, 7) is the process noise's spectral density, `R` (6,) holds the sensors' variances.  A measured yaw is first
    shifted by multiples of 2 pi to within pi of its expectation.
    """
    ekf = ExtendedKalmanFilter(dim_x=N_STATE, dim_z=N_MEASURED)
    rows: list[tuple[Floats, Floats, Floats, Floats, Floats, float, int]] = []
    total = 0.0
    for k in range(len(events.time_s)):
        if events.restart[k]:
            delta, variance = events.x_0[k, DELTA], events.P_0[DELTA]
            if k > 0:
                dt = float(events.time_s[k] - events.time_s[k - 1])
                delta, variance = steering_step(ekf.x[DELTA], events.u_s[k - 1], c.T_s, c.d, dt), ekf.P[DELTA, DELTA]
            ekf.x, ekf.P, Phi = events.x_0[k].copy(), np.diag(events.P_0), np.eye(N_STATE)
            ekf.x[DELTA], ekf.P[DELTA, DELTA] = delta, variance
        else:
            dt = float(events.time_s[k] - events.time_s[k - 1])
            ekf.x, ekf.P, Phi = _predict(ekf.x, ekf.P, float(events.u_s[k - 1]), c, Q, dt)
        prior = ekf.x.copy(), ekf.P.copy()
        here = np.flatnonzero(np.isfinite(events.z[k]))
        nis = 0.0
        if len(here):
            z = events.z[k].copy()
            z[2] -= 2 * math.pi * round((z[2] - ekf.x[2]) / (2 * math.pi)) if 2 in here else 0.0
            ekf.dim_z = len(here)
            ekf.update(z[here], lambda x, i=here: H(x, c)[i], lambda x, i=here: h(x, c)[i], R=np.diag(R[here]))
            nis = float(ekf.y @ np.linalg.solve(ekf.S, ekf.y))
            total -= 0.5 * (nis + np.linalg.slogdet(2 * math.pi * ekf.S)[1])
        rows.append((*prior, ekf.x.copy(), ekf.P.copy(), Phi, nis, len(here)))
    x_prior, P_prior, x, P, Phis, all_nis, dof = (np.array(column, dtype=float) for column in zip(*rows, strict=True))
    return FilterPass(x_prior, P_prior, x, P, Phis, all_nis, dof, float(total))


def run_forward(events: Events, grid: Ints, c: Chassis, Q: Floats, R: Floats) -> ForwardPass:
    """The forward pass by filterpy as one block, in place of the compiled `blockwise.run_forward`."""
    whole = run_filter(events, c, Q, R)
    start = 0, np.zeros(N_STATE), np.zeros((N_STATE, N_STATE))
    return ForwardPass(
        (events, c, Q, R), [start], whole, whole.nis, whole.dof, whole.log_likelihood, whole.x[grid], whole.P[grid]
    )  # fmt: skip


def run_backward(forward: ForwardPass, grid: Ints) -> tuple[Floats, Floats]:
    """Smoothed means (K, 7) and covariances (K, 7, 7) at the events `grid` (K,), by `run_smoother`."""
    x, P = run_smoother(forward.last, forward.task[0].restart)
    return x[grid], P[grid]


def run_smoother(filtered: FilterPass, restart: Floats) -> tuple[Floats, Floats]:
    """Smoothed means (M, 7) and covariances (M, 7, 7) by the textbook Rauch-Tung-Striebel recursion, in NumPy.

    It checks the compiled `kernel.run_smoother`.  `restart` (M,) is 1 at events where the filter began anew; nothing is
    carried back over them.
    """
    x, P = filtered.x.copy(), filtered.P.copy()
    for k in range(len(x) - 2, -1, -1):
        if restart[k + 1]:
            continue
        C = filtered.P[k] @ filtered.Phi[k + 1].T @ np.linalg.inv(filtered.P_prior[k + 1])
        x[k] = filtered.x[k] + C @ (x[k + 1] - filtered.x_prior[k + 1])
        P[k] = filtered.P[k] + C @ (P[k + 1] - filtered.P_prior[k + 1]) @ C.T
    return x, P
