"""Which effects a take shows: forward search by joint refits, backward elimination, exchanges, and the rivals.

The base model's own simplifications are fitted first (`bcid.effects.corrections`), so that they are not mistaken
for an effect; like every effect they have to earn their place in the end.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from bcid.diagnosis.locate.pushes import disturbances
from bcid.diagnosis.locate.regression import Remainder, remainder
from bcid.diagnosis.search.line_search import from_their_sizes, without_place
from bcid.diagnosis.search.place_search import placed
from bcid.diagnosis.search.refits import (
    QUICK,
    SHORTLIST,
    WORTH,
    beside_given,
    best_first,
    from_afar,
    fully,
    named,
    of_the_shortlist,
    refit_with,
    told,
)
from bcid.diagnosis.search.rivals import Beside, distinct, each_left_out, settled
from bcid.diagnosis.search.screen import Candidate, Nulls, changes, nulls, screen
from bcid.effects.corrections import CORRECTIONS
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.score_test import GATE, Changes
from bcid.likelihood.take import Take

MOST_EFFECTS, MOST_PUSHED = 4, 6  # of a take whose base model is far off, more may be missing
SUBSTANTIAL = 0.25  # of what trees predict of the disturbances, which an effect must explain
RELEVANT = 0.01  # share of all that is explained so far that a further effect must add
HOPELESS = 0.03  # share of the best score below which a candidate is not refitted either
PLAIN = 100.0  # nats that no usual take of nothing comes near
SURE = 8.0  # standard errors from nothing at which no refit is needed to see that an effect is there


DELAYS = ("steering_delay", "motor_delay")

Report = Callable[[str], None]


@dataclass(frozen=True)
class Search:
    """The base fit, the accepted effects' joint fit, and refits that explain nearly as much."""

    base: Fit
    corrected: Fit  # the base model with its own simplifications corrected as far as they stand out
    best: Fit
    without: dict[str, Fit]  # the best fit with each of its named effects left out
    others: tuple[Fit, ...]  # each with one accepted effect exchanged, best first
    nulls: Nulls  # what chance promises beside the best fit
    p_value: float  # that all which stands out beside the corrected base model is chance
    trials: Changes  # of the whole vocabulary beside the corrected base model
    promising: tuple[str, ...]  # effects that were so at their sizes, where a score test does not tell
    stand_ins: tuple[str, ...] = ()  # dropped for something that has no name,
    at_ends: tuple[str, ...] = ()  # or since no car is so: neither are rivals of what is left

    def reduced(self, best: Fit, take: Take, stand_ins: Sequence[str] = (), at_ends: Sequence[str] = ()) -> Search:
        """The same search with fewer effects in its best fit; the rivals are others now."""
        for_what_is_left, no_car = (*self.stand_ins, *stand_ins), (*self.at_ends, *at_ends)
        out = (*for_what_is_left, *no_car)
        names = tuple(n for n in self.promising if n not in out)
        found = settled(best, take, self.trials.without(out), (self.corrected, self.base), names)
        return replace(
            self, best=found.best, without=found.without, others=found.others, stand_ins=for_what_is_left,
            at_ends=no_car,
        )  # fmt: skip


def search(
    base: Fit, take: Take, whole: Remainder, report: Report = lambda text: None, left_out: Sequence[str] = (),
    given: Fit | None = None,
) -> Search:  # fmt: skip
    """Effects are added while they earn their place, then taken away where they no longer do.

    `whole` is what of the base model's disturbances is predictable; `given` a simulation's own parameters, beside
    which the first effect is looked for as well: what is missing may have bent the refitted ones.
    """
    report("the base model's own simplifications")
    corrected = _corrected(base, take)
    best, accepted = corrected, list[Fit]()
    report("a score test of every effect")
    trials = changes(best, take).without(left_out)
    chance = nulls(best, take, trials)
    p_value = chance.p_value
    names = without_place(best, left_out) if take.pushed or best.hypothesis.simulated else ()
    promising: tuple[str, ...] = ()
    while len(named(best)) < (MOST_PUSHED if take.pushed else MOST_EFFECTS):
        candidates = screen(best, take, trials.without(best.hypothesis.effects))
        worth = max(WORTH, HOPELESS * candidates[0].score)
        shortlist = [c for c in candidates[:SHORTLIST] if c.score > worth]
        report(f"{len(shortlist)} candidates beside {', '.join(best.hypothesis.effects) or 'the base model'}")
        left = whole if best is base else remainder(disturbances(best, take), best.car())
        least = max(RELEVANT * (best.bic - base.bic), min(chance.gate, PLAIN))
        beside = given if best is corrected else None
        tried = names
        fits, names = _with_one_more(best, take, shortlist, tried, least, left_out, beside)
        promising = promising or names
        others = (*left_out, *tried) if take.pushed else left_out
        fits, also = _further(best, take, best_first(fits, take), left, (least, max(least, chance.gate)), others)
        names = (*names, *also)
        if not (fits and _substantial(best, fits[0], left, least)):
            break
        # beside what is missing even a placebo may promise much: where a gain is plain, the gate beside it counts
        after = nulls(fits[0], take, trials.without(best.hypothesis.effects))
        if fits[0].bic - best.bic < min(chance.gate, after.gate):
            break
        best, accepted, chance = fits[0], fits, after
    before = best
    if "pose_latency" not in left_out:
        best = _one_latency(best, take)
    best = placed(_without_idlers(best, take, chance.gate), take)
    best, without, rest = _beside(best, (before, accepted), take, trials, (corrected, base), promising)
    return Search(base, corrected, best, without, rest, chance, p_value, trials, promising)


