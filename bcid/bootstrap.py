"""The block bootstrap: 95 % intervals of statistics of a recording, from resamples of its blocks (Künsch 1989).

Neighbouring samples are correlated, blocks of a few seconds nearly independent: each resample holds as many blocks as
the recording, drawn with replacement.  Draws are the same at every call, so that figures can be repeated.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats, Ints

RESAMPLES = 999
TAILS = (0.025, 0.975)


def draw_blocks(blocks: int, resamples: int = RESAMPLES, seed: int = 0) -> Ints:
    """Indices (resamples, blocks) of the blocks, out of `blocks` in a recording, that each bootstrap resample draws."""
    return np.random.default_rng(seed).integers(0, blocks, (resamples, blocks))


def draw_block_counts(blocks: int, resamples: int, seed: int) -> Floats:
    """How often each bootstrap resample of `blocks` draws with replacement holds each block: (resamples, blocks)."""
    counts = np.random.default_rng(seed).multinomial(blocks, np.full(blocks, 1.0 / blocks), resamples)
    return np.asarray(counts, dtype=float)


def quantile_interval(statistics: npt.NDArray[Any]) -> Floats:
    """The 2.5 % and 97.5 % quantiles (2, ...) of a statistic's bootstrap values (resamples, ...): its 95 % interval."""
    return np.asarray(np.quantile(statistics, TAILS, axis=0))


def bootstrap_interval(
    blocks: Floats, statistic: Callable[..., Any], resamples: int = RESAMPLES
) -> tuple[float, float]:
    """The 95 % percentile-bootstrap interval of a statistic of block values (B,), such as `np.mean` or `np.median`.

    Draws are those of `draw_blocks`; scipy's quantiles differ from those of `quantile_interval` by rounding only.
    """
    from scipy.stats import bootstrap

    rng = np.random.default_rng(0)
    low, high = bootstrap((blocks,), statistic, n_resamples=resamples, rng=rng, method="percentile").confidence_interval
    return float(low), float(high)
