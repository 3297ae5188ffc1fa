"""Which effects a take shows: forward search by joint refits, backward elimination, exchanges, and the rivals.

The base model's own simplifications are fitted first (`bcid.effects.corrections`), so that they are not mistaken
for an effect; like every effect they have to earn their place in the end.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from bcid.diagnosis.disturbance import disturbances
from bcid.diagnosis.places import placed
from bcid.diagnosis.refit import Fit, refit
from bcid.diagnosis.remainder import Remainder, remainder
from bcid.diagnosis.screen import Candidate, Changes, Nulls, changes, nulls, screen, sharpened
from bcid.diagnosis.take import Take
from bcid.effects.corrections import CORRECTIONS
from bcid.effects.table import EFFECTS

MOST_EFFECTS = 4
SUBSTANTIAL = 0.25  # of what trees predict of the disturbances, which an effect must explain
SHORTLIST = 8
WORTH = 6.0  # nats of score below which a candidate is not refitted
RELEVANT = 0.01  # share of all that is explained so far that a further effect must add
HOPELESS = 0.03  # share of the best score below which a candidate is not refitted either
GATE = 14.0  # what the gate of a usual take comes to; plans count with it before there is a take
PLAIN = 100.0  # nats that no usual take of nothing comes near
RIVAL = 4.0  # nats within which two explanations cannot be told apart
FINALISTS = 3
ENOUGH, FEW = 30, 2  # segments on which effects are compared, and tangents along which
CLOSE = 0.1  # share of the best gain within which a candidate is refitted in full
QUICK = 6  # iterations
SURE = 8.0  # standard errors from nothing at which no refit is needed to see that an effect is there

SWALLOWED = ("motor_power_limit", "tyre_relaxation", "motor_lag", "steering_lag", "friction_circle")
"""Effects that a refitted base model takes up so far that nothing shows of them near it."""

FAR_SHARES = (1.0, 1.6)

DELAYS = ("steering_delay", "motor_delay")

Report = Callable[[str], None]


def named(fit: Fit) -> tuple[str, ...]:
    """The effects of the vocabulary that `fit` holds beyond what its base model assumes."""
    return tuple(n for n in fit.hypothesis.effects if n in EFFECTS and n not in fit.hypothesis.assumed)


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

    def reduced(self, best: Fit, take: Take) -> Search:
        """The same search with fewer effects in its best fit."""
        held = set(best.hypothesis.effects)
        others = tuple(f for f in self.others if len(held - set(f.hypothesis.effects)) == 1)
        return replace(self, best=best, without=_each_left_out(best, self.corrected, self.base, take), others=others)


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
    best, others = corrected, list[Fit]()
    report("a score test of every effect")
    trials = changes(best, take).without(left_out)
    chance = nulls(best, take, trials)
    p_value = chance.p_value
    while len(named(best)) < MOST_EFFECTS:
        candidates = screen(best, take, trials.without(best.hypothesis.effects))
        worth = max(WORTH, HOPELESS * candidates[0].score)
        shortlist = [c for c in candidates[:SHORTLIST] if c.score > worth]
        report(f"{len(shortlist)} candidates beside {', '.join(best.hypothesis.effects) or 'the base model'}")
        left = whole if best is base else remainder(disturbances(best, take), best.car())
        # a mixture of effects would only stand in for something that has no name
        least = max(RELEVANT * (best.bic - base.bic), SUBSTANTIAL * left.gain if left.predictable else 0.0)
        fits = _refitted(best, take, shortlist)
        if given and best is corrected:
            fits = sorted([*fits, *_beside(given, take, left_out)], key=lambda f: -f.bic)
        if base.hypothesis.simulated and best is corrected:
            fits = sorted([*fits, *_missing(base, take, left_out)], key=lambda f: -f.bic)
        if left.predictable and (not fits or fits[0].bic - best.bic < max(least, chance.gate)):
            fits = sorted([*fits, *_from_afar(best, take, left_out)], key=lambda f: -f.bic)
        if not fits or fits[0].bic - best.bic < max(least, min(chance.gate, PLAIN)):
            break
        # beside what is missing even a placebo may promise much: where a gain is plain, the gate beside it counts
        beside = nulls(fits[0], take, trials.without(best.hypothesis.effects))
        if fits[0].bic - best.bic < min(chance.gate, beside.gate):
            break
        best, others, chance = fits[0], fits[1:], beside
    before = best
    if "pose_latency" not in left_out:
        best = _one_latency(best, take)
    best = placed(_without_idlers(best, take, chance.gate), take)
    without = _each_left_out(best, corrected, base, take)
    if named(best) != named(before) or len(named(best)) > 1:
        others = _exchanged(best, take, trials, without)
        if others and others[0].bic > best.bic:
            best, others = others[0], [best, *others[1:]]
            without = _each_left_out(best, corrected, base, take)
    others = sorted(others, key=lambda f: -f.bic)
    return Search(base, corrected, best, without, tuple(others), chance, p_value, trials)


def _one_latency(fit: Fit, take: Take) -> Fit:
    """The fit with a late pose in place of equal delays of both commands, which are the same (specification)."""
    held = fit.hypothesis.effects
    if not set(DELAYS) <= set(named(fit)):
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
        whole = _full(quick, take)
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


def _refitted(fit: Fit, take: Take, shortlist: Sequence[Candidate]) -> list[Fit]:
    """Joint refits with one more effect, best first: quick ones of all, full ones of those that come close."""
    quick = []
    for candidate in shortlist:
        with suppress(FloatingPointError):  # a start from which the car spins out of the numbers is no candidate
            quick.append(_quick(fit, take, candidate))
    quick.sort(key=lambda f: -f.bic)
    if not quick:
        return []
    gain = quick[0].bic - fit.bic
    near = [f for f in quick[:FINALISTS] if quick[0].bic - f.bic < max(CLOSE * gain, 5.0 * RIVAL)]
    full = [_full(f, take) for f in near]
    return sorted([*full, *(f for f in quick if f not in near)], key=lambda f: -f.bic)


def _beside(given: Fit, take: Take, left_out: Sequence[str]) -> list[Fit]:
    """Joint refits of the most promising effects beside parameters that were not refitted."""
    candidates = screen(given, take, changes(given, take).without(left_out))
    return _refitted(given, take, [c for c in candidates[:SHORTLIST] if c.score > WORTH])


def _missing(base: Fit, take: Take, left_out: Sequence[str]) -> list[Fit]:
    """Joint refits of every effect that has no place, at its size beside the parameters of a simulation to be trusted.

    What is missing is plain there, and hardly seen any more where those have bent to it.  All on a part of the take,
    the best on the whole.
    """
    chosen = np.arange(0, take.segments, max(1, take.segments // ENOUGH))
    part, found, hypothesis = take.part(chosen), list[Fit](), base.hypothesis
    assert hypothesis.simulated is not None  # noqa: S101  # what makes it one to be trusted
    simulated = np.array(hypothesis.simulated.phi)
    values = list(hypothesis.values(simulated).values())
    for name in (n for n in EFFECTS if n not in (*hypothesis.effects, *left_out)):
        own = hypothesis.entries[name].parameters if name in hypothesis.entries else ()
        if not own or any(p.places for p in own):
            continue
        more = hypothesis.holding(*hypothesis.effects, name)
        for sign in (1.0, -1.0) if all(p.low < 0.0 for p in own) else (1.0,):
            phi = more.start(hypothesis.car(simulated), [*values, *(sign * p.size for p in own)])
            with suppress(FloatingPointError):
                found.append(refit(part, more, phi, part.start, base.scales, tangents=FEW))
    best = dict[tuple[str, ...], Fit]()
    for f in sorted(found, key=lambda f: f.bic):
        best[f.hypothesis.effects] = f  # of either sign, the better one
    whole = list[Fit]()
    for f in sorted(best.values(), key=lambda f: -f.bic)[:FINALISTS]:
        with suppress(FloatingPointError):
            whole.append(refit(take, f.hypothesis, f.phi, take.start, f.scales))
    return whole


def _from_afar(fit: Fit, take: Take, left_out: Sequence[str]) -> list[Fit]:
    """Joint refits of the effects in SWALLOWED from sizes that matter, whatever the score test says of them.

    The best of them on a part of the take, then on the whole.
    """
    chosen = np.arange(0, take.segments, 4)
    part, found = take.part(chosen), []
    for name, share, car in itertools.product(SWALLOWED, FAR_SHARES, (fit.car(), fit.hypothesis.nominal)):
        if name in fit.hypothesis.effects or name in left_out:
            continue
        more = fit.hypothesis.holding(*fit.hypothesis.effects, name)
        sizes = [share * p.size for p in more.entries[name].parameters]
        phi = more.start(car, [*fit.hypothesis.values(fit.phi).values(), *sizes])
        with suppress(FloatingPointError):
            found.append(refit(part, more, phi, fit.start[chosen], fit.scales, QUICK))
    if not found:
        return []
    best = max(found, key=lambda f: f.bic)
    with suppress(FloatingPointError):
        return [refit(take, best.hypothesis, best.phi, fit.start, fit.scales)]
    return []


def _quick(fit: Fit, take: Take, candidate: Candidate) -> Fit:
    """The joint refit with one more effect along the fit's own tangent, from the score test's values."""
    sharp = sharpened(fit, take, candidate)
    more = fit.hypothesis.holding(*fit.hypothesis.effects, candidate.effect)
    values = [*fit.hypothesis.values(fit.phi).values(), *sharp.values]
    return refit(take, more, more.start(fit.car(), values), fit.start, fit.scales, QUICK, fit.tangent)


def _full(fit: Fit, take: Take) -> Fit:
    """The same hypothesis with its own tangent; as it is where that leads out of the finite numbers."""
    try:
        return refit(take, fit.hypothesis, fit.phi, fit.start, fit.scales)
    except FloatingPointError:
        return fit


def refit_with(fit: Fit, take: Take, effects: tuple[str, ...], added: Sequence[float] = ()) -> Fit:
    """The joint refit of `effects`: those that `fit` holds start from their values there, others from `added`."""
    less = fit.hypothesis.holding(*effects)
    old = fit.hypothesis.values(fit.phi)
    known = [old[f] for f, _ in less.parameters if f in old]
    try:
        return refit(take, less, less.start(fit.car(), [*known, *added]), fit.start, fit.scales)
    except FloatingPointError:  # what was taken away had kept the car within the finite numbers
        return refit(take, less, less.start(less.nominal, [*known, *added]), take.start, fit.scales)


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


def _each_left_out(fit: Fit, corrected: Fit, base: Fit, take: Take) -> dict[str, Fit]:
    """The joint refit without each of the named effects, where it is not known already."""
    known = {f.hypothesis.effects: f for f in (corrected, base)}
    found = {}
    for name in named(fit):
        rest = tuple(n for n in fit.hypothesis.effects if n != name)
        found[name] = known[rest] if rest in known else refit_with(fit, take, rest)
    return found


def _exchanged(fit: Fit, take: Take, trials: Changes, without: dict[str, Fit]) -> list[Fit]:
    """Refits with one of several effects exchanged for the most promising others, best first."""
    found = []
    for less in without.values():
        shortlist = screen(less, take, trials.without(fit.hypothesis.effects))[:3]
        lost = fit.bic - less.bic
        for candidate in shortlist:
            if candidate.score > max(WORTH, CLOSE * lost):
                with suppress(FloatingPointError):
                    quick = _quick(less, take, candidate)
                    found.append(_full(quick, take) if fit.bic - quick.bic < CLOSE * lost else quick)
    return sorted(found, key=lambda f: -f.bic)
