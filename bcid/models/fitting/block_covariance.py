"""The covariance of a least-squares fit whose residuals are correlated for a while (the sandwich of White, 1980).

Not residuals but sums of their slopes over blocks of neighbours count as independent: smoothed velocities are
correlated over seconds, and what a model lacks for longer still.
"""

import numpy as np

from bcid.aliases import Floats

# Length of a block (s): residuals within one are correlated, those of different blocks count as independent.
BLOCK_S = 5.0
# Standard errors to either side of a 95 % interval.
Z_95 = 1.96


def sum_blocks(rows: Floats, block_length: int) -> Floats:
    """Sums (B, n) of the rows (N, n) over blocks of `block_length` consecutive rows; the last block may be shorter."""
    return np.asarray(np.add.reduceat(rows, np.arange(0, len(rows), block_length)))


def sandwich_covariance(J: Floats, block_gradients: Floats) -> Floats:
    """Cluster-robust (sandwich) covariance (n, n) of least-squares parameters, residuals r correlated within blocks.

    (J^T J)^-1 (sum of g g^T over B blocks) (J^T J)^-1 B / (B - 1) (White, 1980), with the Jacobian `J` (N, n) of all
    residuals; row b of `block_gradients` (B, n) is g = J_b^T r_b over the rows of block b.
    """
    bread = np.linalg.pinv(J.T @ J)
    return np.asarray(
        bread @ (block_gradients.T @ block_gradients) @ bread * len(block_gradients) / max(len(block_gradients) - 1, 1)
    )
