"""The normalised mean squared error (paper, lossv; errata 12) and its interval."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats

BLOCK_S = 5.0


class Nmse(NamedTuple):
    """Of v_x, v_y and yaw rate, and their mean with a 95 % block-bootstrap interval."""

    v_x: float
    v_y: float
    yaw_rate: float
    mean: float
    ci95: tuple[float, float]


def nmse(predicted: Floats, measured: Floats, weights: Floats, period_s: float) -> Nmse:
    """||W (q_hat - q)||^2 / (n N) over the rows (N, 3), W = diag(weights)."""
    from scipy.stats import bootstrap

    squares = (weights * (predicted - measured)) ** 2
    channels = squares.mean(axis=0)
    size = max(1, round(BLOCK_S / period_s))
    blocks = np.array([part.mean() for part in np.array_split(squares, max(2, len(squares) // size))])
    found = bootstrap((blocks,), np.mean, n_resamples=1999, rng=np.random.default_rng(0), method="percentile")
    low, high = found.confidence_interval
    v_x, v_y, yaw_rate = channels.tolist()
    return Nmse(v_x, v_y, yaw_rate, float(channels.mean()), (float(low), float(high)))
