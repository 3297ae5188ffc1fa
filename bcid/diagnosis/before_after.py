"""What the fit of the missing physics is worth: closed loop on held-out blocks, with intervals and the noise floor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from bcid.compiled import njit
from bcid.diagnosis.heldout import BLOCK_S, halves, on_half
from bcid.diagnosis.hypothesis import Setting
from bcid.diagnosis.refit import Fit
from bcid.diagnosis.segments import KNOT_S, half_steps
from bcid.diagnosis.take import GROUP_S, STEP_S, Floats, Take
from bcid.effects.car import Body
from bcid.effects.measurement import seen_pose
from bcid.effects.motion import body_step, settled
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import restarted
from bcid.models.augmented import AugmentedNewtonEuler
from bcid.models.samples import scale
from bcid.recording.types import Recording, Stream
from bcid.vehicle import Vehicle

HORIZONS_S = (0.5, 2.0, 10.0)
RESAMPLES = 999


@dataclass(frozen=True)
class Horizon:
    """NMSE of predictions started anew every `horizon_s`, with 95 % intervals over blocks."""

    horizon_s: float
    before: float
    before_ci95: tuple[float, float]
    after: float
    after_ci95: tuple[float, float]
    floor: float  # of the found car itself, simulated with its own noise and estimated like the recording
    ratio_ci95: tuple[float, float]  # of after over before


class Tracks(NamedTuple):
    """Measured and predicted places on the estimate's grid; predictions started anew every 2 s."""

    time_s: Floats
    place: Floats  # (K, 2)
    before: Floats
    after: Floats
    start: Floats  # 1 where predictions start


def as_model(fit: Fit, T: float, period_s: float) -> AugmentedNewtonEuler:
    """The fit as a model that every command takes."""
    hypothesis = fit.hypothesis
    se = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    car = fit.car()
    errors = {s: float(getattr(car, s) * e) for s, e in zip(hypothesis.logs, se, strict=False)}
    errors |= {field: e for field, (_, e) in fit.values().items()}
    facts = {
        "fitted": [*hypothesis.logs, "R_1", "R_2"], "se": errors, "log_likelihood": fit.log_likelihood,
        "noise": {"r": fit.scales.r.tolist(), "q": fit.scales.q.tolist()},
    }  # fmt: skip
    return AugmentedNewtonEuler(
        car, hypothesis.values(fit.phi), hypothesis.constants, hypothesis.angle_limit, T, period_s, facts
    )


