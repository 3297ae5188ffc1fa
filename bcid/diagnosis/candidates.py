"""Joint refits with one effect more: from the score test, beside a simulation's own parameters, from afar."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from contextlib import suppress
from functools import partial

import numpy as np

from bcid.diagnosis.screen import Candidate, changes, screen, sharpened
from bcid.effects.corrections import RAW_COMMANDS
from bcid.effects.entry import Parameter
from bcid.effects.table import EFFECTS
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.refit import Fit, held, refit
from bcid.likelihood.take import Floats, Ints, Take

SHORTLIST = 8
WORTH = 6.0  # nats of score below which a candidate is not refitted
RIVAL = 4.0  # nats within which two explanations cannot be told apart
FINALISTS = 3
FEW = 12  # segments on which an effect's size is looked for
ENOUGH = 30  # segments on which effects are compared
PROMISING = 8  # effects that are compared more closely, and tried again beside what was found
MOST = 50.0  # nats that no segment exceeds when effects are compared roughly: a lost one would outweigh all the others
ROUGHLY, CLOSELY = 1, 3  # tangents along which
COARSELY = (1.0, 3.0, 9.0, 27.0, 81.0, -1.0, -3.0, -9.0, -27.0, -81.0)
"""Times an effect's size that are tried: what a small car lacks may be far beyond what would just show."""
WAYS = ((1.0, 1.0), (1.0, -1.0), (1.0, 0.0), (0.0, 1.0))
"""In which two of them are tried together."""
FINELY = (0.6, 1.7)
"""Times the best of them."""

CLOSE = 0.1  # share of the best gain within which a candidate is refitted in full
QUICK = 6  # iterations
EDGE = 0.08  # share of a take at its ends, in which nothing can be seen to change

SWALLOWED = ("motor_power_limit", "tyre_relaxation", "motor_lag", "steering_lag", "friction_circle")
"""Effects that a refitted base model takes up so far that nothing shows of them near it."""

FAR_SHARES = (1.0, 1.6)


def of_the_shortlist(fit: Fit, take: Take, shortlist: Sequence[Candidate]) -> list[Fit]:
    """Joint refits with one more effect, best first: quick ones of all, full ones of those that come close."""
    quick = []
    for candidate in shortlist:
        with suppress(FloatingPointError):  # a start from which the car spins out of the numbers is no candidate
            quick.append(quickly(fit, take, candidate))
    quick.sort(key=lambda f: -f.bic)
    if not quick:
        return []
    gain = quick[0].bic - fit.bic
    near = sum(quick[0].bic - f.bic < max(CLOSE * gain, 5.0 * RIVAL) for f in quick[:FINALISTS])
    full, rest = [fully(f, take) for f in quick[:near]], quick[near:]
    while rest and rest[0].bic > max(f.bic for f in full):  # full refits may end lower: a quick one is no answer
        full.append(fully(rest.pop(0), take))
    return sorted([*full, *rest], key=lambda f: -f.bic)


def beside_given(given: Fit, corrected: Fit, take: Take, left_out: Sequence[str]) -> list[Fit]:
    """Joint refits of the most promising effects beside parameters that were not refitted, and what `corrected` has."""
    more = corrected.hypothesis
    try:
        if more.effects != given.hypothesis.effects:
            values = corrected.hypothesis.values(corrected.phi) | given.hypothesis.values(given.phi)
            given = held(take, more, more.start(given.car(), list(values.values())), given.scales)
        candidates = screen(given, take, changes(given, take).without(left_out))
    except FloatingPointError:  # parameters that hardly drive this take
        return []
    return of_the_shortlist(given, take, [c for c in candidates[:SHORTLIST] if c.score > WORTH])


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


def at_their_sizes(fit: Fit, take: Take, phi: Floats, names: Sequence[str]) -> list[Fit]:
    """Joint refits of the most promising of `names`, each from its best size beside what `fit` holds; best first.

    On a part of the take, from `phi` of that and from the fit's free parts.
    """
    few, enough = (_evenly(take, n) for n in (FEW, ENOUGH))
    part, best, hypothesis = take.part(enough), dict[str, Fit](), fit.hypothesis
    promise = partial(_promise, before=fit.per_segment[enough])
    for name in names:
        more = hypothesis.holding(*hypothesis.effects, name)
        sizes = _best_sizes(fit, take, few, more, phi)
        if sizes:
            there = more.start(hypothesis.car(phi), [*hypothesis.values(phi).values(), *sizes])
            with suppress(FloatingPointError):
                best[name] = refit(part, more, there, fit.start[enough], fit.scales, tangents=ROUGHLY)
    for name in sorted(best, key=lambda n: -promise(best[n]))[PROMISING:]:
        del best[name]
    return sorted((_closer(f, part) for f in best.values()), key=promise, reverse=True)


