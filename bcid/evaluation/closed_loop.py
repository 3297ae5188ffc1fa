"""Closed-loop rollouts through a whole take or restarted from the estimate every few seconds, and their errors."""

import time
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.bootstrap import bootstrap_interval
from bcid.estimate.types import Estimate
from bcid.models.interface import Model, SupportsRollout, history_at
from bcid.models.limits import LIMITS

# Length (s) of the blocks that are resampled for the interval of an NMSE, and how often.
BLOCK_S, RESAMPLES = 5.0, 1999


@runtime_checkable
class SupportsManyRollouts(SupportsRollout, Protocol):
    """A model of which many vehicles are rolled out at once."""

    def scan_many(self, carries: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """Advance B vehicles (B, n) under parts (B, N, W, 4): carries after the last, and twists (B, N, 3)."""


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
    twist[starts] = estimate.twist[starts]
    for rows in _group_rows_by_length(starts, len(estimate)):
        rest = rows[:, 1:]
        twist[rest] = _roll_out_from_rows(model, estimate, rows[:, 0], rest.shape[1]) if rest.shape[1] else twist[rest]
    return twist


def _group_rows_by_length(starts: list[int], end: int) -> list[Ints]:
    """The rows from each of `starts` until the next, the last until `end`, in arrays (B, n) of equally many rows."""
    begin = np.array(starts, dtype=np.int64)
    lengths = np.diff(np.append(begin, end))
    return [begin[lengths == n, None] + np.arange(n) for n in np.unique(lengths)]


def _roll_out_from_rows(model: SupportsRollout, estimate: Estimate, starts: Ints, steps: int) -> Floats:
    """Twists (B, steps, 3) that a model predicts after each of B rows `starts` of an estimate, under its commands.

    A rollout that passes LIMITS.fastest_twist (150 m/s, 100 rad/s), or is not finite, is NaN throughout.
    """
    carries = [model.init(history_at(estimate, k, model.lags)) for k in starts.tolist()]
    commands = estimate.parts[starts[:, None] + np.arange(steps)]
    if len(starts) > 1 and isinstance(model, SupportsManyRollouts):
        twist = np.array(model.scan_many(np.stack(carries), commands)[1], dtype=float)
    else:
        twist = np.stack([model.scan(carry, parts)[1] for carry, parts in zip(carries, commands, strict=True)])
    with np.errstate(invalid="ignore"):
        follows = (np.abs(twist) <= LIMITS.fastest_twist).all(axis=(1, 2))
    twist[~(follows & (np.abs(estimate.twist[starts]) <= LIMITS.fastest_twist).all(axis=1))] = np.nan
    return twist


def predict_with_restarts(model: SupportsRollout, estimate: Estimate, every_s: float) -> RestartedPrediction:
    """Poses and twists of a model's rollouts through a take, restarted from the estimate every `every_s` seconds."""
    size = max(2, round(every_s / estimate.period_s))
    starts = [k for s in estimate.segments() for k in range(s.start, s.stop, size)]
    twist = _predict_from_starts(model, estimate, starts)
    pose = np.empty_like(twist)
    for rows in _group_rows_by_length(starts, len(estimate)):
        pose[rows] = integrate_poses(estimate.pose[rows[:, 0]], twist[rows], estimate.period_s)
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
    starts = np.array([k for s in estimate.segments() for k in range(s.start, s.stop - size, size)], dtype=np.int64)
    if not len(starts):
        return np.empty(0)
    twist = _roll_out_from_rows(model, estimate, starts, size)
    whole = np.concatenate([estimate.twist[starts, None], twist], axis=1)
    end = integrate_poses(estimate.pose[starts], whole, estimate.period_s)[:, -1]
    errors = np.hypot(*(end[:, :2] - estimate.pose[starts + size, :2]).T)
    return np.asarray(np.where(np.isfinite(errors), errors, np.inf))


def integrate_poses(start: Floats, twist: Floats, period_s: float) -> Floats:
    """Poses (..., N, 3) x, y (m, world), yaw from poses `start` (..., 3) along body-frame twists (..., N, 3).

    By the trapezoidal rule, in steps of `period_s` (s).
    """
    yaw = start[..., 2:] + _trapezoidal_sums(twist[..., 2:], period_s)[..., 0]
    cos_t, sin_t = np.cos(yaw), np.sin(yaw)
    v_x, v_y = twist[..., 0], twist[..., 1]
    world = np.stack([cos_t * v_x - sin_t * v_y, sin_t * v_x + cos_t * v_y], axis=-1)
    moved = _trapezoidal_sums(world, period_s)
    return np.concatenate([start[..., None, :2] + moved, yaw[..., None]], axis=-1)


def _trapezoidal_sums(rate: Floats, period_s: float) -> Floats:
    """Integrals (..., N, n) of `rate` (..., N, n) from the first row to each, by trapezoids `period_s` (s) wide."""
    steps = 0.5 * period_s * (rate[..., 1:, :] + rate[..., :-1, :])
    return np.concatenate([np.zeros_like(rate[..., :1, :]), np.cumsum(steps, axis=-2)], axis=-2)


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
