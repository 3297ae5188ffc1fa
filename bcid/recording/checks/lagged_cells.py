"""What explains the turning of any part of a take with commands at any lag: normal equations, added up cell by cell."""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.recording.checks.agreement import RIDGE, Feature
from bcid.recording.checks.commanded_motion import GRID_HZ, CommandedMotion
from bcid.recording.checks.limits import CLOCK_JUMP as LIMITS
from bcid.recording.checks.turning_terms import OTHER_SIGN, terms_at


class LaggedEquations(NamedTuple):
    """Normal equations of some rows, at one lag or with a leading axis of L lags."""

    gram: Floats  # (..., n, n)
    cross: Floats  # (..., n)
    square: Floats  # (...) of what is explained
    counted: Floats  # (...) of rows whose command is known

    def at(self, k: int) -> "LaggedEquations":
        """The equations at the lag of index `k`."""
        return LaggedEquations(*(np.asarray(x[k]) for x in self))

    def plus(self, other: "LaggedEquations") -> "LaggedEquations":
        """The equations of these rows and the other ones together."""
        return LaggedEquations(*(a + b for a, b in zip(self, other, strict=True)))

    def steered_the_other_way(self) -> "LaggedEquations":
        """The equations of commands with the other steering sign: the terms odd in the angle change theirs."""
        return self._replace(gram=self.gram * np.outer(OTHER_SIGN, OTHER_SIGN), cross=self.cross * OTHER_SIGN)

    def weights(self) -> Floats:
        """The weights (..., n) that explain these rows best."""
        n = self.gram.shape[-1]
        ridge = RIDGE * np.trace(self.gram, axis1=-2, axis2=-1)[..., None, None] + 1e-12
        solved: Floats = np.linalg.solve(self.gram + ridge * np.eye(n), self.cross[..., None])[..., 0]
        return solved

    def left(self, weights: Floats) -> Floats:
        """The mean square (...) that `weights` (..., n) leave; infinite where no row has a command."""
        explained = 2.0 * (weights * self.cross).sum(-1) - np.einsum("...i,...ij,...j", weights, self.gram, weights)
        left = np.maximum(self.square - explained, 0.0) / np.maximum(self.counted, 1.0)
        return np.where(self.counted > 0, left, np.inf)

    def share(self, weights: Floats) -> float:
        """The share that `weights` (n,) explain of what the first term alone leaves."""
        base = self.square - self.cross[0] ** 2 / max(float(self.gram[0, 0]), 1e-12)
        return 1.0 - float(self.left(weights) * self.counted / np.maximum(base, 1e-12))


class LaggedCells:
    """Normal equations of any stretch of a take's cells at all lags, by running sums.

    Attributes: `rows` (K,) at GRID_HZ that count; `edges` (cells + 1,) of the cells among them, which end at gaps;
    `lags` (L,), rows by which commands act later than stamped.
    """

    def __init__(self, motion: CommandedMotion, features: list[Feature]) -> None:
        """The cells of a take's turning, which `features` explain, at lags of up to `CLOCK_JUMP.max_lag_s`."""
        reach = round(LIMITS.max_lag_s * GRID_HZ)
        self.rows, self.lags = np.flatnonzero(motion.use), np.arange(-reach, reach + 1)
        rows, lags = self.rows, self.lags
        gaps = np.flatnonzero(np.diff(rows) > LIMITS.gap_s * GRID_HZ) + 1
        edges = np.union1d(np.arange(0, len(rows), round(LIMITS.cell_s * GRID_HZ)), gaps)
        self.edges, y, n = np.r_[edges, len(rows)], motion.turn[rows], len(features)
        shape = (len(lags), len(edges) + 1)
        self.gram, self.cross, self.square, self.counted = (
            np.zeros(shape + size) for size in ((n, n), (n,), (), ())
        )  # fmt: skip
        for k, lag in enumerate(lags):
            X, under = terms_at(features, motion.known, rows, int(lag))
            w = under.astype(float)
            for sums, products in (
                (self.gram, X[:, :, None] * X[:, None, :]), (self.cross, X * y[:, None]), (self.square, w * y * y),
                (self.counted, w),
            ):  # fmt: skip
                sums[k, 1:] = np.cumsum(np.add.reduceat(products, edges, axis=0), axis=0)

    @property
    def count(self) -> int:
        """The number of cells."""
        return len(self.edges) - 1

    def middle_s(self, motion: CommandedMotion) -> Floats:
        """The time (cells,) in s of the middle of each cell."""
        return np.asarray(motion.time_s[self.rows[(self.edges[:-1] + self.edges[1:] - 1) // 2]])

    def between(self, first: int, end: int) -> LaggedEquations:
        """The equations at all lags of the cells from `first` to before `end`, uncovered lags without any row."""
        part = LaggedEquations(*(x[:, end] - x[:, first] for x in (self.gram, self.cross, self.square, self.counted)))
        covered = part.counted >= LIMITS.least_covered * (self.edges[end] - self.edges[first])
        return part._replace(counted=np.where(covered, part.counted, 0.0))

    def at_lags(self, later: Ints) -> LaggedEquations:
        """The equations of all cells together at all lags, each cell's commands `later` (cells,) rows later than that.

        Lags at which too few rows are under a command have no row.
        """
        total = LaggedEquations(*(np.zeros_like(x[:, 0]) for x in (self.gram, self.cross, self.square, self.counted)))
        for shift in np.unique(later):
            cells = np.flatnonzero(later == shift)
            to = slice(max(0, -shift), len(self.lags) - max(0, shift))
            source = slice(max(0, shift), len(self.lags) + min(0, shift))
            for sums, x in zip(total, (self.gram, self.cross, self.square, self.counted), strict=True):
                sums[to] += (x[source][:, cells + 1] - x[source][:, cells]).sum(axis=1)
        covered = total.counted >= LIMITS.least_covered * len(self.rows)
        return total._replace(counted=np.where(covered, total.counted, 0.0))
