"""`Estimate`, the smoothed motion that every model is fitted on and compared with."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.documents.document import Number, Part
from bcid.estimate.command_parts import mean_commands
from bcid.estimate.consistency import NisSummary
from bcid.estimate.tuning import Tuning


class FilterSummary(Part):
    """Consistency, likelihood and restarts of the filter on one recording."""

    nis: NisSummary
    log_likelihood: Number
    restarts_s: tuple[float, ...]  # when the filter had lost the car and was started anew

    def describe_restarts(self) -> str:
        """The times (s) at which the filter was restarted because it had lost the car, as text; empty without any."""
        at = ", ".join(f"{t:.1f} s" for t in self.restarts_s)
        return f"lost the car and was restarted at {at}" if at else ""


@dataclass(frozen=True)
class Estimate:
    """Smoothed motion of one recording on a uniform grid of `period_s`.

    Row k holds the state at t_k and the commands of the period that begins there.  Rows of one `segment` are
    consecutive on the grid; a new segment begins after every gap or jump, and no sample may straddle two.
    """

    name: str
    period_s: float
    time_s: Floats  # (K,) from the take's time zero
    segment: Ints  # (K,)
    pose: Floats  # (K, 3) x m, y m, yaw rad (continuous)
    twist: Floats  # (K, 3) v_x m/s, v_y m/s, yaw rate rad/s
    kinematic: Floats  # (K, 4) v_f m/s, alpha_f rad, alpha_r rad, delta rad
    parts: Floats  # (K, W, 4) duration s, u_s rad, u_m m/s (or brake share), brake of each part of the next period
    twist_sd: Floats  # (K, 3) standard deviations of the twist
    kinematic_sd: Floats  # (K, 4)
    tuning: Tuning | None = None  # what the filter assumed; None for motion that no filter estimated
    filter: FilterSummary | None = None  # how it went; None likewise

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def command(self) -> Floats:
        """The commands [u_s, u_m] (K, 2), rad and m/s (or brake share), averaged over the period after each row."""
        return mean_commands(self.parts)

    def select_rows(self, rows: slice) -> Estimate:
        """The estimate's grid rows `rows`."""
        columns = ("time_s", "segment", "pose", "twist", "kinematic", "parts", "twist_sd", "kinematic_sd")
        return replace(self, **{name: getattr(self, name)[rows] for name in columns})

    def steering_constants(self) -> tuple[float, float]:
        """Time constant T_s (s) and rate limit d (rad/s) of the steering that the filter assumed.

        Raises:
            ValueError: for motion that no filter estimated.
        """
        if self.tuning is None:
            raise ValueError(f"{self.name}: no filter estimated this motion")
        return self.tuning.T_s, self.tuning.d

    def segments(self) -> list[slice]:
        """The row ranges of the estimate's segments, in order."""
        cuts = np.flatnonzero(np.diff(self.segment)) + 1
        edges = [0, *cuts.tolist(), len(self)]
        return [slice(a, b) for a, b in itertools.pairwise(edges) if b > a]
