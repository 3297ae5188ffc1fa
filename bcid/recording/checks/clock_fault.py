"""What is wrong with two clocks within a take: one jumps, or drifts, against the other, whichever explains more."""

from typing import NamedTuple

import numpy as np

from bcid.recording.checks.agreement import Feature
from bcid.recording.checks.clock_drift import DRIFT, find_clock_drift
from bcid.recording.checks.clock_jump import JUMP, find_clock_jump
from bcid.recording.checks.commanded_motion import GRID_HZ, CommandedMotion
from bcid.recording.checks.lagged_sums import LaggedSums
from bcid.recording.checks.limits import CLOCK
from bcid.recording.checks.limits import CLOCK_JUMP as LIMITS

CLOCK_FAULTS = (JUMP, DRIFT)
"""The kinds of such irregularities."""


class ClockFault(NamedTuple):
    """A fault of the clocks: its kind, in words, and by how much later (s) commands act after it than before."""

    kind: str
    text: str
    size_s: float

    @property
    def is_usable(self) -> bool:
        """Whether it is so small that a model can be fitted all the same."""
        return abs(self.size_s) <= CLOCK.max_usable_s


def find_clock_fault(motion: CommandedMotion, features: list[Feature]) -> ClockFault | None:
    """The jump or the drift of one clock that the turning shows; None where one lag explains it about as well.

    A drift that is usable is left to the estimate of the clock, which gives its interval.  `features` are the
    `turning_terms` that explain the turning.
    """
    rows = np.flatnonzero(motion.use)
    if len(rows) < 2.0 * LIMITS.min_part_s * GRID_HZ:
        return None
    gaps = np.flatnonzero(np.diff(rows) > LIMITS.gap_s * GRID_HZ) + 1
    edges = np.r_[np.union1d(np.arange(0, len(rows), round(LIMITS.cell_s * GRID_HZ)), gaps), len(rows)]
    reach = round(LIMITS.max_lag_s * GRID_HZ)
    sums = LaggedSums(motion.turn, motion.known, features, rows, edges, reach)
    jump, drift = find_clock_jump(motion, sums), find_clock_drift(motion, sums)
    if drift is not None and (jump is None or drift.left < jump.left):
        fault = ClockFault(DRIFT, drift.describe(), drift.total_s)
        if not fault.is_usable:
            return fault
    return None if jump is None else ClockFault(JUMP, jump.describe(), jump.size_s)
