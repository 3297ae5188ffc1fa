"""Poses of a body that was not seen, which some trackers write as zeros or as a number such as -9999."""

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.recording.checks.rowwise import in_all_columns, in_any_column, lengths_of_rows
from bcid.recording.checks.samples import Samples, note_rows
from bcid.recording.limits import LOST as LIMITS
from bcid.recording.types import Irregularity

SHOWN_NUMBERS = 3  # of a placeholder, in a message


def find_lost_poses(positions: Floats, orientations: Floats) -> Bools:
    """Mask (N,) of rows that hold a placeholder instead of a pose, by positions (N, p) and orientations (N, q).

    A placeholder is a row to which the body jumps and from which it jumps back, and which is written for no body: all
    zero but for a quaternion's 1, one number throughout, or to the last digit what stands in several places.  A body
    that moves, or noise, never gives the same row twice.
    """
    finite = in_all_columns(np.isfinite(positions)) & in_all_columns(np.isfinite(orientations))
    known, lost = np.flatnonzero(finite), np.zeros(len(finite), dtype=bool)
    if len(known) < LIMITS.min_rows:
        return lost
    every, at = np.column_stack([positions, orientations])[known], positions.shape[1]
    starts = np.flatnonzero(np.r_[True, in_any_column(every[1:] != every[:-1])])
    ends = np.r_[starts[1:], len(known)]
    jumps = _find_far_steps(every[:, :at]) | _find_far_steps(every[:, at:])
    # the ends of the recording count as jumps, but a run needs one inside
    into, out = np.r_[True, jumps][starts], np.r_[jumps, True][ends - 1]
    runs = np.flatnonzero(into & out & ((starts > 0) | (ends < len(known))))
    if not len(runs):
        return lost
    written = every[starts]
    held = written[runs]
    no_place = (held[:, :at] == 0.0).all(axis=1) & np.isin(held, (0.0, 1.0)).all(axis=1)
    no_place |= (held == held[:, :1]).all(axis=1)
    # only rows that agree in the first number can be the same
    like = np.flatnonzero(np.isin(written[:, 0], held[:, 0]))
    _, row_id, times = np.unique(written[like], axis=0, return_inverse=True, return_counts=True)
    again = times[row_id[np.searchsorted(like, runs)]] > 1
    for i in runs[no_place | again]:
        lost[known[starts[i] : ends[i]]] = True
    return lost


def _find_far_steps(values: Floats) -> Bools:
    """Mask (N - 1,) of steps between successive values (N, n) that are far above the usual step of what moves."""
    # numbers near the largest are no measurements, and are left out elsewhere
    with np.errstate(over="ignore"):
        step = lengths_of_rows(np.diff(values, axis=0))
    moving = step[step > 0.0]
    return np.asarray(step > LIMITS.step_factor * (float(np.median(moving)) if len(moving) else 0.0))


def note_lost_poses(time_s: Floats, rows: Bools, values: Floats) -> list[Irregularity]:
    """One irregularity that counts the lost poses marked in `rows` (N,) and shows what is written there; or []."""
    if not rows.any():
        return []
    shown = ", ".join(f"{v:g}" for v in values[int(np.argmax(rows))][:SHOWN_NUMBERS])
    return note_rows(time_s, rows, "lost pose", "excluded", f"written as {shown} where the body was not seen")


def drop_lost_poses(poses: Samples) -> Samples:
    """The poses x, y, yaw (N, 3) without placeholders of a body that was not seen."""
    rows = find_lost_poses(poses.values[:, :2], poses.values[:, 2:])
    noted = [*poses.irregularities, *note_lost_poses(poses.time_s, rows, poses.values)]
    return Samples(poses.time_s[~rows], poses.values[~rows], noted)
