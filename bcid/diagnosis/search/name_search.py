"""Names for what a take shows: each must add more than chance beside a free remainder that may take its place.

Names are added as if nothing else were missing, and where that leaves something, beside a remainder
(`bcid.diagnosis.search.add_names`); of the two the more likely stands.  Then those go that count for too little
(`keep_names`), and each is exchanged for others (`rivals`).  The method as equations: docs/method.md.
"""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.chance import Chance, draw_chance
from bcid.diagnosis.remainder.explain import basis_for
from bcid.diagnosis.remainder.fit import RemainderFit
from bcid.diagnosis.search import refits
from bcid.diagnosis.search.add_names import Report, add_names_beside_remainder, add_names_plainly, weigh_plain_names
from bcid.diagnosis.search.corrections import fit_corrections, replace_delays_by_latency
from bcid.diagnosis.search.keep_names import KeptNames, keep_names
from bcid.diagnosis.search.name_scores import score_names
from bcid.diagnosis.search.place_search import refine_places
from bcid.diagnosis.search.refits import named_effects
from bcid.diagnosis.search.rivals import distinct_rivals, exchange_until_stable
from bcid.diagnosis.search.screen import NullGains, screen_effects, simulate_trials
from bcid.diagnosis.search.search_state import SearchState, greater_evidence
from bcid.effects.table import EFFECTS
from bcid.errors import PredictionDiverged
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import Take

MAX_EXCHANGES = 2  # rounds, each of exchanges and of what stays after them


class Naming(NamedTuple):
    """The names that a take gives, and what has none."""

    base: Fit
    corrected: Fit  # the base model with those of its own simplifications put right that are certainly wrong
    before: RemainderFit  # what is missing beside it
    rest: RemainderFit  # the fit with the names, and what is missing beside them, copies of laws that have names too
    gains: dict[str, float]  # nats by which each name makes the take likelier, beside the remainder and without it
    without: dict[str, Fit]  # the refit without each name
    rivals: tuple[Fit, ...]  # fits with one name exchanged for another, best first
    dropped: dict[str, float]  # effects that were tried or taken, with what they add beside the remainder at most
    others: dict[str, float]  # nats that each effect without a name would add beside the names, to first order
    nulls: NullGains  # what effects gain by chance
    chance: Chance | None = None  # of a remainder beside the names; none where it is below the gate
    gates: Mapping[str, float] = MappingProxyType({})  # nats that each name has had to exceed

    def gate_of(self, *effects: str) -> float:
        """Nats that each of some effects must add, or the one of them that must add most; of none the overall gate."""
        return max((self.gates.get(name, self.nulls.gate_of(name)) for name in effects), default=self.nulls.gate)

    @property
    def best(self) -> Fit:
        """The fit with the names."""
        return self.rest.named

    @property
    def unknown_nats(self) -> float:
        """Nats that the remainder adds beside the names; zero where chance may be all there is."""
        by_chance = self.chance.reached_with(SEARCH_LIMITS.gate_p_value) if self.chance else 0.0
        return self.rest.nats if self.rest.nats > max(self.nulls.gate, by_chance) else 0.0


def name_effects(
    base: Fit, take: Take, excluded: Sequence[str] = (), others: Sequence[Fit] = (), given: Fit | None = None,
    report: Report = lambda text: None,
) -> Naming:  # fmt: skip
    """Name the effects that a take shows beside the fitted `base` model, but for those `excluded`.

    The first effect is also sought from large sizes; beside a simulation as it is `given`, since refitted parameters
    may hide what is missing; and beside `others`, fits of the base model in other basins, of which an effect may make
    one the likeliest.
    `report` is called with a text in each round.
    """
    report("the base model's own simplifications")
    corrected = fit_corrections(base, take)
    report("a score test of every effect")
    state = SearchState(take, basis_for(corrected, take), tuple(excluded), given=given)
    before = state.beside_remainder(corrected)
    if before.nats > 0.0:
        before = state.beside_remainder_from_given(before)
    state.draw_nulls(before)
    starts = [given, *others] if given else others
    more = [f for start in starts for f in refit_beside(start, corrected, take, excluded)]
    if before.nats > state.gate:
        more += state.from_large_sizes(corrected)
        if given:
            more += refits.refit_from_simulation(given, corrected, take, excluded)
    rest = _add_names(state, before, more, report)
    report("each name left out, and exchanged")
    fit = rest.named if "pose_latency" in excluded else replace_delays_by_latency(rest.named, take)
    refined = state.with_own_view(state.weigh_anew(refine_places(fit, take)))
    kept = _keep_and_seek_again(state, refined, report)
    kept, rivals = _exchange_names(state, kept, (base, corrected))
    state.draw_nulls(kept.rest)
    dropped = {name: nats for name, nats in state.added.items() if name not in kept.gains}
    return Naming(
        base, corrected, before, rest=kept.full, gains=kept.gains, without=kept.without, rivals=rivals,
        dropped=dropped, others=_score_others(state, kept.rest, dropped), nulls=state.nulls,
        chance=_chance_beside(state, kept.full), gates={name: state.gate_of_held(name) for name in kept.gains},
    )  # fmt: skip


