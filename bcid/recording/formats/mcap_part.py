"""The part of an MCAP file that a cut asks for, where the whole holds more messages than are held at once.

Which message belongs to a cut is told by log times, which run from that of the pose topic's first message; whoever cuts
the take looks at the stamps.  That first message is kept whatever the cut, since the cut counts from it.
"""

import math
from pathlib import Path

import numpy as np

from bcid.aliases import Bools, Ints
from bcid.errors import InputRefused
from bcid.recording.formats.raw import TimeCut

EDGE_S = 5.0  # before and after a cut, within which messages are read with it: stamps and log times differ


class TooManyMessages(InputRefused):
    """A file with more messages of the wanted topics than are held at once."""


class LoggedPart:
    """Which messages of a file are kept for a cut, by their log times; it is asked in the order of the file."""

    def __init__(self, cut: TimeCut, hold_s: float) -> None:
        """The messages within `cut`, with the commands that still hold when it begins, `hold_s` (s) old at most."""
        self.cut, self.hold_s = cut, hold_s
        self.first_ns: int | None = None  # log time of the first message on the pose topic
        self.last_ns = 0  # of the last one

    def keep(self, log_ns: Ints, is_pose: Bools) -> Bools:
        """Mask (N,) of the next messages, logged at `log_ns` (N,), that are kept; those `is_pose` hold poses."""
        kept = np.zeros(len(log_ns), dtype=bool)
        if is_pose.any():
            self.last_ns = max(self.last_ns, int(log_ns[is_pose].max()))
            if self.first_ns is None:
                first = int(np.argmax(is_pose))
                self.first_ns, kept[first] = int(log_ns[first]), True
        if self.first_ns is None:
            return np.ones(len(log_ns), dtype=bool)
        # log times are unsigned
        since_s = np.array([ns - self.first_ns for ns in log_ns.tolist()], dtype=float) / 1e9
        kept |= (since_s >= self.cut.begin_s - EDGE_S - self.hold_s) & (since_s <= self.cut.end_s + EDGE_S)
        return kept

    def check_first_pose(self, log_ns: list[int], path: Path) -> None:
        """Raise `InputRefused` unless poses logged at `log_ns` begin with the pose topic's first message, and go on.

        Where the body is first seen in a later message, nothing says from when the cut counts.
        """
        if not log_ns or log_ns[0] != self.first_ns:
            cause = "the body is not in the topic's first message, from which a cut of a file of this size counts"
            raise InputRefused(path, "cut", cause, "cut the recording into takes")
        if len(log_ns) == 1 and self.cut.begin_s > 0.0:
            end = "its end" if math.isinf(self.cut.end_s) else f"{self.cut.end_s:g}"
            lasts_s = (self.last_ns - self.first_ns) / 1e9
            cause = f"no pose lies between {self.cut.begin_s:g} and {end} s: the take lasts {lasts_s:.1f} s"
            raise InputRefused(path, "cut", cause, "cut within the take")
