"""Whether a clock jumped within a take: commands that fit the motion before a time at one lag, after it at another.

The turning y is explained in both parts by one map of the commands, sum_i w_i f_i(t) g_i(t - lag), at the lag of each
part.  A jump is told where two lags leave far less than any single one, and less than a change of the steering's sign
at one lag: where laps come round again, the commands of half a lap later look like those with the other sign.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.recording.checks.agreement import RIDGE, Feature
from bcid.recording.checks.commanded_motion import GRID_HZ, CommandedMotion
from bcid.recording.checks.limits import CLOCK_JUMP as LIMITS
from bcid.recording.checks.turning_terms import OTHER_SIGN, terms_at, turns_leftward

JUMP = "clock jump"
"""The kind of the irregularity."""


class ClockJump(NamedTuple):
    """Two times, between which a clock jumps: commands fit the motion before them at one lag, and after at another."""

    from_s: float
    to_s: float
    before_s: float  # by which commands act later than stamped
    after_s: float

    @property
    def size_s(self) -> float:
        """By how much later (s) than before, against their stamps, commands act after the jump."""
        return self.after_s - self.before_s

    def describe(self) -> str:
        """What happened to the clocks, and what mends it."""
        way = "earlier" if self.size_s > 0.0 else "later"
        return (
            f"one of the clocks jumps between {self.from_s:.0f} and {self.to_s:.0f} s, or samples are missing there: "
            f"from then on the commands come {abs(self.size_s):.1f} s {way}; cut the take there"
        )


class _Normal(NamedTuple):
    """Normal equations of some rows, at one lag or with a leading axis of L lags."""

    gram: Floats  # (..., n, n)
    cross: Floats  # (..., n)
    square: Floats  # (...) of what is explained
    counted: Floats  # (...) of rows whose command is known

    def at(self, k: int) -> "_Normal":
        """The equations at the lag of index `k`."""
        return _Normal(*(np.asarray(x[k]) for x in self))

    def plus(self, other: "_Normal") -> "_Normal":
        """The equations of these rows and the other ones together."""
        return _Normal(*(a + b for a, b in zip(self, other, strict=True)))

    def steered_the_other_way(self) -> "_Normal":
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


class _Parts:
    """Normal equations of any stretch of a take's cells at all lags, by running sums."""

    def __init__(self, motion: CommandedMotion, features: list[Feature], rows: Ints, lags: Ints) -> None:
        """The `rows` (K,) that count, in cells that end at gaps, with commands `lags` (L,) rows later than stamped."""
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

    def between(self, first: int, end: int) -> _Normal:
        """The equations at all lags of the cells from `first` to before `end`, uncovered lags without any row."""
        part = _Normal(*(x[:, end] - x[:, first] for x in (self.gram, self.cross, self.square, self.counted)))
        covered = part.counted >= LIMITS.least_covered * (self.edges[end] - self.edges[first])
        return part._replace(counted=np.where(covered, part.counted, 0.0))


def find_clock_jump(motion: CommandedMotion, features: list[Feature]) -> ClockJump | None:
    """The jump of one clock against the other that the turning shows; None where one lag explains it about as well.

    `features` are the `turning_terms` that explain the turning.
    """
    rows, least = np.flatnonzero(motion.use), LIMITS.min_part_s * GRID_HZ
    if len(rows) < 2 * least:
        return None
    reach = round(LIMITS.max_lag_s * GRID_HZ)
    lags = np.arange(-reach, reach + 1)
    parts = _Parts(motion, features, rows, lags)
    cells = len(parts.edges) - 1
    inner = np.flatnonzero((parts.edges >= least) & (parts.edges <= len(rows) - least)).tolist()
    if not inner:
        return None
    splits = {c: _fit_two_lags(parts.between(0, c), parts.between(c, cells)) for c in inner}
    c = min(splits, key=lambda c: splits[c].left)
    best = splits[c]
    row, beside = int(parts.edges[c]), round(0.5 * LIMITS.cell_s * GRID_HZ)
    from_s, to_s = (float(motion.time_s[rows[k]]) for k in (row - beside, row + beside))
    jump = ClockJump(from_s, to_s, *(float(lags[k]) / GRID_HZ for k in best.lags))
    if min(_fit_other_sign(parts.between(0, c), parts.between(c, cells)) for c in inner) < best.left:
        return None
    whole = parts.between(0, cells)
    if abs(jump.size_s) < LIMITS.least_s or best.left > LIMITS.max_left * float(whole.left(whole.weights()).min()):
        return None
    sides = parts.between(0, c).at(best.lags[0]), parts.between(c, cells).at(best.lags[1])
    explained = min(side.share(best.weights) for side in sides) > LIMITS.least_share
    w = best.weights
    # beside the jump, too: a clock that drifts has changed by half as much there
    near = [parts.between(c // 2, c), parts.between(c, (c + cells + 1) // 2)]
    steps = np.diff([lags[int(np.argmin(part.left(w)))] for part in near])[0] / GRID_HZ / jump.size_s
    return jump if explained and turns_leftward(w) and steps > LIMITS.least_step else None


class _TwoLags(NamedTuple):
    """Two parts of a take, each explained at a lag of its own."""

    left: float  # mean square that is left
    lags: tuple[int, int]  # indices
    weights: Floats


def _fit_other_sign(before: _Normal, after: _Normal) -> float:
    """The mean square that one map at the best single lag leaves, if the steering's sign changes between two parts."""
    both = before.plus(after.steered_the_other_way())
    both = both._replace(counted=np.where((before.counted > 0) & (after.counted > 0), both.counted, 0.0))
    return float(both.left(both.weights()).min())


def _fit_two_lags(before: _Normal, after: _Normal) -> _TwoLags:
    """The lags of two parts with one map: that of the longer part by itself, that of the shorter one with its help."""
    swapped = before.counted.max() < after.counted.max()
    longer, shorter = (after, before) if swapped else (before, after)
    k = int(np.argmin(longer.left(longer.weights())))
    both = shorter.plus(longer.at(k))
    both = both._replace(counted=np.where(shorter.counted > 0, both.counted, 0.0))
    weights = both.weights()
    left = both.left(weights)
    i = int(np.argmin(left))
    return _TwoLags(float(left[i]), (i, k) if swapped else (k, i), weights[i])
