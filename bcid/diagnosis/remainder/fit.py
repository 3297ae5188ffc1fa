"""A fit with a remainder beside its names: coefficients refitted jointly, their spreads by evidence.

The remainder stands in the model, so that predictions know how it feeds back; noise and pushes are estimated anew
beside it.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.diagnosis.locate.pushes import estimate_disturbances
from bcid.diagnosis.remainder.evidence import Quadratic, channel_worths, likeliest_spreads
from bcid.diagnosis.remainder.functions import RemainderBasis, remainder_basis
from bcid.effects.table import effect_switches
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.hypothesis import NO_REMAINDER, Hypothesis
from bcid.likelihood.jacobian import parameter_jacobian
from bcid.likelihood.marginal import (
    NU,
    MarginalTerms,
    estimate_scales,
    robust_weights,
    score_and_information,
    segment_moments,
)
from bcid.likelihood.nuisance import linearise_residuals, remove_pushes
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import Take

REWEIGHTINGS = 3  # of segments, while the remainder is found from nothing
ROUNDS = 3  # of refits, each with the spreads found at the one before
SAME_SPREAD = 0.6  # logarithm of a ratio of spreads below which they are the same
NEGLIGIBLE = 1e-4  # added to spreads there
TANGENTS = 3
SHARES = (1.0, 0.3, 0.0)  # of the remainder found to first order, from which a refit starts


class RemainderFit(NamedTuple):
    """A fit, the remainder that is needed beside it, and what the two explain together."""

    named: Fit  # without the remainder
    fit: Fit  # with it; `named` itself where none is needed
    spread: Mapping[str, float]  # of each channel, 0 where nothing is needed
    log_evidence: float  # log-likelihood, priors and prices of names, integrated over the remainder
    worth: Mapping[str, float]  # nats of each channel that is needed beside the others, most first

    @property
    def nats(self) -> float:
        """What the remainder adds beside the names."""
        return self.log_evidence - self.named.penalised_log_likelihood


class LinearisedNames(NamedTuple):
    """Slopes and information of each segment for the n named parameters, then for K coefficients, at a fit."""

    g: Floats  # (S, n + K)
    G: Floats  # (S, n + K, n + K)
    terms: MarginalTerms
    c: Floats  # (K,) coefficients there


def basis_for(fit: Fit, take: Take) -> RemainderBasis:
    """The functions of a remainder over what the take's drive went through, by the states that `fit` predicts."""
    disturbances = estimate_disturbances(fit, take)
    q, car = disturbances.states, fit.car()
    across = q["v_y"] + car.l_f * q["omega"]
    v_fx = np.cos(q["delta"]) * q["v_x"] + np.sin(q["delta"]) * across
    time_s = disturbances.time_s - take.zero_s[disturbances.segment]
    return remainder_basis({**q, "v_fx": v_fx, "t": time_s}, car)


def fit_with_remainder(fit: Fit, take: Take, basis: RemainderBasis) -> RemainderFit:
    """The `fit` with the remainder of greatest evidence beside it, all refitted together.

    Spreads are found to first order, with segments weighted anew as they are explained; then coefficients and named
    parameters are refitted, and spreads found again at the refit, until they stay.
    """
    named, on = fit.hypothesis, np.zeros(0, dtype=np.int64)
    nothing = RemainderFit(fit, fit, dict.fromkeys(basis.channels, 0.0), fit.penalised_log_likelihood, {})
    at = linearise_beside(fit, take, basis, on)
    spread, quadratic, c, _ = explain_robustly(at, fit, basis)
    best, now = nothing, fit
    for _ in range(ROUNDS):
        sd = basis.sd(spread)
        on = np.flatnonzero(sd)
        if not len(on):
            break
        hypothesis = replace(named, remainder=basis.choose(spread))
        further = _refit_from(now, take, hypothesis, c[on] / sd[on])
        if further is None:
            break
        now, at = further, linearise_beside(further, take, basis, on)
        quadratic = _project(at, robust_weights(at.terms), now, named)
        nats = _penalised(now, named, take) - quadratic.occam_nats(sd)
        if nats > best.log_evidence:
            best = RemainderFit(fit, now, spread, nats, channel_worths(quadratic, basis, spread))
        again = likeliest_spreads(quadratic, basis, basis.channels, spread)
        if all(abs(np.log((again[n] + NEGLIGIBLE) / (spread[n] + NEGLIGIBLE))) < SAME_SPREAD for n in spread):
            break
        spread, c = again, quadratic.posterior_mean(basis.sd(again))
    return best


