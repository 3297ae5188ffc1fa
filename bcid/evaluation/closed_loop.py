"""Closed-loop rollouts: through a whole take, and trajectories started anew every few seconds."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.estimate.types import Estimate
from bcid.models.interface import Diverged, Model, Scans, history_at, rollout


class Restarted(NamedTuple):
    """Predictions started anew from the estimate at regular times; rows as in the estimate."""

    pose: Floats  # (K, 3)
    twist: Floats  # (K, 3)
    start: npt.NDArray[np.bool_]  # (K,) rows at which a prediction starts


def whole_take(model: Scans, estimate: Estimate) -> Floats:
    """Twists (K, 3) predicted from the take's first sample with its commands.

    Where the take has several segments each starts anew.  A stretch that diverges is NaN after its start.
    """
    return _from_starts(model, estimate, [s.start for s in estimate.segments()])


def _from_starts(model: Scans, estimate: Estimate, starts: list[int]) -> Floats:
    twist = np.full((len(estimate), 3), np.nan)
    for a, b in zip(starts, [*starts[1:], len(estimate)], strict=True):
        try:
            twist[a:b] = rollout(model, history_at(estimate, a, model.lags), estimate.command[a : b - 1])
        except Diverged:
            twist[a] = estimate.twist[a]
    return twist


def restarted(model: Scans, estimate: Estimate, every_s: float) -> Restarted:
    """Poses and twists predicted from the estimate, started anew every `every_s` and at each segment."""
    size = max(2, round(every_s / estimate.period_s))
    starts = [k for s in estimate.segments() for k in range(s.start, s.stop, size)]
    twist = _from_starts(model, estimate, starts)
    pose = np.empty_like(twist)
    for a, b in zip(starts, [*starts[1:], len(estimate)], strict=True):
        pose[a:b] = integrate(estimate.pose[a], twist[a:b], estimate.period_s)
    marks = np.zeros(len(estimate), dtype=bool)
    marks[starts] = True
    return Restarted(pose, twist, marks)


def misses(model: Model, estimate: Estimate, after_s: float) -> Floats:
    """Distances (m) between predicted and measured position `after_s` after each start, as `restarted` starts."""
    size = max(2, round(after_s / estimate.period_s))
    found = []
    for segment in estimate.segments():
        for k in range(segment.start, segment.stop - size, size):
            try:
                twist = rollout(model, history_at(estimate, k, model.lags), estimate.command[k : k + size])
            except Diverged:
                found.append(np.inf)
                continue
            end = integrate(estimate.pose[k], twist, estimate.period_s)[-1]
            found.append(float(np.hypot(*(end[:2] - estimate.pose[k + size, :2]))))
    return np.array(found)


def integrate(start: Floats, twist: Floats, period_s: float) -> Floats:
    """Poses (N, 3) along `twist` (N, 3) from the pose `start`, by the trapezoidal rule."""
    yaw = start[2] + np.r_[0.0, np.cumsum(0.5 * period_s * (twist[1:, 2] + twist[:-1, 2]))]
    cos_t, sin_t = np.cos(yaw), np.sin(yaw)
    world = np.column_stack([cos_t * twist[:, 0] - sin_t * twist[:, 1], sin_t * twist[:, 0] + cos_t * twist[:, 1]])
    moved = np.vstack([np.zeros(2), np.cumsum(0.5 * period_s * (world[1:] + world[:-1]), axis=0)])
    return np.column_stack([start[:2] + moved, yaw])


def rollout_ms(model: Model, estimate: Estimate, repeats: int) -> float:
    """Median wall time (ms) of the whole take's rollout, compiled and warm."""
    history = history_at(estimate, 0, model.lags)
    commands = np.ascontiguousarray(estimate.command[:-1])
    model.scan(model.init(history), commands)
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        model.scan(model.init(history), commands)
        times.append(time.perf_counter() - begin)
    return 1e3 * float(np.median(times))
