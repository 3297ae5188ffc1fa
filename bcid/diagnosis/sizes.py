"""Joint refits with one effect more from its best size, where a score test does not tell what an effect does.

Beside pushes that do its work already, and beside parameters that have bent to what is missing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from bcid.diagnosis.candidates import FINALISTS, credible
from bcid.effects.corrections import RAW_COMMANDS
from bcid.effects.entry import Parameter
from bcid.effects.table import EFFECTS
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.refit import Fit, refit, standing
from bcid.likelihood.take import Floats, Ints, Take

FEW = 12  # segments on which an effect's size is looked for
ENOUGH = 30  # segments on which effects are compared
PROMISING = 8  # effects that are compared more closely, and tried again beside what was found
MOST = 50.0  # nats that no segment exceeds when effects are compared roughly: a lost one would outweigh all the others
ROUGHLY, CLOSELY = 1, 3  # tangents along which
LIKELY = 0.5  # of what the first promises, or of what is asked, below which nothing is refitted
COARSELY = (1.0, 3.0, 9.0, 27.0, 81.0)
"""Times an effect's size that are tried: what a small car lacks may be far beyond what would just show."""
FINELY = (0.6, 1.7)
"""Times the best of them."""
FALLS = 5.0  # nats by which a larger size is worse than chance, or another mode, would make it
TWO_WAYS = ((1.0, 1.0), (1.0, -1.0), (1.0, 0.0), (0.0, 1.0))
"""In which two amplitudes are tried."""


def at_simulated(corrected: Fit) -> Floats:
    """The fit's phi with the parameters of a simulation to be trusted; a gain of raw commands is none of them.

    What is missing is plain there, and hardly seen any more where those have bent to it.
    """
    hypothesis = corrected.hypothesis
    assert hypothesis.simulated is not None  # noqa: S101  # what makes it one to be trusted
    known = len(hypothesis.simulated.phi)  # the base model and what is assumed come first
    simulated = np.array([*hypothesis.simulated.phi, *corrected.phi[known:]])
    return np.where(np.isin(hypothesis.names, RAW_COMMANDS), corrected.phi, simulated)


def without_place(fit: Fit, left_out: Sequence[str]) -> tuple[str, ...]:
    """Effects that `fit` does not hold and that are not bound to a place."""
    entries, held = fit.hypothesis.entries, fit.hypothesis.effects
    own = [entries[n] for n in EFFECTS if n in entries and n not in (*held, *left_out)]
    return tuple(e.id for e in own if e.amplitudes and not e.places)


class Sized(NamedTuple):
    """A joint refit with one effect more on a part of a take, from its best size there."""

    fit: Fit
    promise: float  # nats on that part

    @property
    def effect(self) -> str:
        """The one more."""
        return self.fit.hypothesis.effects[-1]


def from_their_sizes(fit: Fit, take: Take, names: Iterable[str], least: float) -> tuple[list[Fit], tuple[str, ...]]:
    """Joint refits of those of `names` that are likely to gain the `least` that is asked, and the most promising names.

    From the parameters of a simulation to be trusted, as long as there is one.
    """
    phi = fit.phi if fit.hypothesis.simulated is None else at_simulated(fit)
    sized = at_their_sizes(fit, take, phi, [n for n in names if n not in fit.hypothesis.effects])
    return on_the_whole(fit, take, sized, least), tuple(s.effect for s in sized)


def at_their_sizes(fit: Fit, take: Take, phi: Floats, names: Sequence[str]) -> list[Sized]:
    """The most promising of `names`, each from its best size beside what `fit` holds, the most promising first.

    On a part of the take, from `phi` of that and from the fit's free parts.
    """
    few, enough = (_evenly(take, n) for n in (FEW, ENOUGH))
    part, best, hypothesis = take.part(enough), list[Sized](), fit.hypothesis
    for name in names:
        more = hypothesis.holding(*hypothesis.effects, name)
        sizes = _best_sizes(fit, take, few, more, phi)
        if sizes:
            there = more.start(hypothesis.car(phi), [*hypothesis.values(phi).values(), *sizes])
            with suppress(FloatingPointError):
                rough = refit(part, more, there, fit.start[enough], fit.scales, tangents=ROUGHLY)
                best.append(Sized(rough, _promise(rough, fit, enough)))
    closely = (_closer(s.fit, part) for s in _in_order(best)[:PROMISING])
    return _in_order(Sized(f, _promise(f, fit, enough)) for f in closely)


