"""Closed-loop prediction errors before and after the fit of what is missing, on held-out blocks, and their floor."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.bootstrap import draw_blocks, quantile_interval
from bcid.diagnosis.judge.fitted_models import (
    model_from_fit,
    model_from_reference,
    refit_on_half_or_keep,
    squared_errors,
)
from bcid.diagnosis.judge.free_functions import best_share, model_of_half, scale_functions, trained_on_first_half
from bcid.diagnosis.judge.held_out import block_length_s, split_halves
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.documents.diagnosis import HorizonError
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import predict_with_restarts
from bcid.experiment.simulate import observe_states, simulate_states
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.nuisance import without_pushes
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import GROUP_S, Take
from bcid.models.fitting.windows import inverse_spread
from bcid.models.interface import Model
from bcid.recording.types import Recording, Stream
from bcid.vehicle import Vehicle

HORIZONS_S = (0.5, 2.0, 10.0)
TRACKS_HORIZON_S = 2.0


class PredictedTracks(NamedTuple):
    """Measured and predicted places (m) on the estimate's grid; predictions restart every TRACKS_HORIZON_S."""

    time_s: Floats  # (K,)
    measured: Floats  # (K, 2)
    before: Floats  # (K, 2)
    after: Floats  # (K, 2)
    starts: Floats  # (K,) 1 where predictions start, else 0


class PredictionErrors(NamedTuple):
    """Errors at all HORIZONS_S, predicted tracks, and at which share of their size free functions do most good."""

    horizons: list[HorizonError]
    tracks: PredictedTracks
    function_share: float  # 0 where they do none, or were not asked for


