"""Training samples: consecutive grid rows of one segment, gathered over several recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.errors import InputRefused
from bcid.estimate.types import Estimate

Floats = npt.NDArray[np.float64]


class Transitions(NamedTuple):
    """N one-step samples k -> k+1; lagged arrays run from the newest row (k) to the oldest (k - lags)."""

    twist: Floats  # (N, lags + 1, 3)
    command: Floats  # (N, lags + 1, 2)
    kinematic: Floats  # (N, 4)
    next_twist: Floats  # (N, 3)
    next_kinematic: Floats  # (N, 4)


def transitions(estimates: Sequence[Estimate], lags: int = 0) -> Transitions:
    """Every one-step sample with `lags` rows before it; none straddles two segments or recordings.

    Raises:
        InputRefused: when no segment is long enough for one sample.
    """
    parts = [_of_segment(e, s, lags) for e in estimates for s in e.segments() if s.stop - s.start > lags + 1]
    if not parts:
        raise InputRefused(
            ", ".join(e.name for e in estimates) or "no recording",
            place="estimate",
            cause=f"no uninterrupted stretch holds {lags + 2} grid rows",
            next_step="use longer takes, or check the gaps listed by `bcid ingest`",
        )
    return Transitions(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _of_segment(e: Estimate, s: slice, lags: int) -> Transitions:
    k = np.arange(s.start + lags, s.stop - 1)
    rows = k[:, None] - np.arange(lags + 1)
    return Transitions(e.twist[rows], e.command[rows], e.kinematic[k], e.twist[k + 1], e.kinematic[k + 1])


def scale(values: Floats) -> Floats:
    """The diagonal of W: 1/sigma of each column (errata 12); a constant column keeps weight 1."""
    sd = values.std(axis=0)
    weights: Floats = 1.0 / np.where(sd > 1e-9, sd, 1.0)
    return weights
