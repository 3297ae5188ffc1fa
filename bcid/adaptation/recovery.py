"""What adapting is worth: predictions of the car as it is known at each moment, beside those of the car as it was."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.adaptation.adapt import Adaptation
from bcid.aliases import Floats
from bcid.bootstrap import bootstrap_interval
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import position_errors
from bcid.models.interface import Model

HORIZON_S = 2.0
"""Time (s) over which positions are predicted: that of a controller that looks ahead."""
EVERY_S = 1.0
"""Time (s) from one prediction to the next."""
BLOCK = 5
"""Predictions in a row that are taken together for an interval: twice as long as one lasts, and more."""


class ErrorsOverTime(NamedTuple):
    """Position errors (m) of predictions over `HORIZON_S` by when they begin (s): one row for each."""

    begin_s: Floats  # (P,)
    frozen: Floats  # (P,) of the model as it was given
    adapted: Floats  # (P,) of the model as it was known when the prediction began

    def loss_interval(self) -> tuple[float, float] | None:
        """The 95 % interval of by how much following made the mean squared error (m^2) larger.

        None of fewer than two blocks of predictions, or where one leaves the finite numbers.
        """
        losses = self.adapted**2 - self.frozen**2
        count = len(losses) // BLOCK
        if count < 2 or not np.isfinite(losses).all():
            return None
        # predictions that overlap are alike, blocks of some nearly independent
        return bootstrap_interval(np.array([block.mean() for block in np.array_split(losses, count)]), np.mean)


def errors_over_time(adaptation: Adaptation, given: Model, estimate: Estimate) -> ErrorsOverTime:
    """Errors of predictions from rows of the estimate, each by what is known until there, beside the model `given`.

    One that leaves the finite numbers is infinitely off.
    """
    period_s = estimate.period_s
    ahead, every = max(2, round(HORIZON_S / period_s)), max(1, round(EVERY_S / period_s))
    rows = [k for s in estimate.segments() for k in range(s.start, s.stop - ahead, every)]
    errors = np.array([
        [_error_from(model, estimate, k, ahead) for model in (given, adaptation.model_at(k))] for k in rows
    ]).reshape(-1, 2)  # fmt: skip
    return ErrorsOverTime(estimate.time_s[rows], errors[:, 0], errors[:, 1])


def _error_from(model: Model, estimate: Estimate, row: int, ahead: int) -> float:
    """The position error (m) of a prediction from a row of the estimate over `ahead` periods."""
    return float(position_errors(model, estimate.select_rows(slice(row, row + ahead + 1)), HORIZON_S)[0])
