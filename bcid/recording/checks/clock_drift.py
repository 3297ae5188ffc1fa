"""Whether the clock of the commands drifts against that of the poses: their lag grows evenly within a take.

The turning is explained by one map of the commands at the lag a + b (t - t_middle) (s), with a the lag in the middle of
the take and b the drift: the normal equations of each cell at its own lag are added up for each pair of a and b.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.recording.checks.commanded_motion import GRID_HZ, CommandedMotion
from bcid.recording.checks.lagged_sums import LaggedSums
from bcid.recording.checks.limits import CLOCK_DRIFT as LIMITS
from bcid.recording.checks.limits import CLOCK_JUMP
from bcid.recording.checks.turning_terms import turns_leftward

DRIFT = "clock drift"
"""The kind of the irregularity."""


class ClockDrift(NamedTuple):
    """A lag of the commands against the poses that grows evenly."""

    total_s: float  # by which the lag is larger in the last cell than in the first
    left: float  # mean square of the turning that is left

    def describe(self) -> str:
        """What the clocks do, and what mends it."""
        way = "early" if self.total_s > 0.0 else "late"
        text = f"by the end of the take the commands come another {abs(self.total_s):.1f} s {way}"
        return f"the commands' clock drifts against that of the poses: {text}; use one clock"


def find_clock_drift(motion: CommandedMotion, sums: LaggedSums) -> ClockDrift | None:
    """The drift of one clock against the other that the turning shows; None where one lag explains it about as well.

    `sums` are the normal equations of the turning's terms.
    """
    middle_s = motion.time_s[sums.rows[(sums.edges[:-1] + sums.edges[1:] - 1) // 2]]
    if len(middle_s) < 2:
        return None
    share = (middle_s - middle_s.mean()) / max(float(np.ptp(middle_s)), 1e-9)
    reach_s = min(LIMITS.max_total_s, LIMITS.max_rate * float(np.ptp(middle_s)))
    steps = int(reach_s * GRID_HZ / LIMITS.total_step_rows)
    totals = LIMITS.total_step_rows * np.arange(-steps, steps + 1)
    fits = [_fit_drift(sums, share, float(total)) for total in totals]
    best = int(np.argmin([fit.left for fit in fits]))
    fit, steady, total_s = fits[best], fits[steps].left, float(totals[best]) / GRID_HZ
    # at the end of what is tried anything may be the cause
    inside = 0 < best < len(totals) - 1 and abs(total_s) >= CLOCK_JUMP.least_s
    if not inside or fit.left > CLOCK_JUMP.max_left * steady or fit.share < CLOCK_JUMP.least_share:
        return None
    return ClockDrift(total_s, fit.left) if fit.leftward else None


class _DriftFit(NamedTuple):
    """What the best lag in the middle of a take explains at some drift."""

    left: float  # mean square that is left
    share: float  # of the turning that is explained
    leftward: bool


def _fit_drift(sums: LaggedSums, share: Floats, total: float) -> _DriftFit:
    """What the best lag explains of the turning if it grows by `total` rows, by its `share` (C,) up to a cell."""
    at = sums.with_growing_lag(np.round(share * total).astype(int), CLOCK_JUMP.least_covered)
    weights = at.weights()
    left = at.left(weights)
    k = int(np.argmin(left))
    return _DriftFit(float(left[k]), float(at.share(weights)[k]), bool(turns_leftward(weights[k])))
