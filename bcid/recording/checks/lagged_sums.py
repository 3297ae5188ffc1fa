"""Normal equations of any stretch of a take at many lags, by running sums over short cells of it.

An entry of a cell's equations, sum_t f_i f_k(t) g_i g_k(t - lag) over its rows t, is a cross-correlation: all lags of a
cell cost one fast Fourier transform of its length plus twice the largest lag.
"""

from typing import NamedTuple

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from bcid.aliases import Bools, Floats, Ints
from bcid.recording.checks.agreement import RIDGE, Feature

PIECE_ROWS = 64  # of a cell that one transform takes


class LaggedEquations(NamedTuple):
    """Normal equations of some rows of a take, in arrays that may have leading axes, such as one of L lags."""

    gram: Floats  # (..., n, n)
    cross: Floats  # (..., n)
    square: Floats  # (...) of what is explained
    counted: Floats  # (...) of rows whose command is known

    def take(self, index: Ints) -> "LaggedEquations":
        """The equations at one lag of each stretch: `index` (S,) where the leading axes are S stretches and L lags."""
        return LaggedEquations(*(x[np.arange(len(index)), index] for x in self))

    def plus(self, other: "LaggedEquations") -> "LaggedEquations":
        """The equations of these rows and the other ones together."""
        return LaggedEquations(*(a + b for a, b in zip(self, other, strict=True)))

    def weights(self) -> Floats:
        """The weights (..., n) that explain these rows best."""
        n = self.gram.shape[-1]
        ridge = RIDGE * np.trace(self.gram, axis1=-2, axis2=-1)[..., None, None] + 1e-12
        solved: Floats = np.linalg.solve(self.gram + ridge * np.eye(n), self.cross[..., None])[..., 0]
        return solved

    def left(self, weights: Floats) -> Floats:
        """The mean square (...) that `weights` (..., n) leave; infinite where no row has a command."""
        bent = (self.gram @ weights[..., None])[..., 0]
        explained = (weights * (2.0 * self.cross - bent)).sum(-1)
        left = np.maximum(self.square - explained, 0.0) / np.maximum(self.counted, 1.0)
        return np.where(self.counted > 0, left, np.inf)

    def share(self, weights: Floats) -> Floats:
        """The share (...) that `weights` (..., n) explain of what the first term alone leaves."""
        base = self.square - self.cross[..., 0] ** 2 / np.maximum(self.gram[..., 0, 0], 1e-12)
        left = np.where(self.counted > 0, self.left(weights), 0.0) * self.counted
        return np.asarray(1.0 - left / np.maximum(base, 1e-12))


