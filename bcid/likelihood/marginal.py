"""Initial states and random pushes eliminated: the likelihood of a segment's residual alone.

With x_0 the deviation of the initial state and p the pushes of a segment, z = [x_0, p], the residual is
r = A z + eps, eps ~ N(0, R), p ~ N(0, Q), and x_0 anything at all (a flat prior).  Each push is correlated with the
next (autoregression of first order), as what pushes a car lasts.  R is diagonal, so
everything goes through the small matrix M = A^T R^-1 A + diag(0, Q^-1):

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

import math
from typing import NamedTuple

import numba
import numpy as np

from bcid.aliases import Floats, Ints
from bcid.compiled.njit import njit_parallel
from bcid.errors import PredictionDiverged
from bcid.likelihood.scales import Scales
from bcid.likelihood.take import N_NUISANCE, N_START
from bcid.likelihood.triangles import (
    LEAST_PIVOT,
    cholesky_factor,
    inverse_of_triangle,
    log_determinant,
    solve_triangular,
)

NU = 8.0  # degrees of freedom of Student's t
MAX_ROUNDING = 0.1  # share of nu by which rounding may make a sum of squares negative


class Moments(NamedTuple):
    """Products of the residual r and its derivatives A, for each segment and each of the channels x, y, yaw."""

    AA: Floats  # (S, 3, N_NUISANCE, N_NUISANCE) A^T A
    Ar: Floats  # (S, 3, N_NUISANCE) A^T r
    rr: Floats  # (S, 3) r^T r
    rows: Ints  # (S,) rows of the segment


class MarginalTerms(NamedTuple):
    """Terms of the marginal likelihood of each segment, and the posterior of its nuisance parameters z."""

    chi2: Floats  # (S,) r^T P r
    log_det: Floats  # (S,) log|R| + log|Q| + log|M| - log|A_0^T W A_0|
    numbers: Floats  # (S,) numbers in the segment's residual, less N_START
    z: Floats  # (S, N_NUISANCE) posterior mean
    L: Floats  # (S, N_NUISANCE, N_NUISANCE) the lower triangle of M = L L^T
    root: Floats  # (S, N_NUISANCE, N_NUISANCE) L^-1
    V: Floats  # (S, N_NUISANCE, N_NUISANCE) posterior covariance M^-1
    rest: Floats  # (S, 3) sum of squares of r - A z in each channel
    spread: Floats  # (S, 3) what the uncertainty of z adds to the expectation of `rest`


@njit_parallel
def segment_moments(residual: Floats, A: Floats, first: Ints) -> Moments:
    """Products A^T A, A^T r, r^T r of each segment (rows `first[s]` to `first[s + 1]`) and channel (x, y, yaw).

    The `residual` r (N, 3) is measured less predicted poses; `A` (N, 3, N_NUISANCE) are the derivatives of predicted
    poses by the nuisance parameters: each segment's initial state and pushes (constant disturbances over 0.25 s).
    """
    S = len(first) - 1
    AA, Ar, rr = np.empty((S, 3, N_NUISANCE, N_NUISANCE)), np.empty((S, 3, N_NUISANCE)), np.empty((S, 3))
    for s in numba.prange(S):
        rows = slice(first[s], first[s + 1])
        for c in range(3):
            Ac, rc = np.ascontiguousarray(A[rows, c]), np.ascontiguousarray(residual[rows, c])
            AA[s, c] = np.dot(Ac.T, Ac)
            Ar[s, c] = np.dot(Ac.T, rc)
            rr[s, c] = np.dot(rc, rc)
    return Moments(AA, Ar, rr, first[1:] - first[:-1])


@njit_parallel
def eliminate_nuisance(moments: Moments, r: Floats, precision: Floats) -> MarginalTerms:
    """Marginal likelihood of each segment: chi^2, log-determinant, posterior mean and covariance of its nuisances.

    Nuisance parameters (initial state, pushes: constant disturbances over 0.25 s) are integrated out in closed form,
    the predictions being linear in them (restricted likelihood).  `moments` are the products of `segment_moments`,
    `r` (3,) the noise's standard deviations (m, m, rad), `precision` (N_NUISANCE, N_NUISANCE) that of the prior: 0 for
    initial states.
    """
    S = len(moments.rr)
    chi2, log_det, count = np.empty(S), np.empty(S), np.empty(S)
    zs, Ls = np.empty((S, N_NUISANCE)), np.empty((S, N_NUISANCE, N_NUISANCE))
    roots, Vs = np.empty((S, N_NUISANCE, N_NUISANCE)), np.empty((S, N_NUISANCE, N_NUISANCE))
    rests, spreads = np.empty((S, 3)), np.empty((S, 3))
    constant = -log_determinant(cholesky_factor(np.ascontiguousarray(precision[N_START:, N_START:])))
    for s in numba.prange(S):
        w_x, w_y, w_yaw = 1.0 / (r[0] * r[0]), 1.0 / (r[1] * r[1]), 1.0 / (r[2] * r[2])
        M = w_x * moments.AA[s, 0] + w_y * moments.AA[s, 1] + w_yaw * moments.AA[s, 2]
        b = w_x * moments.Ar[s, 0] + w_y * moments.Ar[s, 1] + w_yaw * moments.Ar[s, 2]
        square = w_x * moments.rr[s, 0] + w_y * moments.rr[s, 1] + w_yaw * moments.rr[s, 2]
        of_start = log_determinant(cholesky_factor(M[:N_START, :N_START] * (r[0] * r[1] * r[2]) ** (2.0 / 3.0)))
        L = cholesky_factor(M + precision)
        root, (y, z) = inverse_of_triangle(L), solve_triangular(L, b)
        V = np.dot(root.T, root)
        chi2[s] = square - np.dot(y, y)
        log_det[s] = moments.rows[s] * 2.0 * np.sum(np.log(r)) + constant + log_determinant(L) - of_start
        count[s] = 3 * moments.rows[s] - N_START
        zs[s], Ls[s], roots[s], Vs[s] = z, L, root, V
        for c in range(3):
            AAz = np.dot(moments.AA[s, c], z)
            rests[s, c] = moments.rr[s, c] - 2.0 * np.dot(z, moments.Ar[s, c]) + np.dot(z, AAz)
            spreads[s, c] = np.sum(moments.AA[s, c] * V)
    return MarginalTerms(chi2, log_det, count, zs, Ls, roots, Vs, rests, spreads)


@njit_parallel
def score_and_information(
    residual: Floats, A: Floats, J: Floats, first: Ints, r: Floats, root: Floats
) -> tuple[Floats, Floats]:
    """Score J^T P r (S, n) and Fisher information J^T P J (S, n, n) of each segment for coefficients of `J` (N, 3, n).

    `J` holds derivatives or changes of predicted poses; P is the inverse covariance of the noise with the nuisance
    parameters (initial state, pushes) projected out.  `residual` (N, 3) is measured less predicted poses, `A` (N, 3,
    N_NUISANCE) the derivatives of predicted poses by nuisance parameters, `root` (S, N_NUISANCE, N_NUISANCE) that of
    their posterior covariance V = root^T root, `r` (3,) the noise's standard deviations (m, m, rad); segment s has
    rows `first[s]` to `first[s + 1]`.
    """
    S, n = len(first) - 1, J.shape[2]
    g, G = np.empty((S, n)), np.empty((S, n, n))
    for s in numba.prange(S):
        m = 3 * (first[s + 1] - first[s])
        weight = np.empty((m, 1))
        for i in range(m):
            weight[i, 0] = 1.0 / r[i % 3]
        As = np.ascontiguousarray(A[first[s] : first[s + 1]]).reshape(m, N_NUISANCE) * weight
        Js = np.ascontiguousarray(J[first[s] : first[s + 1]]).reshape(m, n) * weight
        rs = np.ascontiguousarray(residual[first[s] : first[s + 1]]).reshape(m) * weight[:, 0]
        own, free = np.dot(root[s], np.dot(As.T, Js)), np.dot(root[s], np.dot(As.T, rs))
        g[s] = np.dot(Js.T, rs) - np.dot(own.T, free)
        G[s] = np.dot(Js.T, Js) - np.dot(own.T, own)
    return g, G


def robust_weights(terms: MarginalTerms) -> Floats:
    """Iterative-reweighting weights (nu + n)/(nu + chi^2) (S,) of segments under Student's t.

    nu = NU are the degrees of freedom; chi^2 is a segment's weighted sum of squared residuals, n its count of
    measured numbers less 6 for its initial state.
    """
    return (NU + terms.numbers) / (NU + terms.chi2)


def student_log_densities(terms: MarginalTerms) -> Floats:
    """Marginal log-likelihood (S,) in nats of each segment, by a multivariate Student's t, NU degrees of freedom."""
    from scipy.special import gammaln

    half = 0.5 * (NU + terms.numbers)
    constant = gammaln(half) - gammaln(0.5 * NU) - 0.5 * terms.numbers * math.log(NU * math.pi)
    return np.asarray(constant - 0.5 * terms.log_det - half * np.log1p(terms.chi2 / NU))


