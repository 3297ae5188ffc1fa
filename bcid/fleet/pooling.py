"""What many recordings of one car say together: constants that they share, and what is each recording's own.

Recording i is fitted alone first, which gives phi_i, the information H_i and, where phi_i is no optimum, the slope g_i
of its log-likelihood; of the recording itself nothing more is needed,

    log L_i(phi) ~ g_i' (phi - phi_i) - 1/2 (phi - phi_i)' H_i (phi - phi_i).

In all of them the car is one, s, but for a few things that differ from drive to drive, such as its load or its battery:

    phi_i = s + C o_i,   o_i ~ N(0, diag(tau^2)),

where a column of C says how one of them moves the constants.  Given tau the o_i are eliminated one recording after the
other, so that what is kept does not grow with their number, and tau is the likeliest one, by expectation and
maximisation (Dempster, Laird and Rubin 1977; for such models: Gelman and Hill, Data Analysis Using Regression and
Multilevel/Hierarchical Models, 2007, chapter 12).  A recording that says little of its own load is thereby drawn to the
others, and one that says much is not.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats

EM_STEPS = 500
"""Steps of expectation and maximisation at most."""
SETTLED = 1e-6
"""Relative change of all tau below which these have settled."""
SETTLED_NATS = 1e-4
"""Gain of a step below which the spreads have settled, too."""
LEAST_SPREAD = 1e-6
"""Smallest tau, in parts of the first one: a spread that is not there goes to zero, which is never reached."""
RIDGE = 1e-9
"""Information that is added to each constant's own, as a share of that: a constant that no recording shows keeps the
mean of the recordings' values."""


class Summary(NamedTuple):
    """What one recording says of n constants."""

    phi: Floats  # (n,)
    information: Floats  # (n, n)
    slope: Floats  # (n,) at phi, 0 at an optimum


class Pooled(NamedTuple):
    """What I recordings say together."""

    shared: Floats  # (n,) s
    shared_covariance: Floats  # (n, n)
    own: Floats  # (I, k) o_i
    own_covariance: Floats  # (I, k, k) of o_i where s is known
    by_shared: Floats  # (I, k, n) derivatives of o_i by s
    spread: Floats  # (k,) tau
    log_likelihood: float  # of tau: all o_i and s integrated out, but for a constant

    @property
    def own_sd(self) -> Floats:
        """Standard deviations (I, k) of the o_i."""
        return np.array([self.difference_sd([i], []) for i in range(len(self.own))])

    def difference_sd(self, recordings: Sequence[int], beside: Sequence[int]) -> Floats:
        """Standard deviations (k,) of the mean o_i of some recordings less that of others, or of zero without any.

        A difference is known much better than either: what all recordings say of a load at once is their car's.
        """
        weights = np.zeros(len(self.own))
        weights[list(recordings)] += 1.0 / max(len(recordings), 1)
        weights[list(beside)] -= 1.0 / max(len(beside), 1)
        by_shared = np.tensordot(weights, self.by_shared, axes=1)
        alone = np.tensordot(weights**2, self.own_covariance, axes=1)
        return np.sqrt(np.diag(alone + by_shared @ self.shared_covariance @ by_shared.T))

    def constants_of(self, recording: int, directions: Floats) -> Floats:
        """The constants (n,) in one of the recordings, where `directions` are C."""
        phi: Floats = self.shared + directions @ self.own[recording]
        return phi


def pool(summaries: Sequence[Summary], directions: Floats, first_spread: Floats) -> Pooled:
    """Pool recordings of one car: `directions` (n, k) are C, and the search for tau begins at `first_spread` (k,)."""
    spread, before = first_spread.astype(float), np.zeros_like(first_spread)
    pooled = pool_at(summaries, directions, spread)
    for _ in range(EM_STEPS):
        if np.allclose(spread, before, rtol=SETTLED, atol=0.0):
            break
        before, last = spread, pooled.log_likelihood
        spread = np.sqrt((pooled.own**2 + pooled.own_sd**2).mean(axis=0))
        spread = np.maximum(spread, LEAST_SPREAD * first_spread)
        pooled = pool_at(summaries, directions, spread)
        # one that goes to zero never settles
        if abs(pooled.log_likelihood - last) < SETTLED_NATS:
            break
    return pooled


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
    return Pooled(shared + mean, covariance, own, alone, by_shared, spread, total)


def _eliminate(each: Summary, C: Floats, D: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """H C, C' H C + D, and the right sides b = H phi_i + g_i and C' b of the normal equations of one recording."""
    H_so = each.information @ C
    b = each.information @ each.phi + each.slope
    return H_so, C.T @ H_so + D, b, C.T @ b


def _log_normalisation(each: Summary, A: Floats, D: Floats, b_o: Floats) -> float:
    """What a recording adds to the log-likelihood of tau beside the terms in s."""
    fit = float(b_o @ np.linalg.solve(A, b_o)) - float(each.phi @ each.information @ each.phi)
    return 0.5 * (fit + float(np.linalg.slogdet(D)[1]) - float(np.linalg.slogdet(A)[1])) - float(each.slope @ each.phi)
