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
from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.evidence import Quadratic, likeliest_spreads
from bcid.diagnosis.remainder.explain import Explained, explain_with_copies
from bcid.diagnosis.remainder.functions import RemainderBasis, is_copy
from bcid.diagnosis.remainder.information import gather_information
from bcid.effects.remainder_table import MOST
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.price import price_nats
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.refit_state import Effort
from bcid.likelihood.take import Take

ROUNDS = 4  # of refits, each with the spreads found at the one before
CONVERGED_NATS = 2.0  # that a further round is expected to gain, below which there is none
FIRST_TANGENTS, TANGENTS = 3, 8  # of the refit with functions found to first order, and of later ones


class RemainderFit(NamedTuple):
    """A fit, the remainder that is needed beside it, and what the two explain together."""

    named: Fit  # without the remainder
    fit: Fit  # with it; `named` itself where none is needed
    basis: RemainderBasis
    on: Ints  # indices in the basis of the functions that `fit` holds
    fitted: Floats  # (K,) their coefficients, zero for others
    spread: Mapping[str, float]  # of each channel, 0 where nothing is needed
    log_evidence: float  # log-likelihood, priors and prices of names, integrated over the remainder
    seen: Explained  # to first order, beside the names alone: those of its `effects`
    settled: bool = True  # False where refits diverged, or ended as they could not reach what they had to exceed

    @classmethod
    def without_functions(cls, fit: Fit, seen: Explained, basis: RemainderBasis | None = None) -> RemainderFit:
        """The `fit` alone, beside which a remainder of the functions of a `basis` would explain what is `seen`."""
        basis = basis or seen.basis
        none, nothing = np.zeros(0, dtype=np.int64), np.zeros(len(basis.size))
        zero = dict.fromkeys(basis.channels, 0.0)
        return cls(fit, fit, basis, none, nothing, zero, fit.penalised_log_likelihood, seen)

    @property
    def nats(self) -> float:
        """What the remainder adds beside the names."""
        return self.log_evidence - self.named.penalised_log_likelihood


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
    none, to = np.zeros(len(on)), seen.c[on] / sd[on]
    effort = Effort(FIRST_TANGENTS, least=_least_nats(seen.nats))
    further = _refit_towards(fit, take, hypothesis, none, to, seen.moved, effort)
    return _refit_until_stable(alone, on, further, take, copied, to_exceed)


@kept_under("near_nats")
def add_beside_remainder(rest: RemainderFit, named: Fit, take: Take, to_exceed: float = -np.inf) -> RemainderFit:
    """The fit `named`, which has effects more than that in `rest`, with a remainder found from that in `rest`.

    Where an effect stands beside others that have no name yet, its fit without them is far from where it belongs: here
    it begins beside what explains them, at no size, and first tries that of `named`.  Refits end where their evidence
    cannot reach `to_exceed`.  What is seen to first order is that of `rest`, as its effects tell.
    """
    more, phi, ahead = rest.fit.hypothesis, rest.fit.phi, rest.fit.phi
    known = named.hypothesis.effect_values(named.phi)
    for name in named.hypothesis.effects:
        if name in rest.fit.hypothesis.effects:
            continue
        values = [known[f] for f in more.entries[name].fields]
        off = [v if p.is_place else p.off for v, p in zip(values, more.entries[name].parameters, strict=True)]
        _, ahead = more.add_effect(name, ahead, values)
        more, phi = more.add_effect(name, phi, off)
    near, effort = rest.fit, Effort(TANGENTS, least=CONVERGED_NATS)
    further = none_if_diverged(refit, take, more, phi, near.start, near.scales, effort, ahead=(ahead,))
    alone = RemainderFit.without_functions(named, rest.seen, rest.basis)
    return _refit_until_stable(alone, rest.on, further, take, (), to_exceed, rounds=1)


@kept_under("near_nats")
def leave_out(rest: RemainderFit, lesser: Fit, take: Take) -> RemainderFit:
    """The fit `lesser`, which lacks one effect that is in `rest`, with a remainder found from that in `rest`.

    The functions there grow into the place of the effect.  What is seen to first order is that of `rest`, as its
    effects tell.
    """
    with_all, functions = rest.fit.hypothesis, rest.fit.phi[rest.fit.hypothesis.named_size :]
    values = with_all.effect_values(rest.fit.phi)
    hypothesis = replace(lesser.hypothesis, remainder=with_all.remainder)
    phi, near = lesser.hypothesis.phi_at(rest.fit.car(), values), rest.fit
    further = none_if_diverged(
        refit, take, hypothesis, np.r_[phi, functions], near.start, near.scales, Effort(least=CONVERGED_NATS),
        ahead=(np.r_[lesser.phi, functions],),
    )  # fmt: skip
    alone = RemainderFit.without_functions(lesser, rest.seen, rest.basis)
    return _refit_until_stable(alone, rest.on, further, take, (), -np.inf)


