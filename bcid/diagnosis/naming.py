"""Names for what a take shows: each must add more than chance beside a free remainder that may take its place.

Beside the names found so far stands a remainder, whose size is found by evidence.  Of all effects the score test says
what each would add beside it, to first order; the most promising are refitted in earnest, with the remainder found anew
beside them, and the best is a name if the evidence grows by more than the gate.  What the remainder still explains when
no name adds more is unknown.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.fit import RemainderFit, basis_for, fit_with_remainder
from bcid.diagnosis.remainder.functions import RemainderBasis
from bcid.diagnosis.remainder.scores import score_names
from bcid.diagnosis.search import refits
from bcid.diagnosis.search.forward_backward import _fit_corrections, _replace_delays_by_latency
from bcid.diagnosis.search.place_search import refine_places
from bcid.diagnosis.search.refits import effects_at_bounds, gain_nats, named_effects, refit_with_effects
from bcid.diagnosis.search.screen import NullGains, sample_null_gains, simulate_trials
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take

Report = Callable[[str], None]
MOST_REFITS = 3  # candidates of a round that are refitted in earnest
NEAR_BEST = 0.3  # share of the best score from which a candidate is


class Naming(NamedTuple):
    """The names that a take gives, and what has none."""

    base: Fit
    corrected: Fit
    best: Fit  # with the names
    rest: RemainderFit  # what is left beside them
    gains: dict[str, float]  # nats by which each name makes the take likelier beside the remainder
    plain_gains: dict[str, float]  # and without it
    dropped: tuple[tuple[str, float], ...]  # effects that were tried or taken, with what they add beside it
    nulls: NullGains
    basis: RemainderBasis


def name_effects(base: Fit, take: Take, excluded: Sequence[str] = (), report: Report = lambda text: None) -> Naming:
    """Name the effects that a take shows beside the fitted `base` model, but for those `excluded`."""
    report("the base model's own simplifications")
    corrected = _fit_corrections(base, take)
    basis = basis_for(corrected, take)
    report("a score test of every effect")
    trials = simulate_trials(corrected, take).without(excluded)
    rest, refused = fit_with_remainder(corrected, take, basis), dict[str, float]()
    # chance has nothing to do with what is missing, which the remainder has taken up
    nulls = sample_null_gains(rest.fit, take, trials)
    known = {frozenset(corrected.hypothesis.effects): rest}
    while len(named_effects(rest.named)) < SEARCH_LIMITS.max_effects_under_pushes:
        fit = rest.named
        scored = score_names(fit, take, basis, trials.without((*fit.hypothesis.effects, *refused)))
        first = [c for c in scored.candidates if c.score > SEARCH_LIMITS.min_score_nats]
        first = [c for c in first if c.score > NEAR_BEST * first[0].score][:MOST_REFITS]
        promising = ", ".join(c.effect for c in first) or "none"
        report(f"{promising} beside {', '.join(fit.hypothesis.effects) or 'the base model'}")
        tried = [none_if_diverged(refits.refit_along_tangent, fit, take, c) for c in first]
        better = _best_beside_remainder([refits.refit_fully(f, take) for f in tried if f], take, basis, refused, rest)
        if (better is None or better.log_evidence < rest.log_evidence + nulls.gate) and rest.nats > nulls.gate:
            # what the base model takes up shows beside no fit of it
            large = refits.refit_from_large_sizes(fit, take, (*excluded, *refused))
            better = _best_beside_remainder(large, take, basis, refused, rest)
        if better is None or better.log_evidence < rest.log_evidence + nulls.gate:
            break
        rest = better
        known[frozenset(rest.named.hypothesis.effects)] = rest
    return _keep_names(base, corrected, rest, take, excluded, nulls, basis, refused, known)


def _best_beside_remainder(
    fits: Sequence[Fit], take: Take, basis: RemainderBasis, refused: dict[str, float], rest: RemainderFit
) -> RemainderFit | None:
    """The fit of greatest evidence with a remainder beside it, of those of a size that a car may have."""
    found = [fit_with_remainder(f, take, basis) for f in fits if not effects_at_bounds(f, take)]
    best = max(found, key=lambda f: f.log_evidence, default=None)
    for f in found:
        gained = f.log_evidence - rest.log_evidence
        if gained < SEARCH_LIMITS.min_score_nats:
            refused[f.named.hypothesis.effects[-1]] = gained
    return best


def _keep_names(
    base: Fit, corrected: Fit, rest: RemainderFit, take: Take, excluded: Sequence[str], nulls: NullGains,
    basis: RemainderBasis, refused: dict[str, float], known: dict[frozenset[str], RemainderFit],
) -> Naming:  # fmt: skip
    """The names that add more than the gate beside the remainder and each other; the least goes first.

    Fits with fewer effects that are `known` from the search are not made again.
    """
    fit = rest.named
    if "pose_latency" not in excluded:
        fit = _replace_delays_by_latency(fit, take)
    fit = refine_places(fit, take)
    if fit is not rest.named:
        rest = fit_with_remainder(fit, take, basis)
    while True:
        gains, plain, without = dict[str, float](), dict[str, float](), dict[str, RemainderFit]()
        for name in named_effects(rest.named):
            held = tuple(n for n in rest.named.hypothesis.effects if n != name)
            less = known.get(frozenset(held))
            without[name] = less or fit_with_remainder(refit_with_effects(rest.named, take, held), take, basis)
            plain[name] = gain_nats(rest.named, without[name].named)
            # what helps only beside a remainder, or only without one, is none
            gains[name] = min(rest.log_evidence - without[name].log_evidence, plain[name])
        weakest = min(gains, key=lambda n: gains[n], default="")
        if not weakest or gains[weakest] > nulls.gate:
            return Naming(base, corrected, rest.named, rest, gains, plain, tuple(refused.items()), nulls, basis)
        refused[weakest] = gains[weakest]
        rest = without[weakest]
