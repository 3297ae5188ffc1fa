"""Names that a take may have, one after the other: first with nothing beside them, then beside a remainder.

A remainder can take the place of several names at once, so that what each adds beside it is a small difference of large
numbers, and the wrong one may come first.  Together the right ones explain what it does.  Hence names are first added
as if there were nothing else.  Only where a remainder still explains something beside those that were found, they are
sought beside it: what has no name then stands in for itself.
"""

from collections.abc import Callable, Mapping, Sequence

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.fit import RemainderFit, add_beside_remainder, converge_further
from bcid.diagnosis.search import refits
from bcid.diagnosis.search.name_scores import score_names
from bcid.diagnosis.search.refits import gain_nats, named_effects
from bcid.diagnosis.search.screen import CandidateEffect, screen_effects
from bcid.diagnosis.search.search_state import SearchState, greater_evidence
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import TrialChanges

Report = Callable[[str], None]

PLAIN_REFITS = 2  # of the effects that are most likely along one tangent, in earnest


def add_names_plainly(state: SearchState, fit: Fit, more: Sequence[Fit], report: Report) -> Fit:
    """The `fit` with names added one after the other, each that makes the take likeliest, nothing being beside it.

    Each must add more than its gate, and more than what has no name beside it may pass for.  The first may be that of
    the fits `more`, too.
    """
    take = state.take
    while len(named_effects(fit)) < SEARCH_LIMITS.max_effects:
        candidates = screen_effects(fit, take, state.trials_beside(fit))
        promising = [c for c in candidates if c.score > SEARCH_LIMITS.min_score_share * state.gate_of(c.effect)]
        promising = promising[: SEARCH_LIMITS.max_candidates]
        report_round(promising, fit, report)
        quick = refits.refit_candidates_along_tangent(fit, take, promising)
        first = refits.rank_credible_fits(quick, take)[:PLAIN_REFITS]
        found = refits.rank_credible_fits([*(refits.refit_fully(f, take) for f in first), *more], take)
        better = next((f for f in found if _counts_plainly(state, f, fit)), None)
        if better is None:
            break
        fit, more = better, ()
    return fit


def _counts_plainly(state: SearchState, found: Fit, fit: Fit) -> bool:
    """Whether the effect that `found` has more than `fit` adds as much as it must, with nothing beside it."""
    name, gained = found.hypothesis.effects[-1], gain_nats(found, fit)
    # what a remainder explains is costly to find, and not asked of what falls short of its gate
    return gained >= state.gate_of(name) and gained >= state.required_nats(state.explain(found).nats, name)


def weigh_plain_names(state: SearchState, rest: RemainderFit, fit: Fit) -> RemainderFit:
    """The `fit`, with names that were added plainly to that of `rest`, with the remainder of greatest evidence.

    It is weighed anew, and unless it explains most of what the remainder of `rest` does, beside that remainder, too.
    """
    anew = state.weigh_anew(fit)
    if fit is rest.named or _explains_most(fit, rest):
        return anew
    return greater_evidence(anew, state.with_own_view(state.remember(add_beside_remainder(rest, fit, state.take))))


def add_names_beside_remainder(
    state: SearchState, rest: RemainderFit, more: Sequence[Fit], report: Report
) -> RemainderFit:
    """The fit with names added to `rest` one after the other, each that adds most to the evidence beside a remainder.

    Each must add more than its gate, which is drawn anew beside it.  The first may be that of the fits `more`, too.
    """
    while len(named_effects(rest.named)) < SEARCH_LIMITS.max_effects:
        state.draw_nulls(rest)
        better = add_name(state, rest, more, report)
        if better is None:
            break
        rest, more = better, ()
    return state.remember(rest)


def report_round(promising: Sequence[CandidateEffect], fit: Fit, report: Report) -> None:
    """Tell which effects are tried beside which names."""
    report(f"{', '.join(c.effect for c in promising) or 'none'} beside {', '.join(named_effects(fit)) or 'none'}")


def add_name(state: SearchState, rest: RemainderFit, more: Sequence[Fit], report: Report) -> RemainderFit | None:
    """The fit with one name more of greatest evidence, if that grows by more than its gate.

    Tried are the effects that the score test promises most beside the remainder, and the fits `more`.
    """
    # what a refit that had not ended gains is not to be the first name's
    rest = state.remember(converge_further(rest, state.take))
    fit, take = rest.named, state.take
    promising = _promising(state, rest)
    report_round(promising, fit, report)
    quick = refits.refit_candidates_along_tangent(fit, take, promising)
    promised = {c.effect: c.score for c in promising if c.score > 0.0}
    better = _best_credible(state, quick, rest, promised, more)
    if better is None and rest.nats > state.gate:
        # what the base model takes up shows beside no fit of it, and may have been refused from a small size
        large = [f for f in state.from_large_sizes(fit) if all(f is not tried for tried in more)]
        better = _best_credible(state, large, rest, {})
    return better


