"""Where and when the disturbances are larger than elsewhere: a scan over circles on the floor and windows of time.

The statistic is Kulldorff's likelihood ratio for exponential energies: how much better two mean energies, inside and
outside, explain the knots than one.  Its p-value is global over all circles (windows) of the scan, by permutation of
the segments.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.diagnosis.limits import LOCATE_LIMITS
from bcid.diagnosis.locate.pushes import Disturbances
from bcid.effects.entry import VehicleScale
from bcid.likelihood.take import KNOTS

RADII_M = (0.5, 0.8, 1.2, 1.7)  # of the bumper car, as is
CENTRE_SPACING = 0.5  # of the circles' centres, in radii
PERMUTATIONS = 499
SETS_AT_ONCE = 256  # of which statistics are computed together: of all, they would need hundreds of megabytes
TIME_PARTS = 24  # of a take, of which windows are made


class FloorCircle(NamedTuple):
    """A place on the floor (m) with Kulldorff's statistic of the disturbances within it."""

    x: float
    y: float
    radius: float
    statistic: float


class TimeWindow(NamedTuple):
    """A stretch of time with Kulldorff's statistic of the disturbances within it."""

    begin_s: float
    end_s: float
    statistic: float


def knot_energies(disturbances: Disturbances) -> Floats:
    """Energy (K,) of the disturbances at each 0.25 s knot: mean over x, y, yaw of (disturbance / standard deviation)^2.

    The standard deviation is the one that the fit expects, so that the mean energy is about 1; values are clipped at
    `LOCATE_LIMITS.max_knot_energy`.
    """
    return np.asarray(np.minimum((disturbances.strength**2).mean(axis=1), LOCATE_LIMITS.max_knot_energy))


def _kulldorff_ratios(inside: Floats, energies: Floats) -> Floats:
    """Kulldorff's log-likelihood ratio K ln E - n ln E_in - (K - n) ln E_out of M sets, each of n of the K knots.

    E is the mean energy of all knots, E_in inside and E_out outside the set.  `inside` (M, K) holds ones and zeros;
    `energies` may be (K,) or, for P permutations, (K, P): the result is (M,) or (M, P).  It is 0 for sets of fewer than
    `LOCATE_LIMITS.min_scan_knots` or more than half the knots, and where E_in <= E_out.
    """
    n = inside.sum(axis=1).reshape(-1, *[1] * (energies.ndim - 1))
    K, total = len(energies), energies.sum(axis=0)
    within = inside @ energies
    # a difference of sums may be below zero by rounding
    mean_in, mean_out = within / np.maximum(n, 1), np.maximum(total - within, 0.0) / np.maximum(K - n, 1)
    tiny = 1e-12
    ratio = K * np.log(total / K + tiny) - n * np.log(mean_in + tiny) - (K - n) * np.log(mean_out + tiny)
    return np.asarray(np.where((mean_in > mean_out) & (n >= LOCATE_LIMITS.min_scan_knots) & (n <= K // 2), ratio, 0.0))


def _scan_sets(inside: Bools, disturbances: Disturbances) -> tuple[Floats, float]:
    """Kulldorff's scan statistic (M,) of the disturbances' energy in M sets of knots, and the p-value of the largest.

    `inside` (M, K) is true where knot k is in set m.  The p-value is by a permutation test: the share of random
    permutations of whole segments whose largest statistic over all sets is at least as large.
    """
    energies, rng = knot_energies(disturbances), np.random.default_rng(0)
    by_segment = energies.reshape(-1, KNOTS)
    orders = [rng.permutation(len(by_segment)) for _ in range(PERMUTATIONS)]
    permuted = np.stack([by_segment[o].ravel() for o in orders], axis=1)
    ratios, most = np.empty(len(inside)), np.zeros(PERMUTATIONS)
    for begin in range(0, len(inside), SETS_AT_ONCE):
        block = inside[begin : begin + SETS_AT_ONCE].astype(float)
        ratios[begin : begin + SETS_AT_ONCE] = _kulldorff_ratios(block, energies)
        most = np.maximum(most, _kulldorff_ratios(block, permuted).max(axis=0))
    return ratios, (1 + int(np.sum(most >= ratios.max()))) / (1 + PERMUTATIONS)


def scan_circles(disturbances: Disturbances, units: VehicleScale, count: int = 6) -> tuple[list[FloorCircle], float]:
    """Find the circles on the floor with the largest disturbances by Kulldorff's scan statistic, the best first.

    Also returns the p-value of the first by a permutation test over all circles.  Circles have each radius in RADII_M,
    scaled to the vehicle by `units`, and centres where the car was.  At most `count` are returned, whose centres lie at
    least `LOCATE_LIMITS.min_circle_distance_m` (scaled) apart.
    """
    place = np.column_stack([disturbances.states["p_x"], disturbances.states["p_y"]])
    tried = list[tuple[float, float, float]]()
    for radius in np.multiply(RADII_M, units.circle_factor).tolist():
        step = CENTRE_SPACING * radius
        centres = np.unique(np.round(place / step).astype(int), axis=0) * step
        tried += [(float(x), float(y), radius) for x, y in centres]
    inside = np.array([((place - [x, y]) ** 2).sum(axis=1) < r * r for x, y, r in tried])
    ratios, p_value = _scan_sets(inside, disturbances)
    distance = LOCATE_LIMITS.min_circle_distance_m * units.circle_factor
    best: list[FloorCircle] = []
    for i in np.argsort(-ratios):
        x, y, radius = tried[i]
        if all((c.x - x) ** 2 + (c.y - y) ** 2 > distance**2 for c in best):
            best.append(FloorCircle(x, y, radius, float(ratios[i])))
        if len(best) == count:
            break
    return best, p_value


def scan_windows(disturbances: Disturbances) -> tuple[TimeWindow, float]:
    """Find the time window with the largest disturbances by Kulldorff's scan statistic (a likelihood ratio).

    Also returns its p-value by a permutation test over all windows.  Windows begin and end at multiples of 1/TIME_PARTS
    of the take's duration.
    """
    time_s = disturbances.time_s
    edges = np.linspace(time_s[0], time_s[-1] + 1e-6, TIME_PARTS + 1)
    spans = [(a, b) for a in range(TIME_PARTS) for b in range(a + 1, TIME_PARTS + 1) if b - a < TIME_PARTS]
    inside = np.array([(time_s >= edges[a]) & (time_s < edges[b]) for a, b in spans])
    ratios, p_value = _scan_sets(inside, disturbances)
    a, b = spans[int(np.argmax(ratios))]
    return TimeWindow(float(edges[a]), float(edges[b]), float(ratios.max())), p_value
