"""Which effects a take shows: forward search by joint refits, backward elimination, and the rivals of what is left."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from bcid.diagnosis.hypothesis import Hypothesis
from bcid.diagnosis.refit import FIRST_ITERATIONS, Fit, refit
from bcid.diagnosis.screen import Candidate, screen
from bcid.diagnosis.take import Take
from bcid.physics.car import Car

MOST_EFFECTS = 4
SHORTLIST = 8
ALWAYS = 2.0  # nats of score below which a candidate is not refitted
GATE = 12.0  # nats of BIC that an effect must earn; chosen well above what nulls gave
RIVAL = 3.0  # nats within which two explanations cannot be told apart


@dataclass(frozen=True)
class Search:
    """The base fit, the accepted effects' joint fit, and refits that explain about as much."""

    base: Fit
    best: Fit
    rivals: tuple[Fit, ...]  # each with one accepted effect exchanged, best first
    shortlist: tuple[Candidate, ...]  # of the first step, most promising first

    @property
    def effects(self) -> tuple[str, ...]:
        """What was accepted, in the order of acceptance."""
        return self.best.hypothesis.effects


def search(base: Fit, take: Take, nominal: Car, progress: Callable[[str], None] = lambda text: None) -> Search:
    """Effects are added while they earn their place, then taken away where they no longer do."""
    best, tried = base, list[Fit]()
    first: tuple[Candidate, ...] = ()
    while len(best.hypothesis.effects) < MOST_EFFECTS:
        shortlist = [c for c in screen(best, take)[:SHORTLIST] if c.score > ALWAYS]
        first = first or tuple(shortlist)
        progress(f"{len(shortlist)} candidates after {', '.join(best.hypothesis.effects) or 'the base model'}")
        fits = [_added(best, candidate, take, nominal) for candidate in shortlist]
        if not fits:
            break
        found = max(fits, key=lambda fit: fit.bic)
        if found.bic - best.bic < GATE:
            break
        tried = [fit for fit in fits if fit is not found]
        best = refit(take, found.hypothesis, found.phi, found.start, found.scales)  # with its own sensitivities
    best = _without_idlers(best, take)
    rivals = sorted((f for f in tried if best.bic - f.bic < RIVAL), key=lambda f: -f.bic)
    return Search(base, best, tuple(rivals), first)


def _added(fit: Fit, candidate: Candidate, take: Take, nominal: Car) -> Fit:
    """The joint refit with one more effect, from the score test's values.

    Both the refitted base, which may have swallowed the effect, and the nominal one are tried.
    """
    base = fit.hypothesis
    more = Hypothesis((*base.effects, candidate.effect), base.nominal, base.angle_limit, base.constants)
    values = [*base.values(fit.phi).values(), *candidate.values]
    tried = [
        refit(take, more, more.start(car, values), fit.start, fit.scales, FIRST_ITERATIONS, fit.A)
        for car in (base.car(fit.phi), nominal)
    ]
    near = max(tried, key=lambda f: f.log_likelihood)
    return refit(take, more, near.phi, near.start, near.scales, known_A=fit.A)


def _without_idlers(fit: Fit, take: Take) -> Fit:
    """The fit without those of its effects that do not earn their place beside the others."""
    for name in fit.hypothesis.effects:
        if len(fit.hypothesis.effects) < 2:
            break
        kept = tuple(n for n in fit.hypothesis.effects if n != name)
        base = fit.hypothesis
        less = Hypothesis(kept, base.nominal, base.angle_limit, base.constants)
        old = base.values(fit.phi)
        values = [old[f] for f, _ in less.parameters]
        without = refit(take, less, less.start(base.car(fit.phi), values), fit.start, fit.scales, known_A=fit.A)
        if fit.bic - without.bic < GATE:
            return _without_idlers(without, take)
    return fit
