"""A take cut into short segments of poses for multi-step prediction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.estimate.types import Estimate
from bcid.physics.car import LONGEST_STEP_S
from bcid.physics.steering import steering_step
from bcid.recording.checks.contacts import Contact
from bcid.recording.types import Recording

SEGMENT_S = 1.5
KNOTS = 3  # of a segment, in each of which a push is constant
KNOT_S = SEGMENT_S / KNOTS
N_START = 6  # of a segment's free part: its initial state, then F_x, F_y, M_z of each knot
N_FREE = N_START + 3 * KNOTS
GROUP_S = 0.05  # poses this near each other are averaged, and so are their predictions: nothing moves faster
START_S = 0.4  # of a segment's poses give its initial state
START_POSES = 5  # at least
FORGOTTEN = 1e-4  # rad: where the wheel stood before the first command matters no more
STANDS = 0.01  # rad, and of the wheelbase: a car that moves less in a whole segment stands
MIN_COVERAGE = 0.6  # of the groups that a segment may hold


class Take(NamedTuple):
    """Poses and commands of one recording, and the S segments in which they are predicted.

    Times count from the first recording's first pose.  Segment s begins at integration step `step[s]`, owns the
    stamps `first_stamp[s]` to `first_stamp[s + 1]` and the rows `first[s]` to `first[s + 1]`: a row is the mean
    of the poses of one group.
    """

    command_s: Floats  # (M,)
    command: Floats  # (M, 2)
    stamp_s: Floats  # (P,) of the poses that lie in segments
    row: Ints  # (P,) the row that each belongs to
    share: Floats  # (P,) and its share in the mean
    first_stamp: Ints  # (S + 1,)
    pose: Floats  # (N, 3) means
    first: Ints  # (S + 1,)
    step: Ints  # (S,)
    steps: int  # integration steps per segment
    T: float  # s until the last recording ends
    start: Floats  # (S, N_FREE) pose and twist at the segments' starts, roughly, and no pushes
    zero_s: Floats  # (S,) when each segment's recording began
    length_s: Floats  # (S,) and how long it is
    command_zero_s: Floats  # (M,) when each command's recording began
    pushed: bool = False  # whether predictions are made under the likeliest pushes (`bcid.likelihood.nuisance`)

    @property
    def segments(self) -> int:
        """How many there are."""
        return len(self.step)

    @property
    def begin_s(self) -> Floats:
        """When the segments begin (S,)."""
        begin: Floats = (self.step * self.h).astype(np.float64)
        return begin

    @property
    def h(self) -> float:
        """Integration step, s."""
        return SEGMENT_S / self.steps

    def rows(self, chosen: Ints) -> Ints:
        """The rows of some of its segments."""
        return _spans(self.first, chosen)[0]

    def part(self, chosen: Ints) -> Take:
        """The same take with some of its segments only."""
        stamps, first_stamp = _spans(self.first_stamp, chosen)
        rows, first = _spans(self.first, chosen)
        renumbered = np.full(len(self.pose), -1, dtype=np.int64)
        renumbered[rows] = np.arange(len(rows))
        return self._replace(
            stamp_s=self.stamp_s[stamps], row=renumbered[self.row[stamps]], share=self.share[stamps],
            first_stamp=first_stamp, pose=self.pose[rows], first=first, step=self.step[chosen],
            start=self.start[chosen], zero_s=self.zero_s[chosen], length_s=self.length_s[chosen],
        )  # fmt: skip


def _spans(first: Ints, chosen: Ints) -> tuple[Ints, Ints]:
    """The numbers in the chosen spans of `first`, and the spans' new beginnings."""
    begin = first[chosen]
    lengths, ends = first[chosen + 1] - begin, np.zeros(len(chosen) + 1, dtype=np.int64)
    np.cumsum(lengths, out=ends[1:])
    return np.arange(ends[-1]) + np.repeat(begin - ends[:-1], lengths), ends


def take_of(recording: Recording, estimate: Estimate, h: float = LONGEST_STEP_S) -> Take:
    """The take in `recording`, with the segments that its estimate covers without a break, for steps of `h` s.

    Segments stand one after the other in each uninterrupted stretch of the estimate.
    """
    zero = float(recording.poses.time_s[0])
    stamp, pose = recording.poses.time_s - zero, recording.poses.values
    rows = round(SEGMENT_S / estimate.period_s)
    least = MIN_COVERAGE * SEGMENT_S * min(recording.rate_hz, 1.0 / GROUP_S)
    kept, means, groups, begin, start = [], [], [], [], []
    for stretch in estimate.segments():
        for k in range(stretch.start, stretch.stop - rows, rows):
            t_0 = float(estimate.time_s[k]) - zero
            mine = np.flatnonzero((stamp >= t_0 - 1e-9) & (stamp < t_0 + SEGMENT_S - 1e-9))
            group = np.unique(np.floor((stamp[mine] - t_0 + 1e-9) / GROUP_S), return_inverse=True)[1]
            if len(mine) == 0 or group[-1] + 1 < least:
                continue
            kept.append(mine)
            groups.append(group.astype(np.int64))
            counts = np.bincount(group)
            means.append(np.column_stack([np.bincount(group, pose[mine, c]) / counts for c in range(3)]))
            begin.append(round(t_0 / h))
            start.append(_state_at(stamp[mine] - t_0, pose[mine]))
    first = np.r_[0, np.cumsum([len(m) for m in means])].astype(np.int64)
    row = np.concatenate([g + f for g, f in zip(groups, first, strict=False)] or [np.empty(0, dtype=np.int64)])
    joined = np.concatenate(kept) if kept else np.empty(0, dtype=np.int64)
    return Take(
        recording.commands.time_s - zero, recording.commands.values, stamp[joined], row,
        1.0 / np.bincount(row)[row] if len(row) else np.empty(0),
        np.r_[0, np.cumsum([len(k) for k in kept])].astype(np.int64),
        np.concatenate(means) if means else np.empty((0, 3)), first, np.array(begin, dtype=np.int64),
        round(SEGMENT_S / h), recording.duration_s, unpushed(np.array(start).reshape(-1, N_START)),
        np.zeros(len(start)), np.full(len(start), recording.duration_s), np.zeros(len(recording.commands.time_s)),
    )  # fmt: skip


