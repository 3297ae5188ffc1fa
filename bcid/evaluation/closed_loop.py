"""Closed-loop rollouts through a whole take or restarted from the estimate every few seconds, and their errors."""

import time
from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.bootstrap import bootstrap_interval
from bcid.estimate.types import Estimate
from bcid.models.interface import Model, RolloutDiverged, SupportsRollout, history_at, rollout

# Length (s) of the blocks that are resampled for the interval of an NMSE, and how often.
BLOCK_S, RESAMPLES = 5.0, 1999


class RestartedPrediction(NamedTuple):
    """Poses and twists predicted from the estimate, restarted at regular times; rows as in the estimate."""

    pose: Floats  # (K, 3)
    twist: Floats  # (K, 3)
    start: Bools  # (K,) rows at which a prediction starts


def predict_whole_take(model: SupportsRollout, estimate: Estimate) -> Floats:
    """Twists (K, 3), v_x, v_y, yaw rate, of a model's rollouts from each segment's first row under the take's commands.

    A segment is a part of the estimated motion without gaps; only its first row (and the model's lagged rows) is
    given to the model.  Where a rollout diverges, all later rows of its segment are NaN.
    """
    return _predict_from_starts(model, estimate, [s.start for s in estimate.segments()])


def _predict_from_starts(model: SupportsRollout, estimate: Estimate, starts: list[int]) -> Floats:
    """Twists (K, 3) of a model's rollouts under a take's commands, one from each row in `starts` until the next start.

    Rows are those of the estimated motion.  Where a rollout diverges, its first row holds the estimated twist and all
    others are NaN.
    """
    twist = np.full((len(estimate), 3), np.nan)
    for a, b in zip(starts, [*starts[1:], len(estimate)], strict=True):
        try:
            twist[a:b] = rollout(model, history_at(estimate, a, model.lags), estimate.parts[a : b - 1])
        except RolloutDiverged:
            twist[a] = estimate.twist[a]
    return twist


def predict_with_restarts(model: SupportsRollout, estimate: Estimate, every_s: float) -> RestartedPrediction:
    """Poses and twists of a model's rollouts through a take, restarted from the estimate every `every_s` seconds."""
    size = max(2, round(every_s / estimate.period_s))
    starts = [k for s in estimate.segments() for k in range(s.start, s.stop, size)]
    twist = _predict_from_starts(model, estimate, starts)
    pose = np.empty_like(twist)
    for a, b in zip(starts, [*starts[1:], len(estimate)], strict=True):
        pose[a:b] = integrate_poses(estimate.pose[a], twist[a:b], estimate.period_s)
    marks = np.zeros(len(estimate), dtype=bool)
    marks[starts] = True
    return RestartedPrediction(pose, twist, marks)


class Nmse(NamedTuple):
    """Normalised mean squared error of v_x, v_y and yaw rate, and their mean with a 95 % block-bootstrap interval."""

    v_x: float
    v_y: float
    yaw_rate: float
    mean: float
    ci95: tuple[float, float]


def nmse(predicted: Floats, measured: Floats, weights: Floats, period_s: float) -> Nmse:
    """Normalised mean squared error ||W (q_hat - q)||^2 / (n N) of predicted q_hat against measured twists q (N, 3).

    W = diag(`weights`), n = 3.  Returns it for each channel and overall, with a 95 % interval of the overall value by
    block bootstrap, over blocks of BLOCK_S seconds of rows `period_s` apart (paper, section "Data-Driven modeling",
    1st equation; docs/errata.md row 12).
    """
    squares = (weights * (predicted - measured)) ** 2
    channels = squares.mean(axis=0)
    size = max(1, round(BLOCK_S / period_s))
    blocks = np.array([part.mean() for part in np.array_split(squares, max(2, len(squares) // size))])
    v_x, v_y, yaw_rate = channels.tolist()
    return Nmse(v_x, v_y, yaw_rate, float(channels.mean()), bootstrap_interval(blocks, np.mean, RESAMPLES))


def position_errors(model: Model, estimate: Estimate, after_s: float) -> Floats:
    """Distances (m) between a model's predicted and the estimated position `after_s` after each of several starts.

    Starts are estimate rows `after_s` apart in each segment.  A rollout that diverges has an infinite distance.
    """
    size = max(2, round(after_s / estimate.period_s))
    errors = []
    for segment in estimate.segments():
        for k in range(segment.start, segment.stop - size, size):
            try:
                twist = rollout(model, history_at(estimate, k, model.lags), estimate.parts[k : k + size])
            except RolloutDiverged:
                errors.append(np.inf)
                continue
            end = integrate_poses(estimate.pose[k], twist, estimate.period_s)[-1]
            errors.append(float(np.hypot(*(end[:2] - estimate.pose[k + size, :2]))))
    return np.array(errors)


def integrate_poses(start: Floats, twist: Floats, period_s: float) -> Floats:
    """Poses (N, 3) x, y (m, world), yaw from the pose `start` (3,) along body-frame twists (N, 3), trapezoidal rule."""
    yaw = start[2] + np.r_[0.0, np.cumsum(0.5 * period_s * (twist[1:, 2] + twist[:-1, 2]))]
    cos_t, sin_t = np.cos(yaw), np.sin(yaw)
    world = np.column_stack([cos_t * twist[:, 0] - sin_t * twist[:, 1], sin_t * twist[:, 0] + cos_t * twist[:, 1]])
    moved = np.vstack([np.zeros(2), np.cumsum(0.5 * period_s * (world[1:] + world[:-1]), axis=0)])
    return np.column_stack([start[:2] + moved, yaw])


def time_rollout_ms(model: Model, estimate: Estimate, repeats: int) -> float:
    """Median wall time (ms) of `repeats` rollouts of a model through all of a take's commands, after one to compile."""
    history = history_at(estimate, 0, model.lags)
    commands = np.ascontiguousarray(estimate.parts[:-1])
    model.scan(model.init(history), commands)
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        model.scan(model.init(history), commands)
        times.append(time.perf_counter() - begin)
    return 1e3 * float(np.median(times))
