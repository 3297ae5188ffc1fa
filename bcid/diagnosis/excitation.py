"""What a take could not have shown: the smallest size of each effect that would have been found."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.diagnosis.score import projected
from bcid.diagnosis.screen import Changes
from bcid.effects.table import EFFECTS
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take

LARGE = 3.0  # times an effect's size: what is only seen beyond counts as not excited


class Unexcited(NamedTuple):
    """An effect that would have had to be large to be seen."""

    effect: str
    symbol: str
    smallest: float | None  # None where the take does not excite it at all
    unit: str


def smallest_detectable(fit: Fit, take: Take, trials: Changes, gate: float) -> dict[str, dict[str, float | None]]:
    """For each effect and amplitude the size at which its expected gain reaches the gate; at its best place.

    The gain of an amplitude a is a^2 G/2, G its information with the base parameters projected out.
    """
    information = np.diag(projected(fit, take, trials.columns).G)
    price = gate + 0.5 * np.log(take.segments)
    entries = fit.hypothesis.entries
    found: dict[str, dict[str, float | None]] = {}
    for trial in trials.trials:
        if trial.effect not in EFFECTS:
            continue
        amplitudes = entries[trial.effect].amplitudes
        sizes = found.setdefault(trial.effect, {p.symbol: None for p in amplitudes})
        for k, vector in enumerate(trial.vectors):
            i = next(i for i, p in enumerate(entries[trial.effect].parameters) if not p.places and vector[i] != p.off)
            p = entries[trial.effect].parameters[i]
            G = information[trial.own][k]
            if G > 1e-6:
                size = abs(vector[i]) * float(np.sqrt(2.0 * price / G))
                known = sizes[p.symbol]
                sizes[p.symbol] = size if known is None else min(known, size)
    return found


def unexcited(fit: Fit, take: Take, trials: Changes, gate: float) -> tuple[Unexcited, ...]:
    """The effects that `fit` does not hold and that the take would not have shown at LARGE times their size."""
    rows = []
    others = trials.without(fit.hypothesis.effects)
    for name, sizes in smallest_detectable(fit, take, others, gate).items():
        for p in fit.hypothesis.entries[name].parameters:
            smallest = sizes.get(p.symbol, 0.0)
            if smallest is None or smallest > LARGE * p.size > 0.0:
                seen = None if smallest is None or smallest > max(abs(p.low), abs(p.high)) else smallest
                told = p.quoted(seen or 0.0, None)
                rows.append(Unexcited(name, told.symbol, None if seen is None else told.value, told.unit))
    return tuple(rows)
