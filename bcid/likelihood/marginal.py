"""Initial states and random pushes eliminated: the likelihood of a segment's residual alone.

With x_0 the deviation of the initial state and p the pushes of a segment, z = [x_0, p], the residual is
r = A z + eps, eps ~ N(0, R), p ~ N(0, Q), and x_0 anything at all (a flat prior).  R is diagonal, so everything
goes through the small matrix M = A^T R^-1 A + diag(0, Q^-1):

    P = R^-1 - R^-1 A M^-1 A^T R^-1,
    log density = const - log|R|/2 - log|Q|/2 - log|M|/2 + log|A_0^T W A_0|/2 - r^T P r/2,

A_0 being the columns of A that belong to x_0.  It is the density of what of r is free of x_0 (restricted likelihood;
Harville 1974): without log|A_0^T W A_0| a model that forgets its initial state sooner would be the likelier one for
that alone, by a nat a segment on slow circles.  He gives it for one A_0; between models it holds where all numbers are
measured alike, in units of their noise: W is R^-1 times the geometric mean of the noise's squares (with metres beside
radians tyres seemed to lag on slow circles, for half a nat a segment), and as far as pushes are small beside the noise
while initial states are forgotten.

Over segments the residuals follow Student's t with nu degrees of freedom in place of the normal law, so that a
segment that goes badly wrong does not rule the rest; it has n - 6 dimensions, six being spent on x_0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from bcid.aliases import Floats, Ints
from bcid.compiled.njit import njit, njit_parallel
from bcid.likelihood.take import KNOTS, N_FREE, N_START

NU = 8.0
SMALLEST = 1e-10  # of a variance: what is left of the difference of large numbers may be less than nothing
SETTLED = 1e-3  # relative change of the scales at which EM ends
ROUNDING = 0.1  # of nu, by which a sum of squares may be less than nothing


class Scales(NamedTuple):
    """Standard deviations of the noise (m, m, rad) and of the pushes (m/s^2, m/s^2, rad/s^2)."""

    r: Floats  # (3,)
    q: Floats  # (3,)

    def precisions(self) -> Floats:
        """Of [initial state, pushes] (N_FREE,): nothing is known of the initial state."""
        known = np.zeros(N_FREE)
        known[N_START:].reshape(KNOTS, 3)[:] = self.q**-2.0
        return known


class Moments(NamedTuple):
    """What the scales are found from: per segment and channel, the residual's and A's products."""

    AA: Floats  # (S, 3, N_FREE, N_FREE)
    Ar: Floats  # (S, 3, N_FREE)
    rr: Floats  # (S, 3)
    rows: Ints  # (S,)


class Eliminated(NamedTuple):
    """Per segment: the quadratic form of S^-1, and the posterior of the free part."""

    chi2: Floats  # (S,) r^T P r
    log_det: Floats  # (S,) log|R| + log|Q| + log|M| - log|A_0^T W A_0|
    numbers: Floats  # (S,) numbers in the segment's residual, less N_START
    z: Floats  # (S, N_FREE) posterior mean of the free part
    V: Floats  # (S, N_FREE, N_FREE) and its covariance
    rest: Floats  # (S, 3) sum of squares of r - A z per channel
    spread: Floats  # (S, 3) and what the uncertainty of z adds to its expectation


@njit_parallel
def moments(residual: Floats, A: Floats, first: Ints) -> Moments:
    """Products of `residual` (N, 3) and `A` (N, 3, N_FREE)."""
    S = len(first) - 1
    AA, Ar, rr = np.empty((S, 3, N_FREE, N_FREE)), np.empty((S, 3, N_FREE)), np.empty((S, 3))
    for s in numba.prange(S):
        rows = slice(first[s], first[s + 1])
        for c in range(3):
            Ac, rc = np.ascontiguousarray(A[rows, c]), np.ascontiguousarray(residual[rows, c])
            AA[s, c] = np.dot(Ac.T, Ac)
            Ar[s, c] = np.dot(Ac.T, rc)
            rr[s, c] = np.dot(rc, rc)
    return Moments(AA, Ar, rr, first[1:] - first[:-1])


@njit
def inverted(M: Floats) -> tuple[Floats, float]:
    """M^-1 (n, n) and log|M| by Cholesky's factor L; NaN of what is no positive form, for which LAPACK would raise.

    An exception in a parallel loop would end the process.
    """
    n, log_det = len(M), 0.0
    L, of_L, V = np.zeros((n, n)), np.zeros((n, n)), np.empty((n, n))  # L and its inverse, transposed
    for i in range(n):
        for j in range(i + 1):
            left = M[i, j]
            for k in range(j):
                left -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = left / L[j, j]
            elif 0.0 < left < np.inf:
                L[i, i] = math.sqrt(left)
            else:
                return np.full((n, n), np.nan), np.nan
        log_det += 2.0 * math.log(L[i, i])
        of_L[i, i] = 1.0 / L[i, i]
        for j in range(i):
            left = 0.0
            for k in range(j, i):
                left -= L[i, k] * of_L[j, k]
            of_L[j, i] = left / L[i, i]
    for i in range(n):
        for j in range(i + 1):
            sum_ = 0.0
            for k in range(i, n):
                sum_ += of_L[i, k] * of_L[j, k]
            V[i, j] = V[j, i] = sum_
    return V, log_det


@njit_parallel
def eliminate(of: Moments, r: Floats, precisions: Floats) -> Eliminated:
    """All segments' likelihood terms at noise `r` (3,) and `precisions` (N_FREE,) of the free part."""
    S = len(of.rr)
    chi2, log_det, count = np.empty(S), np.empty(S), np.empty(S)
    zs, Vs, rests, spreads = np.empty((S, N_FREE)), np.empty((S, N_FREE, N_FREE)), np.empty((S, 3)), np.empty((S, 3))
    constant = -np.sum(np.log(precisions[N_START:]))
    for s in numba.prange(S):
        w_x, w_y, w_yaw = 1.0 / (r[0] * r[0]), 1.0 / (r[1] * r[1]), 1.0 / (r[2] * r[2])
        M = w_x * of.AA[s, 0] + w_y * of.AA[s, 1] + w_yaw * of.AA[s, 2]
        b = w_x * of.Ar[s, 0] + w_y * of.Ar[s, 1] + w_yaw * of.Ar[s, 2]
        square = w_x * of.rr[s, 0] + w_y * of.rr[s, 1] + w_yaw * of.rr[s, 2]
        of_start = inverted(M[:N_START, :N_START] * (r[0] * r[1] * r[2]) ** (2.0 / 3.0))[1]
        for i in range(N_FREE):
            M[i, i] += precisions[i]
        V, size = inverted(M)
        z = np.dot(V, b)
        chi2[s] = square - np.dot(b, z)
        log_det[s] = of.rows[s] * 2.0 * np.sum(np.log(r)) + constant + size - of_start
        count[s] = 3 * of.rows[s] - N_START
        zs[s], Vs[s] = z, V
        for c in range(3):
            AAz = np.dot(of.AA[s, c], z)
            rests[s, c] = of.rr[s, c] - 2.0 * np.dot(z, of.Ar[s, c]) + np.dot(z, AAz)
            spreads[s, c] = np.sum(of.AA[s, c] * V)
    return Eliminated(chi2, log_det, count, zs, Vs, rests, spreads)


