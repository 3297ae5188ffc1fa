"""A take cut into short segments of poses for multi-step prediction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.errors import InputRefused
from bcid.estimate.types import Estimate
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.tracking_functions import SeenRows
from bcid.physics.car import LONGEST_STEP_S, Car, integration_step
from bcid.physics.steering import steering_step
from bcid.recording.checks.contacts import Contact, find_contacts
from bcid.recording.types import Recording

SEGMENT_S = 1.5
# equal parts of a segment, in each of which a push is constant.  Of three a floor that is rough over 0.3 s left what
# passed for information (docs/results/pushes.json).
KNOTS = 6
KNOT_S = SEGMENT_S / KNOTS
N_START = 6  # leading nuisance parameters of a segment: its initial state; then a_x, a_y, alpha_z of each knot's push
N_NUISANCE = N_START + 3 * KNOTS
GROUP_S = 0.05  # poses this near each other are averaged, and so are their predictions: nothing moves faster
# poses from which a segment's initial state is found: those in its first START_S, but START_POSES at least
START_S, START_POSES = 0.4, 5


class Take(NamedTuple):
    """Poses and commands of one or several recordings, and the S segments in which the poses are predicted.

    Times count from the first recording's first pose.  Segment s begins at integration step `step[s]`, has the
    stamps `first_stamp[s]` to `first_stamp[s + 1]` and the rows `first[s]` to `first[s + 1]`: a row is the mean
    of the poses within GROUP_S.
    """

    command_s: Floats  # (M,)
    command: Floats  # (M, 3) u_s, u_m, and the share of a brake that is no part of the throttle
    stamp_s: Floats  # (P,) of the poses that lie in segments
    row: Ints  # (P,) row of each pose
    share: Floats  # (P,) share of each pose in its row's mean
    first_stamp: Ints  # (S + 1,)
    pose: Floats  # (N, 3) means
    first: Ints  # (S + 1,)
    step: Ints  # (S,)
    steps: int  # integration steps per segment
    T: float  # time (s) at which the last recording ends
    start: Floats  # (S, N_NUISANCE) rough pose and twist at the segments' beginnings, and no pushes
    zero_s: Floats  # (S,) time (s) at which the segment's recording began
    length_s: Floats  # (S,) length (s) of the segment's recording
    command_zero_s: Floats  # (M,) time (s) at which the command's recording began

    @property
    def segments(self) -> int:
        """Number of segments, S."""
        return len(self.step)

    @property
    def begin_s(self) -> Floats:
        """Time (s) at which each segment begins (S,)."""
        return np.asarray(self.step * self.h, dtype=np.float64)

    @property
    def h(self) -> float:
        """Integration step (s) of the predictions."""
        return SEGMENT_S / self.steps

    @property
    def seen_rows(self) -> SeenRows:
        """When the poses in the take's rows were seen, since the recording began."""
        zero = np.repeat(self.zero_s, np.diff(self.first))
        return SeenRows(np.bincount(self.row, self.share * self.stamp_s) - zero, self.first)

    def rows(self, chosen: Ints) -> Ints:
        """Indices of the rows of the segments `chosen`, in that order."""
        return select_spans(self.first, chosen)[0]

    def part(self, chosen: Ints) -> Take:
        """The take with the segments `chosen` only."""
        kept = self._with_rows(*select_spans(self.first, chosen), *select_spans(self.first_stamp, chosen))
        return kept._replace(
            step=self.step[chosen], start=self.start[chosen], zero_s=self.zero_s[chosen], length_s=self.length_s[chosen]
        )

    def beginnings(self, share: float) -> Take:
        """The take with the first `share` of each segment's rows only."""
        rows = np.diff(self.first)
        within = np.arange(len(self.pose)) - np.repeat(self.first[:-1], rows)
        kept = within < np.repeat(np.ceil(share * rows), rows)
        stamped = kept[self.row]
        return self._with_rows(
            np.flatnonzero(kept), _count_before(kept, self.first),
            np.flatnonzero(stamped), _count_before(stamped, self.first_stamp),
        )  # fmt: skip

    def _with_rows(self, rows: Ints, first: Ints, stamps: Ints, first_stamp: Ints) -> Take:
        """The take with these `rows` and their `stamps` only, numbered anew; segments have the bounds given."""
        renumbered = np.full(len(self.pose), -1, dtype=np.int64)
        renumbered[rows] = np.arange(len(rows))
        return self._replace(
            stamp_s=self.stamp_s[stamps], row=renumbered[self.row[stamps]], share=self.share[stamps],
            first_stamp=first_stamp, pose=self.pose[rows], first=first,
        )  # fmt: skip