class LaggedSums:
    """Normal equations of any stretch of a take's cells at all lags, by running sums.

    Attributes: `rows` (K,) of the take that count; `edges` (C + 1,) of the cells among them; `lags` (L,), rows by which
    commands act later than stamped.
    """

    def __init__(self, y: Floats, known: Bools, features: list[Feature], rows: Ints, edges: Ints, reach: int) -> None:
        """The equations that explain `y` by `features` at the `rows`, with commands up to `reach` rows off.

        Args:
            y: what is explained (N,), at even times.
            known: rows (N,) whose command is known.
            features: the n terms; those that move are taken at the row less the lag.
            rows: the K rows that count, in order.
            edges: the C + 1 places in `rows` at which cells begin, and K.
            reach: the largest lag, in rows; the 2 `reach` + 1 lags run from -`reach`.
        """
        n, self.rows, self.edges, self.lags = len(features), rows, edges, np.arange(-reach, reach + 1)
        pieces = _Pieces(rows, edges, reach)
        shape = (len(edges), 2 * reach + 1)
        self.gram, self.cross = np.zeros((*shape, n, n)), np.zeros((*shape, n))
        still = [f.still for f in features]
        moving = [known.astype(float) if f.moving is None else known * f.moving for f in features]
        # counts are whole numbers
        self.counted = np.rint(pieces.correlate(np.ones(len(y)), known.astype(float)))
        # rows without a command have no part in any sum, to the last digit
        under = self.counted > 0.0
        self.square = under * pieces.correlate(y * y, known.astype(float))
        for i in range(n):
            self.cross[1:, :, i] = under * pieces.correlate(still[i] * y, moving[i])
            for k in range(i, n):
                entry = under * pieces.correlate(still[i] * still[k], moving[i] * moving[k])
                self.gram[1:, :, i, k] = self.gram[1:, :, k, i] = entry
        zero = np.zeros((1, shape[1]))
        self.square, self.counted = np.r_[zero, self.square], np.r_[zero, self.counted]
        for sums in (self.gram, self.cross, self.square, self.counted):
            np.cumsum(sums, axis=0, out=sums)

    def between(self, first: Ints, end: Ints, least_covered: float) -> LaggedEquations:
        """The equations (S, L) of S stretches, of the cells from `first` (S,) to before `end` (S,), at all L lags.

        A lag at which less than the share `least_covered` of the rows has a command counts as without any row.
        """
        part = LaggedEquations(*(x[end] - x[first] for x in (self.gram, self.cross, self.square, self.counted)))
        covered = part.counted >= least_covered * (self.edges[end] - self.edges[first])[:, None]
        return part._replace(counted=np.where(covered, part.counted, 0.0))

    def with_growing_lag(self, later: Ints, least_covered: float) -> LaggedEquations:
        """The equations (L,) of the whole take, the commands of each cell `later` (C,) rows later than at each lag.

        A lag at which less than the share `least_covered` of the rows has a command counts as without any row.
        """
        sums = (self.gram, self.cross, self.square, self.counted)
        total = LaggedEquations(*(np.zeros_like(x[0]) for x in sums))
        # neighbours that share a lag are taken together
        first = np.flatnonzero(np.r_[True, np.diff(later) != 0])
        for begin, end in zip(first, np.r_[first[1:], len(later)], strict=True):
            shift = int(later[begin])
            to, source = (slice(max(0, k), len(self.lags) + min(0, k)) for k in (-shift, shift))
            for part, x in zip(total, sums, strict=True):
                part[to] += x[end, source] - x[begin, source]
        covered = total.counted >= least_covered * len(self.rows)
        return total._replace(counted=np.where(covered, total.counted, 0.0))


class _Pieces:
    """The rows of cells in pieces of PIECE_ROWS consecutive rows of the take, each within one cell."""

    def __init__(self, rows: Ints, edges: Ints, reach: int) -> None:
        """The pieces of the `rows` (K,) in cells at `edges` (C + 1,), for lags up to `reach`."""
        cell = np.repeat(np.arange(len(edges) - 1), np.diff(edges))
        behind = rows - rows[edges[:-1]][cell]
        # pieces of a cell without any row are left out
        fresh = np.r_[True, (np.diff(cell) != 0) | (np.diff(behind // PIECE_ROWS) != 0)]
        self.piece = np.cumsum(fresh) - 1
        self.place = behind % PIECE_ROWS
        self.begin = (rows - self.place)[fresh]
        self.first_of_cell = np.flatnonzero(np.r_[True, np.diff(cell[fresh]) != 0])
        self.rows, self.reach = rows, reach
        self.size = next_fast_len(PIECE_ROWS + 2 * reach, real=True)

    def correlate(self, still: Floats, moving: Floats) -> Floats:
        """Sums (C, L) over the rows t of each cell of still(t) moving(t - lag), of two signals (N,), lags ascending."""
        values = np.zeros((len(self.begin), PIECE_ROWS))
        values[self.piece, self.place] = still[self.rows]
        padded = np.pad(moving, (self.reach, self.reach + PIECE_ROWS))
        around = np.lib.stride_tricks.sliding_window_view(padded, PIECE_ROWS + 2 * self.reach)[self.begin]
        product = rfft(around, self.size) * np.conj(rfft(values, self.size))
        by_piece = irfft(product, self.size)[:, 2 * self.reach :: -1]
        return np.asarray(np.add.reduceat(by_piece, self.first_of_cell, axis=0))