def _chance_beside(state: SearchState, rest: RemainderFit) -> Chance | None:
    """What a remainder explains by chance beside a fit and its remainder; None where that is below the gate.

    Chance has nothing to do with what is missing, which the remainder has taken up.
    """
    return draw_chance(rest.fit, state.take, state.basis) if rest.nats > state.gate else None


def _score_others(state: SearchState, rest: RemainderFit, tried: Mapping[str, float]) -> dict[str, float]:
    """Nats that each effect without a name would add beside a fit and its remainder, most first.

    They are found to first order, and no more than a refit gained wherever it was `tried`.  Effects of which the take
    has no information are left out.
    """
    scores = score_names(rest, state.take, state.trials_beside(rest.named))
    promised = [c for c in scores if c.effect in EFFECTS]
    nats = {c.effect: min(c.score, tried.get(c.effect, c.score)) for c in promised}
    return dict(sorted(nats.items(), key=lambda pair: -pair[1]))


def _add_names(state: SearchState, before: RemainderFit, more: Sequence[Fit], report: Report) -> RemainderFit:
    """The likeliest fit with names added to that `before`, chance drawn beside it."""
    plain = weigh_plain_names(state, before, add_names_plainly(state, before.named, more, report))
    state.draw_nulls(plain)
    if plain.nats <= state.gate:
        return plain
    beside = add_names_beside_remainder(state, before, more, report)
    before = state.remember(before)  # as the search has refitted it
    required = state.required_nats(plain.nats, *named_effects(plain.named))
    enough = plain.log_evidence > before.log_evidence + required
    best = greater_evidence(beside, plain) if enough else beside
    state.draw_nulls(best)
    return best


def _keep_and_seek_again(state: SearchState, rest: RemainderFit, report: Report) -> KeptNames:
    """The names of `rest` that stay, and those that come in for what one that went had explained."""
    kept = keep_names(state, rest)
    if kept.rest.nats - rest.nats > state.gate:
        # what was refused beside names that went may count beside those that are left
        state.refused = set(named_effects(rest.named)) - set(named_effects(kept.rest.named))
        kept = keep_names(state, add_names_beside_remainder(state, kept.rest, (), report))
    return kept


def _exchange_names(state: SearchState, kept: KeptNames, known: Sequence[Fit]) -> tuple[KeptNames, tuple[Fit, ...]]:
    """The names after exchanges of single ones that raise the evidence, and their rivals, best first.

    `known` are fits with fewer effects.
    """
    for exchanges in range(MAX_EXCHANGES + 1):
        trials = state.trials_beside(kept.rest.named)
        others = exchange_until_stable(kept.rest.named, state.take, trials, (*known, *kept.without.values()))
        exchanged = state.with_own_view(state.weigh_anew(others.best))
        if exchanged.log_evidence <= kept.rest.log_evidence or exchanges == MAX_EXCHANGES:
            break
        again = keep_names(state, exchanged)
        if again.rest.log_evidence <= kept.rest.log_evidence:
            break  # what came in has not stayed
        kept = again
    return kept, distinct_rivals(kept.rest.named, (others.best, *others.rivals))


def refit_beside(other: Fit, corrected: Fit, take: Take, excluded: Sequence[str]) -> list[Fit]:
    """Joint refits of the `corrected` base model with one effect more, from the parameters of an `other` fit.

    That has no effects but the base model's.  Those that come in are the ones from which a score test beside it
    promises most, without those `excluded`.  Empty if its predictions diverge.
    """
    try:
        candidates = screen_effects(other, take, simulate_trials(other, take).without(excluded))
    except PredictionDiverged:
        return []
    more = list[Fit]()
    first = candidates[: SEARCH_LIMITS.max_candidates]
    new = [c for c in first if c.effect not in corrected.hypothesis.effects]
    for quick in refits.refit_candidates_along_tangent(other, take, new):
        values = corrected.hypothesis.effect_values(corrected.phi) | quick.hypothesis.effect_values(quick.phi)
        hypothesis = corrected.hypothesis.with_effects(*corrected.hypothesis.effects, quick.hypothesis.effects[-1])
        phi = hypothesis.phi_at(quick.car(), values)
        found = none_if_diverged(refit, take, hypothesis, phi, quick.start, quick.scales)
        more += [found] if found else []
    return more