def _count_before(kept: Bools, bounds: Ints) -> Ints:
    """How many are `kept` before each of the `bounds`."""
    return np.asarray(np.r_[0, np.cumsum(kept)][bounds], dtype=np.int64)


def select_spans(first: Ints, chosen: Ints) -> tuple[Ints, Ints]:
    """All indices in the `chosen` spans (index arrays), span s being `first[s]` to `first[s + 1]`, and the new bounds.

    The bounds (len(chosen) + 1,) are those of the chosen spans laid one after the other from 0 on.
    """
    begin = first[chosen]
    lengths, ends = first[chosen + 1] - begin, np.zeros(len(chosen) + 1, dtype=np.int64)
    np.cumsum(lengths, out=ends[1:])
    return np.arange(ends[-1]) + np.repeat(begin - ends[:-1], lengths), ends


def build_take(
    recordings: Sequence[Recording], estimates: Sequence[Estimate], car: Car, angle_limit: float
) -> tuple[Take, tuple[Contact, ...]]:
    """Cut recordings into one take of 1.5 s segments that can be predicted; with it, the bumps and crashes found.

    Integration steps are short enough for `car`.  Left out are segments with such contacts, those in which the car
    stands, and those before the steering angle (within +-`angle_limit`, rad) is determined by commands.

    Raises:
        InputRefused: when fewer than `min_segments` segments remain.
    """
    parts, all_contacts = [], []
    for recording, estimate in zip(recordings, estimates, strict=True):
        contacts = find_contacts(recording)
        all_contacts += contacts
        whole = cut_segments(recording, estimate, integration_step(car))
        known = drop_unknown_beginning(whole, car.T_s, car.d, angle_limit)
        parts.append(drop_standing(drop_contacts(known, contacts), car.l_f + car.l_r))
    usable = sum(take.segments for take in parts)
    if usable < LIKELIHOOD_LIMITS.min_segments:
        raise InputRefused(
            recordings[0].sources[0].path, "poses",
            f"only {usable} stretches of 1.5 s in motion can be used, {LIKELIHOOD_LIMITS.min_segments} are the least",
            "record a longer take with fewer gaps",
        )  # fmt: skip
    return concatenate_takes([take for take in parts if take.segments]), tuple(all_contacts)


def cut_segments(recording: Recording, estimate: Estimate, h: float = LONGEST_STEP_S) -> Take:
    """Cut a recording into segments of SEGMENT_S (1.5 s), with poses averaged over 0.05 s: a take of all of them.

    Predictions will be integrated in steps of `h` s.  Each uninterrupted stretch of the `estimate`, which ends where
    poses are missing, gives as many segments as fit; those in which less than the share `min_coverage` of the poses
    is present are left out.
    """
    zero = float(recording.poses.time_s[0])
    stamp, pose = recording.poses.time_s - zero, recording.poses.values
    rows = round(SEGMENT_S / estimate.period_s)
    least = LIKELIHOOD_LIMITS.min_coverage * SEGMENT_S * min(recording.rate_hz, 1.0 / GROUP_S)
    # an empty segment before the first, so that lengths add up to bounds
    kept, means = [np.empty(0, dtype=np.int64)], [np.empty((0, 3))]
    groups, begin, start = [], [], []
    for stretch in estimate.segments():
        end = float(estimate.time_s[stretch.stop - 1]) - zero + 2e-9  # of the stretch, its last row included
        for k in range(stretch.start, stretch.stop - rows, rows):
            # predictions begin at an integration step, the first from the row on: before it may be another stretch
            step = math.ceil((float(estimate.time_s[k]) - zero) / h - 1e-6)
            t_0 = step * h
            mine = np.flatnonzero((stamp >= t_0 - 1e-9) & (stamp < min(t_0 + SEGMENT_S, end) - 1e-9))
            group = np.unique(np.floor((stamp[mine] - t_0 + 1e-9) / GROUP_S), return_inverse=True)[1]
            if len(mine) == 0 or group[-1] + 1 < least:
                continue
            kept.append(mine)
            groups.append(group.astype(np.int64))
            counts = np.bincount(group)
            means.append(np.column_stack([np.bincount(group, pose[mine, c]) / counts for c in range(3)]))
            begin.append(step)
            start.append(_fit_initial_state(stamp[mine] - t_0, pose[mine]))
    first, first_stamp = np.cumsum([len(m) for m in means]), np.cumsum([len(k) for k in kept])
    row = np.concatenate([kept[0], *(g + f for g, f in zip(groups, first, strict=False))])
    driven = recording.driven
    return Take(
        driven.time_s - zero, driven.values, stamp[np.concatenate(kept)], row,
        1.0 / np.bincount(row)[row], first_stamp, np.concatenate(means), first, np.array(begin, dtype=np.int64),
        round(SEGMENT_S / h), recording.duration_s, pad_with_zero_pushes(np.array(start).reshape(-1, N_START)),
        np.zeros(len(start)), np.full(len(start), recording.duration_s), np.zeros(len(driven)),
    )  # fmt: skip


