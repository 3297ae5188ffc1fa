"""`Estimate`: what every model is fitted on and judged against."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bcid.aliases import Floats, Ints


@dataclass(frozen=True)
class Estimate:
    """Smoothed motion of one recording on a uniform grid of `period_s`.

    Row k holds the state at t_k and the command held then.  Rows of one `segment` are consecutive
    on the grid; a new segment begins after every gap or jump, and no sample may straddle two.
    """

    name: str
    period_s: float
    time_s: Floats  # (K,) from the take's time zero
    segment: Ints  # (K,)
    pose: Floats  # (K, 3) x m, y m, yaw rad (continuous)
    twist: Floats  # (K, 3) v_x m/s, v_y m/s, yaw rate rad/s
    kinematic: Floats  # (K, 4) v_f m/s, alpha_f rad, alpha_r rad, delta rad
    command: Floats  # (K, 2) u_s rad, u_m m/s (or brake share)
    twist_sd: Floats  # (K, 3) standard deviations of the twist
    kinematic_sd: Floats  # (K, 4)
    facts: Mapping[str, Any] = field(default_factory=dict)  # noise, consistency, steering

    def __len__(self) -> int:
        return len(self.time_s)

    def part(self, rows: slice) -> Estimate:
        """The grid rows `rows` of it."""
        columns = ("time_s", "segment", "pose", "twist", "kinematic", "command", "twist_sd", "kinematic_sd")
        return replace(self, **{name: getattr(self, name)[rows] for name in columns})

    def segments(self) -> list[slice]:
        """The row ranges of the segments, in order."""
        cuts = np.flatnonzero(np.diff(self.segment)) + 1
        edges = [0, *cuts.tolist(), len(self)]
        return [slice(a, b) for a, b in itertools.pairwise(edges) if b > a]
