"""A Newton-Euler car to start from: least squares on one-step predictions, from physical defaults.

Good to some per cent in a second; whoever needs more goes on from there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bcid.estimate.types import Estimate
from bcid.models.interface import Floats
from bcid.models.newton_euler_fit import Parameter, car_from, one_step_predictions, parameters
from bcid.models.samples import scale, transitions
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
    weight = scale(twist[rows])
    delta, command = samples.kinematic[rows, 3], samples.command[rows, 0]
    top_speed = float(np.quantile(np.abs(samples.kinematic[rows, 0]), 0.999))
    ranges = parameters(vehicle, top_speed)
    low, high = (np.log([getattr(p, side) for p in ranges]) for side in ("low", "high"))

    def car(x: Floats) -> Car:
        values = {p.symbol: float(v) for p, v in zip(ranges, np.exp(x), strict=True)}
        return car_from(values, vehicle, T_s, d, v_0, top_speed)

    def misses(x: Floats) -> Floats:
        predicted = one_step_predictions(car(x), twist[rows], delta, command, estimates[0].period_s)
        return np.asarray((weight * (predicted - after[rows])).ravel())

    found = [
        least_squares(misses, start, bounds=(low, high), loss="soft_l1", f_scale=0.05, max_nfev=40)
        for start in _starts(ranges, low, high)
    ]
    return car(min(found, key=lambda f: f.cost).x)


def _starts(ranges: Sequence[Parameter], low: Floats, high: Floats) -> list[Floats]:
    """The middle of the ranges, which scale with the car, and points about it."""
    middle = 0.5 * (low + high)
    rng = np.random.default_rng(0)
    spread = 0.15 * (high - low)
    return [middle, *(middle + spread * rng.uniform(-1.0, 1.0, len(ranges)) for _ in range(STARTS - 1))]
