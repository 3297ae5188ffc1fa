"""Training samples: consecutive grid rows of one segment, gathered over several recordings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.estimate.types import Estimate
from bcid.models.windows import windows

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
    w, newest_first = windows(estimates, 1, 1, lags), slice(lags, None, -1)
    return Transitions(
        w.twist[:, newest_first], w.command[:, newest_first], w.kinematic[:, lags], w.twist[:, -1], w.kinematic[:, -1]
    )


def spread(values: Floats) -> Floats:
    """The standard deviation of each column; of a constant one, 1."""
    sd = values.std(axis=0)
    return np.where(sd > 1e-9, sd, 1.0)


def scale(values: Floats) -> Floats:
    """The diagonal of W: 1/sigma of each column (errata 12); a constant column keeps weight 1."""
    return 1.0 / spread(values)
