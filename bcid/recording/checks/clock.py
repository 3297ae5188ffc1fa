"""Offset and drift of the pose clock against the command clock, estimated and reported, never applied.

The commanded steering angle is shifted by trial delays. In each block of the take, the delay is found with which a
regression on the angle explains the yaw acceleration best; a robust line through the blocks' delays gives offset and
drift. An unknown delay of the actuator looks the same, so that the sum of both is reported.
"""

from dataclasses import replace

import numpy as np
from scipy.signal import savgol_filter

from bcid.aliases import Floats, Ints
from bcid.bootstrap import bootstrap_interval
from bcid.documents.health import ClockEstimate
from bcid.recording.checks.raw_motion import RawMotion, commanded_steering_angle, differentiate_poses
from bcid.recording.limits import MOTION as LIMITS
from bcid.recording.types import Irregularity, Recording
from bcid.vehicle import Vehicle

WINDOW_S = 0.14  # of the differentiating filter: narrower ones let noise bias the delay, wider ones smear it
SYSTEMATIC_PER_S2 = 0.7  # on simulated takes the offset is 10 ms early with a window of 0.14 s, 42 ms with 0.4 s
SATURATION_RAD = (0.08, 0.2)  # slip angles at which tyres may saturate, weighted by the regression
SLIP_SPEED_MPS = 1.0  # least longitudinal speed in a slip angle


def estimate_clock(recording: Recording, vehicle: Vehicle) -> Recording:
    """The recording with an estimate of its clock offset and drift, and warnings where these are significantly large.

    Offset and drift are those of the command clock against the pose clock; a warning needs their whole 95 % interval
    beyond `MOTION.max_clock_offset_s`.  There is no such warning where a yaw offset of the tracked body was found,
    which looks like a clock offset.
    """
    clock = _estimate_offset_and_drift(recording, vehicle)
    misaligned = any(i.kind == "yaw offset" for i in recording.irregularities)
    warnings = () if misaligned else _clock_warnings(clock, recording)
    return replace(recording, clock=clock, irregularities=(*recording.irregularities, *warnings))


def _estimate_offset_and_drift(recording: Recording, vehicle: Vehicle) -> ClockEstimate:
    """Offset (s) and drift of the command clock: median and Theil-Sen slope of block delays, or the reason for none."""
    applied_s = vehicle.clock.offset_s if vehicle.clock else 0.0
    motion = differentiate_poses(recording, vehicle, WINDOW_S)
    if len(motion.time_s) < 2:
        return ClockEstimate(applied_s=applied_s, reason="the take is too short")
    middle_s, delay_s, explained = _block_delays(motion, recording, vehicle)
    clock = ClockEstimate(applied_s=applied_s, blocks=len(delay_s), explained=explained)
    if explained < LIMITS.min_explained_share:
        return clock.model_copy(update={"reason": f"the commands explain only {explained:.0%} of the yaw acceleration"})
    if clock.blocks < LIMITS.min_clock_blocks:
        few = f"only {clock.blocks} blocks of {LIMITS.clock_block_s:g} s show a clear delay"
        return clock.model_copy(update={"reason": few})
    from scipy.stats import theilslopes

    line = theilslopes(delay_s, middle_s)
    low, high = bootstrap_interval(delay_s, np.median)
    systematic = SYSTEMATIC_PER_S2 * motion.window_s**2
    return ClockEstimate(
        applied_s=applied_s, blocks=clock.blocks, explained=explained, offset_s=float(np.median(delay_s)),
        offset_ci95=(low - systematic, high + systematic), drift=float(line[0]),
        drift_ci95=(float(line[2]), float(line[3])),
    )  # fmt: skip


def _clock_warnings(clock: ClockEstimate, recording: Recording) -> list[Irregularity]:
    """Warnings where the 95 % interval of clock offset, or of drift by the end, passes `MOTION.max_clock_offset_s`."""
    if clock.offset_ci95 is None or clock.drift_ci95 is None:
        return []
    by_the_end = (recording.duration_s * clock.drift_ci95[0], recording.duration_s * clock.drift_ci95[1])
    warnings = []
    for kind, (low, high) in (("offset", clock.offset_ci95), ("drift", by_the_end)):
        if low > LIMITS.max_clock_offset_s or high < -LIMITS.max_clock_offset_s:
            when = " by the end" if kind == "drift" else ""
            text = f"commands are {1e3 * low:.0f} to {1e3 * high:.0f} ms early{when}: [clock] offset_s, or one clock"
            warnings.append(Irregularity(f"clock {kind}", "warning", 1, recording.name, text))
    return warnings


