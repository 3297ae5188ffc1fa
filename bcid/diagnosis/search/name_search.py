"""Names for what a take shows: each must add more than chance beside a free remainder that may take its place.

Beside the names found so far stands a remainder, whose size is found by evidence.  Of all effects the score test says
what each would add beside it, to first order; the most promising are refitted in earnest, with the remainder found anew
beside them, and the best is a name if the evidence grows by more than the gate.  What the remainder still explains when
no name adds more is unknown.  The method as equations: docs/method.md.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.fit import (
    Explained,
    RemainderFit,
    add_beside_remainder,
    basis_for,
    explain,
    fit_with_remainder,
)
from bcid.diagnosis.remainder.functions import CHANNELS, RemainderBasis, is_copy
from bcid.diagnosis.search import refits
from bcid.diagnosis.search.corrections import fit_corrections, replace_delays_by_latency
from bcid.diagnosis.search.name_scores import score_names
from bcid.diagnosis.search.place_search import refine_places
from bcid.diagnosis.search.refits import effects_at_bounds, gain_nats, named_effects, refit_with_effects
from bcid.diagnosis.search.rivals import exchange_until_stable
from bcid.diagnosis.search.screen import (
    NO_NULLS,
    CandidateEffect,
    NullGains,
    sample_null_gains,
    screen_effects,
    simulate_trials,
)
from bcid.errors import PredictionDiverged
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import TrialChanges
from bcid.likelihood.take import Take

Report = Callable[[str], None]


class Naming(NamedTuple):
    """The names that a take gives, and what has none."""

    base: Fit
    corrected: Fit  # the base model with those of its own simplifications put right that are certainly wrong
    before: RemainderFit  # what is missing beside it
    rest: RemainderFit  # the fit with the names, and what is missing beside them
    gains: dict[str, float]  # nats by which each name makes the take likelier, beside the remainder and without it
    without: dict[str, Fit]  # the refit without each name
    rivals: tuple[Fit, ...]  # fits with one name exchanged for another, best first
    dropped: dict[str, float]  # effects that were tried or taken, with what they add beside the remainder
    nulls: NullGains  # what effects gain by chance

    @property
    def best(self) -> Fit:
        """The fit with the names."""
        return self.rest.named

    @property
    def unknown_nats(self) -> float:
        """Nats that the remainder adds beside the names; zero where chance may be all there is."""
        return self.rest.nats if self.rest.nats > self.nulls.gate else 0.0


class WeighedFit(NamedTuple):
    """A fit, and how likely the take is with it, whatever has no name integrated out."""

    named: Fit
    log_evidence: float


@dataclass
class NameSearch:
    """A search for names: what does not change, and what it has found so far."""

    take: Take
    basis: RemainderBasis
    trials: TrialChanges
    excluded: tuple[str, ...]
    trials_beside: tuple[str, ...]  # effects beside which these trials are
    nulls: NullGains = NO_NULLS
    tried: dict[frozenset[str], WeighedFit] = field(default_factory=dict)
    refused: dict[str, float] = field(default_factory=dict)

    @property
    def gate(self) -> float:
        """Nats that a name must add."""
        return self.nulls.gate

    def draw_nulls(self, rest: RemainderFit) -> None:
        """Find what effects gain by chance beside a fit and its remainder.

        Chance has nothing to do with what is missing, which the remainder has taken up; what it follows badly seems to
        be chance as long as it has no name.
        """
        self.nulls = sample_null_gains(rest.fit, self.take, self._trials(rest.named))

    def beside_remainder(self, fit: Fit, seen: Explained | None = None) -> RemainderFit:
        """The fit with the remainder of greatest evidence beside it; `seen` is what it explains to first order."""
        found = fit_with_remainder(fit, self.take, self.basis, seen=seen)
        return self._remember(found)

    def _remember(self, found: RemainderFit) -> RemainderFit:
        """Keep the evidence of a fit with these effects, the greatest that was found."""
        key = frozenset(found.named.hypothesis.effects)
        if key not in self.tried or self.tried[key].log_evidence < found.log_evidence:
            self.tried[key] = WeighedFit(found.named, found.log_evidence)
        return found

    def add_name(self, rest: RemainderFit, more: Sequence[Fit], report: Report) -> RemainderFit | None:
        """The fit with one name more of greatest evidence, if that grows by more than the gate.

        Tried are the effects that the score test promises most beside the remainder, and the fits `more`.
        """
        fit, take = rest.named, self.take
        promising = self._promising(rest)
        report(f"{', '.join(c.effect for c in promising) or 'none'} beside {', '.join(named_effects(fit)) or 'none'}")
        quick = (none_if_diverged(refits.refit_along_tangent, fit, take, c) for c in promising)
        promised = {c.effect: c.score for c in promising if c.score > 0.0}
        better = self._best_credible([*(refits.refit_fully(f, take) for f in quick if f), *more], rest, promised)
        if better is None and rest.nats > self.gate:
            # what the base model takes up shows beside no fit of it
            large = refits.refit_from_large_sizes(fit, take, (*self.excluded, *self.refused))
            better = self._best_credible(large, rest, {})
        return better

    def _promising(self, rest: RemainderFit) -> list[CandidateEffect]:
        """The effects that score tests promise most, beside the remainder, then without it.

        Where much is missing, first-order evidence of name against remainder is a small difference of large numbers,
        and what explains most without a remainder is worth a refit, too.
        """
        beside = self._promising_beside(rest)
        known = {c.effect for c in beside}
        trials = self._trials(rest.named)
        plain = [c for c in screen_effects(rest.named, self.take, trials) if c.score > self.gate]
        more = [c._replace(score=0.0) for c in plain[: SEARCH_LIMITS.plain_candidates] if c.effect not in known]
        return [*beside, *more]

    def _trials(self, fit: Fit) -> TrialChanges:
        """Changes of predicted poses by every effect that `fit` lacks and that is not refused or excluded."""
        if fit.hypothesis.effects != self.trials_beside:
            self.trials = simulate_trials(fit, self.take).without(self.excluded)
            self.trials_beside = fit.hypothesis.effects
        return self.trials.without((*fit.hypothesis.effects, *self.refused))

    def _promising_beside(self, rest: RemainderFit) -> list[CandidateEffect]:
        """The effects that the score test promises most beside the remainder, best first."""
        candidates = score_names(rest, self.take, self._trials(rest.named))
        least = max((SEARCH_LIMITS.near_best_share * c.score for c in candidates[:1]), default=0.0)
        near = [c for c in candidates if c.score > max(least, SEARCH_LIMITS.min_score_share * self.gate)]
        return near[: SEARCH_LIMITS.max_candidates]

    def _best_credible(
        self, fits: Sequence[Fit], rest: RemainderFit, promised: Mapping[str, float]
    ) -> RemainderFit | None:
        """The fit of greatest evidence of those of a size that a car may have, if it exceeds that of `rest` enough.

        `fits` have one effect more than `rest` each.  One whose evidence to first order cannot exceed that of `rest`
        enough, or that of another, is not refitted.  Where little comes of what the score test has `promised` of an
        effect, it is tried from the remainder of `rest`, too.
        """
        least, best = rest.log_evidence + self.gate, None
        # pushes shrink as a remainder explains them, so that it adds more than it promises to first order
        understated = max(1.0, rest.nats / max(rest.seen.nats, 1.0))
        credible = [f for f in fits if not effects_at_bounds(f, self.take)]
        explained = [(f, explain(f, self.take, self.basis)) for f in credible]
        explained.sort(key=lambda pair: -(pair[0].penalised_log_likelihood + pair[1].nats))
        for f, seen in explained:
            name, reached = f.hypothesis.effects[-1], -math.inf
            promise = understated * (1.0 + SEARCH_LIMITS.remainder_error) * seen.nats
            highest = f.penalised_log_likelihood + promise + SEARCH_LIMITS.near_nats
            if highest > max(least, best.log_evidence if best else least):
                found = self.beside_remainder(f, seen)
                reached, best = found.log_evidence, _greater(best, found)
            elif highest > least:
                continue
            kept = SEARCH_LIMITS.kept_promise * promised.get(name, 0.0)
            if name in promised and reached - rest.log_evidence < kept:
                found = self._remember(add_beside_remainder(rest, f, seen, self.take))
                reached, best = max(reached, found.log_evidence), _greater(best, found)
            if reached < least:
                added = reached if math.isfinite(reached) else highest
                self.refused[name] = added - rest.log_evidence
        return best if best and best.log_evidence > least else None

    def keep_names(self, rest: RemainderFit) -> tuple[RemainderFit, dict[str, float], dict[str, Fit]]:
        """The names that each add more than the gate, the nats of each, the refits without it; the least goes first.

        A name must add more than the share of the remainder, too, that smooth functions cannot follow.  The remainder
        beside the names may hold copies of laws that have names.
        """
        while True:
            without, full = self._without_each(rest), self._with_copies(rest)
            gains = {name: self._gain(rest, full, less) for name, less in without.items()}
            required = max(self.gate, SEARCH_LIMITS.remainder_error * full.nats)
            weakest = min(gains, key=lambda n: gains[n], default="")
            if not weakest or gains[weakest] > required:
                return full, gains, {name: less.named for name, less in without.items()}
            self.refused[weakest] = gains[weakest]
            rest = self.beside_remainder(without[weakest].named)

    def _gain(self, rest: RemainderFit, full: RemainderFit, less: WeighedFit) -> float:
        """Nats by which a name makes the take likelier, by the fit `less` it: the least of three comparisons.

        What helps only beside a remainder, or only without one, is no name.  Where a channel is needed beside all
        names, the copies of laws in it may take the name's place; elsewhere they may not, as no name could win.
        """
        gain = min(rest.log_evidence - less.log_evidence, gain_nats(rest.named, less.named))
        least = max(self.gate, SEARCH_LIMITS.needed_share * gain)
        needed = tuple(c for c, nats in full.seen.channel_nats().items() if nats > least) if full.nats > least else ()
        if gain < self.gate or not needed:
            return gain
        beside = fit_with_remainder(less.named, self.take, self.basis, needed)
        return min(gain, full.log_evidence - max(beside.log_evidence, less.log_evidence))

    def _with_copies(self, rest: RemainderFit) -> RemainderFit:
        """The fit `rest`, or that with copies of laws that have names in its remainder, if that is likelier."""
        seen = explain(rest.named, self.take, self.basis, CHANNELS)
        if not any(tau > 0.0 for name, tau in seen.spread.items() if is_copy(name)):
            return rest
        return _greater(rest, fit_with_remainder(rest.named, self.take, self.basis, CHANNELS, seen))

    def _without_each(self, rest: RemainderFit) -> dict[str, WeighedFit]:
        """For each name the refit without it, and its evidence."""
        out = dict[str, WeighedFit]()
        for name in named_effects(rest.named):
            held = tuple(n for n in rest.named.hypothesis.effects if n != name)
            if frozenset(held) not in self.tried:
                self.beside_remainder(refit_with_effects(rest.named, self.take, held))
            out[name] = self.tried[frozenset(held)]
        return out


def _greater(one: RemainderFit | None, other: RemainderFit) -> RemainderFit:
    """The fit of greater evidence of two."""
    return other if one is None or other.log_evidence > one.log_evidence else one


def name_effects(
    base: Fit, take: Take, excluded: Sequence[str] = (), reference_fit: Fit | None = None,
    report: Report = lambda text: None,
) -> Naming:  # fmt: skip
    """Name the effects that a take shows beside the fitted `base` model, but for those `excluded`.

    The first effect is also sought beside `reference_fit`, a reference model at its own parameters, since refitted
    parameters may hide what is missing.  `report` is called with a text in each round.
    """
    report("the base model's own simplifications")
    corrected = fit_corrections(base, take)
    report("a score test of every effect")
    trials = simulate_trials(corrected, take).without(excluded)
    basis = basis_for(corrected, take)
    search = NameSearch(take, basis, trials, tuple(excluded), corrected.hypothesis.effects)
    before = rest = search.beside_remainder(corrected)
    search.draw_nulls(rest)
    more = refit_beside_reference(reference_fit, take, excluded) if reference_fit else []
    while len(named_effects(rest.named)) < SEARCH_LIMITS.max_effects:
        better = search.add_name(rest, more, report)
        if better is None:
            break
        rest, more = better, []
        search.draw_nulls(rest)
    report("each name left out, and exchanged")
    fit = rest.named if "pose_latency" in excluded else replace_delays_by_latency(rest.named, take)
    fit = refine_places(fit, take)
    if fit is not rest.named:
        rest = search.beside_remainder(fit)
    rest, gains, without = search.keep_names(rest)
    others = exchange_until_stable(rest.named, take, trials, (base, corrected, *without.values()))
    if others.best is not rest.named:
        exchanged = search.beside_remainder(others.best)
        if exchanged.log_evidence > rest.log_evidence:
            rest, gains, without = search.keep_names(exchanged)
    return Naming(base, corrected, before, rest, gains, without, others.rivals, search.refused, search.nulls)


def refit_beside_reference(reference: Fit, take: Take, excluded: Sequence[str]) -> list[Fit]:
    """Joint refits with one effect more that start from a reference model's own parameters.

    `reference` is that model as a fit, not refitted.  The effects are those that a score test beside it promises most
    from, without those `excluded`.  Empty if predictions of the reference model diverge.
    """
    try:
        candidates = screen_effects(reference, take, simulate_trials(reference, take).without(excluded))
    except PredictionDiverged:
        return []
    first = candidates[: SEARCH_LIMITS.max_candidates]
    quick = (none_if_diverged(refits.refit_along_tangent, reference, take, c) for c in first)
    return [refits.refit_fully(f, take) for f in quick if f]
