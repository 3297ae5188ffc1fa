"""Names that a take may have, one after the other: first with nothing beside them, then beside a remainder.

A remainder can take the place of several names at once, so that what each adds beside it is a small difference of large
numbers, and the wrong one may come first.  Together the right ones explain what it does.  Hence names are first added
as if there were nothing else.  Only where a remainder still explains something beside them, or none is found, they are
sought beside it: what has no name then stands in for itself.
"""

import math
from collections.abc import Callable, Mapping, Sequence

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.fit import RemainderFit, add_beside_remainder
from bcid.diagnosis.search import refits
from bcid.diagnosis.search.name_scores import score_names
from bcid.diagnosis.search.name_weights import NameWeights, greater_evidence
from bcid.diagnosis.search.refits import effects_at_bounds, gain_nats, named_effects
from bcid.diagnosis.search.screen import CandidateEffect, screen_effects
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.refit import Fit

Report = Callable[[str], None]

PLAIN_REFITS = 2  # of the effects that are most likely along one tangent, in earnest


def add_names_plainly(weights: NameWeights, fit: Fit, more: Sequence[Fit], report: Report) -> Fit:
    """The `fit` with names added one after the other, each that makes the take likeliest, nothing being beside it.

    Each must add more than the gate.  The first may be that of the fits `more`, too.
    """
    take = weights.take
    while len(named_effects(fit)) < SEARCH_LIMITS.max_effects:
        candidates = screen_effects(fit, take, weights.trials_for(fit))[: SEARCH_LIMITS.max_candidates]
        promising = [c for c in candidates if c.score > SEARCH_LIMITS.min_score_share * weights.gate]
        report_round(promising, fit, report)
        quick = (none_if_diverged(refits.refit_along_tangent, fit, take, c) for c in promising)
        first = refits.rank_credible_fits([*(f for f in quick if f), *more], take)[:PLAIN_REFITS]
        found = refits.rank_credible_fits((refits.refit_fully(f, take) for f in first), take)
        if not found or gain_nats(found[0], fit) < weights.gate:
            break
        fit, more = found[0], ()
    return fit


def add_names_beside_remainder(
    weights: NameWeights, rest: RemainderFit, more: Sequence[Fit], report: Report
) -> RemainderFit:
    """The fit with names added to `rest` one after the other, each that adds most to the evidence beside a remainder.

    Each must add more than the gate, which is drawn anew beside it.  The first may be that of the fits `more`, too.
    """
    while len(named_effects(rest.named)) < SEARCH_LIMITS.max_effects:
        weights.draw_nulls(rest)
        better = add_name(weights, rest, more, report)
        if better is None:
            break
        rest, more = better, ()
    return rest


def report_round(promising: Sequence[CandidateEffect], fit: Fit, report: Report) -> None:
    """Tell which effects are tried beside which names."""
    report(f"{', '.join(c.effect for c in promising) or 'none'} beside {', '.join(named_effects(fit)) or 'none'}")


def add_name(weights: NameWeights, rest: RemainderFit, more: Sequence[Fit], report: Report) -> RemainderFit | None:
    """The fit with one name more of greatest evidence, if that grows by more than the gate.

    Tried are the effects that the score test promises most beside the remainder, and the fits `more`.
    """
    fit, take = rest.named, weights.take
    promising = _promising(weights, rest)
    report_round(promising, fit, report)
    quick = (none_if_diverged(refits.refit_along_tangent, fit, take, c) for c in promising)
    promised = {c.effect: c.score for c in promising if c.score > 0.0}
    better = _best_credible(weights, [*(refits.refit_fully(f, take) for f in quick if f), *more], rest, promised)
    if better is None and rest.nats > weights.gate:
        # what the base model takes up shows beside no fit of it, and may have been refused from a small size
        large = refits.refit_from_large_sizes(fit, take, weights.excluded)
        better = _best_credible(weights, large, rest, {})
    return better


def _promising(weights: NameWeights, rest: RemainderFit) -> list[CandidateEffect]:
    """The effects that score tests promise most, beside the remainder, then without it.

    Where much is missing, first-order evidence of name against remainder is a small difference of large numbers,
    and what explains most without a remainder is worth a refit, too.
    """
    beside = _promising_beside(weights, rest)
    known = {c.effect for c in beside}
    trials = weights.trials_for(rest.named)
    plain = [c for c in screen_effects(rest.named, weights.take, trials) if c.score > weights.gate]
    more = [c._replace(score=0.0) for c in plain[: SEARCH_LIMITS.plain_candidates] if c.effect not in known]
    return [*beside, *more]


def _promising_beside(weights: NameWeights, rest: RemainderFit) -> list[CandidateEffect]:
    """The effects that the score test promises most beside the remainder, best first."""
    candidates = score_names(rest, weights.take, weights.trials_for(rest.named))
    least = max((SEARCH_LIMITS.near_best_share * c.score for c in candidates[:1]), default=0.0)
    near = [c for c in candidates if c.score > max(least, SEARCH_LIMITS.min_score_share * weights.gate)]
    return near[: SEARCH_LIMITS.max_candidates]


def _best_credible(
    weights: NameWeights, fits: Sequence[Fit], rest: RemainderFit, promised: Mapping[str, float]
) -> RemainderFit | None:
    """The fit of greatest evidence of those of a size that a car may have, if it exceeds that of `rest` enough.

    `fits` have one effect more than `rest` each.  One whose evidence to first order cannot exceed that of `rest`
    enough, or that of another, is not refitted.  Where little comes of what the score test has `promised` of an
    effect, it is tried from the remainder of `rest`, too.
    """
    least, best = rest.log_evidence + weights.gate, None
    # pushes shrink as a remainder explains them, so that it adds more than it promises to first order
    understated = max(1.0, rest.nats / max(rest.seen.nats, 1.0))
    credible = [f for f in fits if not effects_at_bounds(f, weights.take)]
    explained = [(f, weights.explain(f)) for f in credible]
    explained.sort(key=lambda pair: -(pair[0].penalised_log_likelihood + pair[1].nats))
    for f, seen in explained:
        name, reached = f.hypothesis.effects[-1], -math.inf
        promise = understated * (1.0 + SEARCH_LIMITS.remainder_error) * seen.nats
        highest = f.penalised_log_likelihood + promise + SEARCH_LIMITS.near_nats
        to_exceed = max(least, best.log_evidence) if best else least
        if highest > to_exceed:
            found = weights.beside_remainder(f, seen, to_exceed)
            reached, best = found.log_evidence, greater_evidence(best, found)
        elif highest > least:
            continue
        kept = SEARCH_LIMITS.kept_promise * promised.get(name, 0.0)
        if name in promised and reached - rest.log_evidence < kept:
            found = weights.remember(add_beside_remainder(rest, f, seen, weights.take, to_exceed))
            reached, best = max(reached, found.log_evidence), greater_evidence(best, found)
        if reached < least:
            added = reached if math.isfinite(reached) else highest
            weights.refused[name] = added - rest.log_evidence
    return best if best and best.log_evidence > least else None
