"""What many recordings of one car say together: constants that they share, and what is each recording's own.

Recording i is fitted alone first, which gives phi_i, the information H_i and, where phi_i is no optimum, the slope g_i
of its log-likelihood; of the recording itself nothing more is needed,

    log L_i(phi) ~ g_i' (phi - phi_i) - 1/2 (phi - phi_i)' H_i (phi - phi_i).

In all of them the car is one, s, but for a few things that differ from drive to drive, such as its load or its battery:

    phi_i = s + C o_i,   o_i ~ N(0, diag(tau^2)),

where a column of C says how one of them moves the constants.  Given tau the o_i are eliminated one recording after the
other, so that what is kept does not grow with their number.  A recording that says little of its own load is thereby
drawn to the others, and one that says much is not (for such models: Gelman and Hill, Data Analysis Using Regression and
Multilevel/Hierarchical Models, 2007, chapter 12).

Few recordings say little of tau: where two agree in a constant by chance, its likeliest tau is zero, and all else would
be measured by that constant.  So ln tau has a prior, tau is the likeliest one beside it, and what is not known of tau
counts in all errors: each estimate varies with ln tau, whose covariance is that of Laplace's approximation (Kass and
Steffey, Journal of the American Statistical Association 84, 1989, 717-726).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from bcid.aliases import Floats

LEAST_INFORMATION = 1e-2
"""Least information on ln tau: that of a standard deviation of 10, a spread of which nothing is known."""
LOG_STEP = 0.05
"""Step of ln tau over which differences are taken for derivatives."""
RIDGE = 1e-9
"""Information that is added to each constant's own, as a share of that: a constant that no recording shows keeps the
mean of the recordings' values."""


class Summary(NamedTuple):
    """What one recording says of n constants."""

    phi: Floats  # (n,)
    information: Floats  # (n, n)
    slope: Floats  # (n,) at phi, 0 at an optimum


class SpreadPrior(NamedTuple):
    """What is known of ln tau beforehand: a normal distribution."""

    mean: Floats  # (k,)
    covariance: Floats  # (k, k)


class Pooled(NamedTuple):
    """What I recordings say together."""

    shared: Floats  # (n,) s
    shared_covariance: Floats  # (n, n) where tau is known
    own: Floats  # (I, k) o_i
    own_covariance: Floats  # (I, k, k) of o_i where s and tau are known
    by_shared: Floats  # (I, k, n) derivatives of o_i by s
    spread: Floats  # (k,) tau
    log_likelihood: float  # of tau: all o_i and s integrated out, but for a constant
    shared_by_spread: Floats  # (n, q) how s changes with what is not known of ln tau, in standard deviations of that
    own_by_spread: Floats  # (I, k, q) and how the o_i do; q = 0 where tau is known

    @property
    def shared_sd(self) -> Floats:
        """Standard deviations (n,) of the constants s."""
        return np.asarray(np.sqrt(np.diag(self.shared_covariance) + (self.shared_by_spread**2).sum(axis=-1)))

    @property
    def own_sd(self) -> Floats:
        """Standard deviations (I, k) of the o_i."""
        return np.asarray(np.sqrt(self._own_variance() + (self.own_by_spread**2).sum(axis=-1)))

    @property
    def slope(self) -> Floats:
        """The derivatives (k,) of `log_likelihood` by ln tau."""
        return np.asarray(((self.own**2 + self._own_variance()) / self.spread**2).sum(axis=0) - len(self.own))

    def _own_variance(self) -> Floats:
        """The variances (I, k) of the o_i where tau is known."""
        alone = np.diagonal(self.own_covariance, axis1=1, axis2=2)
        by_shared = np.einsum("ikn,nm,ikm->ik", self.by_shared, self.shared_covariance, self.by_shared)
        return np.asarray(alone + by_shared)

    def difference_sd(self, recordings: Sequence[int], beside: Sequence[int]) -> Floats:
        """Standard deviations (k,) of the mean o_i of some recordings less that of others, or of zero without any.

        A difference is known much better than either: what all recordings say of a load at once is their car's.
        """
        weights = np.zeros(len(self.own))
        weights[list(recordings)] += 1.0 / max(len(recordings), 1)
        weights[list(beside)] -= 1.0 / max(len(beside), 1)
        by_shared, by_spread = (np.tensordot(weights, each, axes=1) for each in (self.by_shared, self.own_by_spread))
        alone = np.tensordot(weights**2, self.own_covariance, axes=1)
        return np.sqrt(np.diag(alone + by_shared @ self.shared_covariance @ by_shared.T + by_spread @ by_spread.T))

    def constants_of(self, recording: int, directions: Floats) -> Floats:
        """The constants (n,) in one of the recordings, where `directions` are C."""
        phi: Floats = self.shared + directions @ self.own[recording]
        return phi