@njit_parallel
def products(residual: Floats, A: Floats, J: Floats, first: Ints, r: Floats, V: Floats) -> tuple[Floats, Floats]:
    """J^T P r (S, n) and J^T P J (S, n, n) of the columns `J` (N, 3, n), `V` as `eliminate` gives it."""
    S, n = len(first) - 1, J.shape[2]
    g, G = np.empty((S, n)), np.empty((S, n, n))
    for s in numba.prange(S):
        m = 3 * (first[s + 1] - first[s])
        weight = np.empty((m, 1))
        for i in range(m):
            weight[i, 0] = 1.0 / r[i % 3]
        As = np.ascontiguousarray(A[first[s] : first[s + 1]]).reshape(m, N_FREE) * weight
        Js = np.ascontiguousarray(J[first[s] : first[s + 1]]).reshape(m, n) * weight
        rs = np.ascontiguousarray(residual[first[s] : first[s + 1]]).reshape(m) * weight[:, 0]
        AJ = np.dot(As.T, Js)
        VAJ = np.dot(V[s], AJ)
        g[s] = np.dot(Js.T, rs) - np.dot(VAJ.T, np.dot(As.T, rs))
        G[s] = np.dot(Js.T, Js) - np.dot(AJ.T, VAJ)
    return g, G