@kept_under("near_nats")
def converge_further(rest: RemainderFit, take: Take) -> RemainderFit:
    """The fit with its remainder after one more refit, from where it is; the same if that gains no evidence."""
    if not len(rest.on):
        return rest
    fit = rest.fit
    further = none_if_diverged(
        refit, take, fit.hypothesis, fit.phi, fit.start, fit.scales, Effort(least=CONVERGED_NATS)
    )
    return _refit_until_stable(rest, rest.on, further, take, (), -np.inf, rounds=1)


@kept_under("near_nats")
def allow_copies(rest: RemainderFit, take: Take, copied: tuple[str, ...]) -> RemainderFit:
    """The fit with copies of laws that have names among the functions beside it, in the channels `copied`.

    What is seen to first order is seen with them.  It is `rest` itself where they do not help.
    """
    if len(rest.on):
        found = _refit_until_stable(rest, rest.on, rest.fit, take, copied, -np.inf)
        helps = found is not rest
        return found._replace(seen=explain_with_copies(rest.named, take, rest.basis, copied)) if helps else rest
    seen = explain_with_copies(rest.named, take, rest.basis, copied)
    helps = any(tau > 0.0 for name, tau in seen.spread.items() if is_copy(name))
    return fit_with_remainder(rest.named, take, seen, copied) if helps else rest


def _refit_until_stable(
    best: RemainderFit, on: Ints, further: Fit | None, take: Take, copied: tuple[str, ...], to_exceed: float,
    rounds: int = ROUNDS,
) -> RemainderFit:  # fmt: skip
    """The fit of greatest evidence, of `best` and of refits from `further` on, which holds the functions `on`.

    After each refit spreads are found anew, and functions that are needed.  What a further round is expected to gain
    is more than all further ones do gain, as predictions bend.
    """
    basis, named, none = best.basis, best.named.hypothesis, np.zeros(len(best.basis.size))
    allowed, spread = basis.groups(copied), best.spread
    for round_ in range(rounds):
        if further is None:
            return best._replace(settled=round_ > 0)
        fitted = none.copy()
        fitted[on] = further.phi[named.named_size :] * further.hypothesis.remainder.sd
        at = none_if_diverged(gather_information, further, take, basis, fitted)
        if at is None:
            return best._replace(settled=round_ > 0)
        weighed = at.weigh(at.robust_weights)
        quadratic = weighed.quadratic
        spread = likeliest_spreads(quadratic, basis, allowed, spread)
        sd = basis.sd(spread)
        c = quadratic.posterior_mean(sd)
        # about none, to second order about the refit; integrated, this holds what a last step would gain
        about_none = _without_remainder(further, named, take) - quadratic.gain(fitted)
        nats = about_none + quadratic.log_evidence(sd) - basis.price(spread)
        gained = nats - best.log_evidence
        if nats > best.log_evidence:
            best = best._replace(fit=further, spread=spread, log_evidence=nats, on=on, fitted=fitted)
        prior = float(np.sum(_whiten(c, sd) ** 2 - _whiten(fitted, sd) ** 2))
        expected = quadratic.gain(c) - quadratic.gain(fitted) - 0.5 * prior
        least = _least_nats(best.nats)
        if expected < least or (round_ and gained < least):
            break
        if max(nats, best.log_evidence) + expected + SEARCH_LIMITS.near_nats < to_exceed:
            return best._replace(settled=False)
        needed = needed_functions(quadratic, sd, c)
        if not len(needed) or round_ == rounds - 1:
            break
        held = np.union1d(needed, on[sd[on] > 0.0])  # from these the refit can stay where it is
        on = held if len(held) <= MOST else needed
        hypothesis = replace(named, remainder=basis.choose(on, sd))
        moved, sd = weighed.names_beside(c), sd[on]
        further = _refit_towards(
            further, take, hypothesis, fitted[on] / sd, c[on] / sd, moved, Effort(TANGENTS, least=least)
        )
    return best


def _least_nats(remainder: float) -> float:
    """Nats that a further step, or round, must gain beside a remainder of so many nats."""
    return max(CONVERGED_NATS, SEARCH_LIMITS.converged_share * remainder)


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


def _refit_towards(
    fit: Fit, take: Take, hypothesis: Hypothesis, c: Floats, to: Floats, moved: Floats, effort: Effort
) -> Fit | None:
    """The `hypothesis` refitted from a fit and whitened coefficients `c`, first towards the coefficients `to`.

    Beside these, the parameters with names are likeliest where they have `moved`; but far from linear it may be better
    that they have not.  None if predictions diverge at the start.
    """
    names = fit.phi[: hypothesis.named_size]
    ahead = np.r_[names + moved, to], np.r_[names, to]
    return none_if_diverged(refit, take, hypothesis, np.r_[names, c], fit.start, fit.scales, effort, ahead=ahead)
