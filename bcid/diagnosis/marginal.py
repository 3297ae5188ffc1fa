"""Initial states and random pushes eliminated: the likelihood of a segment's residual alone.

With z the deviations of the initial state and the pushes of a segment, r = A z + eps, z ~ N(0, Q) and
eps ~ N(0, R), the residual is N(0, S) with S = R + A Q A^T.  R is diagonal, so everything goes through
the small matrix M = Q^-1 + A^T R^-1 A:

    S^-1 = R^-1 - R^-1 A M^-1 A^T R^-1,    log|S| = log|R| + log|Q| + log|M|.

Over segments the residuals follow Student's t with nu degrees of freedom and scale matrix S, so that a
segment that goes badly wrong does not rule the rest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bcid.compiled import njit
from bcid.diagnosis.segments import KNOTS, N_FREE
from bcid.diagnosis.take import Floats, Ints

NU = 8.0
START_SD = (0.05, 0.05, 0.05, 0.3, 0.3, 0.3)  # of the initial states about the estimator's; wide, m, rad, m/s, rad/s


class Scales(NamedTuple):
    """Standard deviations of the noise (m, m, rad) and of the pushes (m/s^2, m/s^2, rad/s^2)."""

    r: Floats  # (3,)
    q: Floats  # (3,)

    def free_variances(self) -> Floats:
        """Of [initial state, pushes] (N_FREE,)."""
        variances: Floats = np.r_[np.array(START_SD) ** 2, np.tile(self.q**2, KNOTS)]
        return variances


class Eliminated(NamedTuple):
    """Per segment: the quadratic forms of S^-1, and the posterior of the free part."""

    chi2: Floats  # (S,) r^T S^-1 r
    log_det: Floats  # (S,)
    numbers: Floats  # (S,) numbers in the segment's residual
    g: Floats  # (S, n) J^T S^-1 r
    G: Floats  # (S, n, n) J^T S^-1 J
    z: Floats  # (S, N_FREE) posterior mean of the free part
    V: Floats  # (S, N_FREE, N_FREE) and its covariance
    rest: Floats  # (S, 3) sum of squares of r - A z per channel
    spread: Floats  # (S, 3) and what the uncertainty of z adds to its expectation


@njit
def eliminate(residual: Floats, A: Floats, J: Floats, first: Ints, r: Floats, variances: Floats) -> Eliminated:
    """All segments' quadratic forms; `residual` (N, 3), `A` (N, 3, N_FREE), `J` (N, 3, n), `r` (3,)."""
    S, n = len(first) - 1, J.shape[2]
    chi2, log_det, count = np.zeros(S), np.zeros(S), np.zeros(S)
    g, G = np.zeros((S, n)), np.zeros((S, n, n))
    zs, Vs, rests, spreads = np.zeros((S, N_FREE)), np.zeros((S, N_FREE, N_FREE)), np.zeros((S, 3)), np.zeros((S, 3))
    weight = 1.0 / (r * r)
    for s in range(S):
        a, b = first[s], first[s + 1]
        m = 3 * (b - a)
        root = np.empty((m, 1))
        for i in range(b - a):
            for c in range(3):
                root[3 * i + c, 0] = math.sqrt(weight[c])
        As = np.ascontiguousarray(A[a:b]).reshape(m, N_FREE) * root
        Js = np.ascontiguousarray(J[a:b]).reshape(m, n) * root
        rs = np.ascontiguousarray(residual[a:b]).reshape(m) * root[:, 0]
        M = np.dot(As.T, As) + np.diag(1.0 / variances)
        V = np.linalg.inv(M)
        Ar, AJ = np.dot(As.T, rs), np.dot(As.T, Js)
        z = np.dot(V, Ar)
        VAJ = np.dot(V, AJ)
        chi2[s] = np.dot(rs, rs) - np.dot(Ar, z)
        log_det[s] = (b - a) * np.sum(np.log(r * r)) + np.sum(np.log(variances)) + np.linalg.slogdet(M)[1]
        count[s] = m
        g[s] = np.dot(Js.T, rs) - np.dot(AJ.T, z)
        G[s] = np.dot(Js.T, Js) - np.dot(AJ.T, VAJ)
        zs[s], Vs[s] = z, V
        rest = rs - np.dot(As, z)
        spread = np.sum(np.dot(As, V) * As, axis=1)
        for i in range(m):
            rests[s, i % 3] += rest[i] * rest[i] / weight[i % 3]
            spreads[s, i % 3] += spread[i] / weight[i % 3]
    return Eliminated(chi2, log_det, count, g, G, zs, Vs, rests, spreads)


def weights(e: Eliminated) -> Floats:
    """Of the segments, (nu + n)/(nu + chi2): Student's t as a mixture of normals."""
    return (NU + e.numbers) / (NU + e.chi2)


def log_likelihood(e: Eliminated) -> Floats:
    """Student's t log-density of each segment's residual (S,)."""
    from scipy.special import gammaln

    half = 0.5 * (NU + e.numbers)
    constant = gammaln(half) - gammaln(0.5 * NU) - 0.5 * e.numbers * math.log(NU * math.pi)
    return np.asarray(constant - 0.5 * e.log_det - half * np.log1p(e.chi2 / NU))


def updated(scales: Scales, e: Eliminated, poses: Ints) -> Scales:
    """One step of EM for the noise and the pushes, each segment with its weight; `poses` (S,) per segment."""
    w = weights(e)
    r2 = (w[:, None] * e.rest + e.spread).sum(axis=0) / poses.sum()
    pushes = e.z[:, 6:].reshape(-1, KNOTS, 3)
    spread = np.einsum("skk->sk", e.V)[:, 6:].reshape(-1, KNOTS, 3)
    q2 = (w[:, None, None] * pushes**2 + spread).mean(axis=(0, 1))
    return Scales(np.sqrt(r2), np.sqrt(np.maximum(q2, 1e-10)))