def weights(e: Eliminated) -> Floats:
    """Of the segments, (nu + n)/(nu + chi2): Student's t as a mixture of normals."""
    return (NU + e.numbers) / (NU + e.chi2)


def log_likelihood(e: Eliminated) -> Floats:
    """Student's t log-density of each segment's residual (S,)."""
    from scipy.special import gammaln

    half = 0.5 * (NU + e.numbers)
    constant = gammaln(half) - gammaln(0.5 * NU) - 0.5 * e.numbers * math.log(NU * math.pi)
    return np.asarray(constant - 0.5 * e.log_det - half * np.log1p(e.chi2 / NU))


def updated(e: Eliminated, rows: Ints) -> Scales:
    """One step of EM for the noise and the pushes; `rows` (S,) per segment.

    Each segment's squares count with its weight, the posterior's spread without: were it weighted as well,
    the scales would drift, and every null take would gain by it.  Division by the mean weight, which is 1 where
    EM ends, takes it there in a few steps (parameter-expanded EM; Meng and van Dyk 1997).
    """
    w = weights(e)
    r2 = (w[:, None] * e.rest + e.spread).sum(axis=0) / rows.sum()
    pushes = e.z[:, N_START:].reshape(-1, KNOTS, 3)
    spread = np.einsum("skk->sk", e.V)[:, N_START:].reshape(-1, KNOTS, 3)
    q2 = (w[:, None, None] * pushes**2 + spread).mean(axis=(0, 1))
    return Scales(np.sqrt(np.maximum(r2 / w.mean(), SMALLEST)), np.sqrt(np.maximum(q2 / w.mean(), SMALLEST)))


def eliminated(of: Moments, scales: Scales) -> Eliminated:
    """The likelihood's terms.

    Raises:
        FloatingPointError: where they are lost in rounding.
    """
    e = eliminate(of, scales.r, scales.precisions())
    if not (e.chi2 > -ROUNDING * NU).all():  # an unstable car answers so strongly that the difference is lost
        raise FloatingPointError("a quadratic form was lost in rounding")
    return e


def rescaled(of: Moments, scales: Scales, steps: int) -> tuple[Scales, Eliminated]:
    """The scales after at most `steps` of EM, and the likelihood's terms there.

    Raises:
        FloatingPointError: where a prediction or a scale is not finite, or is lost in rounding.
    """
    if not (np.isfinite(of.rr).all() and np.isfinite(of.AA).all()):
        raise FloatingPointError("a prediction left the finite numbers")
    e = eliminated(of, scales)
    for _ in range(steps):
        before, scales = scales, updated(e, of.rows)
        if not np.isfinite([*scales.r, *scales.q]).all():
            raise FloatingPointError("the noise left the finite numbers")
        e = eliminated(of, scales)
        if np.allclose(np.r_[before.r, before.q], np.r_[scales.r, scales.q], rtol=SETTLED, atol=0.0):
            break
    return scales, e
