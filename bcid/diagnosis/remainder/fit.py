"""A fit with a remainder beside its names: coefficients refitted jointly, their spreads by evidence.

The remainder stands in the model, so that predictions know how it feeds back; noise and pushes are estimated anew
beside it.  Refitted are the functions that are needed; what the others would add is found to first order.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.diagnosis.kept_steps import kept_under
from bcid.diagnosis.limits import LOCATE_LIMITS, SEARCH_LIMITS
from bcid.diagnosis.locate.pushes import estimate_disturbances
from bcid.diagnosis.remainder.evidence import Quadratic, channel_worths, likeliest_spreads
from bcid.diagnosis.remainder.functions import CHANNELS, RemainderBasis, channel_of, remainder_basis
from bcid.diagnosis.remainder.information import TakeInformation, gather_information
from bcid.diagnosis.remainder.waves import MOST_WAVES, add_waves, find_wave
from bcid.effects.remainder import MOST
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.marginal import robust_weights
from bcid.likelihood.price import price_nats
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import Take

REWEIGHTINGS = 3  # of segments, while the remainder is found from nothing
ROUNDS = 4  # of refits, each with the spreads found at the one before
CONVERGED_NATS = 2.0  # that a further round is expected to gain, below which there is none
CONVERGED_SHARE = 0.01  # of what the remainder explains, likewise: smooth functions miss more than that
TANGENTS = 3
SHARES = (1.0, 0.3, 0.0)  # of the remainder found to first order, from which a refit starts


class Explained(NamedTuple):
    """What a remainder explains beside a fit, to first order."""

    basis: RemainderBasis
    spread: Mapping[str, float]
    quadratic: Quadratic
    c: Floats  # (K,)
    weights: Floats  # (S,) of segments

    @classmethod
    def of_nothing(cls, at: TakeInformation, basis: RemainderBasis) -> Explained:
        """Nothing explained yet."""
        none, K = dict.fromkeys(basis.channels, 0.0), len(basis.size)
        return cls(basis, none, Quadratic(np.zeros(K), np.zeros((K, K))), np.zeros(K), at.robust_weights)

    def beside(self, basis: RemainderBasis) -> Explained:
        """What is explained, with the functions of a larger basis, of which nothing is known yet."""
        return self._replace(basis=basis, spread=dict.fromkeys(basis.channels, 0.0) | dict(self.spread))

    @property
    def nats(self) -> float:
        """What the remainder adds, by evidence."""
        return self.quadratic.log_evidence(self.basis.sd(self.spread)) - self.basis.price

    def channel_nats(self) -> dict[str, float]:
        """Nats that the functions of each channel add beside those of the others, most first."""
        return channel_worths(self.quadratic, self.basis, self.spread)

    def depends_on(self, channel: str) -> tuple[str, ...]:
        """The quantities, most important first, on which what the functions of a `channel` explain depends.

        Of what varies each must explain a share; none where a constant explains nearly all.
        """
        nats, quantities = 0.5 * self.c * self.quadratic.b, self.basis.quantities()
        own = np.array([channel_of(name) == channel for name in self.basis.channel])
        shares = {q: float(nats[own & on].sum()) for q, on in quantities.items()}
        varying = float(nats[own & np.any(list(quantities.values()), axis=0)].sum())
        if varying < LOCATE_LIMITS.min_quantity_share * float(nats[own].sum()):
            return ()
        least = LOCATE_LIMITS.min_quantity_share * varying
        first = sorted((q for q, n in shares.items() if n > max(least, 0.0)), key=lambda q: -shares[q])
        return tuple(first[: LOCATE_LIMITS.max_quantities])


class RemainderFit(NamedTuple):
    """A fit, the remainder that is needed beside it, and what the two explain together."""

    named: Fit  # without the remainder
    fit: Fit  # with it; `named` itself where none is needed
    basis: RemainderBasis
    on: Ints  # indices in the basis of the functions that `fit` holds
    fitted: Floats  # (K,) their coefficients, zero for others
    spread: Mapping[str, float]  # of each channel, 0 where nothing is needed
    log_evidence: float  # log-likelihood, priors and prices of names, integrated over the remainder
    seen: Explained  # to first order, beside the names alone
    settled: bool = True  # False where refits diverged, or ended as they could not reach what they had to exceed

    @classmethod
    def without_functions(cls, fit: Fit, seen: Explained) -> RemainderFit:
        """The `fit` alone, beside which a remainder would explain what is `seen`."""
        basis = seen.basis
        none, nothing = np.zeros(0, dtype=np.int64), np.zeros(len(basis.size))
        zero = dict.fromkeys(basis.channels, 0.0)
        return cls(fit, fit, basis, none, nothing, zero, fit.penalised_log_likelihood, seen)

    @property
    def nats(self) -> float:
        """What the remainder adds beside the names."""
        return self.log_evidence - self.named.penalised_log_likelihood


@kept_under()
def basis_for(fit: Fit, take: Take) -> RemainderBasis:
    """The functions of a remainder over what the take's drive went through, by the states that `fit` predicts."""
    disturbances = estimate_disturbances(fit, take)
    q, car = disturbances.states, fit.car()
    across = q["v_y"] + car.l_f * q["omega"]
    v_fx = np.cos(q["delta"]) * q["v_x"] + np.sin(q["delta"]) * across
    time_s = disturbances.time_s - take.zero_s[disturbances.segment]
    return remainder_basis({**q, "v_fx": v_fx, "t": time_s}, car)


