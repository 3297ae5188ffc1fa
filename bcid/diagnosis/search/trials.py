"""What the score test tries: every effect at a few sizes, on a grid of places and at a few moments."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from bcid.diagnosis.locate.scan_statistic import Circle
from bcid.effects.entry import Effect
from bcid.likelihood.score_test import changed_in
from bcid.likelihood.take import Take

SHARES = (0.5, 1.5)  # trial sizes of an effect of one sign
PLACES = 5  # across the longer side of what was driven
MOMENTS = 8  # in the recording
WITHIN = (0.3, 0.5, 0.7, 1.0)  # of their radius: a circle inside of what is odd shows it, one that sticks out does not


def trials_of(effect: Effect, take: Take, odd: Sequence[Circle]) -> Iterator[list[list[float]]]:
    """Vectors of the effect's parameters to try, those of a row combined linearly; `odd` places are tried too."""
    amplitudes = [i for i, p in enumerate(effect.parameters) if not p.places]
    for place in _places(effect, take, odd):
        still = [place.get(p.symbol, p.off) for p in effect.parameters]
        if len(amplitudes) > 1:
            yield [changed_in(still, i, effect.parameters[i].size) for i in amplitudes]
            continue
        (i,) = amplitudes
        size = effect.parameters[i].size
        if effect.parameters[i].low < 0.0:
            yield from ([changed_in(still, i, sign * size)] for sign in (1.0, -1.0))
        else:
            yield from ([changed_in(still, i, share * size)] for share in (SHARES if not place else (1.0,)))


def _places(effect: Effect, take: Take, odd: Sequence[Circle]) -> list[dict[str, float]]:
    """Trial values of the parameters that are places or times; one empty choice where there are none.

    Circles are tried on a grid and where the disturbances are larger than elsewhere.
    """
    symbols = [p.symbol for p in effect.places]
    if not symbols:
        return [{}]
    if "t_s" in symbols:
        return [{"t_s": share * float(take.length_s.max())} for share in np.linspace(0.1, 0.9, MOMENTS)]
    low, high = np.quantile(take.pose[:, :2], 0.01, axis=0), np.quantile(take.pose[:, :2], 0.99, axis=0)
    spacing = float((high - low).max()) / PLACES
    counts = np.maximum(np.round((high - low) / spacing).astype(int), 1)
    reach = spacing if "r_0" in symbols else 0.0  # a cable may be fixed outside of what was driven
    axes = [
        np.linspace(a - reach, b + reach, n + 1) if reach else a + (np.arange(n) + 0.5) * (b - a) / n
        for a, b, n in zip(low, high, counts, strict=True)
    ]
    rest = {"radius": 0.75 * spacing} if "radius" in symbols else {"r_0": 0.5 * spacing}
    grid = [{"x": float(x), "y": float(y), **rest} for x, y in itertools.product(*axes)]
    if "radius" in symbols:  # a knot's mean place lies up to half a knot's way from where it was pushed
        grid += [{"x": c.x, "y": c.y, "radius": share * c.radius} for c in odd for share in WITHIN]
    return grid
