"""The rivals of a fit: its named effects with one of them left out, or exchanged for another."""

from collections.abc import Iterable
from typing import NamedTuple

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.search import refits
from bcid.diagnosis.search.place_search import refine_places
from bcid.diagnosis.search.screen import CandidateEffect, screen_effects
from bcid.effects.table import ENTRIES
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import TrialChanges
from bcid.likelihood.take import Take

MAX_EXCHANGE_ROUNDS = 3


class Alternatives(NamedTuple):
    """A fit with the refits that it is compared with."""

    best: Fit
    rivals: tuple[Fit, ...]  # each with one named effect exchanged, best first


def exchange_until_stable(fit: Fit, take: Take, trials: TrialChanges, known: Iterable[Fit]) -> Alternatives:
    """The fit and its rivals after exchanges of single named effects, while these raise the penalised log-likelihood.

    A rival is a fit with one effect exchanged for another.  `trials` are changes of predicted poses by the effects
    that may come in, for the score test.  `known` are fits with fewer effects, which are reused instead of refitted.
    """
    known = tuple(known)
    rivals: tuple[Fit, ...] = ()
    for _ in range(MAX_EXCHANGE_ROUNDS):
        without = leave_one_out(fit, known, take)
        rivals = distinct_rivals(fit, [*_refit_exchanges(fit, take, trials, without), *rivals])
        if not rivals or rivals[0].penalised_log_likelihood <= fit.penalised_log_likelihood:
            return Alternatives(fit, rivals)
        fit, rivals = refine_places(rivals[0], take), (fit, *rivals[1:])
    return Alternatives(fit, distinct_rivals(fit, rivals))


def distinct_rivals(best: Fit, fits: Iterable[Fit]) -> tuple[Fit, ...]:
    """The fits that differ from `best` by one effect exchanged for another, best penalised log-likelihood first.

    Of fits with equal sets of effects only the best is kept.
    """
    mine, found = set(best.hypothesis.effects), dict[frozenset[str], Fit]()
    for f in sorted(fits, key=lambda f: f.penalised_log_likelihood):
        theirs = frozenset(f.hypothesis.effects)
        if len(mine - theirs) == 1 and len(theirs - mine) == 1:
            found[theirs] = f
    return tuple(refits.rank_fits(found.values()))


def leave_one_out(fit: Fit, known: Iterable[Fit], take: Take) -> dict[str, Fit]:
    """The joint refits of `fit` without one of its named effects each, by that effect's id.

    A fit among the `known` that holds just the remaining effects is taken instead of a refit.
    """
    fits = {f.hypothesis.effects: f for f in known}
    without = {name: tuple(n for n in fit.hypothesis.effects if n != name) for name in refits.named_effects(fit)}
    return {n: fits.get(rest) or refits.refit_with_effects(fit, take, rest) for n, rest in without.items()}


def _refit_exchanges(fit: Fit, take: Take, trials: TrialChanges, without: dict[str, Fit]) -> list[Fit]:
    """Refits with one named effect of `fit` exchanged for another, by penalised log-likelihood, best first.

    `without` holds the refit without each named effect, by its id.  Into each come the effects that a score test
    beside that refit promises most, and those that may look like it; `trials` holds the changes of predicted poses by
    them.
    """
    held, found = fit.hypothesis.effects, list[Fit]()
    for name, less in without.items():
        near = SEARCH_LIMITS.near_best_share * refits.gain_nats(fit, less)
        candidates = screen_effects(less, take, trials.without(held))
        promising = [c for c in candidates[: SEARCH_LIMITS.max_exchanges] if c.score > near]
        # what it may look like is tried whatever a score test says, which sees no base parameter leave its bound
        alike = [c for c in candidates if c not in promising and c.effect in look_alikes(name)]
        for candidate in (*promising, *alike):
            exchanged = _refit_exchange(less, take, candidate)
            found += [exchanged] if exchanged else []
    return refits.rank_credible_fits(found, take)


def _refit_exchange(less: Fit, take: Take, candidate: CandidateEffect) -> Fit | None:
    """The fit `less` with a `candidate` effect, refitted quickly and then fully; None where predictions diverge.

    Where a quick refit has led to where the take is less likely than without the effect, it begins anew from there.
    """
    quick = none_if_diverged(refits.refit_along_tangent, less, take, candidate)
    found = refits.refit_fully(quick, take) if quick else None
    if found and refits.gain_nats(found, less) > 0.0:
        return found
    effects = (*less.hypothesis.effects, candidate.effect)
    return none_if_diverged(refits.refit_with_effects, less, take, effects, candidate.values)


def look_alikes(name: str) -> set[str]:
    """The effects that a recording may not tell from the one called `name`, as either's entry in the table says."""
    return {*ENTRIES[name].looks_like, *(other for other, entry in ENTRIES.items() if name in entry.looks_like)}