def pool(summaries: Sequence[Summary], directions: Floats, prior: SpreadPrior) -> Pooled:
    """Pool recordings of one car: `directions` (n, k) are C, and `prior` says what is known of tau beforehand."""
    precision = np.asarray(np.linalg.inv(prior.covariance))

    def lose(log_tau: Floats) -> tuple[float, Floats]:
        """What ln tau loses in nats, but for a constant, and the derivatives of that."""
        pooled, pull = pool_at(summaries, directions, np.exp(log_tau)), precision @ (log_tau - prior.mean)
        return 0.5 * float(pull @ (log_tau - prior.mean)) - pooled.log_likelihood, pull - pooled.slope

    log_tau = minimize(lose, prior.mean, jac=True, method="L-BFGS-B").x
    return _add_unknown_spread(pool_at(summaries, directions, np.exp(log_tau)), summaries, directions, precision)


def _add_unknown_spread(
    pooled: Pooled, summaries: Sequence[Summary], directions: Floats, precision: Floats
) -> Pooled:  # fmt: skip
    """What is `pooled`, with what is not known of ln tau, whose prior has the `precision`, by differences around it."""
    k = len(precision)
    steps = LOG_STEP * np.eye(k)
    around = [
        [pool_at(summaries, directions, pooled.spread * np.exp(sign * step)) for sign in (1.0, -1.0)] for step in steps
    ]
    curvature = np.array([(high.slope - low.slope) / (2.0 * LOG_STEP) for high, low in around])
    unknown = np.linalg.cholesky(np.linalg.inv(_keep_positive(precision - 0.5 * (curvature + curvature.T))))
    shared, own = (
        np.stack([(getattr(high, name) - getattr(low, name)) / (2.0 * LOG_STEP) for high, low in around], axis=-1)
        for name in ("shared", "own")
    )
    return pooled._replace(shared_by_spread=shared @ unknown, own_by_spread=own @ unknown)


def _keep_positive(information: Floats) -> Floats:
    """An information matrix (k, k) whose eigenvalues are `LEAST_INFORMATION` at least.

    Where the prior holds tau below its likeliest value the recordings' own part is negative, which the sum may only be
    by rounding.
    """
    values, vectors = np.linalg.eigh(information)
    return np.asarray((vectors * np.maximum(values, LEAST_INFORMATION)) @ vectors.T)


def pool_at(summaries: Sequence[Summary], directions: Floats, spread: Floats) -> Pooled:
    """Pool recordings where tau is known to be `spread`."""
    n, k = directions.shape
    D = np.diag(spread**-2.0)
    # all is counted from the mean, where a constant stays that no recording shows
    mean = np.mean([each.phi for each in summaries], axis=0)
    summaries = [each._replace(phi=each.phi - mean) for each in summaries]
    S, r, constant = np.zeros((n, n)), np.zeros(n), 0.0
    for each in summaries:
        H_so, A, b, b_o = _eliminate(each, directions, D)
        S += each.information - H_so @ np.linalg.solve(A, H_so.T)
        r += b - H_so @ np.linalg.solve(A, b_o)
        constant += _log_normalisation(each, A, D, b_o)
    own_information = np.sum([np.diag(each.information) for each in summaries], axis=0)
    scale = np.sqrt(np.where(own_information > 0.0, own_information, 1.0))
    scaled = S / np.outer(scale, scale) + RIDGE * np.eye(n)
    shared = np.asarray(np.linalg.solve(scaled, r / scale) / scale, float)
    covariance = np.asarray(np.linalg.inv(scaled) / np.outer(scale, scale), float)
    count = len(summaries)
    own, alone, by_shared = np.empty((count, k)), np.empty((count, k, k)), np.empty((count, k, n))
    for i, each in enumerate(summaries):
        H_so, A, _, b_o = _eliminate(each, directions, D)
        own[i] = np.linalg.solve(A, b_o - H_so.T @ shared)
        alone[i], by_shared[i] = np.linalg.inv(A), -np.linalg.solve(A, H_so.T)
    # s is integrated out as well, under a flat prior, as the step of expectation does
    total = constant + 0.5 * float(r @ shared) - 0.5 * float(np.linalg.slogdet(scaled)[1])
    known = np.zeros((n, 0)), np.zeros((count, k, 0))
    return Pooled(shared + mean, covariance, own, alone, by_shared, spread, total, *known)


def _eliminate(each: Summary, C: Floats, D: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """H C, C' H C + D, and the right sides b = H phi_i + g_i and C' b of the normal equations of one recording."""
    H_so = each.information @ C
    b = each.information @ each.phi + each.slope
    return H_so, C.T @ H_so + D, b, C.T @ b


def _log_normalisation(each: Summary, A: Floats, D: Floats, b_o: Floats) -> float:
    """What a recording adds to the log-likelihood of tau beside the terms in s."""
    fit = float(b_o @ np.linalg.solve(A, b_o)) - float(each.phi @ each.information @ each.phi)
    return 0.5 * (fit + float(np.linalg.slogdet(D)[1]) - float(np.linalg.slogdet(A)[1])) - float(each.slope @ each.phi)