def unpushed(state: Floats) -> Floats:
    """Free parts (S, N_FREE) of initial states (S, N_START) without pushes."""
    return np.hstack([state, np.zeros((len(state), N_FREE - N_START))])


def _state_at(since: Floats, pose: Floats) -> Floats:
    """Pose and twist (6,) at time 0 from parabolas through the first poses: where a refit starts.

    The estimator's twist is better, except where a take breaks its assumptions; a refit needs neither.
    """
    first = since < max(START_S, since[min(START_POSES, len(since)) - 1] + 1e-9)
    X = np.vander(since[first], 3, increasing=True)
    (x, y, yaw), (u, v, omega) = np.linalg.lstsq(X, pose[first], rcond=None)[0][:2]
    return np.asarray(
        [x, y, yaw, np.cos(yaw) * u + np.sin(yaw) * v, np.cos(yaw) * v - np.sin(yaw) * u, omega], dtype=np.float64
    )


def moving(take: Take, wheelbase: float) -> Take:
    """The take without the segments in which the car stands.

    Nothing there is predicted wrongly, so that the noise would be taken for what a tracked car at rest shows, and
    everything that moves for an outlier.  What a throttle says that is too small to move the car goes with it.
    """
    x, y, yaw = take.pose.T
    at = take.first[:-1]
    extent = (
        [np.maximum.reduceat(v, at) - np.minimum.reduceat(v, at) for v in (x, y, yaw)] if take.segments else [at] * 3
    )
    moves = (np.hypot(extent[0], extent[1]) > STANDS * wheelbase) | (extent[2] > STANDS)
    return take if moves.all() else take.part(np.flatnonzero(moves))


def without_contacts(take: Take, found: Sequence[Contact]) -> Take:
    """The take without the segments in which a contact lies."""
    begin, end = take.begin_s, take.begin_s + SEGMENT_S + take.h
    free = np.ones(take.segments, dtype=bool)
    for contact in found:
        free &= (end < contact.begin_s) | (begin > contact.end_s)
    return take if free.all() else take.part(np.flatnonzero(free))


def without_beginning(take: Take, T_s: float, d: float, limit: float) -> Take:
    """The take without the segments that begin while it matters where the wheel stood before the first command.

    Nobody logs that.  It is forgotten when a servo comes to the same angle from either lock.
    """
    known = take.begin_s >= _forgotten_s(take, T_s, d, limit) - 1e-9
    return take if known.all() else take.part(np.flatnonzero(known))


def _forgotten_s(take: Take, T_s: float, d: float, limit: float) -> float:
    left, right = limit, -limit
    now = max(0.0, float(take.command_s[0]))  # the chain begins with the poses
    ends = np.r_[take.command_s[1:], np.inf]
    for u_s, end in zip(np.clip(take.command[:, 0], -limit, limit), ends, strict=True):
        while now < end and left - right > FORGOTTEN:
            h = min(end - now, KNOT_S)
            left, right, now = steering_step(left, u_s, T_s, d, h), steering_step(right, u_s, T_s, d, h), now + h
    return now


def joined(takes: Sequence[Take]) -> Take:
    """Several takes as one after the other in time.

    The steering chain runs through, from where the take before left it: their beginnings must be left out.
    """
    whole = takes[0]
    for take in takes[1:]:
        steps = int(np.ceil((whole.T + 1.0) / whole.h))
        ahead = steps * whole.h
        whole = Take(
            np.r_[whole.command_s, take.command_s + ahead], np.vstack([whole.command, take.command]),
            np.r_[whole.stamp_s, take.stamp_s + ahead], np.r_[whole.row, take.row + len(whole.pose)],
            np.r_[whole.share, take.share], np.r_[whole.first_stamp, take.first_stamp[1:] + len(whole.stamp_s)],
            np.vstack([whole.pose, take.pose]), np.r_[whole.first, take.first[1:] + len(whole.pose)],
            np.r_[whole.step, take.step + steps], whole.steps, ahead + take.T, np.vstack([whole.start, take.start]),
            np.r_[whole.zero_s, take.zero_s + ahead], np.r_[whole.length_s, take.length_s],
            np.r_[whole.command_zero_s, take.command_zero_s + ahead],
        )  # fmt: skip
    return whole


def in_one(take: Take) -> Take:
    """The take as if it had been recorded in one go."""
    return take._replace(
        zero_s=np.zeros(take.segments), length_s=np.full(take.segments, take.T),
        command_zero_s=np.zeros(len(take.command_s)),
    )  # fmt: skip
