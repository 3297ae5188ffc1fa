"""One time base for the topics of an MCAP file: header stamps for both of them, or log times for both."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.errors import InputRefused
from bcid.recording.formats.limits import MCAP as LIMITS
from bcid.recording.formats.names import list_names, printable_name
from bcid.recording.types import Irregularity
from bcid.vehicle import Topics


class MessageTrack(NamedTuple):
    """The values and times of one topic's messages, in file order; a stamp is None where a message has none."""

    log_ns: list[int]
    stamp_ns: list[int | None]
    values: Floats  # (N, n)
    irregularities: Sequence[Irregularity] = ()
    topic: str = ""


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


def _check_times(track: MessageTrack, stamped: bool, path: Path) -> None:
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
        raise InputRefused(path, f"topic {printable_name(track.topic)}", cause, step)


class CommonTimes(NamedTuple):
    """The times of poses (N,) and of each command topic's messages (M,) in s from the first pose, on one clock."""

    pose_s: Floats
    command_s: list[Floats]
    splits_s: tuple[float, ...]  # pose times at which the clock of the stamps jumps
    irregularities: tuple[Irregularity, ...]


def common_times(pose: MessageTrack, commands: Sequence[MessageTrack], topics: Topics, path: Path) -> CommonTimes:
    """The times in s of pose and command messages on one clock: header stamps where all carry them, or else log times.

    Where stamps come in bursts, as those of arrival do, and log times are even, log times stand; poses that come in
    bursts by either clock are put on an even grid.  Jumps of the stamps' clock are noted as splits.

    Raises:
        InputRefused: times are invalid, or stamps are missing where the vehicle file asks for them.
    """
    tracks, odd = (pose, *commands), list[Irregularity]()
    stamped = not any(None in track.stamp_ns for track in tracks)
    if topics.time == "header" and not stamped:
        cause = "topics.time is header, but a message carries none"
        raise InputRefused(path, "stamps", cause, 'set topics.time = "log"')
    stamped &= topics.time != "log"
    for track in tracks:
        _check_times(track, stamped, path)
    text = ""
    if not stamped:
        text = "log times stand for both streams: a topic has no stamps, or the vehicle file says so"
    elif topics.time == "auto" and (uneven := [t.topic for t in tracks if _only_stamps_burst(t)]):
        text = f"log times stand for both streams: the stamps of {list_names(uneven)} come in bursts, its log times not"
    if text:
        stamped = False
        odd.append(Irregularity("time base", "warning", 1, path.name, text))
    times_ns = [np.array(t.stamp_ns if stamped else t.log_ns, dtype=np.int64) for t in tracks]
    zero = times_ns[0].min()
    pose_s, *command_s = ((ns - zero) / 1e9 for ns in times_ns)
    jumps = _find_clock_jumps(pose_s, np.array(pose.log_ns, dtype=float) / 1e9) if stamped else np.empty(0, dtype=int)
    for k in jumps:
        step_s, logged_step_s = pose_s[k] - pose_s[k - 1], (pose.log_ns[k] - pose.log_ns[k - 1]) / 1e9
        step = f"stamps step by {step_s:.3f} s in {logged_step_s:.3f} s: split there"
        odd.append(Irregularity("clock jump", "excluded", 1, f"{pose_s[k]:.3f} s", step))
    if not len(jumps):
        pose_s, bursts = _even_out_bursts(pose_s, pose.topic)
        odd += bursts
        command_s = [t - pose_s.min() for t in command_s]
        pose_s = pose_s - pose_s.min()
    return CommonTimes(pose_s, command_s, tuple(float(pose_s[k]) for k in jumps), tuple(odd))


def _only_stamps_burst(track: MessageTrack) -> bool:
    """Whether a topic's stamps come in bursts while its log times are valid and do not."""
    stamps, logged = (np.array(ns, dtype=float) / 1e9 for ns in (track.stamp_ns, track.log_ns))
    if _find_invalid_times(1e9 * logged, 1e9 * float(np.ptp(logged))).any():
        return False
    return bool(_crowded_steps(stamps).any()) and not _crowded_steps(logged).any()