def _block_delays(motion: RawMotion, recording: Recording, vehicle: Vehicle) -> tuple[Floats, Floats, float]:
    """Middle times and delays (B,) in s of blocks of a recording, and R^2 of the yaw acceleration's regression.

    A block's delay is the shift of the commands that minimises the squared residuals of the measured yaw acceleration
    after regression on the wheel forces that the commands cause; R^2 is that at the best shift common to all blocks.
    """
    step_s, block_s = motion.step_s, LIMITS.clock_block_s
    reach = max(2, round(LIMITS.max_clock_delay_s / step_s))
    rows = usable_rows(motion, recording, 2 * reach)
    y = yaw_acceleration(motion)
    if len(rows) < block_s / step_s or y[rows].var() == 0.0:
        return np.empty(0), np.empty(0), 0.0
    angle = commanded_steering_angle(recording, vehicle, motion.time_s)
    throttle = recording.commands.held_at(motion.time_s)[:, 1]
    shifts = np.arange(-reach, reach + 1)
    residuals = [
        yaw_acceleration_residuals(motion, np.roll(angle, s), np.roll(throttle, s), y, rows, vehicle) for s in shifts
    ]
    squares = np.array(residuals) ** 2
    explained = 1.0 - float(squares.mean(axis=1).min() / y[rows].var())
    block = (motion.time_s[rows] // block_s).astype(int)
    found = [
        (float(motion.time_s[rows][block == b].mean()), step_s * best)
        for b in np.unique(block)
        if (best := _parabola_minimum(shifts, squares[:, block == b].sum(axis=1))) is not None
    ]
    middle, delay = np.array(found).reshape(len(found), 2).T
    return middle, delay, explained


def _parabola_minimum(shifts: Ints, cost: Floats) -> float | None:
    """Shift of least `cost`, refined by parabolic interpolation with its neighbours; None at either end of `shifts`."""
    k = int(np.argmin(cost))
    if k in (0, len(shifts) - 1):
        return None
    left, middle, right = cost[k - 1 : k + 2]
    return float(shifts[k] + 0.5 * (left - right) / (left - 2.0 * middle + right))


def usable_rows(motion: RawMotion, recording: Recording, margin: int) -> Ints:
    """Row numbers to use in a regression: fast, far from gaps, under a command, and `margin` rows from either end.

    Fast means above `MOTION.min_clock_speed_mps`.
    """
    t, commands = motion.time_s, recording.commands
    commanded = (t >= commands.time_s[0]) & (t < commands.time_s[-1] + recording.hold_s)
    use = motion.good & commanded & (motion.v_f > LIMITS.min_clock_speed_mps)
    use[:margin] = use[len(use) - margin :] = False
    return np.flatnonzero(use)


def yaw_acceleration(motion: RawMotion) -> Floats:
    """Yaw acceleration (N,) in rad/s²: the motion's yaw rate, differentiated by a quadratic Savitzky-Golay filter.

    The filter has the same length as the one that made the yaw rate from poses.
    """
    return _smooth(motion.yaw_rate, motion, derivative=1)


def yaw_acceleration_residuals(
    motion: RawMotion, delta: Floats, u_m: Floats, y: Floats, rows: Ints, vehicle: Vehicle
) -> Floats:
    """Residuals (M,) in rad/s² of linear least squares of the yaw acceleration y (N,), at M `rows`, on wheel forces.

    The regressors are proportional to tyre and motor forces of unknown size: cos(delta) alpha_f, unlimited and
    clipped at each of SATURATION_RAD; alpha_r; sin(delta) max(u_m - v_fx, 0); sin(delta) min(u_m, 0) v_fx; sin(delta)
    v_fx; the yaw rate; and 1.  They are smoothed like y.  delta (N,) is the steering angle in rad, u_m (N,) the
    throttle (m/s, a brake share below 0), v_fx the front wheel's rolling speed.
    """
    v_f, beta_f, omega = motion.v_f, motion.beta_f, motion.yaw_rate
    v_fx, v_fy = v_f * np.cos(beta_f - delta), v_f * np.sin(beta_f - delta)
    alpha_f = np.arctan(v_fy / np.maximum(np.abs(v_fx), SLIP_SPEED_MPS))
    v_x, v_ry = v_f * np.cos(beta_f), v_f * np.sin(beta_f) - vehicle.body.wheelbase_m * omega
    alpha_r = np.arctan(v_ry / np.maximum(np.abs(v_x), SLIP_SPEED_MPS))
    cos_d, sin_d = np.cos(delta), np.sin(delta)
    causes = [cos_d * alpha_f, *(cos_d * np.clip(alpha_f, -s, s) for s in SATURATION_RAD)]
    causes += [alpha_r, sin_d * np.maximum(u_m - v_fx, 0), sin_d * np.minimum(u_m, 0) * v_fx, sin_d * v_fx, omega]
    X = _smooth(np.column_stack([*causes, np.ones(len(y))]), motion)[rows]
    weights, *_ = np.linalg.lstsq(X, y[rows], rcond=None)
    residual: Floats = y[rows] - X @ weights
    return residual


def _smooth(values: Floats, motion: RawMotion, derivative: int = 0) -> Floats:
    """Values (N,) or (N, n), smoothed or differentiated in time by a quadratic Savitzky-Golay filter.

    The filter has the length of the one that made `motion` from poses.
    """
    width = 2 * max(2, round(motion.window_s / (2 * motion.step_s))) + 1
    return np.asarray(savgol_filter(values, width, 2, deriv=derivative, delta=motion.step_s, axis=0))
