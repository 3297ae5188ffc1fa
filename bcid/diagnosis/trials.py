"""What the score test tries: every effect at a few sizes, on a grid of places and at a few moments."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from bcid.diagnosis.scan import Circle
from bcid.effects.entry import Effect
from bcid.likelihood.take import SEGMENT_S, Floats, Ints, Take

SHARES = (0.5, 1.5)  # trial sizes of an effect of one sign
PLACES = 5  # across the longer side of what was driven
MOMENTS = 8  # in the recording
WITHIN = (0.3, 0.5, 0.7, 1.0)  # of their radius: a circle inside of what is odd shows it, one that sticks out does not
SEEN_ELSEWHERE = 0.1  # of its distance from the origin, at most: a pose's scale and the marker's offset


class Trial(NamedTuple):
    """One effect at one place: its trial vectors, combined linearly, and their columns among the changes."""

    effect: str
    vectors: list[list[float]]
    own: slice


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


def changed_in(values: list[float], i: int, value: float) -> list[float]:
    """The values with the `i`th replaced."""
    return [*values[:i], value, *values[i + 1 :]]


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


def concerned(take: Take, path: Floats, at: Mapping[str, float]) -> Ints:
    """The segments whose predictions an effect `at` a place or time can change, seen along `path` (N, 3) without it.

    A circle changes nothing for a car that does not come into it, a moment nothing for what was before.  Where the
    car is may differ from where it is seen.
    """
    if "radius" in at:
        steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
        within = np.diff(np.repeat(np.arange(take.segments), np.diff(take.first))) == 0
        apart = np.hypot(path[:, 0] - at["x"], path[:, 1] - at["y"]) - SEEN_ELSEWHERE * np.hypot(*path[:, :2].T)
        return np.flatnonzero(np.minimum.reduceat(apart, take.first[:-1]) < at["radius"] + 2.0 * steps[within].max())
    if "t_s" in at:
        return np.flatnonzero(take.begin_s - take.zero_s + 2.0 * SEGMENT_S > at["t_s"])
    return np.arange(take.segments)
