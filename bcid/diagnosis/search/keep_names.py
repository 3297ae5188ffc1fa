"""Which names stay: each must make the take likelier beside a remainder that may take its place, and without one.

A name counts by what is lost without it, the remainder found anew.  What the remainder still explains beside all names
is unknown.  The method as equations: docs/method.md.
"""

from typing import NamedTuple

import numpy as np

from bcid.diagnosis.limits import JUDGE_LIMITS, SEARCH_LIMITS
from bcid.diagnosis.remainder.fit import RemainderFit, leave_out
from bcid.diagnosis.remainder.functions import CHANNELS
from bcid.diagnosis.search.refits import gain_nats, named_effects, refit_with_effects
from bcid.diagnosis.search.search_state import SearchState, effects_of, greater_evidence
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


def keep_names(state: SearchState, rest: RemainderFit) -> KeptNames:
    """Those names of a fit that each add enough; the one that lacks most goes first, others are weighed anew."""
    while True:
        state.draw_nulls(rest)
        full, lesser = state.with_copies(rest, CHANNELS), _without_each(state, rest)
        gains = {name: _gain(state, rest, full, less) for name, less in lesser.items()}
        beyond = {name: _surplus(state, rest, full, less, gains[name]) for name, less in lesser.items()}
        weakest = min(beyond, key=lambda name: beyond[name], default="")
        if not weakest or beyond[weakest] > 0.0:
            return KeptNames(rest, full, gains, {name: less.fit for name, less in lesser.items()})
        state.refused.add(weakest)
        state.added[weakest] = gains[weakest]
        rest = state.with_own_view(lesser[weakest].weighed)


def _surplus(state: SearchState, rest: RemainderFit, full: RemainderFit, less: Lesser, gain: float) -> float:
    """Nats by which a name adds more than it must, `less` being what explains the take without it; below 0 it falls.

    Against nothing in its place it must add the gate beyond what one segment adds alone, as a single odd one is no law.
    Beside a remainder it must add as much, the share of what all names leave that smooth functions cannot follow, and
    the share of the remainder in its place to which that is converged.  But where all names leave hardly more than that
    share of what the remainder in its place explains, the two are explanations of the same: the name, which is one law,
    need only be likelier by the odds that tell rivals apart.
    """
    alone = max(float(np.max(rest.named.per_segment - less.fit.per_segment)), 0.0)
    plain, instead = state.gate + alone, less.weighed.nats
    explains_as_much = full.nats < SEARCH_LIMITS.remainder_error * instead
    beside = JUDGE_LIMITS.rival_nats if explains_as_much else max(plain, state.required_nats(full.nats))
    return min(gain_nats(rest.named, less.fit) - plain, gain - max(beside, SEARCH_LIMITS.converged_share * instead))


def _gain(state: SearchState, rest: RemainderFit, full: RemainderFit, less: Lesser) -> float:
    """Nats by which a name makes the take likelier, by what explains it with `less`: the least of three comparisons.

    What helps only beside a remainder, or only without one, is no name.  Where a channel is needed beside all names,
    the copies of laws in it may take the name's place; elsewhere they may not, as no name could win.
    """
    gain = min(rest.log_evidence - less.weighed.log_evidence, gain_nats(rest.named, less.fit))
    least = max(state.gate, SEARCH_LIMITS.needed_share * gain)
    needed = tuple(c for c, nats in full.seen.channel_nats().items() if nats > least) if full.nats > least else ()
    if gain < state.gate or not needed:
        return gain
    copied = state.with_copies(rest, needed).log_evidence - state.with_copies(less.weighed, needed).log_evidence
    return min(gain, copied)


def _without_each(state: SearchState, rest: RemainderFit) -> dict[str, Lesser]:
    """What explains the take without each name.

    It is refitted from the fit with the name: what was found before may be a lesser maximum.  Where the name seems to
    add enough, the remainder without it is also found from that beside it.
    """
    held, lesser = rest.named.hypothesis.effects, dict[str, Lesser]()
    for name in named_effects(rest.named):
        fit = refit_with_effects(rest.named, state.take, tuple(n for n in held if n != name))
        weighed = state.beside_remainder(fit)
        if len(rest.on) and rest.log_evidence - weighed.log_evidence > state.gate:
            found = leave_out(rest, state.likeliest[effects_of(fit)], state.take)
            weighed = state.remember(greater_evidence(weighed, found))
        lesser[name] = Lesser(state.likeliest[effects_of(fit)], weighed)
    return lesser
