"""A Newton-Euler car to start from, good to some per cent in a second: least squares on one-step predictions."""

from collections.abc import Sequence

import numpy as np

from bcid.aliases import Floats
from bcid.estimate.types import Estimate
from bcid.models.fitting.windows import Windows, cut_windows, inverse_spread
from bcid.models.limits import LIMITS
from bcid.models.newton_euler.objective import TransposedWindows, predict_twists
from bcid.models.newton_euler.parameters import TOP_SPEED_QUANTILE, ConstantBox
from bcid.physics.car import Car
from bcid.vehicle import Vehicle

MAX_SAMPLES = 2000


def guess_car(estimates: Sequence[Estimate], vehicle: Vehicle, T_s: float, d: float, v_0: float = 1.0) -> Car:
    """Guess a car to start a fit from: robust least squares on the twist predicted one period ahead.

    The one of less cost from two starts within the constants' ranges.  Not fitted are the steering's time constant
    T_s (s) and rate limit d (rad/s), and v_0 (m/s), the least rolling speed in a slip angle (docs/errata.md row 14).
    """
    from scipy.optimize import least_squares

    steps = cut_windows(estimates, 1, 1)
    change = np.abs(steps.twist[:, 1] - steps.twist[:, 0])
    usual = np.quantile(change, 0.9, axis=0)
    rows = np.flatnonzero((change < LIMITS.max_relative_change * usual).all(axis=1))
    rows = rows[:: max(1, len(rows) // MAX_SAMPLES)]
    steps = Windows(steps.twist[rows], steps.kinematic[rows], steps.parts[rows], 0)
    weight = inverse_spread(steps.twist[:, 0])[:, None]
    one = TransposedWindows.from_windows(steps, estimates[0].period_s)
    top_speed = float(np.quantile(np.abs(steps.kinematic[:, 0, 0]), TOP_SPEED_QUANTILE))
    box = ConstantBox(vehicle, T_s, d, v_0, top_speed)
    # The ranges scale with the car, so that their middle is a fair start.
    low = np.log([p.low for p in box.constants])
    high, rng = low + box.log_range, np.random.default_rng(0)
    middle, spread = 0.5 * (low + high), 0.15 * (high - low)
    starts = middle, middle + spread * rng.uniform(-1.0, 1.0, len(middle))

    def residuals(x: Floats) -> Floats:
        predicted = predict_twists([box.car((x - low) / box.log_range)], one)[0]
        return np.asarray((weight * (predicted - one.after)).ravel())

    ends = [
        least_squares(residuals, start, bounds=(low, high), loss="soft_l1", f_scale=0.05, max_nfev=40)
        for start in starts
    ]
    return box.car((min(ends, key=lambda end: end.cost).x - low) / box.log_range)
