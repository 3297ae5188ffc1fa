"""95 % intervals of a model's predictions, sampled from its process noise, and how often they hold."""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.documents.report import Coverage
from bcid.estimate.command_parts import stack_parts
from bcid.estimate.types import Estimate
from bcid.evaluation.process_noise import ProcessNoise, list_prediction_starts, sample_rollouts
from bcid.models.interface import History, Model, history_at

# Horizons (s) at which intervals are checked and models compared.
HORIZONS_S = (0.5, 2.0, 10.0)
# Pushed rollouts from which an interval is drawn, and starts whose rollouts are drawn together.
SAMPLES, STARTS_PER_BATCH = 200, 50
# Share of a normal law within one standard deviation.
ONE_SIGMA_SHARE = 0.6827


class PredictionInterval(NamedTuple):
    """Predicted twists with the half widths of their 95 % intervals."""

    twist: Floats  # (N, 3) after each command
    half_width: Floats  # (N, 3) the interval's half width


def predict_with_interval(
    model: Model, history: History, commands: Floats, noise: ProcessNoise, seed: int = 0
) -> PredictionInterval:
    """Twists (N, 3) that a model predicts after each of `commands`, with half widths of their 95 % intervals.

    Commands are (N, 2), or parts (N, W, 4).  The half widths are Monte Carlo estimates, from rollouts with random
    samples of the model's process noise.
    """
    prediction = _predict_many_with_intervals(model, model.init(history)[None], commands[None], noise, seed)
    return PredictionInterval(prediction.twist[0], prediction.half_width[0])


def _predict_many_with_intervals(
    model: Model, carries: Floats, commands: Floats, noise: ProcessNoise, seed: int
) -> PredictionInterval:
    """Twists and half widths of their 95 % intervals (both (B, N, 3)) of B rollouts under commands.

    These are (B, N, 2), or parts (B, N, W, 4); `carries` (B, n) are the model's states at the starts.  By Monte Carlo:
    SAMPLES rollouts of each start are disturbed by process noise, and the half width is `noise.factor` times the
    ONE_SIGMA_SHARE (68 %) quantile of their absolute deviations from the undisturbed rollout, a robust standard
    deviation.  It is infinite where a third of them diverges.
    """
    plain = model.scan_many(carries, commands)[1]
    rng = np.random.default_rng(seed)
    many = sample_rollouts(model, carries, commands, SAMPLES, np.array(noise.q), noise.tau_s, rng)
    with np.errstate(invalid="ignore", over="ignore"):
        off = np.abs(many - plain[:, None])
    return PredictionInterval(
        plain, noise.factor * np.quantile(np.where(np.isfinite(off), off, np.inf), ONE_SIGMA_SHARE, axis=1)
    )


def interval_half_widths(model: Model, estimate: Estimate, noise: ProcessNoise | None) -> Floats:
    """Half widths (K, 3) of 95 % intervals of predicted twists v_x, v_y, yaw rate; NaN where `noise` is None.

    They are Monte Carlo estimates, from rollouts with random process noise that start at each segment's first row (0
    there).
    """
    half = np.full_like(estimate.twist, np.nan)
    if noise is None:
        return half
    for s in estimate.segments():
        half[s.start] = 0.0
        if s.stop - s.start > 1:
            commands, history = estimate.parts[s.start : s.stop - 1], history_at(estimate, s.start, model.lags)
            half[s.start + 1 : s.stop] = predict_with_interval(model, history, commands, noise).half_width
    return half


def measure_coverage(model: Model, estimate: Estimate, noise: ProcessNoise) -> list[Coverage]:
    """Share of estimated twists that lie within the model's 95 % intervals, at each of HORIZONS_S after a start.

    Rollouts start a horizon apart, so that no two share a row.  The share's own 95 % interval (Wilson) counts each
    start once, not each of its three channels; intervals include the estimated twist's standard deviation.
    """
    from scipy.stats import binomtest

    coverages = []
    for horizon in HORIZONS_S:
        n, within = round(horizon / model.period_s), list[float]()
        starts = list_prediction_starts([estimate], n, n, model.lags) if n else []
        for batch in (starts[i : i + STARTS_PER_BATCH] for i in range(0, len(starts), STARTS_PER_BATCH)):
            carries = np.stack([model.init(history_at(e, k, model.lags)) for e, k in batch])
            commands = stack_parts([e.parts[k : k + n] for e, k in batch])
            predictions = _predict_many_with_intervals(model, carries, commands, noise, seed=0)
            ends = np.array([k + n for _, k in batch])
            half = np.hypot(predictions.half_width[:, -1], noise.factor * estimate.twist_sd[ends])
            within += (np.abs(predictions.twist[:, -1] - estimate.twist[ends]) <= half).mean(axis=1).tolist()
        if within:
            share = float(np.mean(within))
            low, high = binomtest(round(share * len(within)), len(within)).proportion_ci(0.95, "wilson")
            coverages.append(Coverage(horizon_s=horizon, covered=share, ci95=(low, high), starts=len(within)))
    return coverages
