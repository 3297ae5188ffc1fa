"""Steering and throttle that come on their own: how long each holds."""

from __future__ import annotations

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.recording.checks.samples import is_regular

MOST_SILENCES = 2
"""Silences of a stream that is sent at a rate: as of a node that is away once or twice.  What falls silent more often
is sent only as its value changes."""


def held_too_long(sample_s: Floats, at_s: Floats, hold_s: float) -> Bools:
    """Which of the times `at_s` (K,) in s come more than `hold_s` after the last of the samples (M,) before them.

    None do of a stream that is sent only as its value changes: that value holds.
    """
    silences = int((np.diff(sample_s) > hold_s).sum())
    if len(sample_s) < 2 or silences > MOST_SILENCES or not is_regular(sample_s):
        return np.zeros(len(at_s), dtype=np.bool_)
    last = sample_s[np.maximum(np.searchsorted(sample_s, at_s, side="right") - 1, 0)]
    return np.asarray(at_s - last > hold_s)