def _best_sizes(fit: Fit, take: Take, chosen: Ints, more: Hypothesis, phi: Floats) -> tuple[float, ...]:
    """Of `more`'s last effect the values that promise most on the `chosen` segments; none where all leave the numbers.

    All else stays at `phi` of what `fit` holds.
    """
    hypothesis, part, before = fit.hypothesis, take.part(chosen), fit.per_segment[chosen]
    known, own = list(hypothesis.values(phi).values()), more.entries[more.effects[-1]].parameters
    tried, best = dict[tuple[float, ...], float](), tuple(p.size for p in own)
    together = ((1.0,) * len(own),)
    for shares, ways in ((COARSELY, WAYS if len(own) == 2 else together), (FINELY, together)):
        for sizes in (v for v in _sizes(own, best, shares, ways) if v not in tried):
            with suppress(FloatingPointError):
                there = more.start(hypothesis.car(phi), [*known, *sizes])
                found = refit(part, more, there, fit.start[chosen], fit.scales, tangents=0)
                tried[sizes] = _promise(found, before)
        if not tried:
            return ()
        best = max(tried, key=lambda sizes: tried[sizes])
    return best


def _sizes(
    own: Sequence[Parameter], of: tuple[float, ...], shares: tuple[float, ...], ways: Sequence[tuple[float, ...]]
) -> list[tuple[float, ...]]:
    """Values to try of an effect's parameters: such shares `of` some, in each of the `ways`, within their bounds."""
    signed = shares if all(p.low < 0.0 for p in own) else [share for share in shares if share > 0.0]
    values = (
        tuple(min(max(share * s * v, p.low), p.high) for p, v, s in zip(own, of, way, strict=True))
        for share, way in itertools.product(signed, ways)
    )
    return list(dict.fromkeys(values))


def _closer(fit: Fit, part: Take) -> Fit:
    """The fit a few tangents on, or as it is where they lead out of the finite numbers."""
    try:
        return refit(part, fit.hypothesis, fit.phi, fit.start, fit.scales, tangents=CLOSELY)
    except FloatingPointError:
        return fit


def _promise(fit: Fit, before: Floats) -> float:
    """Nats that a fit gains over each segment's `before`, lost ones counting little, less what its BIC charges."""
    each = MOST * np.tanh((fit.per_segment - before) / MOST)
    return float(each.sum()) + fit.bic - fit.log_likelihood


def on_the_whole(beside: Fit, take: Take, fits: Sequence[Fit]) -> list[Fit]:
    """The first FINALISTS of `fits`, which are of a part of the take, refitted on all of it from the parts of `beside`.

    Those that are not credible are passed over.
    """
    whole = list[Fit]()
    for f in itertools.islice((f for f in fits if credible(f, take)), FINALISTS):
        with suppress(FloatingPointError):
            whole.append(refit(take, f.hypothesis, f.phi, beside.start, beside.scales))
    return whole


def _evenly(take: Take, n: int) -> Ints:
    """So many of the take's segments, or all."""
    return np.unique(np.linspace(0, take.segments - 1, min(n, take.segments)).round().astype(np.int64))


def from_afar(fit: Fit, take: Take, left_out: Sequence[str]) -> list[Fit]:
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


def quickly(fit: Fit, take: Take, candidate: Candidate) -> Fit:
    """The joint refit with one more effect along the fit's own tangent, from the score test's values."""
    sharp = sharpened(fit, take, candidate)
    more = fit.hypothesis.holding(*fit.hypothesis.effects, candidate.effect)
    values = [*fit.hypothesis.values(fit.phi).values(), *sharp.values]
    return refit(take, more, more.start(fit.car(), values), fit.start, fit.scales, QUICK, fit.tangent)


def named(fit: Fit) -> tuple[str, ...]:
    """The effects of the vocabulary that `fit` holds beyond what its base model assumes."""
    return tuple(n for n in fit.hypothesis.effects if n in EFFECTS and n not in fit.hypothesis.assumed)


def credible(fit: Fit, take: Take) -> bool:
    """Whether none that it names stands in: no car has a size, of either sign, where the range of such sizes ends.

    A change so early or late that the rest of the take is another car tells of the base model's parameters.
    """
    values, names, length_s = fit.hypothesis.values(fit.phi), named(fit), float(np.max(take.length_s))
    return not any(
        not EDGE * length_s < values[field] < (1.0 - EDGE) * length_s
        if p.symbol == "t_s"
        else p.low < 0.0 and not p.places and p.at_bound(values[field])
        for field, p in fit.hypothesis.parameters
        if field.partition("__")[0] in names
    )


def best_first(fits: Sequence[Fit], take: Take) -> list[Fit]:
    """Those that are credible."""
    return sorted((f for f in fits if credible(f, take)), key=lambda f: -f.bic)


def fully(fit: Fit, take: Take) -> Fit:
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
    fits, error = list[Fit](), FloatingPointError()
    for car, start in ((fit.car(), fit.start), (less.nominal, take.start)):
        if fits and not take.pushed:  # under pushes, what was taken away leaves such as hold the car where it was
            break
        try:
            fits.append(refit(take, less, less.start(car, [*known, *added]), start, fit.scales))
        except FloatingPointError as failed:  # what was taken away had kept the car within the finite numbers
            error = failed
    if not fits:
        raise error
    return max(fits, key=lambda f: f.bic)