def _penalised(fit: Fit, named: Hypothesis, take: Take) -> float:
    """Log-likelihood plus log priors of names and remainder, less the price of the names (nats)."""
    names, c = fit.phi[: named.named_size], fit.phi[named.named_size :]
    trusted = named.prior(names).log_density(names) if named.trusted_simulation is not None else 0.0
    price = 0.5 * len(named.effect_parameters) * float(np.log(take.segments))
    return fit.log_likelihood + trusted - price - 0.5 * float(c @ c)


def _refit_from(fit: Fit, take: Take, hypothesis: Hypothesis, c: Floats) -> Fit | None:
    """The `hypothesis` refitted from a fit and whitened coefficients `c`, or from less of them where that diverges."""
    names = fit.phi[: hypothesis.named_size]
    for share in SHARES:
        phi = np.r_[names, share * c]
        found = none_if_diverged(refit, take, hypothesis, phi, fit.start, fit.scales, tangents=TANGENTS)
        if found is not None:
            return found
    return None


def linearise_beside(fit: Fit, take: Take, basis: RemainderBasis, on: Ints) -> LinearisedNames:
    """Slopes and information of all segments at a fit, which holds the coefficients of the functions `on`."""
    h, c = fit.hypothesis, np.zeros(len(basis.size))
    c[on] = fit.phi[h.named_size :] * h.remainder.sd
    body, tracking = basis.tables(c)
    named = replace(h, remainder=NO_REMAINDER)
    inputs = h.prediction_inputs(fit.phi, take)
    every = inputs._replace(switches=effect_switches(h.effect_values(fit.phi), body), tracking=tracking)
    r, A, B = linearise_residuals(take, every, fit.start)
    own = parameter_jacobian(take, h, fit.phi, fit.start, r, range(named.base_size, named.named_size))
    J = np.ascontiguousarray(np.concatenate([fit.tangent.J[:, :, : named.base_size], own, B], axis=2))
    rest = remove_pushes(r, A, fit.start, take.first)
    _, terms = estimate_scales(segment_moments(rest, A, take.first), fit.scales, 0)
    g, G = score_and_information(rest, A, J, take.first, fit.scales.r, terms.V)
    return LinearisedNames(g, G, terms, c)


def _project(at: LinearisedNames, weights: Floats, fit: Fit, named: Hypothesis) -> Quadratic:
    """The log-likelihood of the coefficients, about none, with the named parameters projected out."""
    n = named.named_size
    prior, phi = named.prior(fit.phi[:n]), fit.phi[:n]
    g, G = weights @ at.g, np.tensordot(weights, at.G, axes=1)
    g[:n] -= prior.stiffness * (phi - prior.centre)
    G[:n, :n] += np.diag(prior.stiffness)
    g = g + G[:, n:] @ at.c
    answer = np.linalg.lstsq(G[:n, :n], G[:n, n:], rcond=1e-12)[0]
    return Quadratic(g[n:] - answer.T @ g[:n], G[n:, n:] - G[n:, :n] @ answer)


def explain_robustly(
    at: LinearisedNames, fit: Fit, basis: RemainderBasis
) -> tuple[dict[str, float], Quadratic, Floats, Floats]:
    """Spreads, the quadratic log-likelihood, coefficients and weights of segments, about a fit without a remainder.

    Segments that the remainder explains gain weight, as in the likelihood.
    """
    named, n = fit.hypothesis, fit.hypothesis.named_size
    prior, weights, spread = named.prior(fit.phi), robust_weights(at.terms), dict.fromkeys(basis.channels, 0.0)
    for _ in range(REWEIGHTINGS):
        quadratic = _project(at, weights, fit, named)
        spread = likeliest_spreads(quadratic, basis, basis.channels, spread)
        c = quadratic.posterior_mean(basis.sd(spread))
        g, G = weights @ at.g, np.tensordot(weights, at.G, axes=1)
        slope = g[:n] - prior.stiffness * (fit.phi - prior.centre) - G[:n, n:] @ c
        moved = np.linalg.lstsq(G[:n, :n] + np.diag(prior.stiffness), slope, rcond=1e-12)[0]
        a = np.r_[moved, c]
        chi2 = np.maximum(at.terms.chi2 - 2.0 * at.g @ a + np.einsum("i,sij,j->s", a, at.G, a), 0.0)
        weights = (NU + at.terms.numbers) / (NU + chi2)
    return spread, quadratic, c, weights
