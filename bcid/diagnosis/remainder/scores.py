"""What each effect would add beside a remainder, to first order: the score test of a name that nothing else replaces.

A trial is an effect at one size and place, and its column the change of predicted poses by it.  With its amplitude
free and the named parameters projected out, the evidence of trial and remainder together is compared with that of the
remainder alone, whose spreads are found anew beside the trial.
"""

import itertools
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.remainder.evidence import Quadratic
from bcid.diagnosis.remainder.fit import explain_robustly, linearise_beside
from bcid.diagnosis.remainder.functions import RemainderBasis
from bcid.diagnosis.search.screen import CandidateEffect, _combine_vectors
from bcid.effects.table import ENTRIES, effect_switches
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.jacobian import parameter_jacobian
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.marginal import estimate_scales, segment_moments
from bcid.likelihood.nuisance import linearise_residuals, remove_pushes
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import TrialChanges
from bcid.likelihood.take import N_NUISANCE, Take


class ScoredNames(NamedTuple):
    """Effects by what they would add beside the remainder, best first, and what the remainder adds alone."""

    candidates: list[CandidateEffect]
    remainder_nats: float
    spread: Mapping[str, float]


def score_names(fit: Fit, take: Take, basis: RemainderBasis, trials: TrialChanges) -> ScoredNames:
    """The effects of the `trials` by the evidence (nats) that each adds beside a remainder, to first order."""
    at = linearise_beside(fit, take, basis, np.zeros(0, dtype=np.int64))
    spread, _, _, weights = explain_robustly(at, fit, basis)
    g, G = _weighted_products(fit, take, basis, trials.columns, weights)
    n, K = fit.hypothesis.named_size, len(basis.size)
    _add_prior(g, G, fit.hypothesis, fit.phi)
    answer = np.linalg.lstsq(G[:n, :n], G[:n, n:], rcond=1e-12)[0]
    b, H = g[n:] - answer.T @ g[:n], G[n:, n:] - G[n:, :n] @ answer
    alone = Quadratic(b[:K], H[:K, :K])
    nothing = alone.log_evidence(basis.sd(spread))
    best = dict[str, CandidateEffect]()
    for trial in trials.trials:
        own = slice(K + trial.own.start, K + trial.own.stop)
        own_H, own_b = H[own, own], b[own]
        if (np.diag(own_H) < LIKELIHOOD_LIMITS.min_information).any():
            continue
        taken = np.linalg.lstsq(own_H, H[own, :K], rcond=1e-9)[0]
        amplitude = np.linalg.lstsq(own_H, own_b, rcond=1e-9)[0]
        beside = Quadratic(b[:K] - taken.T @ own_b, H[:K, :K] - H[own, :K].T @ taken)
        channel = ENTRIES[trial.effect].channel
        again = _best_of(beside, basis, [spread, spread | {channel: 0.0} if channel in spread else spread,
                                         dict.fromkeys(spread, 0.0)])  # fmt: skip
        c = beside.posterior_mean(basis.sd(again))
        amplitude = amplitude - taken @ c
        score = 0.5 * float(own_b @ np.linalg.lstsq(own_H, own_b, rcond=1e-9)[0])
        price = 0.5 * len(trial.vectors) * float(np.log(take.segments))
        score += beside.log_evidence(basis.sd(again)) - nothing - price
        values = _combine_vectors(trial, amplitude)
        p = ENTRIES[trial.effect].parameters
        if any(not q.is_place and q.low >= 0.0 and v <= 0.0 for q, v in zip(p, values, strict=True)):
            continue
        if trial.effect not in best or score > best[trial.effect].score:
            best[trial.effect] = CandidateEffect(trial.effect, values, score)
    return ScoredNames(sorted(best.values(), key=lambda c: -c.score), nothing, spread)


def _best_of(
    quadratic: Quadratic, basis: RemainderBasis, spreads: list[dict[str, float]] | list[Mapping[str, float]]
) -> Mapping[str, float]:
    """Of the `spreads` the one of greatest evidence."""
    return max(spreads, key=lambda s: quadratic.log_evidence(basis.sd(s)))


def _weighted_products(
    fit: Fit, take: Take, basis: RemainderBasis, columns: Floats, weights: Floats
) -> tuple[Floats, Floats]:
    """Slope (m,) and information (m, m) for names, coefficients and trials, initial states and pushes projected out."""
    h, inputs = fit.hypothesis, fit.hypothesis.prediction_inputs(fit.phi, take)
    body, tracking = basis.tables(np.zeros(len(basis.size)))
    every = inputs._replace(switches=effect_switches(h.effect_values(fit.phi), body), tracking=tracking)
    r, A, B = linearise_residuals(take, every, fit.start)
    own = parameter_jacobian(take, h, fit.phi, fit.start, r, range(h.base_size, h.named_size))
    rest = remove_pushes(r, A, fit.start, take.first)
    _, terms = estimate_scales(segment_moments(rest, A, take.first), fit.scales, 0)
    J = np.concatenate([fit.tangent.J[:, :, : h.base_size], own, B, columns, rest[:, :, None]], axis=2)
    root = np.sqrt(np.repeat(weights, np.diff(take.first)))[:, None] / fit.scales.r
    J = (J * root[:, :, None]).reshape(-1, J.shape[2])
    A = (A * root[:, :, None]).reshape(-1, N_NUISANCE)
    edges = 3 * take.first
    # V holds for weight one: A has the weight's root twice
    C = np.linalg.cholesky(terms.V)
    answered = [
        C[s].T @ (A[a:b].T @ J[a:b]) / np.sqrt(weights[s]) for s, (a, b) in enumerate(itertools.pairwise(edges))
    ]
    N = np.concatenate(answered)
    products = J.T @ J - N.T @ N
    return products[:-1, -1].copy(), products[:-1, :-1].copy()


def _add_prior(g: Floats, G: Floats, named: Hypothesis, phi: Floats) -> None:
    """Add the slope and stiffness of the named parameters' prior, in place."""
    n, prior = named.named_size, named.prior(phi)
    g[:n] -= prior.stiffness * (phi - prior.centre)
    G[:n, :n] += np.diag(prior.stiffness)
