"""What the fit of the missing physics is worth: closed loop on held-out blocks, with intervals and the noise floor."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.diagnosis.compared import Compared
from bcid.diagnosis.judge.held_out import block_s, halves, on_half
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import Restarted, restarted
from bcid.experiment.simulate import seen_at, states
from bcid.likelihood.prepare import constants_of
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import GROUP_S, Take
from bcid.models.fitting.windows import scale
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.recording.types import Recording, Stream
from bcid.vehicle import Vehicle

Interval = tuple[float, float]

HORIZONS_S = (0.5, 2.0, 10.0)
RESAMPLES = 999


@dataclass(frozen=True)
class Horizon:
    """NMSE of predictions started anew every `horizon_s`, with 95 % intervals over blocks."""

    horizon_s: float
    before: float | None  # None, as all of them, where no prediction stays within the finite numbers
    before_ci95: Interval | None
    after: float | None
    after_ci95: Interval | None
    floor: float | None  # of the found car itself, simulated with its own noise and estimated like the recording
    ratio_ci95: Interval | None  # of after over before
    lost: float  # share of the time in which either left the finite numbers, which counts for neither
    given: float | None = None  # of the simulation as it was given, refitted to nothing
    given_lost: float | None = None


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


def compared_model(simulation: Compared, vehicle: Vehicle, T: float, period_s: float) -> AugmentedNewtonEuler:
    """The simulation as it was given, as a model that every command takes."""
    return AugmentedNewtonEuler(
        simulation.car, simulation.effects, constants_of(vehicle), vehicle.steering.max_angle_rad, T, period_s, {}
    )


def compared(
    before: Fit, after: Fit, take: Take, recording: Recording, estimate: Estimate, vehicle: Vehicle, tuning: Tuning,
    simulation: Compared | None = None,
) -> tuple[list[Horizon], Tracks]:  # fmt: skip
    """Both fits, each refitted to one half of the blocks and judged on the other; and `simulation` as it is."""
    weights = scale(estimate.twist)
    block = ((estimate.time_s - recording.poses.time_s[0]) // block_s(take)).astype(int)
    side = block % 2
    trained = [(_on_half(before, take, half), _on_half(after, take, half)) for half in halves(take)]
    T = float(take.length_s[0])
    models = [tuple(as_model(f, T, estimate.period_s) for f in pair) for pair in trained]
    again: Estimate | None = None
    with suppress(FloatingPointError):  # a car that only fits stretch by stretch may not drive a whole take
        again = estimate_motion(replayed(after, take, recording), vehicle, tuning, estimate.period_s)
    itself = as_model(after, T, estimate.period_s)
    given = compared_model(simulation, vehicle, T, estimate.period_s) if simulation else None
    rows, tracks = [], None
    for horizon in HORIZONS_S:
        squares, places = [], []
        for which in (0, 1):
            predictions = [restarted(models[half][which], estimate, horizon) for half in (0, 1)]
            errors = [_squares(p, estimate, weights) for p in predictions]
            squares.append(np.where(side == 1, *errors))  # trained on the others
            places.append(np.where((side == 1)[:, None], *(p.pose[:, :2] for p in predictions)))
            starts = predictions[0].start
        floor = None if again is None else _mean(_squares(restarted(itself, again, horizon), again, weights))
        row = _judged(horizon, squares[0], squares[1], floor, block)
        if given is not None:
            off = _squares(restarted(given, estimate, horizon), estimate, weights)
            row = replace(row, given=_mean(off), given_lost=float(np.isnan(off).mean()))
        rows.append(row)
        if horizon == 2.0:
            tracks = Tracks(estimate.time_s, estimate.pose[:, :2], places[0], places[1], starts.astype(float))
    assert tracks is not None  # noqa: S101  # 2 s is one of the horizons
    return rows, tracks


def _on_half(fit: Fit, take: Take, half: Ints) -> Fit:
    """The fit refitted to half of the take; as it is, which flatters it, where that leaves the finite numbers."""
    try:
        return on_half(fit, take, half)
    except FloatingPointError:
        return fit


def _squares(predicted: Restarted, estimate: Estimate, weights: Floats) -> Floats:
    """Weighted squares of what predictions are off (K,); NaN all along a stretch that left the finite numbers.

    The row that such a stretch starts with is the estimate's own, and no prediction.
    """
    off = ((weights * (predicted.twist - estimate.twist)) ** 2).mean(axis=1)
    off[:-1][predicted.start[:-1] & np.isnan(off[1:])] = np.nan
    return np.asarray(off)


def _mean(squares: Floats) -> float | None:
    """Of what there is, if anything is."""
    there = squares[np.isfinite(squares)]
    return float(there.mean()) if len(there) else None


def _judged(horizon: float, before: Floats, after: Floats, floor: float | None, block: Ints) -> Horizon:
    """Means and their intervals, by resampling those blocks in which there is anything of both."""
    finite = np.isfinite(before) & np.isfinite(after)
    lost = float((~finite).mean())
    if lost == 1.0:
        return Horizon(horizon, None, None, None, None, floor, None, lost)
    known = np.bincount(block, finite) > 0.0
    count = np.bincount(block, finite)[known]
    sums = [np.bincount(block, np.where(finite, s, 0.0))[known] for s in (before, after)]
    draws = np.random.default_rng(0).integers(0, len(count), (RESAMPLES, len(count)))
    b, a = (s[draws].sum(axis=1) / count[draws].sum(axis=1) for s in sums)
    whole = [float(s.sum() / count.sum()) for s in sums]

    def interval(values: Floats) -> Interval:
        low, high = np.quantile(values, [0.025, 0.975])
        return float(low), float(high)

    ratio = interval(a / np.maximum(b, 1e-30))
    return Horizon(horizon, whole[0], interval(b), whole[1], interval(a), floor, ratio, lost)


def replayed(fit: Fit, take: Take, recording: Recording, seed: int = 0) -> Recording:
    """A recording of the fitted car itself under the recording's commands, with the fit's own pushes and noise.

    Raises:
        FloatingPointError: where its drive leaves the finite numbers.
    """
    setting = fit.hypothesis.setting(fit.phi, take)
    path = seen_at(
        recording.poses.time_s - recording.poses.time_s[0],
        states(setting, float(take.length_s[0]), fit.scales, seed, fit.start[0]), setting,
    )  # fmt: skip
    each = max(1.0, round(GROUP_S * recording.rate_hz))
    noise = np.random.default_rng([seed, 1]).standard_normal(path.shape) * fit.scales.r * np.sqrt(each)
    return replace(recording, poses=Stream(recording.poses.time_s, path + noise), channels={})