def compare_predictions(
    before: Fit, after: Fit, take: Take, recording: Recording, estimate: Estimate, vehicle: Vehicle, tuning: Tuning,
    reference: ReferenceModel | None = None, with_remainder: bool = False,
) -> PredictionErrors:  # fmt: skip
    """Prediction errors of two fits at all HORIZONS_S, with 95 % intervals and the noise floor, and predicted tracks.

    Predictions restart from the `estimate` of the take's first recording every horizon; errors are normalised mean
    squares of the twist (NMSE).  The fits without (`before`) and with (`after`) the named effects are cross-validated:
    refitted to each half of the take's blocks and judged on the other; and `with_remainder` the latter with free
    functions beside it is, too, at the share of their size that does most good.  The `reference` model is judged as
    given.  The noise floor is the error of `after` on a recording simulated by `after` itself, whose motion is
    estimated with the same `tuning`.  Tracks are measured and predicted positions; their predictions restart every
    TRACKS_HORIZON_S.
    """
    weights = inverse_spread(estimate.twist)
    zero_s, halves = float(recording.poses.time_s[0]), split_halves(take)
    block = ((estimate.time_s - zero_s) // block_length_s(take)).astype(int)
    trained_on_first = trained_on_first_half(estimate, take, zero_s)
    T, period_s = float(take.length_s[0]), estimate.period_s
    refits = [[refit_on_half_or_keep(fit, take, half) for half in halves] for fit in (before, after)]
    trained: list[list[Model]] = [[model_from_fit(fit, T, period_s) for fit in pair] for pair in refits]
    share = 0.0
    if with_remainder:
        pairs = zip(refits[1], halves, strict=True)
        whole = [model_of_half(fit, take, half, period_s) for fit, half in pairs]
        share = best_share(whole, estimate, trained_on_first)
        if share > 0.0:
            trained.append([scale_functions(model, share) for model in whole])
    # a car that only fits stretch by stretch may not drive a whole take
    simulated = none_if_diverged(simulate_fitted_car, after, take, recording)
    again = estimate_motion(simulated, vehicle, tuning, period_s) if simulated else None
    after_model = model_from_fit(after, T, period_s)
    reference_model = model_from_reference(reference, vehicle, T, period_s) if reference else None
    rows, tracks = [], None
    for horizon in HORIZONS_S:
        squares, places = [], []
        for models in trained:
            predictions = [predict_with_restarts(model, estimate, horizon) for model in models]
            errors = [squared_errors(p, estimate, weights) for p in predictions]
            squares.append(np.where(trained_on_first, *errors))
            places.append(np.where(trained_on_first[:, None], *(p.pose[:, :2] for p in predictions)))
        floor = None
        if again is not None:
            itself = predict_with_restarts(after_model, again, horizon)
            floor = _finite_mean(squared_errors(itself, again, weights))
        row = _bootstrap_errors(horizon, squares[0], squares[1], floor, block)
        if reference_model is not None:
            given = predict_with_restarts(reference_model, estimate, horizon)
            off = squared_errors(given, estimate, weights)
            lost = float(np.isnan(off).mean())
            row = row.model_copy(update={"nmse_given": _finite_mean(off), "given_lost": lost})
        if share > 0.0:
            beside = _bootstrap_errors(horizon, squares[1], squares[2], None, block)
            row = row.model_copy(update={
                "nmse_remainder": beside.nmse_after, "remainder_lost": beside.lost,
                "remainder_ci95": beside.after_ci95, "remainder_ratio_ci95": beside.ratio_ci95,
            })  # fmt: skip
        rows.append(row)
        if horizon == TRACKS_HORIZON_S:
            starts = predictions[0].start.astype(float)
            tracks = PredictedTracks(estimate.time_s, estimate.pose[:, :2], places[0], places[1], starts)
    assert tracks is not None  # noqa: S101  # it is one of the horizons
    return PredictionErrors(rows, tracks, share)


def _finite_mean(squares: Floats) -> float | None:
    """Mean of the finite values; None if there are none."""
    there = squares[np.isfinite(squares)]
    return float(there.mean()) if len(there) else None


def _bootstrap_errors(horizon: float, before: Floats, after: Floats, floor: float | None, block: Ints) -> HorizonError:
    """Mean prediction errors at a `horizon` (s) without and with the named effects, their ratio, and 95 % intervals.

    `before` and `after` are squared errors (K,), of which rows finite in both count; `floor` is the noise floor's mean
    squared error, if known.  Intervals are by block bootstrap over the rows' blocks, numbered by `block` (K,).
    """
    finite = np.isfinite(before) & np.isfinite(after)
    lost = float((~finite).mean())
    if lost == 1.0:
        return HorizonError(horizon_s=horizon, nmse_floor=floor, lost=lost)
    known = np.bincount(block, finite) > 0.0
    count = np.bincount(block, finite)[known]
    sums = [np.bincount(block, np.where(finite, s, 0.0))[known] for s in (before, after)]
    draws = draw_blocks(len(count))
    b, a = (s[draws].sum(axis=1) / count[draws].sum(axis=1) for s in sums)
    nmse_before, nmse_after = (float(s.sum() / count.sum()) for s in sums)
    before_ci95, after_ci95, ratio_ci95 = (
        (float(low), float(high)) for low, high in map(quantile_interval, (b, a, a / np.maximum(b, 1e-30)))
    )
    return HorizonError(
        horizon_s=horizon, nmse_before=nmse_before, nmse_after=nmse_after, nmse_floor=floor, lost=lost,
        before_ci95=before_ci95, after_ci95=after_ci95, ratio=nmse_after / nmse_before if nmse_before else None,
        ratio_ci95=ratio_ci95,
    )  # fmt: skip


def simulate_fitted_car(fit: Fit, take: Take, recording: Recording, seed: int = 0) -> Recording:
    """A simulated recording: the fitted car with its effects, driven by the commands of the take's first `recording`.

    Its poses have the stamps of the `recording`.  Disturbance accelerations of the body, constant over 0.25 s, and
    noise of the poses are drawn at random by `seed`, with the fitted standard deviations.
    """
    setting = fit.hypothesis.prediction_inputs(fit.phi, take)
    path = observe_states(
        recording.poses.time_s - recording.poses.time_s[0],
        simulate_states(setting, float(take.length_s[0]), fit.scales, seed, without_pushes(fit.start)[0]), setting,
    )  # fmt: skip
    each = max(1.0, round(GROUP_S * recording.rate_hz))
    noise = np.random.default_rng([seed, 1]).standard_normal(path.shape) * fit.scales.r * np.sqrt(each)
    return replace(recording, poses=Stream(recording.poses.time_s, path + noise), channels={})
