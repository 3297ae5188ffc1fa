"""Gains of an explanation on blocks of the take that its parameters have not seen: two-fold cross-validation."""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.bootstrap import draw_blocks, quantile_interval
from bcid.errors import PredictionDiverged
from bcid.likelihood.marginal import Scales, estimate_scales, segment_moments, student_log_densities
from bcid.likelihood.newton import Tangent
from bcid.likelihood.nuisance import residuals_without_pushes
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import Take

# blocks are as long as pushes may be correlated; of fewer blocks, a bootstrap shows no scatter
LONGEST_BLOCK_S, MIN_BLOCKS = 20.0, 12
HALF_ITERATIONS = 3


class HeldOutGain(NamedTuple):
    """How much likelier one explanation makes the held-out blocks than another (nats of log-likelihood)."""

    nats: float
    ci95: tuple[float, float]


def block_length_s(take: Take) -> float:
    """Length (s) of the blocks of a take that are held out and resampled."""
    return min(LONGEST_BLOCK_S, take.T / MIN_BLOCKS)


def split_halves(take: Take) -> list[Ints]:
    """Indices of the segments in the even blocks of a take, and of those in its odd blocks."""
    block = (take.begin_s // block_length_s(take)).astype(int)
    return [np.flatnonzero(block % 2 == side) for side in (0, 1)]


def refit_on_half(fit: Fit, take: Take, chosen: Ints) -> Fit:
    """The fit refitted to the `chosen` segments only, starting from its own parameters and along its own tangent."""
    rows, share = take.rows(chosen), fit.hypothesis.scale_simulation_prior(len(chosen) / take.segments)
    tangent = Tangent(np.ascontiguousarray(fit.tangent.A[rows]), np.ascontiguousarray(fit.tangent.J[rows]))
    return refit(take.part(chosen), share, fit.phi, fit.start[chosen], fit.scales, HALF_ITERATIONS, tangent)


def held_out_log_likelihoods(fit: Fit, take: Take) -> Floats:
    """Log-likelihood of every segment (S,) under parameters refitted to the other half of the take.

    Where a refit diverges on the other half, the parameters of the whole take are used there, which flatters the fit.
    """
    out, halves = np.zeros(take.segments), split_halves(take)
    for train, test in (halves, halves[::-1]):
        try:
            trained = refit_on_half(fit, take, train)
            out[test] = _evaluate_segments(fit, take, test, trained.phi, trained.scales)
        except PredictionDiverged:
            out[test] = _evaluate_segments(fit, take, test, fit.phi, fit.scales)
    return out


def _evaluate_segments(fit: Fit, take: Take, chosen: Ints, phi: Floats, scales: Scales) -> Floats:
    """Log-likelihood of each `chosen` segment under the fit's hypothesis with other parameters and scales."""
    part = take.part(chosen)
    A = np.ascontiguousarray(fit.tangent.A[take.rows(chosen)])
    r = residuals_without_pushes(part, fit.hypothesis.prediction_inputs(phi, part), fit.start[chosen], A)
    _, e = estimate_scales(segment_moments(r, A, part.first), scales, 0)
    return student_log_densities(e)


def bootstrap_gain(better: Floats, worse: Floats, take: Take, prior_gain: float = 0.0) -> HeldOutGain:
    """Gain (nats) of one explanation over another on held-out blocks, with a 95 % interval by resampling the blocks.

    `better` and `worse` are the segments' log-likelihoods (S,) by `held_out_log_likelihoods`.  `prior_gain` (nats), by
    which the better one departs less from a trusted reference model, does not depend on the take: it is added to all.
    """
    block = (take.begin_s // block_length_s(take)).astype(int)
    sums = np.bincount(block, better - worse)[np.unique(block)]
    low, high = quantile_interval(sums[draw_blocks(len(sums))].sum(axis=1)) + prior_gain
    return HeldOutGain(float(sums.sum()) + prior_gain, (float(low), float(high)))
