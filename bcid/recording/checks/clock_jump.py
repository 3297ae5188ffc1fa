"""Whether a clock jumped within a take: commands that fit the motion before a time at one lag, after it at another.

The turning y is explained in both parts by one map of the commands, sum_i w_i f_i(t) g_i(t - lag), at the lag of each
part.  A jump is told where two lags leave far less than any single one, and less than a change of the steering's sign
at one lag: where laps come round again, the commands of half a lap later look like those with the other sign.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.recording.checks.agreement import Feature
from bcid.recording.checks.commanded_motion import GRID_HZ, CommandedMotion
from bcid.recording.checks.lagged_sums import LaggedEquations, LaggedSums
from bcid.recording.checks.limits import CLOCK_JUMP as LIMITS
from bcid.recording.checks.turning_terms import OTHER_SIGN, turns_leftward

JUMP = "clock jump"
"""The kind of the irregularity."""
SPLITS_AT_ONCE = 16  # whose equations are held together, which bounds memory


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


def find_clock_jump(motion: CommandedMotion, features: list[Feature]) -> ClockJump | None:
    """The jump of one clock against the other that the turning shows; None where one lag explains it about as well.

    `features` are the `turning_terms` that explain the turning.
    """
    rows, least = np.flatnonzero(motion.use), LIMITS.min_part_s * GRID_HZ
    if len(rows) < 2 * least:
        return None
    reach = round(LIMITS.max_lag_s * GRID_HZ)
    gaps = np.flatnonzero(np.diff(rows) > LIMITS.gap_s * GRID_HZ) + 1
    edges = np.r_[np.union1d(np.arange(0, len(rows), round(LIMITS.cell_s * GRID_HZ)), gaps), len(rows)]
    inner = np.flatnonzero((edges >= least) & (edges <= len(rows) - least))
    if not len(inner):
        return None
    take = _SplitTake(LaggedSums(motion.turn, motion.known, features, rows, edges, reach))
    best = take.fit_two_lags(inner)
    lags = np.arange(-reach, reach + 1)
    row, beside = int(edges[best.cell]), round(0.5 * LIMITS.cell_s * GRID_HZ)
    from_s, to_s = (float(motion.time_s[rows[k]]) for k in (row - beside, row + beside))
    jump = ClockJump(from_s, to_s, *(float(lags[k]) / GRID_HZ for k in best.lags))
    if abs(jump.size_s) < LIMITS.least_s or best.left > LIMITS.max_left * take.left_by_one_lag():
        return None
    w, explained = best.weights, take.explained_shares(best)
    # beside the jump, too: a clock that drifts has changed by half as much there
    steps = np.diff([lags[k] for k in take.lags_beside(best)])[0] / GRID_HZ / jump.size_s
    if min(explained) <= LIMITS.least_share or not turns_leftward(w) or steps <= LIMITS.least_step:
        return None
    return None if take.left_by_other_sign(inner) < best.left else jump


class _TwoLags(NamedTuple):
    """Two parts of a take, each explained at a lag of its own."""

    left: float  # mean square that is left
    cell: int  # at which the second part begins
    lags: tuple[int, int]  # indices
    weights: Floats


class _SplitTake(NamedTuple):
    """A take that is split into two parts, at any of its cells."""

    sums: LaggedSums

    def parts_at(self, cells: Ints) -> tuple[LaggedEquations, LaggedEquations]:
        """The equations (S, L) of the parts before, and from, each of the `cells` (S,) on."""
        first, end = np.zeros_like(cells), np.full_like(cells, len(self.sums.edges) - 1)
        before = self.sums.between(first, cells, LIMITS.least_covered)
        return before, self.sums.between(cells, end, LIMITS.least_covered)

    def left_by_one_lag(self) -> float:
        """The mean square that the best single lag leaves of the whole take."""
        whole = self.sums.between(np.array([0]), np.array([len(self.sums.edges) - 1]), LIMITS.least_covered)
        return float(whole.left(whole.weights()).min())

    def fit_two_lags(self, cells: Ints) -> _TwoLags:
        """The best of the splits at `cells` (S,) with two lags and one map of the commands."""
        fits = [_fit_two_lags(*self.parts_at(some)) for some in _in_blocks(cells)]
        left, before, after, weights = (np.concatenate(x) for x in zip(*fits, strict=True))
        s = int(np.argmin(left))
        return _TwoLags(float(left[s]), int(cells[s]), (int(before[s]), int(after[s])), weights[s])

    def left_by_other_sign(self, cells: Ints) -> float:
        """The least mean square that one map at a single lag leaves, if the steering's sign changes at a cell."""
        return min(_fit_other_sign(*self.parts_at(some)) for some in _in_blocks(cells))

    def explained_shares(self, fit: _TwoLags) -> list[float]:
        """The shares that the fit explains, of either part, of what the first term alone leaves."""
        sides = [
            part.take(np.array([k])) for part, k in zip(self.parts_at(np.array([fit.cell])), fit.lags, strict=True)
        ]
        base = [side.square - side.cross[:, 0] ** 2 / np.maximum(side.gram[:, 0, 0], 1e-12) for side in sides]
        return [
            1.0 - float((side.left(fit.weights) * side.counted / np.maximum(b, 1e-12))[0])
            for side, b in zip(sides, base, strict=True)
        ]  # fmt: skip

    def lags_beside(self, fit: _TwoLags) -> list[int]:
        """The indices of the lags at which the fit's map explains the halves of the parts that lie beside the split."""
        c, cells = fit.cell, len(self.sums.edges) - 1
        near = self.sums.between(np.array([c // 2, c]), np.array([c, (c + cells + 1) // 2]), LIMITS.least_covered)
        return [int(k) for k in np.argmin(near.left(fit.weights), axis=1)]


def _in_blocks(cells: Ints) -> list[Ints]:
    """The cells (S,) in blocks of at most SPLITS_AT_ONCE."""
    return np.split(cells, np.arange(SPLITS_AT_ONCE, len(cells), SPLITS_AT_ONCE))


def _fit_other_sign(before: LaggedEquations, after: LaggedEquations) -> float:
    """The mean square that one map at the best single lag leaves, if the steering's sign changes between two parts."""
    # commands with the other sign: the terms that are odd in the angle change theirs
    turned = after._replace(gram=after.gram * np.outer(OTHER_SIGN, OTHER_SIGN), cross=after.cross * OTHER_SIGN)
    both = before.plus(turned)
    both = both._replace(counted=np.where((before.counted > 0) & (after.counted > 0), both.counted, 0.0))
    return float(both.left(both.weights()).min())


def _fit_two_lags(before: LaggedEquations, after: LaggedEquations) -> tuple[Floats, Ints, Ints, Floats]:
    """The lags of two parts with one map: that of the longer part by itself, that of the shorter one with its help.

    Returns of each of S splits the mean square (S,) that is left, the indices (S,) of both lags, the weights (S, n).
    """
    swapped = before.counted.max(axis=1) < after.counted.max(axis=1)

    def choose(first: Bools) -> LaggedEquations:
        """The parts before where `first` (S,) is true, and after elsewhere."""
        return LaggedEquations(*(
            np.where(first.reshape(-1, *[1] * (x.ndim - 1)), x, y) for x, y in zip(before, after, strict=True)
        ))  # fmt: skip

    longer, shorter = choose(~swapped), choose(swapped)
    k = np.argmin(longer.left(longer.weights()), axis=1)
    known = LaggedEquations(*(x[:, None] for x in longer.take(k)))
    both = shorter.plus(known)
    both = both._replace(counted=np.where(shorter.counted > 0, both.counted, 0.0))
    weights = both.weights()
    left = both.left(weights)
    i = np.argmin(left, axis=1)
    at = np.arange(len(i)), i
    return left[at], np.where(swapped, i, k), np.where(swapped, k, i), weights[at]
