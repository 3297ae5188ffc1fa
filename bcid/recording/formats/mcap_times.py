"""One time base for the topics of an MCAP file: header stamps for all of them, or log times for all."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.recording.types import Irregularity
from bcid.vehicle import Topics

LAST_STAMP = float(1 << 62)  # ns: a century beyond
UNUSED_NS = 1e10  # a clock that starts at zero comes to other stamps within seconds
CLOCK_STEP_S = 0.1  # of stamps against log times, between two messages
BURST, BURST_SHARE = 0.2, 0.1  # of the mean step; of the steps
GAP = 1.5  # times as long as nearly all steps
EVEN_S = 0.1  # how far an even grid may lie off the times of arrival


class Track(NamedTuple):
    """The messages of one topic, in file order."""

    log_ns: list[int]
    stamp_ns: list[int | None]
    values: Floats  # (N, n)
    odd: Sequence[Irregularity] = ()


def _no_times(ns: Floats, lasts_ns: float) -> npt.NDArray[np.bool_]:
    """Which of a topic's times are none: negative, beyond all, all the same, or zero among others."""
    wrong = (ns < 0.0) | (ns >= LAST_STAMP)
    if len(ns) > 1 and np.ptp(ns) == 0.0:
        wrong[:] = True
    later = ns[~wrong & (ns > 0.0)]
    if len(later) and later.min() > lasts_ns + UNUSED_NS:
        wrong |= ns == 0.0
    return wrong


def _check_stamps(track: Track, topic: str, path: Path) -> None:
    """Raise `InputRefused` where header stamps are no times."""
    stamps = np.array([float(s) for s in track.stamp_ns if s is not None])
    first, last = min(track.log_ns), max(track.log_ns)
    wrong = _no_times(stamps, last - first)
    if wrong.any():
        raise InputRefused(
            path, f"topic {topic}", f"{wrong.sum()} of {len(stamps)} stamps are no times ({stamps[wrong][0]:.0f} ns; "
            f"logged {first / 1e9:.3f} to {last / 1e9:.3f} s)", 'correct the stamps, or set topics.time = "log"',
        )  # fmt: skip


def _check_logged(track: Track, topic: str, path: Path) -> None:
    """Raise `InputRefused` where log times, which stand for stamps, are no times."""
    logged = np.array(track.log_ns, dtype=float)
    usual = np.quantile(logged, [0.1, 0.9])  # whatever a few of them are
    wrong = _no_times(logged, usual[1] - usual[0])
    if wrong.any():
        k = int(np.argmax(wrong))
        cause = f"{wrong.sum()} of {len(logged)} log times are no times (message {k + 1}: {track.log_ns[k]} ns)"
        raise InputRefused(path, f"topic {topic}", cause, "record again, or stamp the messages in their headers")


class Times(NamedTuple):
    """Both streams in seconds from the first pose."""

    pose_s: Floats
    command_s: Floats
    splits_s: tuple[float, ...]  # the pose clock steps there
    odd: tuple[Irregularity, ...]


def common_times(pose: Track, command: Track, topics: Topics, path: Path) -> Times:
    """Header stamps for both topics or log times for both, and what was odd about them.

    Raises:
        InputRefused: stamps that are none, or missing where the vehicle file names them.
    """
    stamped = all(s is not None for s in (*pose.stamp_ns, *command.stamp_ns))
    if topics.time == "header" and not stamped:
        cause = "topics.time is header, but a message carries none"
        raise InputRefused(path, "stamps", cause, 'set topics.time = "log"')
    if stamped and topics.time != "log":
        return _of_stamps(pose, command, topics, path)
    for track, topic in ((pose, topics.pose), (command, topics.command)):
        _check_logged(track, topic, path)
    pose_ns, command_ns = (np.array(t.log_ns, dtype=np.int64) for t in (pose, command))
    zero = pose_ns.min()
    text = "log times stand for both streams: a topic has no stamps, or the vehicle file says so"
    odd = [Irregularity("time base", "warning", 1, path.name, text)]
    pose_s, bursts = _evened((pose_ns - zero) / 1e9, topics.pose)
    return Times(pose_s, (command_ns - zero) / 1e9, (), (*odd, *bursts))


def _of_stamps(pose: Track, command: Track, topics: Topics, path: Path) -> Times:
    for track, topic in ((pose, topics.pose), (command, topics.command)):
        _check_stamps(track, topic, path)
    pose_ns, command_ns = (np.array(t.stamp_ns, dtype=np.int64) for t in (pose, command))
    zero = pose_ns.min()
    pose_s, logged_s = (pose_ns - zero) / 1e9, np.array(pose.log_ns, dtype=float) / 1e9
    rows = _clock_jumps(pose_s, logged_s)
    odd = [
        Irregularity(
            "clock jump", "excluded", 1, f"{pose_s[k]:.3f} s",
            f"stamps step by {pose_s[k] - pose_s[k - 1]:.3f} s in {logged_s[k] - logged_s[k - 1]:.3f} s: split there",
        )
        for k in rows
    ]  # fmt: skip
    return Times(pose_s, (command_ns - zero) / 1e9, tuple(float(pose_s[k]) for k in rows), tuple(odd))


def _clock_jumps(stamp_s: Floats, logged_s: Floats) -> list[int]:
    """Rows before which the stamps, not their arrival, step, and stay stepped: a late message comes back."""
    behind = logged_s - stamp_s
    steps = [int(k) + 1 for k in np.flatnonzero(np.abs(np.diff(behind)) > CLOCK_STEP_S)]
    return [
        k for k in steps
        if abs(stamp_s[k] - stamp_s[k - 1]) > CLOCK_STEP_S
        and abs(behind[min(k + 1, len(behind) - 1)] - behind[k - 1]) > CLOCK_STEP_S
    ]  # fmt: skip


def _evened(time_s: Floats, topic: str) -> tuple[Floats, list[Irregularity]]:
    """Times of arrival, put on an even grid where they come in bursts and an even grid lies close to them.

    A grid of its own for each part between gaps.
    """
    if len(time_s) < 3:
        return time_s, []
    step = np.diff(time_s)
    crowded = step < BURST * step.mean()
    if crowded.mean() < BURST_SHARE:
        return time_s, []
    even = time_s.copy()
    gaps = np.flatnonzero(step > GAP * np.quantile(step, 0.99)) + 1
    for part in np.split(np.arange(len(time_s)), gaps):
        if len(part) > 2:
            slope, start = np.polyfit(part, time_s[part], 1)
            even[part] = start + slope * part
    off = float(np.abs(even - time_s).max())
    close = off < EVEN_S and bool((np.diff(even) > 0.0).all())
    text = f"messages arrive in bursts, up to {off:.3f} s off an even grid"
    text += ": put on it" if close else ": times of arrival stand"
    odd = Irregularity("bursts", "warning", int(crowded.sum()), f"topic {topic}", text)
    return (even if close else time_s), [odd]
