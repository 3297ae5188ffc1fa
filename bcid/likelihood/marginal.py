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

import math
from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np

from bcid.aliases import Floats, Ints
from bcid.compiled.njit import njit, njit_parallel
from bcid.errors import PredictionDiverged
from bcid.likelihood.divergence import require_finite
from bcid.likelihood.take import KNOTS, N_NUISANCE, N_START

NU = 8.0  # degrees of freedom of Student's t
MIN_VARIANCE = 1e-10  # what is left of a difference of large numbers may be negative
EM_STEPS_BEFORE_LEAPS = 2  # of a call that is to take so many, none is a leap
EM_TOLERANCE = 1e-3  # relative change of the scales at which EM ends
# share of its diagonal below which a pivot is rounding: some hundred times the smallest difference of numbers
LEAST_PIVOT = 1e-13
MOST_UNSHOWN = 3  # numbers of a segment that poses need not show: its twist; where the car is they always show
PERSISTENCES = np.arange(0.0, 0.96, 0.005)  # correlations of neighbouring pushes that are tried
MAX_ROUNDING = 0.1  # share of nu by which rounding may make a sum of squares negative


class Scales(NamedTuple):
    """Standard deviations of the noise (m, m, rad) and of the pushes (m/s^2, m/s^2, rad/s^2), and how these persist.

    The pushes of a segment are a stationary autoregression: p_k+1 = rho p_k + sqrt(1 - rho^2) q N(0, 1), since what
    pushes a car, such as a rough floor, lasts for longer than an instant.
    """

    r: Floats  # (3,)
    q: Floats  # (3,)
    rho: Floats = np.zeros(3)  # correlation of a push with the next one, 0.125 s later

    def nuisance_precision(self) -> Floats:
        """Prior precision (N_NUISANCE, N_NUISANCE) of [initial state, pushes]: zero for the initial state."""
        known = np.zeros((N_NUISANCE, N_NUISANCE))
        pushes = known[N_START:, N_START:].reshape(KNOTS, 3, KNOTS, 3)
        for c in range(3):
            pushes[:, c, :, c] = autoregressive_precision(self.rho[c]) / self.q[c] ** 2
        return known


def autoregressive_precision(rho: float) -> Floats:
    """Inverse (KNOTS, KNOTS) of the correlation rho^|i - j| of an autoregression."""
    inner = np.diag([1.0, *np.full(KNOTS - 2, 1.0 + rho**2), 1.0])
    beside = np.eye(KNOTS, k=1) + np.eye(KNOTS, k=-1)
    return np.asarray((inner - rho * beside) / (1.0 - rho**2))


UNLIMITED = Scales(np.full(3, math.inf), np.full(3, math.inf))


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
    root: Floats  # (S, N_NUISANCE, N_NUISANCE) L^-1 of M = L L^T
    V: Floats  # (S, N_NUISANCE, N_NUISANCE) posterior covariance M^-1
    rest: Floats  # (S, 3) sum of squares of r - A z in each channel
    spread: Floats  # (S, 3) what the uncertainty of z adds to the expectation of `rest`


@njit_parallel
def segment_moments(residual: Floats, A: Floats, first: Ints) -> Moments:
    """Products A^T A, A^T r, r^T r of each segment (rows `first[s]` to `first[s + 1]`) and channel (x, y, yaw).

    The `residual` r (N, 3) is measured less predicted poses; `A` (N, 3, N_NUISANCE) are the derivatives of predicted
    poses by the nuisance parameters: each segment's initial state and pushes (constant disturbances over 0.125 s).
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


@njit
def cholesky_factor(M: Floats) -> Floats:
    """The lower triangular L (n, n) with L L^T = M, a symmetric matrix; NaN where M is not positive semidefinite.

    A pivot that rounding alone decides counts as LEAST_PIVOT of its diagonal, MOST_UNSHOWN times at most: a part of an
    initial state that poses do not show at all (a side slip that is gone before the first of them leaves a shift) is
    then hardly known, instead of nothing being known of the segment.  Written out because LAPACK would raise where M is
    indefinite, and an exception in a parallel loop ends the process.
    """
    n = len(M)
    L, unshown = np.zeros((n, n)), 0
    for i in range(n):
        for j in range(i + 1):
            left = M[i, j]
            for k in range(j):
                left -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = left / L[j, j]
                continue
            unshown += 1 if left < LEAST_PIVOT * M[i, i] else 0
            if -LEAST_PIVOT * M[i, i] < left < np.inf and M[i, i] > 0.0 and unshown <= MOST_UNSHOWN:
                L[i, i] = math.sqrt(max(left, LEAST_PIVOT * M[i, i]))
            else:
                return np.full((n, n), np.nan)
    return L


@njit
def log_determinant(L: Floats) -> float:
    """log|L L^T| of a lower triangular `L` with a positive diagonal."""
    total = 0.0
    for i in range(len(L)):
        total += 2.0 * math.log(L[i, i])
    return total


@njit
def inverse_of_triangle(L: Floats) -> Floats:
    """The inverse (n, n) of a lower triangular `L` (n, n), which is one, too."""
    n = len(L)
    inverse = np.zeros((n, n))
    for i in range(n):
        inverse[i, i] = 1.0 / L[i, i]
        for j in range(i):
            left = 0.0
            for k in range(j, i):
                left -= L[i, k] * inverse[k, j]
            inverse[i, j] = left / L[i, i]
    return inverse


@njit
def solve_triangular(L: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Solutions y = L^-1 b and z = L^-T y (n,), of a lower triangular `L` (n, n); y . y is b . (L L^T)^-1 b.

    Where a part of an initial state is hardly shown, as where a car stands, L L^T is almost singular, and b . z would
    be lost in rounding; y . y is not.
    """
    n = len(b)
    y, z = np.empty(n), np.empty(n)
    for i in range(n):
        left = b[i]
        for k in range(i):
            left -= L[i, k] * y[k]
        y[i] = left / L[i, i]
    for i in range(n - 1, -1, -1):
        left = y[i]
        for k in range(i + 1, n):
            left -= L[k, i] * z[k]
        z[i] = left / L[i, i]
    return y, z


