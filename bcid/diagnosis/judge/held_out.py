"""Gains of an explanation on blocks of the take that its parameters have not seen: two-fold cross-validation."""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.bootstrap import draw_blocks, quantile_interval
from bcid.diagnosis.limits import JUDGE_LIMITS
from bcid.errors import PredictionDiverged
from bcid.likelihood.marginal import segment_moments, student_log_densities
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.refit_state import Effort
from bcid.likelihood.scale_estimate import estimate_scales
from bcid.likelihood.scales import Scales
from bcid.likelihood.take import Take

HALF_EFFORT = Effort(iterations=3)


class HeldOutGain(NamedTuple):
    """How much likelier one explanation makes the held-out blocks than another (nats of log-likelihood)."""

    nats: float
    ci95: tuple[float, float]


def block_length_s(take: Take) -> float:
    """Length (s) of the blocks for cross-validation and the block bootstrap: 20 s, or a twelfth of a shorter take."""
    return min(JUDGE_LIMITS.max_block_s, take.T / JUDGE_LIMITS.min_blocks)


def split_halves(take: Take) -> list[Ints]:
    """Indices of the 1.5 s segments in a take's even blocks, and in its odd blocks, for two-fold cross-validation.

    Blocks are consecutive stretches of `block_length_s`.
    """
    block = (take.begin_s // block_length_s(take)).astype(int)
    return [np.flatnonzero(block % 2 == side) for side in (0, 1)]


def refit_on_half(fit: Fit, take: Take, chosen: Ints) -> Fit:
    """The fit refitted to the segments with indices `chosen` only: a few Gauss-Newton steps from its own parameters.

    Derivatives of the predictions by base parameters and initial states are not renewed: they are those of `fit`,
    which was made to the whole take.
    """
    share = fit.hypothesis.scale_simulation_prior(len(chosen) / take.segments)
    fit, half = fit.part(take, chosen)
    return refit(half, share, fit.phi, fit.start, fit.scales, HALF_EFFORT, fit.tangent)


def held_out_log_likelihoods(fit: Fit, take: Take) -> Floats:
    """Two-fold cross-validated log-likelihood (nats) of every segment (S,): parameters are refitted to the other half.

    The halves are the take's even and odd blocks.  Where a refit diverges (its predictions are not finite), the
    parameters fitted to the whole take are used, which makes the fit look better than it is.
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
    """Marginal log-likelihoods (nats) of the segments with indices `chosen` under the fit's hypothesis.

    Its parameter vector is `phi` (base parameters, then effects' parameters); `scales` are standard deviations of pose
    noise and of disturbances of the body.  Each segment's initial state and disturbances are integrated out.
    """
    fit, part = fit.part(take, chosen)
    _, e = estimate_scales(segment_moments(fit.residuals(part, phi), fit.tangent.A, part.first), scales, 0)
    return student_log_densities(e)


def bootstrap_gain(better: Floats, worse: Floats, take: Take, prior_gain: float = 0.0) -> HeldOutGain:
    """Difference of log-likelihood (nats) of two fits on held-out blocks, with a 95 % interval by block bootstrap.

    `better` and `worse` are the two fits' log-likelihoods of each segment (S,) by `held_out_log_likelihoods`; their
    difference is summed over the take.  `prior_gain` (nats), the difference of the fits' log priors where a reference
    model has a prior, is added to the sum and to both ends of the interval.
    """
    block = (take.begin_s // block_length_s(take)).astype(int)
    sums = np.bincount(block, better - worse)[np.unique(block)]
    low, high = quantile_interval(sums[draw_blocks(len(sums))].sum(axis=1)) + prior_gain
    return HeldOutGain(float(sums.sum()) + prior_gain, (float(low), float(high)))
