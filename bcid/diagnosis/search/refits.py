"""Joint refits with one effect more: from the score test, beside a simulation's own parameters, from afar.

From sizes of their own: `bcid.diagnosis.search.line_search`.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from contextlib import suppress

import numpy as np

from bcid.diagnosis.search.screen import Candidate, changes, screen, sharpened
from bcid.effects.corrections import CORRECTIONS
from bcid.effects.entry import Parameter
from bcid.effects.table import EFFECTS, effects_of
from bcid.likelihood.refit import Fit, held, refit
from bcid.likelihood.take import Take

SHORTLIST = 8
WORTH = 6.0  # nats of score below which a candidate is not refitted
RIVAL = 4.0  # nats within which two explanations cannot be told apart
FINALISTS = 3
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


def told(fit: Fit, take: Take, candidates: Iterable[Candidate]) -> list[Candidate]:
    """Those of which a score test tells anything.

    Beside pushes that do its work already, a small change promises little of what an effect does.
    """
    return [c for c in candidates if not take.pushed or fit.hypothesis.entries[c.effect].places]


def from_afar(fit: Fit, take: Take, left_out: Sequence[str]) -> list[Fit]:
    """Joint refits of the effects in SWALLOWED from sizes that matter, whatever the score test says of them.

    The best of them on a part of the take, then on the whole.
    """
    chosen = np.arange(0, take.segments, 4)
    part, found, h = take.part(chosen), list[Fit](), fit.hypothesis
    nominal = h.start(h.nominal, list(h.values(fit.phi).values()))
    for name, share, near in itertools.product(SWALLOWED, FAR_SHARES, (fit.phi, nominal)):
        if name not in h.entries or name in h.effects or name in left_out:
            continue
        more, phi = h.with_effect(name, near, [share * p.size for p in h.entries[name].parameters])
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
    more, phi = fit.hypothesis.with_effect(candidate.effect, fit.phi, sharp.values)
    return refit(take, more, phi, fit.start, fit.scales, QUICK, fit.tangent)


def named(fit: Fit) -> tuple[str, ...]:
    """The effects of the vocabulary that `fit` holds beyond what its base model assumes."""
    return tuple(n for n in fit.hypothesis.effects if n in EFFECTS and n not in fit.hypothesis.assumed)


def corrections(fit: Fit) -> tuple[str, ...]:
    """The base model's own simplifications that `fit` corrects; what is assumed stands with the base model."""
    return tuple(n for n in fit.hypothesis.effects if n in CORRECTIONS and n not in fit.hypothesis.assumed)


def incredible(fit: Fit, take: Take) -> tuple[str, ...]:
    """Those of the effects named that stand in: no car has a size, of either sign, where the range of such sizes ends.

    A change so early or late that the rest of the take is another car tells of the base model's parameters.
    """
    values, length_s = fit.hypothesis.values(fit.phi), float(np.max(take.length_s))

    def at_an_end(field: str, p: Parameter) -> bool:
        if p.symbol == "t_s":
            return not EDGE * length_s < values[field] < (1.0 - EDGE) * length_s
        return p.low < 0.0 and not p.places and p.at_bound(values[field])

    at_ends = effects_of(field for field, p in fit.hypothesis.parameters if at_an_end(field, p))
    return tuple(name for name in named(fit) if name in at_ends)


def best_first(fits: Sequence[Fit], take: Take) -> list[Fit]:
    """Those that name nothing incredible."""
    return sorted((f for f in fits if not incredible(f, take)), key=lambda f: -f.bic)


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
