"""Names for what a take shows: each must add more than chance beside a free remainder that may take its place.

Beside the names found so far stands a remainder, whose size is found by evidence.  Of all effects the score test says
what each would add beside it, to first order; the most promising are refitted in earnest, with the remainder found anew
beside them, and the best is a name if the evidence grows by more than the gate.  What the remainder still explains when
no name adds more is unknown.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.fit import RemainderFit, basis_for, explain, fit_with_remainder
from bcid.diagnosis.remainder.functions import RemainderBasis
from bcid.diagnosis.remainder.scores import score_names
from bcid.diagnosis.search import refits
from bcid.diagnosis.search.forward_backward import _fit_corrections, _replace_delays_by_latency
from bcid.diagnosis.search.place_search import refine_places
from bcid.diagnosis.search.refits import effects_at_bounds, gain_nats, named_effects, refit_with_effects
from bcid.diagnosis.search.screen import NullGains, sample_null_gains, simulate_trials
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import TrialChanges
from bcid.likelihood.take import Take

Report = Callable[[str], None]
MOST_REFITS = 4  # candidates of a round that are refitted
NEAR_BEST = 0.2  # share of the best score from which a candidate is
ACCURACY = 0.03  # share of what a remainder explains that smooth functions and waves cannot follow
NEAR_NATS = 10.0  # and nats within which an evidence to first order decides nothing


class Naming(NamedTuple):
    """The names that a take gives, and what has none."""

    base: Fit
    corrected: Fit
    before: RemainderFit  # what is missing beside the corrected base model
    rest: RemainderFit  # the fit with the names, and what is left beside it
    gains: dict[str, float]  # nats by which each name makes the take likelier, beside the remainder and without it
    dropped: dict[str, float]  # effects that were tried or taken, with what they add beside it
    nulls: NullGains
    tried: dict[frozenset[str], RemainderFit]  # all that were refitted beside a remainder, by their effects

    @property
    def best(self) -> Fit:
        """The fit with the names."""
        return self.rest.named


@dataclass
class NameSearch:
    """A search for names: what does not change, and what it has found so far."""

    take: Take
    basis: RemainderBasis
    trials: TrialChanges
    excluded: tuple[str, ...]
    gate: float = 0.0
    tried: dict[frozenset[str], RemainderFit] = field(default_factory=dict)
    refused: dict[str, float] = field(default_factory=dict)

    def beside_remainder(self, fits: Iterable[Fit], floor: float = -float("inf")) -> list[RemainderFit]:
        """The fits, each with the remainder of greatest evidence beside it, the greatest evidence first.

        Left out are those whose evidence to first order lies clearly below that of another one, or below the `floor`.
        """
        explained = [(f, explain(f, self.take, self.basis)) for f in fits]
        explained.sort(key=lambda pair: -(pair[0].penalised_log_likelihood + pair[1].nats))
        found = list[RemainderFit]()
        for f, seen in explained:
            reach = f.penalised_log_likelihood + (1.0 + ACCURACY) * seen.nats + NEAR_NATS
            if reach < max(floor, max((r.log_evidence for r in found), default=floor)):
                continue
            found.append(fit_with_remainder(f, self.take, self.basis, seen=seen))
            self.tried[frozenset(f.hypothesis.effects)] = found[-1]
        return sorted(found, key=lambda r: -r.log_evidence)

    def add_name(self, rest: RemainderFit, report: Report) -> RemainderFit | None:
        """The fit with one name more of greatest evidence, if that grows by more than the gate."""
        fit, take = rest.named, self.take
        trials = self.trials.without((*fit.hypothesis.effects, *self.refused))
        first = [c for c in score_names(fit, take, rest.seen, trials).candidates if c.score > self.gate / 2.0]
        first = [c for c in first if c.score > NEAR_BEST * first[0].score][:MOST_REFITS]
        report(f"{', '.join(c.effect for c in first) or 'none'} beside {', '.join(named_effects(fit)) or 'the base'}")
        quick = [none_if_diverged(refits.refit_along_tangent, fit, take, c) for c in first]
        better = self._best_credible([refits.refit_fully(f, take) for f in quick if f], rest)
        if better is None and rest.nats > self.gate:
            # what the base model takes up shows beside no fit of it
            large = refits.refit_from_large_sizes(fit, take, (*self.excluded, *self.refused))
            better = self._best_credible(large, rest)
        return better

    def _best_credible(self, fits: Sequence[Fit], rest: RemainderFit) -> RemainderFit | None:
        """The fit of greatest evidence of those of a size that a car may have, if it is greater than that of `rest`."""
        credible = [f for f in fits if not effects_at_bounds(f, self.take)]
        found = self.beside_remainder(credible)
        for r in found:
            gained = r.log_evidence - rest.log_evidence
            if gained < self.gate:
                self.refused[r.named.hypothesis.effects[-1]] = gained
        return found[0] if found and found[0].log_evidence > rest.log_evidence + self.gate else None

    def without_each(self, rest: RemainderFit) -> dict[str, RemainderFit]:
        """For each name the fit without it, with the remainder of greatest evidence beside it."""
        out = dict[str, RemainderFit]()
        for name in named_effects(rest.named):
            held = tuple(n for n in rest.named.hypothesis.effects if n != name)
            less = self.tried.get(frozenset(held))
            out[name] = less or self.beside_remainder([refit_with_effects(rest.named, self.take, held)])[0]
        return out


def name_effects(base: Fit, take: Take, excluded: Sequence[str] = (), report: Report = lambda text: None) -> Naming:
    """Name the effects that a take shows beside the fitted `base` model, but for those `excluded`."""
    report("the base model's own simplifications")
    corrected = _fit_corrections(base, take)
    report("a score test of every effect")
    trials = simulate_trials(corrected, take).without(excluded)
    search = NameSearch(take, basis_for(corrected, take), trials, tuple(excluded))
    before = rest = search.beside_remainder([corrected])[0]
    # chance has nothing to do with what is missing, which the remainder has taken up
    nulls = sample_null_gains(rest.fit, take, trials)
    search.gate = nulls.gate
    while len(named_effects(rest.named)) < SEARCH_LIMITS.max_effects_under_pushes:
        better = search.add_name(rest, report)
        if better is None:
            break
        rest = better
    fit = rest.named if "pose_latency" in excluded else _replace_delays_by_latency(rest.named, take)
    fit = refine_places(fit, take)
    if fit is not rest.named:
        rest = search.beside_remainder([fit])[0]
    rest, gains = _keep_names(rest, search)
    return Naming(base, corrected, before, rest, gains, search.refused, nulls, search.tried)


def _keep_names(rest: RemainderFit, search: NameSearch) -> tuple[RemainderFit, dict[str, float]]:
    """The names that add more than the gate beside the remainder and each other, and the nats; the least goes first."""
    while True:
        without = search.without_each(rest)
        # what helps only beside a remainder, or only without one, is no name
        gains = {
            name: min(rest.log_evidence - less.log_evidence, gain_nats(rest.named, less.named))
            for name, less in without.items()
        }
        required = max(search.gate, ACCURACY * rest.nats)
        weakest = min(gains, key=lambda n: gains[n], default="")
        if not weakest or gains[weakest] > required:
            return rest, gains
        search.refused[weakest] = gains[weakest]
        rest = without[weakest]
