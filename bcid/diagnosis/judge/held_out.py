"""What an explanation is worth on blocks of the take that its parameters have not seen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.likelihood.marginal import Scales, log_likelihood, moments, rescaled
from bcid.likelihood.newton import Tangent
from bcid.likelihood.nuisance import deviations
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import Take

LONGEST_BLOCK_S = 20.0
BLOCKS = 12  # at least: of fewer, a bootstrap shows no scatter
RESAMPLES = 999
ITERATIONS = 3


class Gain(NamedTuple):
    """Nats of log-likelihood on held-out blocks, one explanation over another."""

    nats: float
    ci95: tuple[float, float]


def block_s(take: Take) -> float:
    """How long the blocks are that are held out and resampled."""
    return min(LONGEST_BLOCK_S, take.T / BLOCKS)


def halves(take: Take) -> list[Ints]:
    """The segments of every other block, and those between."""
    block = (take.begin_s // block_s(take)).astype(int)
    return [np.flatnonzero(block % 2 == side) for side in (0, 1)]


def on_half(fit: Fit, take: Take, chosen: Ints) -> Fit:
    """The fit refitted to some of the segments, from where it stands and along its own tangent."""
    rows, share = take.rows(chosen), fit.hypothesis.of_a_share(len(chosen) / take.segments)
    tangent = Tangent(np.ascontiguousarray(fit.tangent.A[rows]), np.ascontiguousarray(fit.tangent.J[rows]))
    return refit(take.part(chosen), share, fit.phi, fit.start[chosen], fit.scales, ITERATIONS, tangent)


def scores(fit: Fit, take: Take) -> Floats:
    """Log-likelihood of every segment (S,) under parameters fitted to the other half.

    Where half a take leads a poor explanation out of the finite numbers on the other, it is judged by the parameters of
    the whole take, which flatters it: what it lacks is not made larger by that.
    """
    one, other = halves(take)
    out = np.zeros(take.segments)
    for train, test in ((one, other), (other, one)):
        try:
            trained = on_half(fit, take, train)
            out[test] = _on(fit, take, test, trained.phi, trained.scales)
        except FloatingPointError:
            out[test] = _on(fit, take, test, fit.phi, fit.scales)
    return out


def _on(fit: Fit, take: Take, chosen: Ints, phi: Floats, scales: Scales) -> Floats:
    """Log-likelihood of some of the segments at phi."""
    part = take.part(chosen)
    A = np.ascontiguousarray(fit.tangent.A[take.rows(chosen)])
    r = deviations(part, fit.hypothesis.setting(phi, part), fit.start[chosen], A)
    _, e = rescaled(moments(r, A, part.first), scales, 0)
    return log_likelihood(e)


def gain(better: Floats, worse: Floats, take: Take, unbent: float = 0.0) -> Gain:
    """The gain of `better` over `worse`, both as `scores` gives them, with a block bootstrap.

    And `unbent`, nats by which it bends the parameters of a trusted simulation less: what those were found from is
    no part of the take, and contradicts `worse` on every block of it.
    """
    block = (take.begin_s // block_s(take)).astype(int)
    sums = np.bincount(block, better - worse)[np.unique(block)]
    rng = np.random.default_rng(0)
    totals = sums[rng.integers(0, len(sums), (RESAMPLES, len(sums)))].sum(axis=1)
    low, high = np.quantile(totals, [0.025, 0.975]) + unbent
    return Gain(float(sums.sum()) + unbent, (float(low), float(high)))
