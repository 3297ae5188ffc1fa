"""The covariance of a least-squares fit whose residuals are alike for a while (the sandwich of White, 1980).

Slopes of blocks of neighbouring residuals are taken as independent, not residuals: smoothed velocities are alike over
seconds, and what a model lacks longer than that.
"""

from __future__ import annotations

import numpy as np

from bcid.aliases import Floats

TWO_SIDED = 1.96  # standard errors to either side of a 95 % interval


def blocks_of(each: Floats, block: int) -> Floats:
    """Sums (B, n) over so many neighbouring rows of `each` (N, n)."""
    return np.asarray(np.add.reduceat(each, np.arange(0, len(each), block)))


def covariance(J: Floats, blocks: Floats) -> Floats:
    """Of the parameters (n, n): `J` (N, n) of all residuals r, `blocks` (B, n) the sums of J r over each block."""
    bread = np.linalg.pinv(J.T @ J)
    return np.asarray(bread @ (blocks.T @ blocks) @ bread * len(blocks) / max(len(blocks) - 1, 1))
