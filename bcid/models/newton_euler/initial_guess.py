"""A Newton-Euler car to start from: least squares on one-step predictions, from physical defaults.

Good to some per cent in a second; whoever needs more goes on from there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bcid.aliases import Floats
from bcid.estimate.types import Estimate
from bcid.models.fitting.windows import scale, transitions
from bcid.models.newton_euler.objective import Stretches, predictions
from bcid.models.newton_euler.parameters import Box
from bcid.physics.car import Car
from bcid.vehicle import Vehicle

MOST_SAMPLES = 2000
STARTS = 2
LOUDEST = 20.0  # robust times the usual change of the twist in a period; beyond, the estimator has failed


def started_car(estimates: Sequence[Estimate], vehicle: Vehicle, T_s: float, d: float, v_0: float = 1.0) -> Car:
    """The car that predicts the twist one period ahead best, from a few starts within the parameters' ranges."""
    from scipy.optimize import least_squares

    samples = transitions(estimates)
    twist, after = samples.twist[:, 0], samples.next_twist
    change = np.abs(after - twist)
    usual = np.quantile(change, 0.9, axis=0)
    rows = np.flatnonzero((change < LOUDEST * usual).all(axis=1))
    rows = rows[:: max(1, len(rows) // MOST_SAMPLES)]
    weight = scale(twist[rows])[:, None]
    start = np.vstack([twist[rows].T, samples.kinematic[rows, 3]])
    one = Stretches(start, *(np.ascontiguousarray(a[rows].T[None]) for a in (samples.command[:, 0], after)))
    box = Box(vehicle, T_s, d, v_0, float(np.quantile(np.abs(samples.kinematic[rows, 0]), 0.999)))
    low = np.log([p.low for p in box.table])

    def misses(x: Floats) -> Floats:
        predicted = predictions([box.car((x - low) / box.log_range)], one, estimates[0].period_s)[0]
        return np.asarray((weight * (predicted - one.after)).ravel())

    found = [
        least_squares(misses, start, bounds=(low, low + box.log_range), loss="soft_l1", f_scale=0.05, max_nfev=40)
        for start in _starts(low, low + box.log_range)
    ]
    return box.car((min(found, key=lambda f: f.cost).x - low) / box.log_range)


def _starts(low: Floats, high: Floats) -> list[Floats]:
    """The middle of the ranges, which scale with the car, and points about it."""
    middle = 0.5 * (low + high)
    rng = np.random.default_rng(0)
    spread = 0.15 * (high - low)
    return [middle, *(middle + spread * rng.uniform(-1.0, 1.0, len(middle)) for _ in range(STARTS - 1))]