def _in_order(sized: Iterable[Sized]) -> list[Sized]:
    return sorted(sized, key=lambda s: -s.promise)


def _best_sizes(fit: Fit, take: Take, chosen: Ints, more: Hypothesis, phi: Floats) -> tuple[float, ...]:
    """Of `more`'s last effect the values that promise most on the `chosen` segments; none where all leave the numbers.

    All else stays at `phi` of what `fit` holds.  From a size that is worse than a smaller one no larger one is tried.
    """
    hypothesis, part = fit.hypothesis, take.part(chosen)
    known, own = list(hypothesis.values(phi).values()), more.entries[more.effects[-1]].parameters
    tried = dict[tuple[float, ...], float]()

    def promises(sizes: tuple[float, ...]) -> float:
        if sizes not in tried:
            tried[sizes] = -np.inf
            with suppress(FloatingPointError):
                there = more.start(hypothesis.car(phi), [*known, *sizes])
                each = standing(part, more, there, fit.start[chosen], fit.scales)
                tried[sizes] = _counted(each - fit.per_segment[chosen])
        return tried[sizes]

    for way in _ways(own):
        last = -np.inf
        for share in COARSELY:
            now = promises(_within(own, [share * v for v in way]))
            if now < last - FALLS:
                break
            last = now
    best = max(tried, key=promises)
    best = max((best, *(_within(own, [share * v for v in best]) for share in FINELY)), key=promises)
    return best if promises(best) > -np.inf else ()


def _ways(own: Sequence[Parameter]) -> list[tuple[float, ...]]:
    """An effect's size in each direction that it may have: of either sign, two amplitudes together and each alone."""
    ways = TWO_WAYS if len(own) == 2 else ((1.0,) * len(own),)
    signs = (1.0, -1.0) if all(p.low < 0.0 for p in own) else (1.0,)
    return [tuple(sign * w * p.size for w, p in zip(way, own, strict=True)) for sign in signs for way in ways]


def _within(own: Sequence[Parameter], values: Sequence[float]) -> tuple[float, ...]:
    """The values, none beyond its bounds."""
    return tuple(min(max(v, p.low), p.high) for v, p in zip(values, own, strict=True))


def _closer(fit: Fit, part: Take) -> Fit:
    """The fit a few tangents on, or as it is where they lead out of the finite numbers."""
    try:
        return refit(part, fit.hypothesis, fit.phi, fit.start, fit.scales, tangents=CLOSELY)
    except FloatingPointError:
        return fit


def _promise(fit: Fit, beside: Fit, chosen: Ints) -> float:
    """Nats that a fit of the `chosen` segments gains there over `beside`, which is of all of them.

    Lost segments count little.  Of what either is charged for its parameters, as much as was chosen; and half a nat for
    each of them, which it gains by suiting these segments more than the others.
    """
    charged = (fit.bic - fit.log_likelihood) - (beside.bic - beside.log_likelihood)
    share = len(chosen) / len(beside.per_segment)
    return _counted(fit.per_segment - beside.per_segment[chosen]) + share * charged - 0.5 * len(fit.phi)


def _counted(nats: Floats) -> float:
    """The sum over segments, of which none counts for more than MOST."""
    return float(np.sum(MOST * np.tanh(nats / MOST)))


def on_the_whole(beside: Fit, take: Take, sized: Sequence[Sized], least: float) -> list[Fit]:
    """The first FINALISTS of those `sized`, refitted on the whole take from the free parts of `beside`.

    Those that are not credible are passed over, and those left that promise little beside the first, or beside the
    `least` that is asked of the whole.
    """
    likely, whole = [s for s in sized if credible(s.fit, take)][:FINALISTS], list[Fit]()
    for s in likely:
        asked = least * len(s.fit.per_segment) / take.segments
        if s.promise < LIKELY * max(likely[0].promise, asked):
            break
        with suppress(FloatingPointError):
            whole.append(refit(take, s.fit.hypothesis, s.fit.phi, beside.start, beside.scales))
    return whole


def _evenly(take: Take, n: int) -> Ints:
    """So many of the take's segments, or all."""
    return np.unique(np.linspace(0, take.segments - 1, min(n, take.segments)).round().astype(np.int64))