def _promising(state: SearchState, rest: RemainderFit) -> list[CandidateEffect]:
    """The effects that score tests promise most, beside the remainder, then without it.

    Where much is missing, first-order evidence of name against remainder is a small difference of large numbers,
    and what explains most without a remainder is worth a refit, too.
    """
    trials = state.trials_beside(rest.named).without(tuple(state.refused))
    beside = _promising_beside(state, rest, trials)
    known = {c.effect for c in beside}
    plain = [c for c in screen_effects(rest.named, state.take, trials) if c.score > state.gate_of(c.effect)]
    more = [c._replace(score=0.0) for c in plain[: SEARCH_LIMITS.plain_candidates] if c.effect not in known]
    return [*beside, *more]


def _promising_beside(state: SearchState, rest: RemainderFit, trials: TrialChanges) -> list[CandidateEffect]:
    """The effects of the `trials` that the score test promises most beside the remainder, best first."""
    candidates = score_names(rest, state.take, trials)
    least = max((SEARCH_LIMITS.near_best_share * c.score for c in candidates[:1]), default=0.0)
    near = [c for c in candidates if c.score > max(least, SEARCH_LIMITS.min_score_share * state.gate_of(c.effect))]
    return near[: SEARCH_LIMITS.max_candidates]


def _best_credible(
    state: SearchState, fits: Sequence[Fit], rest: RemainderFit, promised: Mapping[str, float],
    more: Sequence[Fit] = (),
) -> RemainderFit | None:  # fmt: skip
    """The fit of greatest evidence of those of a size that a car may have, if it exceeds that of `rest` enough.

    `fits` have one effect more than `rest` each, whose evidence the score test has `promised` to grow.  What cannot add
    as much as its gate is refused, and not tried again; but for those `more`, which began far from `rest`, and of which
    another start may make more.
    """
    best, added = None, dict[str, float]()
    for f in refits.rank_credible_fits([*fits, *more], state.take):
        name = f.hypothesis.effects[-1]
        least = rest.log_evidence + state.gate_of(name)
        to_exceed = max(least, best.log_evidence) if best else least
        found = _weigh_candidate(state, rest, f, to_exceed, promised.get(name, 0.0))
        if _counts(state, found, rest, name):
            best = greater_evidence(best, found)
        elif to_exceed == least and not any(f is other for other in more):
            added[name] = found.log_evidence - rest.log_evidence
    held = best.named.hypothesis.effects if best else ()
    state.tell_added({name: nats for name, nats in added.items() if name not in held})
    return _converge_name(state, best) if best else None


def _counts(state: SearchState, found: RemainderFit, rest: RemainderFit, name: str) -> bool:
    """Whether what was `found` adds as much to `rest` as its `name` must beside what has none."""
    return found.log_evidence > rest.log_evidence + state.required_nats(found.nats, name)


def _converge_name(state: SearchState, best: RemainderFit) -> RemainderFit:
    """The fit `best` refitted to its end, with its remainder and without one; the greater evidence of all starts."""
    alone = state.weigh_anew(refits.refit_fully(best.named, state.take))
    found = converge_further(greater_evidence(best, alone), state.take)
    return state.with_own_view(state.remember(found._replace(named=alone.named)))


def _weigh_candidate(
    state: SearchState, rest: RemainderFit, fit: Fit, to_exceed: float, promised: float
) -> RemainderFit:
    """The `fit`, which has one effect more than `rest`, with a remainder beside it, found from the nearer start.

    A fit that explains most of what the remainder of `rest` does leaves little to a remainder, which is found from
    nothing; beside another the remainder is much the same.  Where little comes of what the score test has `promised` of
    a fit that stands alone, it is tried beside that remainder, too.  And where nothing comes of one that would count if
    there were no remainder, it is weighed anew: the remainder of `rest` may have taken its place, and does not give it
    up.
    """
    found, take = None, state.take
    if _explains_most(fit, rest):
        found = state.beside_remainder(refits.refit_fully(fit, take), to_exceed)
        if found.log_evidence - rest.log_evidence >= SEARCH_LIMITS.kept_promise * promised:
            return found
    best = greater_evidence(found, state.remember(add_beside_remainder(rest, fit, take, to_exceed)))
    name = fit.hypothesis.effects[-1]
    if _counts(state, best, rest, name) or gain_nats(fit, rest.named) <= state.required_nats(best.nats, name):
        return best
    return greater_evidence(best, state.weigh_anew(found.named if found else refits.refit_fully(fit, take), to_exceed))


def _explains_most(fit: Fit, rest: RemainderFit) -> bool:
    """Whether a fit without a remainder explains most of what that of `rest` does."""
    return gain_nats(fit, rest.named) > SEARCH_LIMITS.most_share * rest.nats
