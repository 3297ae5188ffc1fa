"""Joint refits with one effect more from its best size, where a score test does not tell what an effect does.

Beside pushes that do its work already, and beside parameters that have bent to what is missing.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.diagnosis.search.refits import FINALISTS, incredible
from bcid.effects.entry import Parameter
from bcid.effects.table import EFFECTS
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.marginal import Scales
from bcid.likelihood.refit import Fit, refit, standing
from bcid.likelihood.take import Take

FEW = 12  # segments on which an effect's size is looked for
ENOUGH = 30  # segments on which effects are compared
PROMISING = 8  # effects of which the likeliest are refitted on the whole take, and all tried again beside what is found
MOST = 50.0  # nats that no segment exceeds when effects are compared: a lost one would outweigh all the others
TANGENTS = 3  # along which these are refitted: after fewer, a size found on FEW of them may not suit the others yet
LIKELY = 0.5  # of what is asked, or of what the first promises, below which nothing is refitted,
CHANCE = 2.0  # and standard deviations by which a promise may be less than that by chance
COARSELY = (1.0, 3.0, 9.0, 27.0, 81.0)
"""Times an effect's size that are tried: what a small car lacks may be far beyond what would just show."""
FINELY = (0.6, 1.7)
"""Times the best of them."""
FALLS = 2  # sizes in a row, each worse than the one before: a single one may have thrown a segment off
ATTEMPTS = 2  # sizes from which a refit is tried
TWO_WAYS = ((1.0, 1.0), (1.0, -1.0), (1.0, 0.0), (0.0, 1.0))
"""In which two amplitudes are tried."""


def at_simulated(corrected: Fit) -> Floats:
    """The fit's phi with the parameters of a simulation to be trusted, as far as that knows them.

    What is missing is plain there, and hardly seen any more where those have bent to it.
    """
    hypothesis = corrected.hypothesis
    assert hypothesis.simulated is not None  # noqa: S101  # what makes it one to be trusted
    known = len(hypothesis.simulated.phi)  # the base model and what is assumed come first
    simulated = np.array([*hypothesis.simulated.phi, *corrected.phi[known:]])
    return np.where(np.isin(hypothesis.names, hypothesis.simulated.free), corrected.phi, simulated)


def without_place(fit: Fit, left_out: Sequence[str]) -> tuple[str, ...]:
    """Effects that `fit` does not hold and that are not bound to a place."""
    entries, held = fit.hypothesis.entries, fit.hypothesis.effects
    own = [entries[n] for n in EFFECTS if n in entries and n not in (*held, *left_out)]
    return tuple(e.id for e in own if e.amplitudes and not e.places)


class Sized(NamedTuple):
    """A joint refit with one effect more on a part of a take, from its best size there."""

    fit: Fit
    promise: float  # nats on that part
    sd: float  # of the promise, by how segments scatter

    @property
    def effect(self) -> str:
        """The one more."""
        return self.fit.hypothesis.effects[-1]


def from_their_sizes(fit: Fit, take: Take, names: Iterable[str], least: float) -> tuple[list[Fit], tuple[str, ...]]:
    """Joint refits of those of `names` that are likely to gain the `least` that is asked, and the most promising names.

    From the parameters of a simulation to be trusted, as long as there is one.
    """
    names = [n for n in names if n not in fit.hypothesis.effects]
    if not names:
        return [], ()
    phi = fit.phi if fit.hypothesis.simulated is None else at_simulated(fit)
    sized = at_their_sizes(fit, take, phi, names)
    return on_the_whole(fit, take, sized, least), tuple(s.effect for s in sized)


def at_their_sizes(fit: Fit, take: Take, phi: Floats, names: Sequence[str]) -> list[Sized]:
    """The most promising of `names`, each from its best size beside what `fit` holds, the most promising first.

    On a part of the take, which bends a simulation's parameters as far as the whole does, from `phi` of that and from
    the fit's free parts.
    """
    few, enough = (_evenly(take, n) for n in (FEW, ENOUGH))
    part, hypothesis = take.part(enough), fit.hypothesis.of_a_share(len(enough) / take.segments)
    nothing, sized = _nothing_more(fit, part, enough, hypothesis, phi), list[Sized]()
    for name in names:
        starts = [hypothesis.with_effect(name, phi, s) for s in _best_sizes(fit, take, few, name, phi)[:ATTEMPTS]]
        refitted = _refitted(part, starts, fit.start[enough], fit.scales)
        sized += [_sized(refitted, nothing, take.segments)] if refitted else []
    return sorted(sized, key=lambda s: -s.promise)[:PROMISING]


class _Nothing(NamedTuple):
    """A part of a take without anything more."""

    per_segment: Floats
    bent: float

    def bettered_by(self, fit: Fit) -> Floats:
        """Nats by segment, of which none counts for more than MOST: a lost one would outweigh all the others."""
        return _counted(fit.per_segment - self.per_segment)