@njit_parallel
def eliminate_nuisance(moments: Moments, r: Floats, precision: Floats) -> MarginalTerms:
    """Marginal likelihood of each segment: chi^2, log-determinant, posterior mean and covariance of its nuisances.

    Nuisance parameters (initial state, pushes: constant disturbances over 0.125 s) are integrated out in closed form,
    the predictions being linear in them (restricted likelihood).  `moments` are the products of `segment_moments`,
    `r` (3,) the noise's standard deviations (m, m, rad), `precision` (N_NUISANCE, N_NUISANCE) the prior
    precision, the inverse of a covariance: 0 for initial states.
    """
    S = len(moments.rr)
    chi2, log_det, count = np.empty(S), np.empty(S), np.empty(S)
    zs, roots = np.empty((S, N_NUISANCE)), np.empty((S, N_NUISANCE, N_NUISANCE))
    Vs = np.empty((S, N_NUISANCE, N_NUISANCE))
    rests, spreads = np.empty((S, 3)), np.empty((S, 3))
    constant = -log_determinant(cholesky_factor(precision[N_START:, N_START:]))
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
        zs[s], roots[s], Vs[s] = z, root, V
        for c in range(3):
            AAz = np.dot(moments.AA[s, c], z)
            rests[s, c] = moments.rr[s, c] - 2.0 * np.dot(z, moments.Ar[s, c]) + np.dot(z, AAz)
            spreads[s, c] = np.sum(moments.AA[s, c] * V)
    return MarginalTerms(chi2, log_det, count, zs, roots, Vs, rests, spreads)


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


def em_update(terms: MarginalTerms, rows: Ints, rho: Floats, most: Scales = UNLIMITED) -> Scales:
    """Scales after one step of expectation maximisation (EM) from likelihood `terms`, where pushes persisted by `rho`.

    `rows` (S,) counts the mean poses of each segment; scales are `most` at most.  Squared residuals and pushes are
    multiplied by the segment's robust weight, posterior variances are not: that would bias the scales, and raise the
    likelihood where nothing is missing.  Variances are divided by the mean weight to converge in fewer steps
    (parameter-expanded EM; Meng and van Dyk 1997).
    """
    w = robust_weights(terms)
    r2 = (w[:, None] * terms.rest + terms.spread).sum(axis=0) / rows.sum()
    pushes = terms.z[:, N_START:].reshape(-1, KNOTS, 3)
    V = terms.V[:, N_START:, N_START:].reshape(-1, KNOTS, 3, KNOTS, 3)
    products = np.einsum("s,sic,sjc->cij", w, pushes, pushes) + np.einsum("sicjc->cij", V)
    products /= len(pushes) * w.mean()
    r2 /= w.mean()
    q2 = np.array([np.sum(autoregressive_precision(rho[c]) * products[c]) / KNOTS for c in range(3)])
    r, q = (np.sqrt(np.maximum(square, MIN_VARIANCE)) for square in (r2, q2))
    rho = np.array([_likeliest_persistence(products[c] / q[c] ** 2) for c in range(3)])
    return Scales(np.minimum(r, most.r), np.minimum(q, most.q), rho)


def _likeliest_persistence(products: Floats) -> float:
    """The rho in the range of PERSISTENCES that makes pushes over their standard deviation likeliest.

    `products` (KNOTS, KNOTS) are means over segments.

    Of an autoregression the log-likelihood is -(K - 1)/2 log(1 - rho^2) - (a - 2 rho b + rho^2 c)/(2 (1 - rho^2)), with
    a the sum of all squares, b of products of neighbours, c of the squares of those with two neighbours.
    """
    a, b, c = np.trace(products), np.trace(products, offset=1), np.trace(products[1:-1, 1:-1])
    free = 1.0 - PERSISTENCES**2
    nats = -0.5 * (KNOTS - 1) * np.log(free) - 0.5 * (a - 2.0 * PERSISTENCES * b + PERSISTENCES**2 * c) / free
    best = int(np.argmax(nats))
    if best in (0, len(nats) - 1):
        return float(PERSISTENCES[best])
    # the vertex of the parabola through three neighbours, as a likelihood that moves by steps has no slope
    before, there, after = nats[best - 1 : best + 2]
    step = PERSISTENCES[1] - PERSISTENCES[0]
    return float(PERSISTENCES[best] + 0.5 * step * (before - after) / (before - 2.0 * there + after))


