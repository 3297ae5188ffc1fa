"""A stream's rows put in order: finite, one a stamp, in strictly increasing time; whatever was done is counted."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.recording.types import Irregularity

MAX_NON_FINITE = 0.05
LARGEST = 1e9  # m or rad: beyond the Earth, or no number at all
LONGEST_S = 1e11  # beyond any clock's zero
MAX_SHARED = 0.2  # of the samples may share a stamp with another one
LATE_SAMPLES = 10  # that arrive out of order; more is a clock that was set back


class Samples(NamedTuple):
    """A stream's samples, and what was odd about them."""

    time_s: Floats
    values: Floats
    odd: list[Irregularity]


def where(time_s: Floats, rows: npt.NDArray[np.bool_]) -> str:
    """From when to when these rows are."""
    hit = time_s[rows]
    first, last = float(np.nanmin(hit)), float(np.nanmax(hit))
    return f"{first:.3f} s" if len(hit) == 1 else f"{first:.3f} to {last:.3f} s"


def _rows(time_s: Floats, rows: npt.NDArray[np.bool_]) -> str:
    """When these rows are, by their number where they have no time."""
    hit = rows & np.isfinite(time_s)
    return where(time_s, hit) if hit.any() else f"row {int(np.argmax(rows)) + 1}"


def cleaned(time_s: Floats, values: Floats, what: str, source: str) -> Samples:
    """Rows with finite cells in strictly increasing time; what was dropped is counted.

    Blank cells are NaN, those that hold no finite number infinite.

    Raises:
        InputRefused: no samples, many that are no numbers, or a clock that steps back.
    """
    odd: list[Irregularity] = []
    if len(time_s) == 0:
        raise InputRefused(source, what, "holds no samples", "record the take again")
    largest = float(np.abs(time_s[np.isfinite(time_s)]).max(initial=0.0))
    if largest > LONGEST_S:
        cause = f"times reach {largest:.3g}: are they in seconds?"
        raise InputRefused(source, f"{what} times", cause, "write or map them in seconds")
    infinite = (np.abs(values) > LARGEST).any(axis=1) | ~np.isfinite(time_s)
    if infinite.mean() > MAX_NON_FINITE:
        raise InputRefused(
            source, what, f"{infinite.mean():.0%} of the rows are not finite numbers", "export the take again"
        )
    blank = ~np.isfinite(values).all(axis=1) & ~infinite
    if infinite.any():
        text = "not finite numbers (nan, inf, or too large)"
        odd.append(Irregularity(f"{what} numbers", "excluded", int(infinite.sum()), _rows(time_s, infinite), text))
    if (blank | infinite).all():
        raise InputRefused(source, what, "holds no finite sample", "export the take again")
    if blank.any():
        text = f"blank samples in {int(np.sum(np.diff(np.r_[0, blank]) == 1))} runs: gaps"
        odd.append(Irregularity(f"{what} dropout", "excluded", int(blank.sum()), where(time_s, blank), text))
    time_s, values = time_s[~blank & ~infinite], values[~blank & ~infinite]
    time_s, values, again = _without_repeats(time_s, values, what)
    odd += again
    if np.any(np.diff(time_s) < 0):
        late = np.r_[False, np.diff(time_s) < 0]
        _check_overlap(time_s, late, what, source)
        order = np.argsort(time_s, kind="stable")
        odd.append(
            Irregularity(
                f"{what} order", "fixed", int(late.sum()), where(time_s, late), "samples put in the order of time"
            )
        )
        time_s, values = time_s[order], values[order]
    time_s, values, duplicates = _without_contradictions(time_s, values, what, source)
    return Samples(time_s, values, odd + duplicates)


def _check_overlap(time_s: Floats, late: npt.NDArray[np.bool_], what: str, source: str) -> None:
    """Raise `InputRefused` where the clock steps back: two stretches of the same times cannot be put in order."""
    step = float(np.median(np.abs(np.diff(time_s))))
    far = np.r_[0.0, -np.diff(time_s)] > 0.5 * LATE_SAMPLES * step
    for row in np.flatnonzero(late & far):
        again = int((time_s[:row] > time_s[row]).sum())
        ahead = int((time_s[row:] < time_s[row - 1]).sum())
        if min(again, ahead) > LATE_SAMPLES:
            back = time_s[row - 1] - time_s[row]
            cause = f"the clock steps back by {back:.3f} s at {time_s[row - 1]:.3f} s: {again} samples have times twice"
            raise InputRefused(source, f"{what} times", cause, "cut the recording there, or use the other time base")


def _without_contradictions(
    time_s: Floats, values: Floats, what: str, source: str
) -> tuple[Floats, Floats, list[Irregularity]]:
    """Without rows that share a stamp: they say different things, and none can be chosen."""
    _, inverse, counts = np.unique(time_s, return_inverse=True, return_counts=True)
    contradicting = counts[inverse] > 1
    if not contradicting.any():
        return time_s, values, []
    if contradicting.mean() > MAX_SHARED:
        cause = f"{contradicting.mean():.0%} of the samples share a stamp with another: are the stamps rounded?"
        raise InputRefused(source, f"{what} times", cause, "log them with more digits, or use the other time base")
    text = "same stamp, other value: all dropped"
    odd = Irregularity(f"{what} duplicate", "excluded", int(contradicting.sum()), where(time_s, contradicting), text)
    return time_s[~contradicting], values[~contradicting], [odd]


def _without_repeats(time_s: Floats, values: Floats, what: str) -> tuple[Floats, Floats, list[Irregularity]]:
    """Without rows that were there before, to the last digit, wherever they stand."""
    _, first = np.unique(np.column_stack([time_s, values]), axis=0, return_index=True)
    if len(first) == len(time_s):
        return time_s, values, []
    again = np.ones(len(time_s), dtype=bool)
    again[first] = False
    odd = Irregularity(
        f"{what} duplicate", "fixed", int(again.sum()), where(time_s, again), "same stamp, same value: once"
    )
    return time_s[~again], values[~again], [odd]
