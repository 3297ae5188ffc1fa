"""Which stretch of a drive is shown as predicted paths: where the findings help most, with the gain in numbers."""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.report.canvas import Columns

STRETCH_S = 20.0
"""Length (s) of the stretch whose paths are drawn."""


class PathStretch(NamedTuple):
    """The rows of the tracks that are drawn, and what the picture says of them."""

    rows: Ints
    title: str
    caption: str


def choose_stretch(tracks: Columns) -> PathStretch:
    """The STRETCH_S seconds in which the findings help most; where nothing was found, those that are predicted worst.

    `tracks` are columns (K,) of measured and predicted positions (m); help is the fall of the sum of squared misses.
    """
    before, after = (_squared_miss(tracks, stage) for stage in ("before", "after"))
    changed = not np.allclose(before, after, equal_nan=True)
    rows = _rows_of_largest_sum(tracks, before - after if changed else before)
    begin, end = tracks["time_s"][rows][[0, -1]]
    where = f"The {end - begin:.0f} s from {begin:.0f} s on"
    again = "predictions start anew from the measured state every 2 s (crosses). Held-out throughout."
    if not changed:
        caption = f"{where}, where the base model misses most; {again}"
        return PathStretch(rows, "Predicted paths where the base model is worst", caption)
    (here_before, here_after), (all_before, all_after) = (
        [f"{100.0 * np.sqrt(np.nanmean(square[part])):.2g}" for square in (before, after)]
        for part in (rows, slice(None))
    )
    caption = (
        f"{where}, where what was found helps most: the miss (RMS) falls from {here_before} to {here_after} cm, in the "
        f"whole recording from {all_before} to {all_after} cm; {again}"
    )
    return PathStretch(rows, "Predicted paths where what was found helps most", caption)


def _squared_miss(tracks: Columns, stage: str) -> Floats:
    """Squared distances (K,) of predicted from measured positions, of the stage "before" or "after"."""
    return np.asarray((tracks[f"{stage}_x"] - tracks["x"]) ** 2 + (tracks[f"{stage}_y"] - tracks["y"]) ** 2)


def _rows_of_largest_sum(tracks: Columns, values: Floats) -> Ints:
    """Rows of the STRETCH_S seconds, from a restart on, with the largest sum of the `values` (K,)."""
    time = tracks["time_s"]
    total = np.r_[0.0, np.cumsum(np.nan_to_num(values))]
    starts = np.flatnonzero(tracks["start"] > 0.5)
    starts = starts if len(starts) else np.array([0])
    ends = np.searchsorted(time, time[starts] + STRETCH_S)
    best = int(np.argmax(total[ends] - total[starts]))
    return np.arange(starts[best], ends[best])
