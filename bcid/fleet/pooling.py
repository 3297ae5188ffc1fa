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
LEAST_SPREAD = 1e-6
"""Smallest tau, in parts of the first one: a spread that is not there goes to zero, which is never reached."""
RIDGE = 1e-9
"""Information about a constant, beside the largest of all, that is added: where no recording shows it, it stays put."""


class Summary(NamedTuple):
    """What one recording says of n constants."""

    phi: Floats  # (n,)
    information: Floats  # (n, n)
    slope: Floats  # (n,) at phi, 0 at an optimum


class Pooled(NamedTuple):
    """What recordings say together."""

    shared: Floats  # (n,) s
    shared_covariance: Floats  # (n, n)
    own: Floats  # (I, k) o_i
    own_sd: Floats  # (I, k)
    spread: Floats  # (k,) tau
    log_likelihood: float  # of all, o_i integrated out, but for a constant

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
        before = spread
        spread = np.sqrt((pooled.own**2 + pooled.own_sd**2).mean(axis=0))
        spread = np.maximum(spread, LEAST_SPREAD * first_spread)
        pooled = pool_at(summaries, directions, spread)
    return pooled


def pool_at(summaries: Sequence[Summary], directions: Floats, spread: Floats) -> Pooled:
    """Pool recordings where tau is known to be `spread`."""
    n, k = directions.shape
    D = np.diag(spread**-2.0)
    S, r, constant = np.zeros((n, n)), np.zeros(n), 0.0
    for each in summaries:
        H_so, A, b, b_o = _eliminate(each, directions, D)
        S += each.information - H_so @ np.linalg.solve(A, H_so.T)
        r += b - H_so @ np.linalg.solve(A, b_o)
        constant += _log_normalisation(each, A, D, b_o)
    S[np.diag_indices(n)] += RIDGE * np.diag(S).max()
    shared = np.asarray(np.linalg.solve(S, r), float)
    covariance = np.asarray(np.linalg.inv(S), float)
    own, own_sd = np.empty((len(summaries), k)), np.empty((len(summaries), k))
    for i, each in enumerate(summaries):
        H_so, A, _, b_o = _eliminate(each, directions, D)
        own[i] = np.linalg.solve(A, b_o - H_so.T @ shared)
        through = np.linalg.solve(A, H_so.T)
        own_sd[i] = np.sqrt(np.diag(np.linalg.inv(A) + through @ covariance @ through.T))
    total = constant + 0.5 * float(r @ shared)
    return Pooled(shared, covariance, own, own_sd, spread, total)


def _eliminate(each: Summary, C: Floats, D: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """H C, C' H C + D, and the right sides b = H phi_i + g_i and C' b of the normal equations of one recording."""
    H_so = each.information @ C
    b = each.information @ each.phi + each.slope
    return H_so, C.T @ H_so + D, b, C.T @ b


def _log_normalisation(each: Summary, A: Floats, D: Floats, b_o: Floats) -> float:
    """What a recording adds to the log-likelihood of tau beside the terms in s."""
    fit = float(b_o @ np.linalg.solve(A, b_o)) - float(each.phi @ each.information @ each.phi)
    return 0.5 * (fit + float(np.linalg.slogdet(D)[1]) - float(np.linalg.slogdet(A)[1])) - float(each.slope @ each.phi)