@kept_under("near_nats")
def fit_with_remainder(
    fit: Fit, take: Take, seen: Explained, copied: tuple[str, ...] = (), to_exceed: float = -np.inf
) -> RemainderFit:
    """The `fit` with the remainder of greatest evidence beside it, all refitted together.

    The remainder that is `seen` to first order is refitted with the named parameters, and its spreads are found again
    at the refit, until that gains little, or its evidence cannot reach `to_exceed`.  Copies of laws that have names may
    be there in the channels `copied`.
    """
    alone = RemainderFit.without_functions(fit, seen)
    sd = seen.basis.sd(seen.spread)
    on = needed_functions(seen.quadratic, sd, seen.c)
    if not len(on):
        return alone
    hypothesis = replace(fit.hypothesis, remainder=seen.basis.choose(on, sd))
    further = _refit_from(fit, take, hypothesis, seen.c[on] / sd[on])
    return _refit_until_stable(alone, on, further, take, copied, to_exceed)


@kept_under("near_nats")
def add_beside_remainder(
    rest: RemainderFit, named: Fit, seen: Explained, take: Take, to_exceed: float = -np.inf
) -> RemainderFit:
    """The fit `named`, which has one effect more than that in `rest`, with a remainder found from that in `rest`.

    Where the effect stands beside others that have no name yet, its fit without them is far from where it belongs: here
    it begins beside what explains them.  `seen` is what a remainder explains beside `named` to first order.  Refits end
    where their evidence cannot reach `to_exceed`.
    """
    alone = RemainderFit.without_functions(named, seen._replace(basis=rest.basis))
    name = named.hypothesis.effects[-1]
    values = [named.hypothesis.effect_values(named.phi)[f] for f in named.hypothesis.entries[name].fields]
    hypothesis, phi = rest.fit.hypothesis.add_effect(name, rest.fit.phi, values)
    further = none_if_diverged(refit, take, hypothesis, phi, rest.fit.start, rest.fit.scales, tangents=TANGENTS)
    return _refit_until_stable(alone, rest.on, further, take, (), to_exceed)._replace(seen=seen)


def _refit_until_stable(
    best: RemainderFit, on: Ints, further: Fit | None, take: Take, copied: tuple[str, ...], to_exceed: float
) -> RemainderFit:
    """The fit of greatest evidence, of `best` and of refits from `further` on, which holds the functions `on`.

    After each refit spreads are found anew, and functions that are needed.  What a further round is expected to gain
    is more than all further ones do gain, as predictions bend.
    """
    basis, named, none = best.basis, best.named.hypothesis, np.zeros(len(best.basis.size))
    allowed, spread = basis.groups(copied), best.spread
    for round_ in range(ROUNDS):
        if further is None:
            return best._replace(settled=round_ > 0)
        fitted = none.copy()
        fitted[on] = further.phi[named.named_size :] * further.hypothesis.remainder.sd
        at = none_if_diverged(gather_information, further, take, basis, fitted)
        if at is None:
            return best._replace(settled=round_ > 0)
        quadratic = at.weigh(at.robust_weights).quadratic
        spread = likeliest_spreads(quadratic, basis, allowed, spread)
        sd = basis.sd(spread)
        c = quadratic.posterior_mean(sd)
        # about none, to second order about the refit; integrated, this holds what a last step would gain
        about_none = _without_remainder(further, named, take) - quadratic.gain(fitted)
        nats = about_none + quadratic.log_evidence(sd) - basis.price
        gained = nats - best.log_evidence
        if nats > best.log_evidence:
            best = best._replace(fit=further, spread=spread, log_evidence=nats, on=on, fitted=fitted)
        prior = float(np.sum(_whiten(c, sd) ** 2 - _whiten(fitted, sd) ** 2))
        expected = quadratic.gain(c) - quadratic.gain(fitted) - 0.5 * prior
        if expected < max(CONVERGED_NATS, CONVERGED_SHARE * best.nats) or (round_ and gained < CONVERGED_NATS):
            break
        if max(nats, best.log_evidence) + expected + SEARCH_LIMITS.near_nats < to_exceed:
            return best._replace(settled=False)
        on = needed_functions(quadratic, sd, c)
        if not len(on):
            break
        hypothesis = replace(named, remainder=basis.choose(on, sd))
        further = _refit_from(further, take, hypothesis, c[on] / sd[on])
    return best


