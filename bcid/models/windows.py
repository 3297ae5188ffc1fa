"""Stretches of a take that a model predicts from their start: the samples of the multi-step loss."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.errors import InputRefused
from bcid.estimate.types import Estimate

Floats = npt.NDArray[np.float64]


class Windows(NamedTuple):
    """B stretches of `lags` rows before a start, the start, and the steps after it, oldest row first."""

    twist: Floats  # (B, lags + 1 + steps, 3)
    kinematic: Floats  # (B, lags + 1 + steps, 4)
    command: Floats  # (B, lags + 1 + steps, 2); the last row's is not driven within the stretch

    def __len__(self) -> int:
        return len(self.twist)

    def part(self, rows: npt.NDArray[np.intp] | slice) -> Windows:
        """Some of the stretches."""
        return Windows(*(column[rows] for column in self))


def windows(estimates: Sequence[Estimate], steps: int, every: int, lags: int = 0) -> Windows:
    """Stretches of `steps`, one from each `every`-th row on; none straddles two segments or recordings.

    Raises:
        InputRefused: when no segment is long enough for one.
    """
    parts = [_of_segment(e, s, steps, every, lags) for e in estimates for s in e.segments()]
    parts = [p for p in parts if len(p)]
    if not parts:
        raise InputRefused(
            ", ".join(e.name for e in estimates) or "no recording",
            place="estimate",
            cause=f"no uninterrupted stretch holds {lags + 1 + steps} grid rows",
            next_step="use longer takes, a shorter horizon_s, or check the gaps listed by `bcid ingest`",
        )
    return Windows(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _of_segment(e: Estimate, s: slice, steps: int, every: int, lags: int) -> Windows:
    starts = np.arange(s.start + lags, s.stop - steps, every)
    rows = starts[:, None] + np.arange(-lags, steps + 1)
    return Windows(e.twist[rows], e.kinematic[rows], e.command[rows])
