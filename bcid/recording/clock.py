"""Offset and drift of the pose clock against the command clock, estimated and reported, never applied.

The yaw acceleration answers at once to the front wheel's slip angle, alpha_f = beta_f - delta.  So the
yaw acceleration is regressed on what the wheel forces depend on, with the commanded angle shifted by
a trial delay; in each block of the take the delay that leaves the least unexplained is found, and a
robust line through the blocks gives offset and drift.  A delay of the actuator that the vehicle file
does not know looks the same: what is reported is the sum.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.signal import savgol_filter

from bcid.recording.course import Course, commanded_angle, course
from bcid.recording.types import Floats, Recording
from bcid.vehicle import Vehicle

WINDOW_S = 0.14  # of the differentiating filter: narrower ones let noise bias the answer, wider ones smear it
SYSTEMATIC_PER_S2 = 0.7  # on simulated takes of known offset the answer is 10 ms early at 0.14 s, 42 ms at 0.4 s
BLOCK_S = 10.0
MAX_DELAY_S = 0.3
MIN_BLOCKS = 4
MIN_SPEED_MPS = 0.3
MIN_EXPLAINED = 0.5
SATURATION_RAD = (0.08, 0.2)  # slip angles at which tyres may saturate; the regression weighs them
SLIP_SPEED_MPS = 1.0


class Delays(NamedTuple):
    """One best delay per block, seconds."""

    middle_s: Floats
    delay_s: Floats


def estimate_clock(recording: Recording, vehicle: Vehicle) -> Recording:
    """The recording with `clock`: offset_s, offset_ci95, drift, drift_ci95, or the reason for none.

    The offset is what would have to be added to the command times.
    """
    applied = vehicle.clock.offset_s if vehicle.clock else 0.0
    facts: dict[str, Any] = {"applied_s": applied, "offset_s": None}
    motion = course(recording, vehicle, WINDOW_S)
    if len(motion.time_s) < 2:
        return replace(recording, clock=facts | {"reason": "the take is too short"})
    delays, explained = _block_delays(motion, recording, vehicle)
    facts |= {"blocks": len(delays.delay_s), "explained": explained}
    if explained < MIN_EXPLAINED:
        reason = f"the commands explain only {explained:.0%} of the yaw acceleration"
        return replace(recording, clock=facts | {"reason": reason})
    if len(delays.delay_s) < MIN_BLOCKS:
        reason = f"only {len(delays.delay_s)} blocks of {BLOCK_S:g} s show a clear delay"
        return replace(recording, clock=facts | {"reason": reason})
    from scipy.stats import bootstrap, theilslopes

    line = theilslopes(delays.delay_s, delays.middle_s)
    middle = bootstrap(
        (delays.delay_s,), np.median, n_resamples=999, rng=np.random.default_rng(0), method="percentile"
    ).confidence_interval
    systematic = SYSTEMATIC_PER_S2 * motion.window_s**2
    facts |= {
        "offset_s": float(np.median(delays.delay_s)),
        "offset_ci95": [float(middle.low - systematic), float(middle.high + systematic)],
        "drift": float(line[0]),
        "drift_ci95": [float(line[2]), float(line[3])],
        "includes": "delays of the steering actuator beyond the vehicle file's; systematic error of the method",
    }
    return replace(recording, clock=facts)


def _block_delays(motion: Course, recording: Recording, vehicle: Vehicle) -> tuple[Delays, float]:
    step_s = float(motion.time_s[1] - motion.time_s[0])
    angle = commanded_angle(recording, vehicle, motion.time_s)
    held = np.searchsorted(recording.commands.time_s, motion.time_s, side="right") - 1
    throttle = recording.commands.values[np.maximum(held, 0), 1]
    y = _smooth(motion.yaw_rate, motion, derivative=1)
    covered = (held >= 0) & (motion.time_s < recording.commands.time_s[-1] + recording.hold_s)
    reach = max(2, round(MAX_DELAY_S / step_s))
    use = motion.good & covered & (motion.v_f > MIN_SPEED_MPS)
    use[: 2 * reach] = use[-2 * reach :] = False
    rows = np.flatnonzero(use)
    if len(rows) < BLOCK_S / step_s:
        return Delays(np.empty(0), np.empty(0)), 0.0
    shifts = np.arange(-reach, reach + 1)
    squares = np.array(
        [_unexplained(motion, np.roll(angle, s), np.roll(throttle, s), y, rows, vehicle) for s in shifts]
    )
    explained = 1.0 - float(squares.mean(axis=1).min() / y[rows].var())
    block = (motion.time_s[rows] // BLOCK_S).astype(int)
    found = [
        (float(motion.time_s[rows][block == b].mean()), step_s * best)
        for b in np.unique(block)
        if (best := _vertex(shifts, squares[:, block == b].sum(axis=1))) is not None
    ]
    middle, delay = np.array(found).reshape(len(found), 2).T
    return Delays(middle, delay), explained


def _unexplained(
    motion: Course, delta: Floats, u_m: Floats, y: Floats, rows: npt.NDArray[np.int64], vehicle: Vehicle
) -> Floats:
    """Squared residuals of the yaw acceleration at `rows` after a regression on the wheel forces' causes."""
    wheelbase = vehicle.body.cog_to_front_m + vehicle.body.cog_to_rear_m
    v_f, beta_f, omega = motion.v_f, motion.beta_f, motion.yaw_rate
    v_fx, v_fy = v_f * np.cos(beta_f - delta), v_f * np.sin(beta_f - delta)
    alpha_f = np.arctan(v_fy / np.maximum(np.abs(v_fx), SLIP_SPEED_MPS))
    v_x = v_f * np.cos(beta_f)
    alpha_r = np.arctan((v_f * np.sin(beta_f) - wheelbase * omega) / np.maximum(np.abs(v_x), SLIP_SPEED_MPS))
    cos_d, sin_d = np.cos(delta), np.sin(delta)
    causes = [cos_d * alpha_f, *(cos_d * np.clip(alpha_f, -s, s) for s in SATURATION_RAD)]
    causes += [alpha_r, sin_d * np.maximum(u_m - v_fx, 0), sin_d * np.minimum(u_m, 0) * v_fx, sin_d * v_fx, omega]
    X = _smooth(np.column_stack([*causes, np.ones(len(y))]), motion)[rows]
    weights, *_ = np.linalg.lstsq(X, y[rows], rcond=None)
    residual: Floats = (y[rows] - X @ weights) ** 2
    return residual


def _smooth(values: Floats, motion: Course, derivative: int = 0) -> Floats:
    """The filter that the motion has gone through, once more, so that both sides are smeared alike."""
    step_s = float(motion.time_s[1] - motion.time_s[0])
    width = 2 * max(2, round(motion.window_s / (2 * step_s))) + 1
    return np.asarray(savgol_filter(values, width, 2, deriv=derivative, delta=step_s, axis=0))


def _vertex(shifts: npt.NDArray[np.int64], cost: Floats) -> float | None:
    """Where a parabola through the smallest cost and its neighbours is lowest; None at the search's edge."""
    k = int(np.argmin(cost))
    if k in (0, len(shifts) - 1):
        return None
    left, middle, right = cost[k - 1 : k + 2]
    return float(shifts[k] + 0.5 * (left - right) / (left - 2.0 * middle + right))
