"""How well a steering angle explains the yaw acceleration, without any fitted model.

The yaw acceleration answers at once to the front wheel's slip angle, alpha_f = beta_f - delta.  It is
regressed on what the wheel forces depend on; the right steering angle leaves least unexplained.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.signal import savgol_filter

from bcid.recording.course import Course
from bcid.recording.types import Floats, Recording
from bcid.vehicle import Vehicle

WINDOW_S = 0.14  # of the differentiating filter: narrower ones let noise bias the answer, wider ones smear it
MIN_SPEED_MPS = 0.3
SATURATION_RAD = (0.08, 0.2)  # slip angles at which tyres may saturate; the regression weighs them
SLIP_SPEED_MPS = 1.0


def usable_rows(motion: Course, recording: Recording, margin: int) -> npt.NDArray[np.int64]:
    """Rows that are fast enough, far from holes and edges, and under a held command."""
    held = np.searchsorted(recording.commands.time_s, motion.time_s, side="right") - 1
    covered = (held >= 0) & (motion.time_s < recording.commands.time_s[-1] + recording.hold_s)
    use = motion.good & covered & (motion.v_f > MIN_SPEED_MPS)
    use[:margin] = use[len(use) - margin :] = False
    return np.flatnonzero(use)


def held_throttle(motion: Course, recording: Recording) -> Floats:
    """u_m held at the motion's times."""
    held = np.searchsorted(recording.commands.time_s, motion.time_s, side="right") - 1
    values: Floats = recording.commands.values[np.maximum(held, 0), 1]
    return values


def yaw_acceleration(motion: Course) -> Floats:
    """rad/s^2, by the filter that the motion has gone through, once more."""
    return _smooth(motion.yaw_rate, motion, derivative=1)


def unexplained(
    motion: Course, delta: Floats, u_m: Floats, y: Floats, rows: npt.NDArray[np.int64], vehicle: Vehicle
) -> Floats:
    """Residuals at `rows` of the yaw acceleration `y` after a regression on the wheel forces' causes."""
    wheelbase = vehicle.body.cog_to_front_m + vehicle.body.cog_to_rear_m
    v_f, beta_f, omega = motion.v_f, motion.beta_f, motion.yaw_rate
    v_fx, v_fy = v_f * np.cos(beta_f - delta), v_f * np.sin(beta_f - delta)
    alpha_f = np.arctan(v_fy / np.maximum(np.abs(v_fx), SLIP_SPEED_MPS))
    v_x = v_f * np.cos(beta_f)
    alpha_r = np.arctan((v_f * np.sin(beta_f) - wheelbase * omega) / np.maximum(np.abs(v_x), SLIP_SPEED_MPS))
    cos_d, sin_d = np.cos(delta), np.sin(delta)
    causes = [cos_d * alpha_f, *(cos_d * np.clip(alpha_f, -s, s) for s in SATURATION_RAD)]
    causes += [alpha_r, sin_d * np.maximum(u_m - v_fx, 0), sin_d * np.minimum(u_m, 0) * v_fx, sin_d * v_fx, omega]
    # both sides are smeared alike
    X = _smooth(np.column_stack([*causes, np.ones(len(y))]), motion)[rows]
    weights, *_ = np.linalg.lstsq(X, y[rows], rcond=None)
    residual: Floats = y[rows] - X @ weights
    return residual


def _smooth(values: Floats, motion: Course, derivative: int = 0) -> Floats:
    step_s = float(motion.time_s[1] - motion.time_s[0])
    width = 2 * max(2, round(motion.window_s / (2 * step_s))) + 1
    return np.asarray(savgol_filter(values, width, 2, deriv=derivative, delta=step_s, axis=0))
