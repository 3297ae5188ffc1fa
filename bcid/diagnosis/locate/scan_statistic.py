"""Where and when the disturbances are larger than elsewhere: a scan over circles on the floor and windows of time.

The statistic is Kulldorff's likelihood ratio for exponential energies: how much better two mean energies, in and
out, explain the knots than one.  Its p-value is global over all circles (windows) looked at, by permuting
segments.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.locate.pushes import Disturbances
from bcid.effects.entry import Units
from bcid.likelihood.take import KNOTS

RADII_M = (0.5, 0.8, 1.2, 1.7)  # of the bumper car, as is
SPACING = 0.5  # of the circles' centres, in radii
CLIP = 30.0  # one knot cannot carry a place alone
FEWEST = 6  # knots in a circle
PERMUTATIONS = 499
WINDOWS = 24  # of time
APART_M = 0.6


class Circle(NamedTuple):
    """A place that stands out."""

    x: float
    y: float
    radius: float
    statistic: float


class Window(NamedTuple):
    """A time that stands out."""

    begin_s: float
    end_s: float
    statistic: float


def energy(of: Disturbances) -> Floats:
    """Mean squared strength of the three channels of every knot (K,), 1 where the fit expects it, clipped."""
    return np.asarray(np.minimum((of.strength**2).mean(axis=1), CLIP))


def _ratios(inside: Floats, energies: Floats) -> Floats:
    """The statistic of every set of knots: `inside` (M, K) of ones and zeros, `energies` (K,) or (K, P)."""
    n = inside.sum(axis=1).reshape(-1, *[1] * (energies.ndim - 1))
    K, total = len(energies), energies.sum(axis=0)
    within = inside @ energies
    mean_in, mean_out = within / np.maximum(n, 1), np.maximum(total - within, 0.0) / np.maximum(K - n, 1)  # by rounding
    tiny = 1e-12
    ratio = K * np.log(total / K + tiny) - n * np.log(mean_in + tiny) - (K - n) * np.log(mean_out + tiny)
    return np.asarray(np.where((mean_in > mean_out) & (n >= FEWEST) & (n <= K // 2), ratio, 0.0))


def _permuted(energies: Floats) -> Floats:
    """The energies with whole segments exchanged (K, PERMUTATIONS)."""
    rng = np.random.default_rng(0)
    by_segment = energies.reshape(-1, KNOTS)
    orders = [rng.permutation(len(by_segment)) for _ in range(PERMUTATIONS)]
    return np.stack([by_segment[o].ravel() for o in orders], axis=1)


def _global_p(inside: Floats, energies: Floats, observed: float) -> float:
    most = _ratios(inside, _permuted(energies)).max(axis=0)
    return (1 + int(np.sum(most >= observed))) / (1 + PERMUTATIONS)


def circles(of: Disturbances, units: Units, count: int = 6) -> tuple[list[Circle], float]:
    """The circles that stand out most, APART_M from each other, best first; and the global p-value of the first.

    As wide and as far apart as suits the vehicle in `units`.
    """
    place = np.column_stack([of.mean["p_x"], of.mean["p_y"]])
    tried, rows = [], []
    for radius in np.multiply(RADII_M, units.reach).tolist():
        step = SPACING * radius
        centres = np.unique(np.round(place / step).astype(int), axis=0) * step
        for x, y in centres:
            rows.append(((place - [x, y]) ** 2).sum(axis=1) < radius * radius)
            tried.append((float(x), float(y), radius))
    inside = np.array(rows, dtype=float)
    energies = energy(of)
    found = _ratios(inside, energies)
    best: list[Circle] = []
    for i in np.argsort(-found):
        x, y, radius = tried[i]
        if all((c.x - x) ** 2 + (c.y - y) ** 2 > (APART_M * units.reach) ** 2 for c in best):
            best.append(Circle(x, y, radius, float(found[i])))
        if len(best) == count:
            break
    return best, _global_p(inside, energies, best[0].statistic)


def windows(of: Disturbances) -> tuple[Window, float]:
    """The time that stands out most, in whole parts of the take, and its global p-value."""
    edges = np.linspace(of.time_s[0], of.time_s[-1] + 1e-6, WINDOWS + 1)
    spans = [(a, b) for a in range(WINDOWS) for b in range(a + 1, WINDOWS + 1) if b - a < WINDOWS]
    inside = np.array([(of.time_s >= edges[a]) & (of.time_s < edges[b]) for a, b in spans], dtype=float)
    energies = energy(of)
    found = _ratios(inside, energies)
    i = int(np.argmax(found))
    a, b = spans[i]
    return Window(float(edges[a]), float(edges[b]), float(found[i])), _global_p(inside, energies, float(found[i]))
