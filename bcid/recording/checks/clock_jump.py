"""Whether a clock jumped within a take: commands that fit the motion before a time at one lag, after it at another.

The turning y is explained in both parts by one map of the commands, sum_i w_i f_i(t) g_i(t - lag), at the lag of each
part.  A jump is told where two lags leave far less than any single one, and less than a change of the steering's sign
at one lag: where laps come round again, the commands of half a lap later look like those with the other sign.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.recording.checks.commanded_motion import GRID_HZ, CommandedMotion
from bcid.recording.checks.lagged_cells import LaggedCells, LaggedEquations
from bcid.recording.checks.limits import CLOCK_JUMP as LIMITS
from bcid.recording.checks.turning_terms import turns_leftward

JUMP = "clock jump"
"""The kind of the irregularity."""


class ClockJump(NamedTuple):
    """Two times, between which a clock jumps: commands fit the motion before them at one lag, and after at another."""

    from_s: float
    to_s: float
    before_s: float  # by which commands act later than stamped
    after_s: float
    left: float  # mean square of the turning that is left

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


def find_clock_jump(motion: CommandedMotion, parts: LaggedCells) -> ClockJump | None:
    """The jump of one clock against the other that the turning shows; None where one lag explains it about as well."""
    rows, lags, cells, least = parts.rows, parts.lags, parts.count, LIMITS.min_part_s * GRID_HZ
    inner = np.flatnonzero((parts.edges >= least) & (parts.edges <= len(rows) - least)).tolist()
    if not inner:
        return None
    splits = {c: _fit_two_lags(parts.between(0, c), parts.between(c, cells)) for c in inner}
    c = min(splits, key=lambda c: splits[c].left)
    best = splits[c]
    row, beside = int(parts.edges[c]), round(0.5 * LIMITS.cell_s * GRID_HZ)
    from_s, to_s = (float(motion.time_s[rows[k]]) for k in (row - beside, row + beside))
    before_s, after_s = (float(lags[k]) / GRID_HZ for k in best.lags)
    jump = ClockJump(from_s, to_s, before_s, after_s, best.left)
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


def _fit_other_sign(before: LaggedEquations, after: LaggedEquations) -> float:
    """The mean square that one map at the best single lag leaves, if the steering's sign changes between two parts."""
    both = before.plus(after.steered_the_other_way())
    both = both._replace(counted=np.where((before.counted > 0) & (after.counted > 0), both.counted, 0.0))
    return float(both.left(both.weights()).min())


def _fit_two_lags(before: LaggedEquations, after: LaggedEquations) -> _TwoLags:
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