def _find_clock_jumps(stamp_s: Floats, logged_s: Floats) -> Ints:
    """Rows at which the clock of the stamps jumps, as seen against the log times.

    The difference of log times and stamps (N,) in s changes there by more than `LIMITS.max_clock_step_s`, and does
    not change back with the next message, as it does for one late message.
    """
    behind, limit = logged_s - stamp_s, LIMITS.max_clock_step_s
    rows = np.flatnonzero(np.abs(np.diff(behind)) > limit) + 1
    stays = np.abs(behind[np.minimum(rows + 1, len(behind) - 1)] - behind[rows - 1]) > limit
    return rows[stays & (np.abs(stamp_s[rows] - stamp_s[rows - 1]) > limit)]


def _crowded_steps(time_s: Floats) -> Bools:
    """The steps (N - 1,) of times (N,) in s that are those of bursts; all False where there are too few of them.

    Times that repeat are no bursts but rounded, and times that step back are not in order.
    """
    step = np.diff(time_s)
    none = np.zeros(len(step), dtype=bool)
    if len(step) < LIMITS.min_burst_steps or (step < 0.0).any():
        return none
    # pauses would outweigh all other steps
    usual = float(np.minimum(step, 2.0 * np.quantile(step, 0.99)).mean())
    crowded = step < LIMITS.crowded_step * usual
    rounded = (step == 0.0).sum() > 0.5 * crowded.sum()
    return none if crowded.mean() < LIMITS.min_crowded_share or rounded else crowded


def _even_out_bursts(time_s: Floats, topic: str) -> tuple[Floats, list[Irregularity]]:
    """Arrival times (N,) in s, put back to when the messages were sent if they come in bursts, with a warning then.

    They are kept where any lies later than `LIMITS.max_late_s`, or where the sending would not have been even.
    """
    crowded = _crowded_steps(time_s)
    if not crowded.any():
        return time_s, []
    even = _sending_times(time_s)
    late = float((time_s - even).max())
    steps = np.diff(even)
    usual = float(np.median(steps))
    is_even = (np.abs(steps - usual) < LIMITS.max_uneven_step * usual).mean() > LIMITS.min_even_share
    text = f"messages arrive in bursts, up to {late:.3f} s late against even sending"
    mended = is_even and late < LIMITS.max_late_s
    text += ": put back to it" if mended else ": times of arrival stand"
    odd = Irregularity("bursts", "warning", int(crowded.sum()), f"topic {printable_name(topic)}", text)
    return (even if mended else time_s), [odd]


def _sending_times(time_s: Floats) -> Floats:
    """The latest times (N,) in s at which messages that arrived at `time_s` (N,) can have been sent at their rate.

    A message arrives late, never early, and is sent a period P before the next: t_k = min over j >= k of the arrival
    t_j - (j - k) P.  Lost messages part the times as they part the arrivals.
    """
    window = min(LIMITS.burst_window, len(time_s) // 2)
    parts = [time_s[k : k + window] for k in range(0, len(time_s) - window + 1, window)]
    # a period too long would shift all of the beginning
    period = (1.0 - LIMITS.period_margin) * float(np.median([_sending_period(part) for part in parts]))
    grid = period * np.arange(len(time_s))
    sent: Floats = grid + np.asarray(np.minimum.accumulate((time_s - grid)[::-1])[::-1], dtype=float)
    return sent


def _sending_period(time_s: Floats) -> float:
    """The period (s) at which messages that arrived at `time_s` (N,) were sent, by those that were held up least.

    It is the slope of the lower convex hull of time over number, at the middle: a straight line below all arrivals.
    """
    hull: list[int] = []
    for k, t in enumerate(time_s):
        while len(hull) > 1:
            i, j = hull[-2:]
            if (time_s[j] - time_s[i]) * (k - i) < (t - time_s[i]) * (j - i):
                break
            hull.pop()
        hull.append(k)
    right = int(np.searchsorted(hull, len(time_s) // 2))
    i, j = hull[max(right - 1, 0)], hull[max(right, 1)]
    return float(time_s[j] - time_s[i]) / (j - i)
