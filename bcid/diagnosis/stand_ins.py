"""Effects that only stand in for something without a name: they do roughly what is missing, and much of it stays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress

from bcid.diagnosis.candidates import at_simulated, named
from bcid.diagnosis.channels import explained_by
from bcid.diagnosis.disturbance import disturbances, relieved
from bcid.diagnosis.remainder import Remainder
from bcid.diagnosis.scan import Circle
from bcid.diagnosis.search import Search
from bcid.effects.table import EFFECTS
from bcid.likelihood.refit import held
from bcid.likelihood.take import Take

ENOUGH = 0.1  # share of what is explained that may be left predictable, where effects are named
LEFT_OVER = 0.4  # of what an effect's own channel would explain without it, which may be left in another,
OVERLAP = 0.25  # and which that other would explain less with it: beyond both it only stands in for something else
BEYOND = 3.0  # times what free functions promise, which an effect gains where they are no measure of it
STANDING_OUT = 0.4  # correlation of what is left with what trees predict, above which names are stand-ins
ELSEWHERE = 0.25  # share of what an effect relieves the pushes of, up to which it does so elsewhere
WAYS = {"fx": ("along",), "motor": ("along",), "fy": ("across",), "mz": ("across",), "steering": ("across",)}
"""Where a channel's pushes go; those of the others, anywhere."""


def stand_ins(
    found: Search, gains: Mapping[str, float], take: Take, place: Circle | None, left: Remainder,
    over: Mapping[str, float],
) -> tuple[str, ...]:  # fmt: skip
    """Those of the effects found that stand in, each alone or all together.

    `gains` are theirs (nats), `left` what is predictable beside them, `over` what free functions would still explain
    by channel.
    """
    if not gains:
        return ()
    beside = _beside_simulation(found, take) if over or left.predictable else {}
    explained = {name: max(gain, beside.get(name, gain)) for name, gain in gains.items()}
    alone = tuple(n for n, nats in explained.items() if _stands_in(n, nats, found, take, place, over))
    if alone or not left.predictable or left.correlation <= STANDING_OUT:
        return alone
    return _mixed(found, take, left) if left.gain > _much(take, ENOUGH) * sum(explained.values()) else ()


def _beside_simulation(found: Search, take: Take) -> dict[str, float]:
    """Nats that each effect found gains beside a trusted simulation's own parameters, where there is one.

    A refit without the effect bends them to what is missing, however well they are known.
    """
    best = found.best.hypothesis
    if best.simulated is None:
        return {}
    phi = at_simulated(found.best)
    values = best.values(phi)

    def nats(*effects: str) -> float:
        own = best.holding(*effects)
        start = own.start(best.car(phi), [values[field] for field, _ in own.parameters])
        return held(take, own, start, found.best.scales).bic

    gains = {}
    for name in named(found.best):
        with suppress(FloatingPointError):  # without it they may not drive this take at all
            gains[name] = nats(*best.effects) - nats(*(n for n in best.effects if n != name))
    return gains


def _stands_in(
    name: str, gained: float, found: Search, take: Take, place: Circle | None, over: Mapping[str, float]
) -> bool:
    """Whether an effect does only roughly what a channel's free functions show to be missing there.

    They still explain much beside it (`over`, nats by channel), and without it would explain much of what it does:
    what is really missing enters there, in another way.
    """
    if not over:
        return False
    without = explained_by(found.without[name], take, place)
    own = without.get(EFFECTS[name].channel, max(without.values()))  # to first order, as the others are
    # which says little where the fit had to go far, or where pushes do the work already: then what it gains counts
    if take.pushed or gained > BEYOND * own:
        own = max(own, gained)
    much = _much(take, LEFT_OVER) * own
    there = [c for c, nats in over.items() if nats > much and without[c] - nats > OVERLAP * own]
    return _pushes_in(there, name, found, take)


def _much(take: Take, share: float) -> float:
    """The share of what is explained that may be left; as much again, where the base model is far off in many ways."""
    return 1.0 if take.pushed else share


def _pushes_in(channels: Sequence[str], name: str, found: Search, take: Take) -> bool:
    """Whether the pushes that the effect makes unnecessary go where one of the channels' do.

    What acts along a car is no stand-in for what is left across it.
    """
    if not channels:
        return False
    shares = relieved(disturbances(found.without[name], take), disturbances(found.best, take))
    return any(sum(shares[way] for way in WAYS.get(c, tuple(shares))) > ELSEWHERE for c in channels)


def _mixed(found: Search, take: Take, left: Remainder) -> tuple[str, ...]:
    """Effects that stand in, together, for something that is not in the vocabulary and still stands out."""
    out = [c for c, r in left.correlations.items() if r > STANDING_OUT]
    return tuple(n for n in named(found.best) if _pushes_in(out, n, found, take))
