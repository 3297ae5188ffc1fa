"""A car with a regression of what it leaves: the usual way to make a model better without knowing what it lacks.

The regression is of the accelerations that the car lacks from one row of the estimated motion to the next, on twist,
wheel angle and commands; added to the car's own, they are rolled out with it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.estimate.command_parts import hold_for_periods, mean_commands
from bcid.estimate.types import Estimate
from bcid.models.interface import History, history_at
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler

WHEEL_ANGLE = 9  # its place in the carry of the car (`bcid.models.newton_euler.augmented_step.pack_carry`)


class Standardised(NamedTuple):
    """Means and spreads of the columns of a table."""

    mean: Floats  # (n,)
    spread: Floats  # (n,)

    @classmethod
    def from_rows(cls, rows: Floats) -> Standardised:
        """Those of a table (N, n); a column that does not vary has the spread 1."""
        spread = rows.std(axis=0)
        return cls(rows.mean(axis=0), np.where(spread > 0.0, spread, 1.0))

    def to_units(self, rows: Floats) -> Floats:
        """Rows (N, n) less the means, over the spreads."""
        return np.asarray((rows - self.mean) / self.spread)

    def from_units(self, rows: Floats) -> Floats:
        """Rows (N, n) of which `to_units` made these."""
        return np.asarray(rows * self.spread + self.mean)


@dataclass(frozen=True)
class ResidualModel:
    """A car, and a regression of the accelerations that it lacks."""

    car: AugmentedNewtonEuler
    predict: Callable[[Floats], Floats]  # standardised accelerations (N, 3) at standardised inputs (N, 6)
    inputs: Standardised
    accelerations: Standardised  # m/s^2, m/s^2, rad/s^2 of the body
    name: str

    @property
    def lags(self) -> int:
        """Rows of history before the start that `init` wants."""
        return self.car.lags

    def init(self, history: History) -> Floats:
        """The car's carry at the last row of `history`."""
        return self.car.init(history)

    def scan(self, carry: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """Advance one car under `commands`, (N, 2) or parts (N, W, 4): its last carry, and the twists (N, 3)."""
        parts = commands if commands.ndim == 3 else hold_for_periods(commands, self.car.period_s)
        after, twists = self.scan_many(carry[None], parts[None])
        return after[0], twists[0]

    def scan_many(self, carries: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """Advance B cars under parts (B, N, W, 4): carries after the last, and twists (B, N, 3).

        The acceleration that the regression predicts at the beginning of each period acts throughout it.  A car that
        leaves the finite numbers is not finite from there on.
        """
        carries, twists = np.array(carries), np.empty((*commands.shape[:2], 3))
        for k in range(commands.shape[1]):
            gained = self.car.period_s * self._predict_accelerations(carries, mean_commands(commands[:, k]))
            carries, twist = self.car.scan_many(carries, commands[:, k : k + 1])
            carries[:, self.car.motion] += gained
            twists[:, k] = twist[:, 0] + gained
        return carries, twists

    def _predict_accelerations(self, carries: Floats, commands: Floats) -> Floats:
        """Accelerations (B, 3) that the car lacks at B carries and commands (B, 2); NaN at one that is not finite."""
        inputs = _regression_inputs(carries, commands)
        finite, predicted = np.isfinite(inputs).all(axis=1), np.full((len(inputs), 3), np.nan)
        if finite.any():
            own = self.predict(self.inputs.to_units(inputs[finite]))
            predicted[finite] = self.accelerations.from_units(own)
        return predicted


def fit_residual_model(
    car: AugmentedNewtonEuler, estimate: Estimate,
    fit: Callable[[Floats, Floats], Callable[[Floats], Floats]], name: str,
) -> ResidualModel:  # fmt: skip
    """Fit a regression to the accelerations that `car` lacks from each row of an estimated motion to the next.

    `fit` is given standardised inputs (N, 6) and accelerations (N, 3), and returns what predicts the latter.
    """
    rows = np.concatenate([np.arange(s.start, s.stop - 1) for s in estimate.segments()])
    carries = np.stack([car.init(history_at(estimate, k, car.lags)) for k in rows.tolist()])
    _, twists = car.scan_many(carries, estimate.parts[rows][:, None])
    lacking = (estimate.twist[rows + 1] - twists[:, 0]) / car.period_s
    inputs = _regression_inputs(carries, estimate.command[rows])
    known = np.isfinite(inputs).all(axis=1) & np.isfinite(lacking).all(axis=1)
    X, y = Standardised.from_rows(inputs[known]), Standardised.from_rows(lacking[known])
    return ResidualModel(car, fit(X.to_units(inputs[known]), y.to_units(lacking[known])), X, y, name)


def _regression_inputs(carries: Floats, commands: Floats) -> Floats:
    """Inputs (B, 6) of the regression: v_x, v_y, yaw rate, wheel angle in carries (B, n), and commands (B, 2)."""
    return np.column_stack([carries[:, AugmentedNewtonEuler.motion], carries[:, WHEEL_ANGLE], commands])
