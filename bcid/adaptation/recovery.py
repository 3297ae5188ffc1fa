"""What adapting is worth: predictions of the car as it is known at each moment, beside those of the car as it was."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bcid.adaptation.adapt import Adaptation
from bcid.aliases import Floats
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import position_errors
from bcid.models.interface import Model

HORIZON_S = 2.0
"""Time (s) over which positions are predicted: that of a controller that looks ahead."""
EVERY_S = 1.0
"""Time (s) from one prediction to the next."""
BEFORE_S = 20.0
"""Time (s) over which errors are averaged, backward, in what recovery is judged by."""


class ErrorsOverTime(NamedTuple):
    """Position errors (m) of predictions over `HORIZON_S` by when they begin (s): one row for each."""

    begin_s: Floats  # (P,)
    frozen: Floats  # (P,) of the model as it was given
    adapted: Floats  # (P,) of the model as it was known when the prediction began


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


def recovery_time_s(errors: ErrorsOverTime, change_s: float, factor: float = 1.2) -> float | None:
    """The time (s) from a change at `change_s` until the adapted model is as good as before, but for a `factor`.

    Good is the root mean square of the errors over `BEFORE_S`: after the change of those that begin in so long a time
    from the moment that is judged, before it of the last ones that end by then.  None where it never is, or where
    predictions do not go so far to either side.
    """

    def root_mean_square(begin: float, end: float) -> float:
        chosen = errors.adapted[(errors.begin_s >= begin) & (errors.begin_s < end)]
        return float(np.sqrt(np.mean(chosen**2)))

    first, last = float(errors.begin_s[0]), float(errors.begin_s[-1])
    until = change_s - HORIZON_S
    if until - BEFORE_S < first or change_s + BEFORE_S > last:
        return None
    former = root_mean_square(until - BEFORE_S, until)
    for begin in errors.begin_s[(errors.begin_s >= change_s) & (errors.begin_s + BEFORE_S <= last)].tolist():
        if root_mean_square(begin, begin + BEFORE_S) <= factor * former:
            return float(begin - change_s)
    return None
