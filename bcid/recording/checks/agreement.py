"""How much of a motion commands explain at any lag: a regression for each lag at once, by fast Fourier transforms.

y(t) is explained by features f_i(t) g_i(t + lag): f_i stands still, g_i moves with the commands.  The entries of the
normal equations are cross-correlations, sum_t w(t) f_i f_j(t) m g_i g_j(t + lag), so that all lags cost
as much as a few.
The share that the moving features explain beyond the others at the true lag stands out from that at wrong lags, which
is the null that any other take's commands would give: no threshold depends on the kind of car.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from bcid.aliases import Bools, Floats, Ints
from bcid.recording.checks.limits import AGREEMENT as LIMITS

RIDGE = 1e-9  # of the features' squares, so that equal ones are no error


class Feature(NamedTuple):
    """One term of the regression: what stands still times what moves with the commands."""

    still: Floats  # (N,)
    moving: Floats | None  # (N,) or None for one that does not depend on the commands


class LagScan(NamedTuple):
    """What commands explain at each lag, beyond what is explained without them."""

    lags: Ints  # (K,) rows by which the commands are taken later than stamped
    share: Floats  # (K,) of the variation that is left without commands
    left: Floats  # (K,) mean square that is left without commands
    total: Floats  # (K,) mean square of what is explained
    weights: Floats  # (K, n) of the features

    def best(self, low: float, high: float) -> int:
        """The index of the lag of the largest share among lags from `low` to `high` (rows)."""
        inside = np.flatnonzero((self.lags >= low) & (self.lags <= high))
        return int(inside[np.argmax(self.share[inside])])

    def null_share(self, near: float) -> float:
        """What commands of another time explain: the 95 % quantile of the share at lags of more than `near` rows."""
        far = np.abs(self.lags) > near
        return float(np.quantile(self.share[far], 0.95)) if far.sum() >= 20 else 0.0


def scan_lags(y: Floats, use: Bools, features: list[Feature], known: Bools, least_share: float = 0.4) -> LagScan:
    """The share of y (N,) that features explain at every lag at which enough rows are left.

    Args:
        y: what is to be explained, at even times.
        use: rows (N,) of it that count.
        features: terms of the regression; those that do not move are the base that the share counts from.
        known: rows (N,) at which commands are known.
        least_share: of the rows that count, which must be under a command at a lag.
    """
    n, count = len(y), len(features)
    size = next_fast_len(2 * n)
    w, m = use.astype(float), known.astype(float)

    transforms = dict[tuple[int, ...], np.ndarray]()

    def correlate(still: Floats, *moving: int) -> Floats:
        # sum_t still(t) moving(t - lag), for lags -n+1 .. n-1, of the product of moving parts of these features
        key = tuple(i for i in moving if features[i].moving is not None)
        if key not in transforms:
            transforms[key] = np.conj(rfft(math.prod((gs[i] for i in key), start=m), size))
        full = irfft(rfft(still, size) * transforms[key], size)
        return np.asarray(np.r_[full[-(n - 1) :], full[:n]])

    gs = [np.ones(n) if f.moving is None else f.moving for f in features]
    scale_f = [max(float(np.sqrt(np.mean(f.still[use] ** 2))), 1e-12) if use.any() else 1.0 for f in features]
    scale_g = [max(float(np.sqrt(np.mean(g[known] ** 2))), 1e-12) if known.any() else 1.0 for g in gs]
    fs = [w * f.still / a for f, a in zip(features, scale_f, strict=True)]
    gs = [m * g / a for g, a in zip(gs, scale_g, strict=True)]
    rows = correlate(w)
    kept = (rows > least_share * w.sum() + 1.0) & (np.abs(np.arange(-(n - 1), n)) <= LIMITS.max_lags)
    lags = np.arange(-(n - 1), n)[kept]
    gram, cross = np.empty((len(lags), count, count)), np.empty((len(lags), count))
    for i in range(count):
        cross[:, i] = correlate(fs[i] * y, i)[kept]
        for k in range(i, count):
            gram[:, i, k] = gram[:, k, i] = correlate(fs[i] * fs[k], i, k)[kept]
    squares = correlate(w * y * y)[kept]
    base = np.array([f.moving is None for f in features])
    left_base, _ = _residual_squares(gram[:, base][:, :, base], cross[:, base], squares)
    left_all, weights = _residual_squares(gram, cross, squares)
    scale = np.array(scale_f) * np.array(scale_g)
    count_rows = rows[kept]
    return LagScan(
        lags, 1.0 - left_all / np.maximum(left_base, 1e-300), left_base / count_rows, squares / count_rows,
        weights / scale,
    )  # fmt: skip


def _residual_squares(gram: Floats, cross: Floats, squares: Floats) -> tuple[Floats, Floats]:
    """Sums of squares (K,) that least squares leaves, and its weights (K, n), from normal equations of K lags."""
    size = gram.shape[1]
    if size == 0:
        return squares, np.empty((len(squares), 0))
    regular = gram + RIDGE * np.einsum("kii->k", gram)[:, None, None] * np.eye(size) + 1e-12 * np.eye(size)
    weights = np.linalg.solve(regular, cross[:, :, None])[:, :, 0]
    left = squares - 2.0 * np.einsum("ki,ki->k", weights, cross) + np.einsum("ki,kij,kj->k", weights, gram, weights)
    return np.maximum(left, 1e-12 * squares), weights