def compared(
    before: Fit, after: Fit, take: Take, recording: Recording, estimate: Estimate, vehicle: Vehicle, tuning: Tuning
) -> tuple[list[Horizon], Tracks]:
    """Both fits, each refitted to one half of the blocks and judged on the other."""
    weights = scale(estimate.twist)
    side = ((estimate.time_s - estimate.time_s[0]) // BLOCK_S).astype(int) % 2
    trained = [(on_half(before, take, half), on_half(after, take, half)) for half in halves(take)]
    models = [tuple(as_model(f, take.T, estimate.period_s) for f in pair) for pair in trained]
    again = replayed(after, take, recording)
    floor_estimate = estimate_motion(again, vehicle, tuning, estimate.period_s)
    floor_model = as_model(after, take.T, estimate.period_s)
    rows, tracks = [], None
    for horizon in HORIZONS_S:
        squares, places = [], []
        for which in (0, 1):
            predictions = [restarted(models[half][which], estimate, horizon) for half in (0, 1)]
            twist = np.where((side == 1)[:, None], predictions[0].twist, predictions[1].twist)  # trained on the others
            pose = np.where((side == 1)[:, None], predictions[0].pose, predictions[1].pose)
            squares.append(((weights * (twist - estimate.twist)) ** 2).mean(axis=1))
            places.append(pose[:, :2])
            starts = predictions[0].start
        at_floor = restarted(floor_model, floor_estimate, horizon)
        floor = float(np.nanmean((weights * (at_floor.twist - floor_estimate.twist)) ** 2))
        rows.append(_judged(horizon, squares[0], squares[1], floor, estimate.period_s))
        if horizon == 2.0:
            tracks = Tracks(estimate.time_s, estimate.pose[:, :2], places[0], places[1], starts.astype(float))
    assert tracks is not None  # noqa: S101  # 2 s is one of the horizons
    return rows, tracks


def _judged(horizon: float, before: Floats, after: Floats, floor: float, period_s: float) -> Horizon:
    """Means and their intervals, by resampling blocks."""
    block = np.arange(len(before)) // max(1, round(BLOCK_S / period_s))
    finite = np.isfinite(before) & np.isfinite(after)
    count = np.maximum(np.bincount(block, finite), 1e-9)
    sums = [np.bincount(block, np.where(finite, s, 0.0)) for s in (before, after)]
    draws = np.random.default_rng(0).integers(0, len(count), (RESAMPLES, len(count)))
    b, a = (s[draws].sum(axis=1) / count[draws].sum(axis=1) for s in sums)
    whole = [float(s.sum() / count.sum()) for s in sums]

    def interval(values: Floats) -> tuple[float, float]:
        low, high = np.quantile(values, [0.025, 0.975])
        return float(low), float(high)

    return Horizon(horizon, whole[0], interval(b), whole[1], interval(a), floor, interval(a / np.maximum(b, 1e-30)))


@njit
def _driven(start: Floats, n: int, pushes: Floats, setting: Setting, T: float) -> Floats:
    """States (n + 1, 6) of the car under `pushes` (K, 3), from the take's beginning."""
    out = np.empty((n + 1, 6))
    chain, p, e, c = setting.chain, setting.car, setting.switches, setting.constants
    b = Body(start[0], start[1], start[2], start[3], start[4], start[5])
    lagged = settled(b, 0, chain, T, p, e, c)
    per_knot = round(KNOT_S / chain.h)
    for k in range(n + 1):
        out[k, 0], out[k, 1], out[k, 2] = b.p_x, b.p_y, b.theta
        out[k, 3], out[k, 4], out[k, 5] = b.v_x, b.v_y, b.omega
        if k < n:
            b, lagged = body_step(b, lagged, k, chain, T, pushes[k // per_knot], p, e, c)
    return out


def replayed(fit: Fit, take: Take, recording: Recording, seed: int = 0) -> Recording:
    """A recording of the fitted car itself under the recording's commands, with the fit's own pushes and noise."""
    rng = np.random.default_rng(seed)
    setting = fit.hypothesis.setting(fit.phi, take)
    n = half_steps(take.T) - 1
    car = setting.car
    pushes = rng.standard_normal((int(n * STEP_S / KNOT_S) + 2, 3)) * fit.scales.q * [car.m, car.m, car.I_z]
    states = _driven(fit.start[0], n, pushes, setting, take.T)
    time = recording.poses.time_s - recording.poses.time_s[0]
    cos_t, sin_t = np.cos(states[:, 2]), np.sin(states[:, 2])
    u, v = cos_t * states[:, 3] - sin_t * states[:, 4], sin_t * states[:, 3] + cos_t * states[:, 4]
    path = CubicHermiteSpline(np.arange(n + 1) * STEP_S, states[:, :3], np.column_stack([u, v, states[:, 5]]))(time)
    e = setting.switches
    seen = np.array(
        [
            seen_pose(
                x, y, t, e.marker_offset__d_x, e.marker_offset__d_y, e.body_yaw_misalignment__psi, e.pose_scale__kappa
            )
            for x, y, t in path
        ]
    )
    each = max(1.0, round(GROUP_S * recording.rate_hz))
    seen += rng.standard_normal(seen.shape) * fit.scales.r * np.sqrt(each)
    return replace(recording, poses=Stream(recording.poses.time_s, seen), channels={})