def _beside(
    best: Fit, accepted: tuple[Fit, Sequence[Fit]], take: Take, trials: Changes, known: tuple[Fit, Fit],
    promising: Sequence[str],
) -> Beside:  # fmt: skip
    """The best fit and its rivals: of a single name those that were tried when it was `accepted`, else others.

    Fits that hold a correction which has been taken from the best since are no rivals of it.
    """
    before, tried = accepted
    if best.hypothesis.effects == before.hypothesis.effects and len(named(best)) < 2:
        return Beside(best, each_left_out(best, known, take), distinct(best, tried))
    return settled(best, take, trials, known, promising)


def _substantial(best: Fit, more: Fit, left: Remainder, least: float) -> bool:
    """Whether a fit that holds one effect more than `best` gains the `least`, and a fair share of what is `left`.

    A mixture of effects, each of which explains little, would only stand in for something that has no name.
    """
    gained = more.bic - best.bic
    return gained >= least and (gained >= SUBSTANTIAL * left.gain or not left.predictable)


def _with_one_more(
    best: Fit, take: Take, shortlist: Sequence[Candidate], names: tuple[str, ...], least: float,
    left_out: Sequence[str], given: Fit | None,
) -> tuple[list[Fit], tuple[str, ...]]:  # fmt: skip
    """Joint refits with one effect more, and which of `names` are worth trying beside the next.

    Those of the shortlist start from the score test's values, beside `given` parameters of a simulation as well; the
    effects `names` from their sizes, if they are likely to gain the `least` that is asked.
    """
    fits = of_the_shortlist(best, take, told(best, take, shortlist))
    if given:
        fits += beside_given(given, best, take, left_out)
    if names:
        sized, names = from_their_sizes(best, take, names, least)
        fits += sized
    return fits, names if take.pushed else ()


def _further(
    best: Fit, take: Take, fits: list[Fit], left: Remainder, least: tuple[float, float], others: Sequence[str]
) -> tuple[list[Fit], tuple[str, ...]]:
    """The fits, and where much is `left` and none explains enough of it, more: from afar, and under pushes from sizes.

    Effects in `others` were tried or may not be.  Beside what was found, any may promise that did not before; the names
    of those that do.  `least` is asked of what was tried at last, and of what was tried first.
    """

    def enough(asked: float) -> bool:
        return bool(fits) and _substantial(best, fits[0], left, asked)

    if not left.predictable or enough(least[1]):
        return fits, ()
    fits = best_first([*fits, *from_afar(best, take, others)], take)
    if not (take.pushed and named(best)) or enough(least[0]):
        return fits, ()
    more, names = from_their_sizes(best, take, without_place(best, others), least[0])
    return best_first([*fits, *more], take), names


def _one_latency(fit: Fit, take: Take) -> Fit:
    """The fit with a late pose in place of delays of both commands, if that is likelier: equal ones are the same."""
    held = fit.hypothesis.effects
    if not set(DELAYS) <= set(named(fit)) or "pose_latency" in held:
        return fit
    tau = 0.5 * sum(fit.values()[f"{name}__tau"][0] for name in DELAYS)
    late = refit_with(fit, take, (*(n for n in held if n not in DELAYS), "pose_latency"), [tau])
    return late if late.bic > fit.bic else fit


def _corrected(base: Fit, take: Take) -> Fit:
    """The base model with those of its simplifications corrected that stand out."""
    free = [n for n in CORRECTIONS if n in base.hypothesis.entries and n not in base.hypothesis.assumed]
    sizes = [p.size for n in free for p in base.hypothesis.entries[n].parameters]
    all_of_them = base.hypothesis.holding(*free)
    known = base.hypothesis.values(base.phi).values()
    start = all_of_them.start(base.car(), [*known, *(0.1 * size for size in sizes)])
    try:
        quick = refit(take, all_of_them, start, base.start, base.scales, QUICK, base.tangent)
        if quick.bic - base.bic < GATE:
            return base
        whole = fully(quick, take)
    except FloatingPointError:  # corrections that spin the car out of the numbers correct nothing
        return base
    kept = tuple(n for n in free if _sure(whole, n))
    if not kept:
        return base
    less = whole if len(kept) == len(free) else refit_with(whole, take, kept)
    return less if less.bic - base.bic > GATE else base  # a refit may end on another, lower hill


def _sure(fit: Fit, name: str) -> bool:
    """Whether an amplitude of the effect is many standard errors from nothing, and the fit the better for it."""
    values, entry = fit.values(), fit.hypothesis.entries[name]
    return any(
        abs(values[field][0]) > SURE * values[field][1] > 0.0
        for field, p in zip(entry.fields, entry.parameters, strict=True)
        if not p.places
    )


def _without_idlers(fit: Fit, take: Take, gate: float) -> Fit:
    """The fit without those of its effects that do not earn their place beside the others."""
    held = fit.hypothesis.effects
    if len(held) < 2:
        return fit
    for name in held:
        if name in fit.hypothesis.assumed or _sure(fit, name):
            continue
        without = refit_with(fit, take, tuple(n for n in held if n != name))
        if fit.bic - without.bic < gate:
            return _without_idlers(without, take, gate)
    return fit
