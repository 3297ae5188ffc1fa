"""Names for what a take shows: each must add more than chance beside a free remainder that may take its place.

Names are added as if nothing else were missing, and where that leaves something, beside a remainder
(`bcid.diagnosis.search.add_names`); of the two the more likely stands.  Then those go that count for too little
(`name_weights`), and each is exchanged for others (`rivals`).  The method as equations: docs/method.md.
"""

from collections.abc import Sequence
from typing import NamedTuple

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.fit import RemainderFit, basis_for
from bcid.diagnosis.search import refits
from bcid.diagnosis.search.add_names import Report, add_names_beside_remainder, add_names_plainly
from bcid.diagnosis.search.corrections import fit_corrections, replace_delays_by_latency
from bcid.diagnosis.search.name_weights import NameWeights, greater_evidence
from bcid.diagnosis.search.place_search import refine_places
from bcid.diagnosis.search.rivals import exchange_until_stable
from bcid.diagnosis.search.screen import NullGains, screen_effects, simulate_trials
from bcid.errors import PredictionDiverged
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take


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
    weights = NameWeights(take, basis_for(corrected, take), trials, tuple(excluded), corrected.hypothesis.effects)
    before = weights.beside_remainder(corrected)
    weights.draw_nulls(before)
    more = refit_beside_reference(reference_fit, take, excluded) if reference_fit else []
    rest = _add_names(weights, before, more, report)
    report("each name left out, and exchanged")
    fit = rest.named if "pose_latency" in excluded else replace_delays_by_latency(rest.named, take)
    fit = refine_places(fit, take)
    kept = weights.keep_names(rest if fit is rest.named else weights.beside_remainder(fit))
    if kept.rest.nats > weights.gate >= rest.nats:
        # a name went that had explained what is left now
        kept = weights.keep_names(add_names_beside_remainder(weights, kept.rest, (), report))
    others = exchange_until_stable(kept.rest.named, take, trials, (base, corrected, *kept.without.values()))
    if others.best is not kept.rest.named:
        exchanged = weights.beside_remainder(others.best)
        if exchanged.log_evidence > kept.rest.log_evidence:
            kept = weights.keep_names(exchanged)
    dropped = {name: nats for name, nats in weights.refused.items() if name not in kept.gains}
    return Naming(base, corrected, before, *kept, others.rivals, dropped, weights.nulls)


def _add_names(weights: NameWeights, before: RemainderFit, more: Sequence[Fit], report: Report) -> RemainderFit:
    """The likeliest fit with names added to that `before`, chance drawn beside it."""
    plain = before
    fit = add_names_plainly(weights, before.named, more, report)
    if fit is not before.named:
        plain = weights.beside_remainder(fit)
        weights.draw_nulls(plain)
    if plain.nats <= weights.gate:
        return plain
    beside = add_names_beside_remainder(weights, before, more, report)
    best = greater_evidence(beside, plain)
    if best is plain:
        weights.draw_nulls(plain)
    return best


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
