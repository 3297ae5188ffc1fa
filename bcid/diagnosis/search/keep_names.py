"""Which names stay: each must make the take likelier beside a remainder that may take its place, and without one.

A name counts by what is lost without it, the remainder found anew.  What the remainder still explains beside all names
is unknown.  The method as equations: docs/method.md.
"""

from typing import NamedTuple

import numpy as np

from bcid.diagnosis.limits import JUDGE_LIMITS, SEARCH_LIMITS
from bcid.diagnosis.remainder.fit import RemainderFit, add_beside_remainder, leave_out
from bcid.diagnosis.remainder.functions import CHANNELS
from bcid.diagnosis.search.refits import first_order_nats, gain_nats, named_effects, refit_with_effects
from bcid.diagnosis.search.search_state import SearchState, greater_evidence
from bcid.likelihood.refit import Fit


class KeptNames(NamedTuple):
    """The names that count, and what shows that."""

    rest: RemainderFit  # the fit with them, and the functions beside them that are needed
    full: RemainderFit  # the fit with them, copies of laws that have names among those functions where that is likelier
    gains: dict[str, float]  # nats by which each makes the take likelier, beside the remainder and without it
    without: dict[str, Fit]  # the likeliest fit without each


class Lesser(NamedTuple):
    """What explains a take without one of its names."""

    fit: Fit  # the likeliest, without a remainder
    weighed: RemainderFit  # of the greatest evidence


class Judged(NamedTuple):
    """What a name adds, and what explains the take without it."""

    gain: float  # nats that it adds at most, by the comparisons made
    alone: float  # nats by which it adds more than it must where there is no remainder
    surplus: float  # nats by which it does in all comparisons; at zero and below the name falls
    less: Lesser


def keep_names(state: SearchState, rest: RemainderFit) -> KeptNames:
    """Those names of a fit that each add enough; the others go one at a time, and those left are weighed anew.

    Names are judged in the order of what they seem to add, the least first, and the first that falls short goes at
    once: most of the work of a search is to find what may take a name's place.
    """
    while True:
        state.draw_nulls(rest)
        kept = dict[str, Judged]()
        for name in _weakest_first(rest):
            kept[name] = judged = _judge(state, rest, name)
            if judged.surplus <= 0.0:
                again = _find_beside_lesser(state, rest, judged)
                if again.log_evidence <= rest.log_evidence - judged.surplus:
                    state.refused.add(name)
                    state.added[name] = judged.gain
                    again = judged.less.weighed
                rest = state.with_own_view(again)
                break
        else:
            gains = {name: judged.gain for name, judged in kept.items()}
            without = {name: judged.less.fit for name, judged in kept.items()}
            return KeptNames(rest, state.with_copies(rest, CHANNELS), gains, without)


def _find_beside_lesser(state: SearchState, rest: RemainderFit, judged: Judged) -> RemainderFit:
    """The fit with all names of `rest`, its remainder found from that without the name that was judged, too.

    Each of the two is sought from the other: a remainder has many maxima, and the luck of one search is no evidence.
    """
    less = judged.less.weighed
    if judged.alone <= 0.0 or not len(less.on):
        return rest
    return state.remember(greater_evidence(rest, add_beside_remainder(less, rest.named, state.take)))


def _weakest_first(rest: RemainderFit) -> list[str]:
    """The names of a fit in the order of what each adds to first order, beside the remainder or without it."""
    fits = (rest.named, rest.fit)
    return sorted(named_effects(rest.named), key=lambda name: min(first_order_nats(fit, name) for fit in fits))


def _judge(state: SearchState, rest: RemainderFit, name: str) -> Judged:
    """What a name adds, against one thing after another in its place, until it falls short.

    A single odd segment is no law: the share of the name's gain that the segment with most of it makes up, with nothing
    in its place, counts in no comparison.  The rest must exceed its gate against nothing, and `_least_beside` against
    a remainder, which is found from nothing and then from that beside the name, and against copies of laws.  The fit
    without it begins at the fit with it: what was found before may be a lesser maximum.
    """
    others = tuple(n for n in rest.named.hypothesis.effects if n != name)
    fit = state.keep_likeliest(refit_with_effects(rest.named, state.take, others))
    plain, less = gain_nats(rest.named, fit), Lesser(fit, state.weigh_anew(fit))
    counted = _counted_share(rest.named, fit)
    alone = plain - state.gate_of_held(name) / counted if counted else -np.inf
    if alone <= 0.0:
        return Judged(plain, alone, alone, less)

    def judge(less: Lesser, beside: float) -> Judged:
        """What the name adds where it adds so many nats `beside` a remainder."""
        surplus = beside - _least_beside(state, rest, less, name) / counted
        return Judged(min(plain, beside), alone, min(alone, surplus), less)

    judged = judge(less, rest.log_evidence - less.weighed.log_evidence)
    if judged.surplus > 0.0 and len(rest.on):
        found = leave_out(rest, fit, state.take)
        less = less._replace(weighed=state.remember(greater_evidence(less.weighed, found)))
        judged = judge(less, rest.log_evidence - less.weighed.log_evidence)
    if judged.surplus > 0.0:
        copied = _gain_beside_copies(state, rest, less, judged.gain)
        judged = judge(less, min(rest.log_evidence - less.weighed.log_evidence, copied))
    return judged


def _counted_share(fit: Fit, less: Fit) -> float:
    """The share of what `fit` gains over `less` that is not of the segment with most of it; zero without a gain."""
    gain = gain_nats(fit, less)
    largest = max(float(np.max(fit.per_segment - less.per_segment)), 0.0)
    return max(1.0 - largest / gain, 0.0) if gain > 0.0 else 0.0


def _least_beside(state: SearchState, rest: RemainderFit, less: Lesser, name: str) -> float:
    """Nats that a name must add to a remainder in its place.

    They are those that it must add to nothing, the share of what all names leave that smooth functions cannot follow,
    and the share of the remainder in its place to which that is converged.  But where all names leave hardly more than
    such a share of what the remainder in its place explains, the two are explanations of the same: the name, which is
    one law, need only be likelier by the odds that tell rivals apart.
    """
    left, instead = state.with_copies(rest, CHANNELS).nats, less.weighed.nats
    explains_as_much = left < SEARCH_LIMITS.remainder_error * instead
    missed = SEARCH_LIMITS.remainder_error * left
    beside = JUDGE_LIMITS.rival_nats if explains_as_much else max(state.gate_of_held(name), missed)
    return max(beside, SEARCH_LIMITS.converged_share * instead)


def _gain_beside_copies(state: SearchState, rest: RemainderFit, less: Lesser, gain: float) -> float:
    """The nats that a name adds, `gain` without copies of laws, where such copies may take its place.

    They may in a channel that is needed beside all names; elsewhere, as no name could win, they may not: infinite nats.
    """
    full = state.with_copies(rest, CHANNELS)
    least = max(state.gate, SEARCH_LIMITS.needed_share * gain)
    needed = tuple(c for c, nats in full.seen.channel_nats().items() if nats > least) if full.nats > least else ()
    if not needed:
        return np.inf
    return state.with_copies(rest, needed).log_evidence - state.with_copies(less.weighed, needed).log_evidence
