"""A take cut into short segments of poses for multi-step prediction."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.estimate.types import Estimate
from bcid.recording.types import Recording

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]

SEGMENT_S = 1.5
STEP_S = 0.025
MIN_COVERAGE = 0.6  # of the poses that the rate promises in a segment


class Take(NamedTuple):
    """Poses and commands of one recording, and the S segments in which they are predicted.

    Times count from the recording's first pose.  Segment s begins at integration step `step[s]` and
    owns the poses `first[s]` to `first[s + 1]`.
    """

    command_s: Floats  # (M,)
    command: Floats  # (M, 2)
    stamp_s: Floats  # (N,) of the poses that lie in segments
    pose: Floats  # (N, 3)
    first: Ints  # (S + 1,)
    step: Ints  # (S,)
    steps: int  # integration steps per segment
    T: float  # length of the recording, s
    start: Floats  # (S, 6) pose and twist at the segments' starts, from the estimator

    @property
    def segments(self) -> int:
        """How many there are."""
        return len(self.step)

    def part(self, chosen: Ints) -> Take:
        """The same take with some of its segments only."""
        rows = [np.arange(self.first[s], self.first[s + 1]) for s in chosen]
        joined = np.concatenate(rows) if rows else np.empty(0, dtype=np.int64)
        first = np.r_[0, np.cumsum([len(r) for r in rows])].astype(np.int64)
        return self._replace(
            stamp_s=self.stamp_s[joined], pose=self.pose[joined], first=first, step=self.step[chosen],
            start=self.start[chosen],
        )  # fmt: skip


def take_of(recording: Recording, estimate: Estimate) -> Take:
    """The take in `recording`, with the segments that its estimate covers without a break.

    Segments stand one after the other in each uninterrupted stretch of the estimate.
    """
    zero = float(recording.poses.time_s[0])
    stamp, pose = recording.poses.time_s - zero, recording.poses.values
    steps = round(SEGMENT_S / STEP_S)
    rows = round(SEGMENT_S / estimate.period_s)
    least = MIN_COVERAGE * SEGMENT_S * recording.rate_hz
    kept, begin, start = [], [], []
    for stretch in estimate.segments():
        for k in range(stretch.start, stretch.stop - rows, rows):
            t_0 = float(estimate.time_s[k]) - zero
            mine = np.flatnonzero((stamp >= t_0 - 1e-9) & (stamp < t_0 + SEGMENT_S - 1e-9))
            if len(mine) >= least:
                kept.append(mine)
                begin.append(round(t_0 / STEP_S))
                turns = 2.0 * np.pi * np.round((pose[mine[0], 2] - estimate.pose[k, 2]) / (2.0 * np.pi))
                start.append([*(estimate.pose[k] + [0.0, 0.0, turns]), *estimate.twist[k]])
    joined = np.concatenate(kept) if kept else np.empty(0, dtype=np.int64)
    first = np.r_[0, np.cumsum([len(r) for r in kept])].astype(np.int64)
    return Take(
        recording.commands.time_s - zero, recording.commands.values, stamp[joined], pose[joined], first,
        np.array(begin, dtype=np.int64), steps, recording.duration_s, np.array(start).reshape(len(start), 6),
    )  # fmt: skip
