"""What a take could not have shown: effects that would have had to be large for this vehicle to be seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcid.effects.entry import Units
from bcid.effects.table import EFFECTS
from bcid.experiment.detectability import Option, gains_of, options_of, smallest
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take

LARGE = 3.0  # times an effect's size: what is only seen beyond counts as not excited


class Unexcited(NamedTuple):
    """An effect that would have had to be large to be seen."""

    effect: str
    symbol: str
    smallest: float | None  # None where the take does not excite it at all
    unit: str


def unexcited(fit: Fit, take: Take, units: Units, gate: float) -> tuple[Unexcited, ...]:
    """The effects that `fit` does not hold and that the take would not have shown at LARGE times their size.

    At the size as it suits the vehicle in `units`, not this drive: what matters at full speed may not show in a slow
    one.  Of an effect with a place, at the one that shows it best.
    """
    usual = replace(fit.hypothesis, units=units)
    names = [n for n in EFFECTS if n in usual.entries and n not in usual.effects]
    options = [o.at(min(LARGE * o.values[o.which], o.parameter.high)) for o in options_of(names, take, usual)]
    price = gate + 0.5 * np.log(take.segments)
    seen = gains_of(fit, take, options)
    best = dict[tuple[str, str], int]()
    for i, o in enumerate(options):
        here = (o.effect, o.parameter.symbol)
        best[here] = max(best.get(here, i), i, key=lambda j: seen[j])
    missed = [options[i] for i in best.values() if seen[i] < price]
    return _told(missed, smallest(fit, take, missed, np.full(len(missed), price))) if missed else ()


def _told(missed: Sequence[Option], sizes: Sequence[float]) -> tuple[Unexcited, ...]:
    """Each with the smallest size that shows, if any within its bounds does."""
    rows = []
    for o, size in zip(missed, sizes, strict=True):
        told = o.parameter.quoted(size if np.isfinite(size) else 0.0, None)
        rows.append(Unexcited(o.effect, told.symbol, told.value if np.isfinite(size) else None, told.unit))
    return tuple(rows)