def _nothing_more(fit: Fit, part: Take, chosen: Ints, hypothesis: Hypothesis, phi: Floats) -> _Nothing:
    """The fit on the `chosen` segments, or a refit to these alone from where effects are tried, if that is better.

    What any effect would gain by trying says nothing of it.
    """
    nothing = _Nothing(fit.per_segment[chosen], fit.bent * len(chosen) / len(fit.per_segment))
    again = _refitted(part, [(hypothesis, phi)], fit.start[chosen], fit.scales)
    if again and nothing.bettered_by(again).sum() + again.bent - nothing.bent > 0.0:
        return _Nothing(again.per_segment, again.bent)
    return nothing


def _refitted(part: Take, starts: Iterable[tuple[Hypothesis, Floats]], start: Floats, scales: Scales) -> Fit | None:
    """The refit from the first of these that has a slope: others lie beside the end of the numbers."""
    for hypothesis, phi in starts:
        with suppress(FloatingPointError):
            return refit(part, hypothesis, phi, start, scales, tangents=TANGENTS)
    return None


def _best_sizes(fit: Fit, take: Take, chosen: Ints, name: str, phi: Floats) -> list[tuple[float, ...]]:
    """Values of one effect more, those first that promise most on the `chosen` segments.

    All else stays at `phi` of what `fit` holds.  After two sizes each of which is worse than the smaller one before it,
    no larger one is tried; none is told that leaves the numbers.
    """
    part, own = take.part(chosen), fit.hypothesis.entries[name].parameters
    tried = dict[tuple[float, ...], float]()

    def promises(sizes: tuple[float, ...]) -> float:
        if sizes not in tried:
            tried[sizes] = -np.inf
            with suppress(FloatingPointError):
                each = standing(part, *fit.hypothesis.with_effect(name, phi, sizes), fit.start[chosen], fit.scales)
                tried[sizes] = float(_counted(each - fit.per_segment[chosen]).sum())
        return tried[sizes]

    for way in _ways(own):
        last, falls = -np.inf, 0
        for share in COARSELY:
            now = promises(_within(own, [share * v for v in way]))
            falls, last = falls + 1 if now < last or now == -np.inf else 0, now
            if falls == FALLS:
                break
    best = max(tried, key=promises)
    for share in FINELY:
        promises(_within(own, [share * v for v in best]))
    return sorted((sizes for sizes in tried if promises(sizes) > -np.inf), key=lambda sizes: -tried[sizes])


def _ways(own: Sequence[Parameter]) -> list[tuple[float, ...]]:
    """An effect's size in each direction that it may have: of either sign, two amplitudes together and each alone."""
    ways = TWO_WAYS if len(own) == 2 else ((1.0,) * len(own),)
    signs = (1.0, -1.0) if all(p.low < 0.0 for p in own) else (1.0,)
    return [tuple(sign * w * p.size for w, p in zip(way, own, strict=True)) for sign in signs for way in ways]


def _within(own: Sequence[Parameter], values: Sequence[float]) -> tuple[float, ...]:
    """The values, none beyond its bounds."""
    return tuple(min(max(v, p.low), p.high) for v, p in zip(values, own, strict=True))


def _sized(fit: Fit, nothing: _Nothing, segments: int) -> Sized:
    """What a fit of a part promises there over `nothing` more, of a take of so many `segments`.

    Of what the whole is charged for each parameter of the effect, as much as the part is of it; and half a nat, which
    it gains by suiting these segments more than the others, where there are others.
    """
    each, share = nothing.bettered_by(fit), len(fit.per_segment) / segments
    own = len(fit.hypothesis.entries[fit.hypothesis.effects[-1]].parameters)
    charged = 0.5 * own * (share * float(np.log(segments)) + 1.0 - share)
    return Sized(fit, float(each.sum()) + fit.bent - nothing.bent - charged, float(each.std() * np.sqrt(len(each))))


def _counted(nats: Floats) -> Floats:
    """Nats by segment, of which none counts for more than MOST."""
    return np.asarray(MOST * np.tanh(nats / MOST))


def on_the_whole(beside: Fit, take: Take, sized: Sequence[Sized], least: float) -> list[Fit]:
    """The first FINALISTS of those `sized`, refitted on the whole take from the free parts of `beside`.

    Those that are not credible are passed over, and those left that promise little beside the first, or beside the
    `least` that is asked of the whole.
    """
    likely, whole = [s for s in sized if not incredible(s.fit, take)][:FINALISTS], list[Fit]()
    for s in likely:
        asked = LIKELY * least * len(s.fit.per_segment) / take.segments
        if s.promise + CHANCE * s.sd < asked or (whole and s.promise < LIKELY * likely[0].promise):
            break
        more = beside.hypothesis.holding(*s.fit.hypothesis.effects)
        with suppress(FloatingPointError):
            whole.append(refit(take, more, s.fit.phi, beside.start, beside.scales))
    return whole


def _evenly(take: Take, n: int) -> Ints:
    """So many of the take's segments, or all."""
    return np.unique(np.linspace(0, take.segments - 1, min(n, take.segments)).round().astype(np.int64))