def checked_marginal_terms(moments: Moments, scales: Scales) -> MarginalTerms:
    """Marginal likelihood terms (chi^2, log-determinant, posterior) of each segment by `eliminate_nuisance`, checked.

    `scales` are the standard deviations of noise and pushes, `moments` the products of `segment_moments`.

    Raises:
        PredictionDiverged: rounding makes a chi^2 less than -MAX_ROUNDING NU, or predictions answer so strongly that a
            shift of the car is less than rounding; an unstable car can cause both.
    """
    _require_resolved_answers(moments)
    return _terms_within_rounding(moments, scales)


def _require_resolved_answers(moments: Moments) -> None:
    """Raise `PredictionDiverged` where an answer to an initial state or a push is so strong that a shift is rounding.

    The squares of poses' answers to a shift are as many as there are rows.
    """
    answers = np.einsum("scii->sci", moments.AA).max(axis=(1, 2))
    if not (answers < moments.rows / LEAST_PIVOT).all():
        raise PredictionDiverged("an answer to an initial state or a push left what rounding resolves")


def _terms_within_rounding(moments: Moments, scales: Scales) -> MarginalTerms:
    """The terms of `eliminate_nuisance`; raises `PredictionDiverged` where rounding makes a chi^2 negative."""
    terms = eliminate_nuisance(moments, scales.r, scales.nuisance_precision())
    # an unstable car answers so strongly that a difference of large numbers is lost
    if not (terms.chi2 > -MAX_ROUNDING * NU).all():
        raise PredictionDiverged("a quadratic form was lost in rounding")
    return terms


def estimate_scales(
    moments: Moments, scales: Scales, steps: int, most: Scales = UNLIMITED
) -> tuple[Scales, MarginalTerms]:
    """Maximum-likelihood scales of noise and pushes, and the segments' marginal likelihood terms there.

    Expectation maximisation (EM) takes at most `steps` from `scales`, and ends where they change by less than the
    relative EM_TOLERANCE; `steps` = 0 only evaluates.  After every second step it leaps to where the last two lead
    (SQUAREM; Varadhan and Roland 2008), if that is likelier: pushes that poses hardly show it would take hundreds of
    steps to size.  Scales are `most` at most.  `moments` are the segments' products of residuals and derivatives by
    nuisances (`segment_moments`).

    Raises:
        PredictionDiverged: where a prediction or a scale is not finite, or rounding makes a chi^2 negative.
    """
    require_finite("a prediction", moments.rr, moments.AA)
    terms, path = checked_marginal_terms(moments, scales), [scales]
    for _ in range(steps):
        scales = em_update(terms, moments.rows, scales.rho, most)
        require_finite("the noise", scales.r, scales.q)
        terms = _terms_within_rounding(moments, scales)
        if np.allclose(_as_vector(path[-1]), _as_vector(scales), rtol=0.0, atol=EM_TOLERANCE):
            break
        path.append(scales)
        if len(path) > 2 and len(path) % 2 and steps > EM_STEPS_BEFORE_LEAPS:
            scales, terms = _leap(path[-3:], terms, moments, most)
            path = [scales]
    return scales, terms


def _leap(path: Sequence[Scales], terms: MarginalTerms, moments: Moments, most: Scales) -> tuple[Scales, MarginalTerms]:
    """The scales to which two steps of EM along a `path` lead, and the terms there; its end where that is likelier."""
    before, between, end = (_as_vector(scales) for scales in path)
    step, bend = between - before, end - 2.0 * between + before
    length = -max(float(np.linalg.norm(step) / max(np.linalg.norm(bend), 1e-12)), 1.0)
    ahead = _from_vector(before - 2.0 * length * step + length**2 * bend, most)
    try:
        there = _terms_within_rounding(moments, ahead)
    except PredictionDiverged:
        return path[-1], terms
    likelier = student_log_densities(there).sum() > student_log_densities(terms).sum()
    return (ahead, there) if likelier else (path[-1], terms)


def _as_vector(scales: Scales) -> Floats:
    """Scales as (9,) numbers of alike size: logarithms of standard deviations, and rho."""
    return np.r_[np.log(scales.r), np.log(scales.q), scales.rho]


def _from_vector(vector: Floats, most: Scales) -> Scales:
    """The scales of `_as_vector`, within their ranges."""
    r, q = (np.sqrt(np.maximum(np.exp(2.0 * log), MIN_VARIANCE)) for log in (vector[:3], vector[3:6]))
    rho = np.clip(vector[6:], PERSISTENCES[0], PERSISTENCES[-1])
    return Scales(np.minimum(r, most.r), np.minimum(q, most.q), rho)
