"""One time base for the topics of an MCAP file: header stamps for both of them, or log times for both."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.errors import InputRefused
from bcid.recording.limits import MCAP as LIMITS
from bcid.recording.types import Irregularity
from bcid.vehicle import Topics


class MessageTrack(NamedTuple):
    """The values and times of one topic's messages, in file order; a stamp is None where a message has none."""

    log_ns: list[int]
    stamp_ns: list[int | None]
    values: Floats  # (N, n)
    irregularities: Sequence[Irregularity] = ()


def _find_invalid_times(ns: Floats, duration_ns: float) -> Bools:
    """Which of a topic's times (N,) in ns are invalid: negative, far in the future, all the same, or an unset zero.

    A zero is unset where all later times exceed the duration plus `LIMITS.min_unused_stamp_ns`.
    """
    wrong = (ns < 0.0) | (ns >= LIMITS.max_stamp_ns)
    if len(ns) > 1 and np.ptp(ns) == 0.0:
        wrong[:] = True
    later = ns[~wrong & (ns > 0.0)]
    if len(later) and later.min() > duration_ns + LIMITS.min_unused_stamp_ns:
        wrong |= ns == 0.0
    return wrong


def _check_times(track: MessageTrack, stamped: bool, topic: str, path: Path) -> None:
    """Raise `InputRefused` where a topic's stamps (if `stamped`, else log times) are negative, unset or all alike."""
    if stamped:
        times = np.array([float(s) for s in track.stamp_ns if s is not None])
        first, last = min(track.log_ns), max(track.log_ns)
        kind, step = "stamps", 'correct the stamps, or set topics.time = "log"'
    else:
        times = np.array(track.log_ns, dtype=float)
        # whatever a few of them are
        first, last = np.quantile(times, [0.1, 0.9])
        kind, step = "log times", "record again, or stamp the messages in their headers"
    wrong = _find_invalid_times(times, last - first)
    if wrong.any():
        k = int(np.argmax(wrong))
        example = f"message {k + 1}: {track.log_ns[k]} ns"
        if stamped:
            example = f"{times[k]:.0f} ns; logged {first / 1e9:.3f} to {last / 1e9:.3f} s"
        cause = f"{wrong.sum()} of {len(times)} {kind} are no times ({example})"
        raise InputRefused(path, f"topic {topic}", cause, step)


class CommonTimes(NamedTuple):
    """The times of poses (N,) and of commands (M,) in s from the first pose, on one clock."""

    pose_s: Floats
    command_s: Floats
    splits_s: tuple[float, ...]  # pose times at which the clock of the stamps jumps
    irregularities: tuple[Irregularity, ...]


def common_times(pose: MessageTrack, command: MessageTrack, topics: Topics, path: Path) -> CommonTimes:
    """The times in s of pose and command messages on one clock: header stamps where all carry them, or else log times.

    Jumps of the stamps' clock are noted as splits; log times that come in bursts are evened out.

    Raises:
        InputRefused: times are invalid, or stamps are missing where the vehicle file asks for them.
    """
    stamped = all(s is not None for s in (*pose.stamp_ns, *command.stamp_ns))
    if topics.time == "header" and not stamped:
        cause = "topics.time is header, but a message carries none"
        raise InputRefused(path, "stamps", cause, 'set topics.time = "log"')
    stamped &= topics.time != "log"
    for track, topic in ((pose, topics.pose), (command, topics.command)):
        _check_times(track, stamped, topic, path)
    pose_ns, command_ns = (np.array(t.stamp_ns if stamped else t.log_ns, dtype=np.int64) for t in (pose, command))
    zero = pose_ns.min()
    pose_s, command_s = (pose_ns - zero) / 1e9, (command_ns - zero) / 1e9
    if not stamped:
        text = "log times stand for both streams: a topic has no stamps, or the vehicle file says so"
        pose_s, bursts = _even_out_bursts(pose_s, topics.pose)
        return CommonTimes(pose_s, command_s, (), (Irregularity("time base", "warning", 1, path.name, text), *bursts))
    logged_s, odd = np.array(pose.log_ns, dtype=float) / 1e9, []
    rows = _find_clock_jumps(pose_s, logged_s)
    for k in rows:
        step_s, logged_step_s = pose_s[k] - pose_s[k - 1], logged_s[k] - logged_s[k - 1]
        text = f"stamps step by {step_s:.3f} s in {logged_step_s:.3f} s: split there"
        odd.append(Irregularity("clock jump", "excluded", 1, f"{pose_s[k]:.3f} s", text))
    return CommonTimes(pose_s, command_s, tuple(float(pose_s[k]) for k in rows), tuple(odd))


def _find_clock_jumps(stamp_s: Floats, logged_s: Floats) -> Ints:
    """Rows at which the clock of the stamps jumps, as seen against the log times.

    The difference of log times and stamps (N,) in s changes there by more than `LIMITS.max_clock_step_s`, and does
    not change back with the next message, as it does for one late message.
    """
    behind, limit = logged_s - stamp_s, LIMITS.max_clock_step_s
    rows = np.flatnonzero(np.abs(np.diff(behind)) > limit) + 1
    stays = np.abs(behind[np.minimum(rows + 1, len(behind) - 1)] - behind[rows - 1]) > limit
    return rows[stays & (np.abs(stamp_s[rows] - stamp_s[rows - 1]) > limit)]


def _even_out_bursts(time_s: Floats, topic: str) -> tuple[Floats, list[Irregularity]]:
    """Arrival times (N,) in s, put on an even grid between gaps if messages come in bursts, with a warning then.

    The grid is a straight line of time over message number, by least squares.  Times are kept where any lies further
    than `LIMITS.max_grid_error_s` from the grid.
    """
    if len(time_s) < 3:
        return time_s, []
    step = np.diff(time_s)
    crowded = step < LIMITS.crowded_step * step.mean()
    if crowded.mean() < LIMITS.min_crowded_share:
        return time_s, []
    even = time_s.copy()
    gaps = np.flatnonzero(step > LIMITS.burst_gap_factor * np.quantile(step, 0.99)) + 1
    for part in np.split(np.arange(len(time_s)), gaps):
        if len(part) > 2:
            slope, start = np.polyfit(part, time_s[part], 1)
            even[part] = start + slope * part
    off = float(np.abs(even - time_s).max())
    close = off < LIMITS.max_grid_error_s and bool((np.diff(even) > 0.0).all())
    text = f"messages arrive in bursts, up to {off:.3f} s off an even grid"
    text += ": put on it" if close else ": times of arrival stand"
    odd = Irregularity("bursts", "warning", int(crowded.sum()), f"topic {topic}", text)
    return (even if close else time_s), [odd]
