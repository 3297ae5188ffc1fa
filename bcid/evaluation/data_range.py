"""The range of motion and commands that a model was fitted on: beyond it, a rollout is a guess."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.estimate.types import Estimate

QUANTITIES = {
    "v_x": "m/s", "v_y": "m/s", "yaw_rate": "rad/s", "v_x yaw_rate": "m/s²", "u_s": "rad", "u_m": ""
}  # fmt: skip
MARGIN = 0.05  # of a quantity's span that it may go beyond


class Beyond(NamedTuple):
    """Where a rollout first leaves the range of one quantity."""

    step: int
    quantity: str
    value: float
    limit: float

    def words(self, period_s: float) -> str:
        """As a warning says it."""
        unit, side = QUANTITIES[self.quantity], "up to" if self.value > self.limit else "down to"
        value, limit = (f"{v:.3g} {unit}".strip() for v in (self.value, self.limit))
        return f"{self.quantity} is {value} at {self.step * period_s:.1f} s, the takes go {side} {limit}"


class DataRange(NamedTuple):
    """Least and greatest of each of QUANTITIES."""

    low: tuple[float, ...]
    high: tuple[float, ...]

    @classmethod
    def of(cls, estimates: Sequence[Estimate]) -> DataRange:
        """Those of the takes."""
        table = np.concatenate([_table(e.twist, e.command) for e in estimates])
        return cls(tuple(table.min(axis=0).tolist()), tuple(table.max(axis=0).tolist()))

    def beyond(self, twist: Floats, command: Floats) -> list[Beyond]:
        """Where a rollout first leaves the range, by quantity in order of time; twist (N, 3), command (N, 2)."""
        table, low, high = _table(twist, command), np.array(self.low), np.array(self.high)
        outside, found = self._outside(table), []
        for c in np.flatnonzero(outside.any(axis=0)):
            k = int(np.argmax(outside[:, c]))
            value = float(table[k, c])
            found.append(Beyond(k, list(QUANTITIES)[c], value, float(high[c] if value > high[c] else low[c])))
        return sorted(found)

    def share_outside(self, twist: Floats, command: Floats) -> float:
        """The share of the rows of which any quantity is outside."""
        return float(self._outside(_table(twist, command)).any(axis=1).mean())

    def _outside(self, table: Floats) -> npt.NDArray[np.bool_]:
        low, high = np.array(self.low), np.array(self.high)
        margin = MARGIN * (high - low)
        return np.asarray((table < low - margin) | (table > high + margin))


def _table(twist: Floats, command: Floats) -> Floats:
    return np.column_stack([twist, twist[:, 0] * twist[:, 2], command])