def pad_with_zero_pushes(state: Floats) -> Floats:
    """Nuisance parameters (S, N_NUISANCE): initial states `state` (S, N_START), then pushes (disturbances) of zero."""
    return np.hstack([state, np.zeros((len(state), N_NUISANCE - N_START))])


def _fit_initial_state(since: Floats, pose: Floats) -> Floats:
    """State [x, y, yaw (world), v_x, v_y (body), omega] at a segment's beginning, by parabolas through its first poses.

    Least squares on `pose` (P, 3), x, y (m), yaw (rad), at `since` (s) after the beginning; the poses of the first
    START_S, at least START_POSES.  It is independent of the motion estimate's assumptions.
    """
    first = since < max(START_S, since[min(START_POSES, len(since)) - 1] + 1e-9)
    X = np.vander(since[first], 3, increasing=True)
    (x, y, yaw), (u, v, omega) = np.linalg.lstsq(X, pose[first], rcond=None)[0][:2]
    return np.asarray(
        [x, y, yaw, np.cos(yaw) * u + np.sin(yaw) * v, np.cos(yaw) * v - np.sin(yaw) * u, omega], dtype=np.float64
    )


def drop_standing(take: Take, wheelbase: float) -> Take:
    """The take without segments in which the car stands still.

    It stands if its position ranges over at most `standing_extent` wheelbases and its yaw over as many rad;
    `wheelbase` is in m.  Every model predicts such segments without error, so that they would make the estimated
    noise too small.
    """
    x, y, yaw = take.pose.T
    at, limit = take.first[:-1], LIKELIHOOD_LIMITS.standing_extent
    if not take.segments:
        return take
    extent = [np.maximum.reduceat(v, at) - np.minimum.reduceat(v, at) for v in (x, y, yaw)]
    moves = (np.hypot(extent[0], extent[1]) > limit * wheelbase) | (extent[2] > limit)
    return take if moves.all() else take.part(np.flatnonzero(moves))


def drop_contacts(take: Take, contacts: Sequence[Contact]) -> Take:
    """The take without the segments during which one of the `contacts` (bumps, crashes in the recording) happens."""
    begin, end = take.begin_s, take.begin_s + SEGMENT_S + take.h
    free = np.ones(take.segments, dtype=bool)
    for contact in contacts:
        free &= (end < contact.begin_s) | (begin > contact.end_s)
    return take if free.all() else take.part(np.flatnonzero(free))


def drop_unknown_beginning(take: Take, T_s: float, d: float, angle_limit: float) -> Take:
    """The take without its first segments, in which the steering angle depends on the unknown one before any command.

    The angle is known once two simulated servos, begun at either lock, +-`angle_limit` (rad), differ by no more than
    `unknown_wheel_angle_rad`; the servo has the time constant `T_s` (s) and the rate limit `d` (rad/s).
    """
    # two servos, one that began at each lock, until they stand at the same angle
    left, right = angle_limit, -angle_limit
    now = max(0.0, float(take.command_s[0]))  # the chain begins with the poses
    ends = np.r_[take.command_s[1:], np.inf]
    for u_s, end in zip(np.clip(take.command[:, 0], -angle_limit, angle_limit), ends, strict=True):
        while now < end and left - right > LIKELIHOOD_LIMITS.unknown_wheel_angle_rad:
            h = min(end - now, KNOT_S)
            left, right, now = steering_step(left, u_s, T_s, d, h), steering_step(right, u_s, T_s, d, h), now + h
    known = take.begin_s >= now - 1e-9
    return take if known.all() else take.part(np.flatnonzero(known))


def concatenate_takes(takes: Sequence[Take]) -> Take:
    """One take of all `takes`, each shifted in time to begin at least 1 s after the one before ends.

    Commands run on from one take to the next, which falsifies steering at the beginning of all but the first: the
    segments there must have been left out by `drop_unknown_beginning`.
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


def as_one_recording(take: Take) -> Take:
    """The take with all its segments counted as one recording: time in effects' equations runs on from 0."""
    return take._replace(
        zero_s=np.zeros(take.segments), length_s=np.full(take.segments, take.T),
        command_zero_s=np.zeros(len(take.command_s)),
    )  # fmt: skip
