"""What predictions are off, and where there is none: a stretch that leaves the finite numbers is no good prediction."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bcid.diagnosis.judge import fitted_models
from bcid.diagnosis.judge.fitted_models import refit_on_half_or_keep, squared_errors
from bcid.diagnosis.judge.prediction_error import _bootstrap_errors, _finite_mean
from bcid.errors import PredictionDiverged
from bcid.evaluation.closed_loop import RestartedPrediction

ROWS, EACH = 60, 20
MEASURED = np.tile([1.0, 0.0, 0.5], (ROWS, 1))
ONES = np.ones(3)


def predicted(lost: tuple[int, ...]) -> RestartedPrediction:
    """Three stretches 0.1 off but for the row that they start with; `lost` are NaN after it."""
    twist = MEASURED + 0.1
    start = np.arange(ROWS) % EACH == 0
    twist[start] = MEASURED[start]
    for k in lost:
        twist[k * EACH + 1 : (k + 1) * EACH] = np.nan
    return RestartedPrediction(np.zeros((ROWS, 3)), twist, start)


@pytest.mark.parametrize(("lost", "share"), [((), 0.0), ((1,), 1 / 3), ((0, 2), 2 / 3)])
def test_a_stretch_that_is_lost_counts_for_nothing(lost: tuple[int, ...], share: float) -> None:
    estimate: Any = SimpleNamespace(twist=MEASURED)
    off, other = squared_errors(predicted(lost), estimate, ONES), squared_errors(predicted(()), estimate, ONES)
    assert np.isnan(off).mean() == pytest.approx(share)
    assert _finite_mean(off) == pytest.approx(_finite_mean(other))
    row = _bootstrap_errors(2.0, other, off, None, np.arange(ROWS) // EACH)
    assert row.lost == pytest.approx(share)
    assert row.nmse_before == pytest.approx(row.nmse_after) == pytest.approx(0.01 * (EACH - 1) / EACH)


def test_of_a_model_that_is_lost_everywhere_there_is_no_error() -> None:
    """Not one of zero, which is what the rows that its predictions start with would make."""
    off = squared_errors(predicted((0, 1, 2)), SimpleNamespace(twist=MEASURED), ONES)  # type: ignore[arg-type]
    assert np.isnan(off).all()
    assert _finite_mean(off) is None
    row = _bootstrap_errors(2.0, off, off, None, np.arange(ROWS) // EACH)
    assert (row.nmse_before, row.nmse_after, row.before_ci95, row.ratio_ci95, row.lost) == (None, None, None, None, 1.0)
    assert row.ratio is None


def test_blocks_that_are_lost_pull_no_interval_to_nothing() -> None:
    """Each of those that are left is as far off."""
    estimate: Any = SimpleNamespace(twist=MEASURED)
    row = _bootstrap_errors(
        2.0, *[squared_errors(predicted((0, 1)), estimate, ONES)] * 2, None, np.arange(ROWS) // EACH
    )
    assert row.before_ci95 == pytest.approx((row.nmse_before, row.nmse_before))
    assert row.ratio_ci95 == pytest.approx((1.0, 1.0))


def test_half_a_take_that_leads_astray_leaves_the_fit_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    def astray(*_: Any) -> Any:
        raise PredictionDiverged("a prediction left the finite numbers")

    whole: Any = object()
    half: Any = None
    monkeypatch.setattr(fitted_models, "refit_on_half", astray)
    assert refit_on_half_or_keep(whole, half, half) is whole
