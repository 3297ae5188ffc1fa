"""Offset and drift of the pose clock against the command clock, estimated and reported, never applied.

The commanded steering angle is shifted by a trial delay; in each block of the take the delay at which
it explains the yaw acceleration best is found, and a robust line through the blocks gives offset and
drift.  A delay of the actuator that the vehicle file does not know looks the same: what is reported
is the sum.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.signal import savgol_filter

from bcid.aliases import Floats
from bcid.recording.checks.raw_motion import Course, commanded_angle, course
from bcid.recording.types import Irregularity, Recording
from bcid.vehicle import Vehicle

SYSTEMATIC_PER_S2 = 0.7  # on simulated takes of known offset the answer is 10 ms early at 0.14 s, 42 ms at 0.4 s
BLOCK_S = 10.0
MAX_DELAY_S = 0.3
MIN_BLOCKS = 4
MIN_EXPLAINED = 0.5
RESIDUAL_S = 0.005  # apart by more is told


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
    askew = any(i.kind == "yaw offset" for i in recording.irregularities)  # and looks like a clock that is off
    told = () if askew else _apart(facts, recording)
    return replace(recording, clock=facts, irregularities=(*recording.irregularities, *told))


def _apart(facts: dict[str, Any], recording: Recording) -> list[Irregularity]:
    """Word of clocks that are surely apart by more than `RESIDUAL_S`, at once or by the end of the take."""
    grown = [recording.duration_s * d for d in facts["drift_ci95"]]
    told = []
    for what, (low, high) in (("offset", facts["offset_ci95"]), ("drift", grown)):
        if low > RESIDUAL_S or high < -RESIDUAL_S:
            when = " by the end" if what == "drift" else ""
            text = f"commands are {1e3 * low:.0f} to {1e3 * high:.0f} ms early{when}: [clock] offset_s, or one clock"
            told.append(Irregularity(f"clock {what}", "warning", 1, recording.name, text))
    return told


def _block_delays(motion: Course, recording: Recording, vehicle: Vehicle) -> tuple[Delays, float]:
    step_s = float(motion.time_s[1] - motion.time_s[0])
    reach = max(2, round(MAX_DELAY_S / step_s))
    rows = usable_rows(motion, recording, 2 * reach)
    y = yaw_acceleration(motion)
    if len(rows) < BLOCK_S / step_s or y[rows].var() == 0.0:
        return Delays(np.empty(0), np.empty(0)), 0.0
    angle, throttle = commanded_angle(recording, vehicle, motion.time_s), held_throttle(motion, recording)
    shifts = np.arange(-reach, reach + 1)
    residuals = [unexplained(motion, np.roll(angle, s), np.roll(throttle, s), y, rows, vehicle) for s in shifts]
    squares = np.array(residuals) ** 2
    explained = 1.0 - float(squares.mean(axis=1).min() / y[rows].var())
    block = (motion.time_s[rows] // BLOCK_S).astype(int)
    found = [
        (float(motion.time_s[rows][block == b].mean()), step_s * best)
        for b in np.unique(block)
        if (best := _vertex(shifts, squares[:, block == b].sum(axis=1))) is not None
    ]
    middle, delay = np.array(found).reshape(len(found), 2).T
    return Delays(middle, delay), explained


def _vertex(shifts: npt.NDArray[np.int64], cost: Floats) -> float | None:
    """Where a parabola through the smallest cost and its neighbours is lowest; None at the search's edge."""
    k = int(np.argmin(cost))
    if k in (0, len(shifts) - 1):
        return None
    left, middle, right = cost[k - 1 : k + 2]
    return float(shifts[k] + 0.5 * (left - right) / (left - 2.0 * middle + right))


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