def checked_marginal_terms(moments: Moments, scales: Scales) -> MarginalTerms:
    """Marginal likelihood terms (chi^2, log-determinant, posterior) of each segment by `eliminate_nuisance`, checked.

    `scales` are the standard deviations of noise and pushes, `moments` the products of `segment_moments`.

    Raises:
        PredictionDiverged: rounding makes a chi^2 less than -MAX_ROUNDING NU, or predictions answer so strongly that a
            shift of the car is less than rounding; an unstable car can cause both.
    """
    _require_resolved_answers(moments)
    return terms_within_rounding(moments, scales)


def _require_resolved_answers(moments: Moments) -> None:
    """Raise `PredictionDiverged` where an answer to an initial state or a push is so strong that a shift is rounding.

    The squares of poses' answers to a shift are as many as there are rows.
    """
    answers = np.einsum("scii->sci", moments.AA).max(axis=(1, 2))
    if not (answers < moments.rows / LEAST_PIVOT).all():
        raise PredictionDiverged("an answer to an initial state or a push left what rounding resolves")


def terms_within_rounding(moments: Moments, scales: Scales) -> MarginalTerms:
    """The terms of `eliminate_nuisance`; raises `PredictionDiverged` where rounding makes a chi^2 negative."""
    terms = eliminate_nuisance(moments, scales.r, scales.nuisance_precision())
    # an unstable car answers so strongly that a difference of large numbers is lost
    if not (terms.chi2 > -MAX_ROUNDING * NU).all():
        raise PredictionDiverged("a quadratic form was lost in rounding")
    return terms
