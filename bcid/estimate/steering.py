"""Time constant and rate limit of the steering, identified from the poses where the vehicle file omits them.

They are those under which the commanded angle explains the yaw acceleration best.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.recording.checks.clock import WINDOW_S, held_throttle, unexplained, usable_rows, yaw_acceleration
from bcid.recording.checks.raw_motion import (
    DEFAULT_RATE_RADPS,
    DEFAULT_TIME_CONSTANT_S,
    Course,
    commanded_angle,
    course,
)
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

T_S_RANGE = (0.02, 1.5)
RATE_RANGE = (0.1, 60.0)
MARGIN_S = 1.0
MIN_ROWS = 200
MIN_EXCITATION_RAD = 0.02


def identify(recordings: Sequence[Recording], vehicle: Vehicle) -> tuple[float, float, dict[str, Any]]:
    """T_s (s), d (rad/s) and what is to be said of them; what the vehicle file gives stays.

    Where no take moves enough the documented defaults stand, and the facts say so.
    """
    from scipy.optimize import least_squares

    given = vehicle.steering
    free = [given.time_constant_s is None, given.max_rate_radps is None]
    start = np.log([given.time_constant_s or DEFAULT_TIME_CONSTANT_S, given.max_rate_radps or DEFAULT_RATE_RADPS])
    names = [n for n, f in zip(("time_constant_s", "max_rate_radps"), free, strict=True) if f]
    steered = [r for r in recordings if np.std(r.commands.values[:, 0]) > MIN_EXCITATION_RAD]
    motions = [(r, m) for r in steered if len((m := course(r, vehicle, WINDOW_S)).time_s) > MIN_ROWS]
    if not names or not motions:
        return float(np.exp(start[0])), float(np.exp(start[1])), {"identified": [], "defaults": names}
    low, high = np.log([T_S_RANGE, RATE_RANGE]).T[:, free]

    def constants(x: Floats) -> tuple[float, float]:
        full = start.copy()
        full[free] = x
        return float(np.exp(full[0])), float(np.exp(full[1]))

    def residuals(x: Floats) -> Floats:
        return np.concatenate([_residuals(r, m, vehicle, *constants(x)) for r, m in motions])

    fits = [
        least_squares(residuals, x_0[free], bounds=(low, high), diff_step=[1e-2] * sum(free))
        for x_0 in (start, start + np.log([0.4, 0.5]), start + np.log([2.0, 3.0]))
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    T_s, d = constants(best.x)
    near = np.isclose(best.x, low, atol=1e-2) | np.isclose(best.x, high, atol=1e-2)
    reached = any(_rate_reached(r, m, vehicle, T_s, d) for r, m in motions)
    return T_s, d, {"identified": names, "at_bound": bool(near.any()), "rate_reached": reached}


def _residuals(recording: Recording, motion: Course, vehicle: Vehicle, T_s: float, d: float) -> Floats:
    delta = commanded_angle(recording, vehicle, motion.time_s, T_s, d)
    margin = round(MARGIN_S / float(motion.time_s[1] - motion.time_s[0]))
    rows = usable_rows(motion, recording, margin)
    return unexplained(motion, delta, held_throttle(motion, recording), yaw_acceleration(motion), rows, vehicle)


def _rate_reached(recording: Recording, motion: Course, vehicle: Vehicle, T_s: float, d: float) -> bool:
    """Whether the commands ever drive the steering at its rate limit; otherwise d is not identified."""
    delta = commanded_angle(recording, vehicle, motion.time_s, T_s, d)
    rate = np.abs(np.diff(delta) / np.diff(motion.time_s))
    return bool(np.any(rate > 0.99 * d))
