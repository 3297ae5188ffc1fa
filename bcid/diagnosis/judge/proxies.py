"""Effects that only stand in for something without a name: they do roughly what is missing, and much of it stays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

from bcid.diagnosis.locate.channel_gains import explained_by
from bcid.diagnosis.locate.pushes import disturbances, relieved
from bcid.diagnosis.locate.scan_statistic import Circle
from bcid.diagnosis.locate.unexplained import Left
from bcid.diagnosis.search.forward_backward import Search
from bcid.diagnosis.search.line_search import at_simulated
from bcid.diagnosis.search.refits import named
from bcid.effects.table import EFFECTS
from bcid.likelihood.refit import Fit, held
from bcid.likelihood.take import Take

WORTH_TELLING = 0.02  # share of what is explained from which a remainder is told beside it
ENOUGH = 0.1  # share of what is explained that may be left predictable, where effects are named
LEFT_OVER = 0.15  # of what an effect's own channel would explain without it, which may be left in another,
OVERLAP = 0.25  # and which that other would explain less with it: beyond both it only stands in for something else
BEYOND = 3.0  # times what free functions promise, which an effect gains where they are no measure of it
FAR_OFF = 0.5  # the same two shares, of a car that is pushed: more is missing than has a name
STANDING_OUT = 0.4  # correlation of what is left with what trees predict, above which names are stand-ins
ELSEWHERE = 0.25  # share of what an effect relieves the pushes of, up to which it does so elsewhere
WAYS = {"fx": ("along",), "motor": ("along",), "fy": ("across",), "mz": ("across",), "steering": ("across",)}
"""Where a channel's pushes go; those of the others, anywhere."""


class _Seen(NamedTuple):
    """What a take shows with some effects and without each, as far as it says which of them stand in."""

    best: Fit
    without: Mapping[str, Fit]
    left: Left

    @property
    def gains(self) -> dict[str, float]:
        """Nats that each effect is worth beside the others."""
        return {name: self.best.bic - fit.bic for name, fit in self.without.items()}

    def over(self, gate: float) -> dict[str, float]:
        """Of `entering` what is worth telling and beyond chance."""
        least = max(gate, WORTH_TELLING * sum(self.gains.values()))
        return {channel: nats for channel, nats in self.left.entering.items() if nats > least}


def stand_ins(found: Search, take: Take, place: Circle | None, left: Left) -> tuple[str, ...]:
    """Those of the effects found that stand in, each alone or all together; `left` is what is left beside them.

    Beside a trusted simulation they have to stand in beside its own parameters as well: a refit without an effect bends
    those to what is missing as far as they go, so that the effect seems to explain little.
    """
    if not named(found.best):
        return ()
    seen = _Seen(found.best, found.without, left)
    doing = _doing_duty(seen, take, place, found.nulls.gate)
    if not doing or found.best.hypothesis.simulated is None:
        return doing
    try:
        beside = _doing_duty(_beside_simulation(found, take, place), take, place, found.nulls.gate)
    except FloatingPointError:  # its own parameters may not drive this take
        return doing
    return tuple(name for name in doing if name in beside)


def _beside_simulation(found: Search, take: Take, place: Circle | None) -> _Seen:
    """The same effects beside a trusted simulation's own parameters, nothing of which is refitted.

    Those without which it does not drive this take at all explain what nothing else does, and are left out.

    Raises:
        FloatingPointError: it does not, with all of them.
    """
    best, without = _held(found.best, take), dict[str, Fit]()
    for name, fit in found.without.items():
        with suppress(FloatingPointError):
            without[name] = _held(fit, take)
    return _Seen(best, without, Left.of(best, take, place))


def _held(fit: Fit, take: Take) -> Fit:
    """The fit with a trusted simulation's own parameters, and its own of all else."""
    return held(take, fit.hypothesis, at_simulated(fit), fit.scales)


def _doing_duty(seen: _Seen, take: Take, place: Circle | None, gate: float) -> tuple[str, ...]:
    """Those that stand in, each alone; all together where none does and much is left that stands out."""
    over, gains, left = seen.over(gate), seen.gains, seen.left.remainder
    alone = tuple(name for name in gains if over and _stands_in(name, seen, take, place, over))
    if alone or not left.predictable or left.correlation <= STANDING_OUT:
        return alone
    return _mixed(seen, take) if left.gain > _much(take, ENOUGH) * sum(gains.values()) else ()


def _stands_in(name: str, seen: _Seen, take: Take, place: Circle | None, over: Mapping[str, float]) -> bool:
    """Whether an effect does only roughly what a channel's free functions show to be missing there.

    They still explain much beside it (`over`, nats by channel), and without it would explain much of what it does:
    what is really missing enters there, in another way.
    """
    without, gained = explained_by(seen.without[name], take, place), seen.gains[name]
    own = without.get(EFFECTS[name].channel, max(without.values()))  # to first order, as the others are
    # which says little where the fit had to go far, or where pushes do the work already: then what it gains counts
    if take.pushed or gained > BEYOND * own:
        own = max(own, gained)
    much = _much(take, LEFT_OVER) * own
    there = [c for c, nats in over.items() if nats > much and without[c] - nats > OVERLAP * own]
    return _pushes_in(there, name, seen, take)


def _much(take: Take, share: float) -> float:
    """The share of what is explained that may be left; FAR_OFF where the base model is wrong in many ways."""
    return FAR_OFF if take.pushed else share


def _pushes_in(channels: Sequence[str], name: str, seen: _Seen, take: Take) -> bool:
    """Whether the pushes that the effect makes unnecessary go where one of the channels' do.

    What acts along a car is no stand-in for what is left across it.
    """
    if not channels:
        return False
    shares = relieved(disturbances(seen.without[name], take), disturbances(seen.best, take))
    return any(sum(shares[way] for way in WAYS.get(c, tuple(shares))) > ELSEWHERE for c in channels)


def _mixed(seen: _Seen, take: Take) -> tuple[str, ...]:
    """Effects that stand in, together, for something that is not in the vocabulary and still stands out."""
    out = [c for c, r in seen.left.remainder.correlations.items() if r > STANDING_OUT]
    return tuple(n for n in seen.without if _pushes_in(out, n, seen, take))