def _whiten(c: Floats, sd: Floats) -> Floats:
    """Coefficients over their prior standard deviations; zero where there is none."""
    return np.divide(c, sd, out=np.zeros_like(c), where=sd > 0.0)


def needed_functions(quadratic: Quadratic, sd: Floats, c: Floats) -> Ints:
    """Indices of the functions whose coefficients `c` are some standard deviations from zero: MOST of them at most."""
    strength = np.abs(c) * np.sqrt(np.maximum(np.diag(quadratic.G), 0.0)) * (sd > 0.0)
    first = np.argsort(-strength, kind="stable")[:MOST]
    return np.sort(first[strength[first] > SEARCH_LIMITS.needed_sd])


def _without_remainder(fit: Fit, named: Hypothesis, take: Take) -> float:
    """Log-likelihood plus log prior of the names, less their price (nats), at a fit with a remainder."""
    names = fit.phi[: named.named_size]
    trusted = named.prior(names).log_density(names) if named.trusted_simulation is not None else 0.0
    return fit.log_likelihood + trusted - price_nats(len(named.effect_parameters), take.segments)


def _refit_from(fit: Fit, take: Take, hypothesis: Hypothesis, c: Floats) -> Fit | None:
    """The `hypothesis` refitted from a fit and whitened coefficients `c`, or from less of them where that diverges."""
    names = fit.phi[: hypothesis.named_size]
    for share in SHARES:
        phi = np.r_[names, share * c]
        found = none_if_diverged(refit, take, hypothesis, phi, fit.start, fit.scales, tangents=TANGENTS)
        if found is not None:
            return found
    return None


@kept_under("remainder_error", "min_wave_nats")
def explain(fit: Fit, take: Take, basis: RemainderBasis, copied: tuple[str, ...] = ()) -> Explained:
    """What a remainder explains beside a `fit`, to first order: smooth functions, and the waves that are needed.

    Segments that the remainder explains gain weight, as in the likelihood.  Copies of laws that have names may be there
    in the channels `copied`.
    """
    at = gather_information(fit, take, basis, np.zeros(len(basis.size)))
    seen = _reweigh(at, Explained.of_nothing(at, basis), copied, REWEIGHTINGS)
    for _ in range(MOST_WAVES):
        moved = at.weigh(seen.weights).names_beside(seen.c)
        # what gains less than smooth functions err by is not worth its refits
        least = SEARCH_LIMITS.remainder_error * seen.nats
        wave = find_wave(at, fit.car(), seen.weights, moved, seen.c, least)
        if wave is None:
            break
        before, basis = basis, add_waves(basis, [wave])
        if len(basis.tracking) == len(before.tracking):
            at = at.with_functions(basis, fit.car())
        else:
            at = gather_information(fit, take, basis, np.zeros(len(basis.size)))
        seen = _reweigh(at, seen.beside(basis), copied, 1)
    return seen


def explain_with_copies(seen: Explained, fit: Fit, take: Take) -> Explained:
    """What a remainder explains beside the `fit` where copies of laws that have names help, in any channel.

    `seen` is what it explains without, and its waves are those.
    """
    at = gather_information(fit, take, seen.basis, np.zeros(len(seen.basis.size)))
    return _reweigh(at, seen, CHANNELS, 1)


def _reweigh(at: TakeInformation, seen: Explained, copied: tuple[str, ...], times: int) -> Explained:
    """What a remainder explains, its spreads found and segments weighed anew so many `times`."""
    basis, weights, spread = seen.basis, seen.weights, seen.spread
    for _ in range(times):
        weighed = at.weigh(weights)
        quadratic = weighed.quadratic
        spread = likeliest_spreads(quadratic, basis, basis.groups(copied), spread)
        c = quadratic.posterior_mean(basis.sd(spread))
        weights = robust_weights(at.terms._replace(chi2=at.chi2_beside(weighed.names_beside(c), c)))
    return Explained(basis, spread, quadratic, c, weights)
