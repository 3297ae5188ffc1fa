"""What predictions are off, and where there is none: a stretch that leaves the finite numbers is no good prediction."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bcid.diagnosis import document
from bcid.diagnosis.judge import prediction_error
from bcid.diagnosis.judge.prediction_error import _judged, _mean, _on_half, _squares
from bcid.evaluation.closed_loop import Restarted

ROWS, EACH = 60, 20
MEASURED = np.tile([1.0, 0.0, 0.5], (ROWS, 1))
ONES = np.ones(3)


def predicted(lost: tuple[int, ...]) -> Restarted:
    """Three stretches 0.1 off but for the row that they start with; `lost` are NaN after it."""
    twist = MEASURED + 0.1
    start = np.arange(ROWS) % EACH == 0
    twist[start] = MEASURED[start]
    for k in lost:
        twist[k * EACH + 1 : (k + 1) * EACH] = np.nan
    return Restarted(np.zeros((ROWS, 3)), twist, start)


@pytest.mark.parametrize(("lost", "share"), [((), 0.0), ((1,), 1 / 3), ((0, 2), 2 / 3)])
def test_a_stretch_that_is_lost_counts_for_nothing(lost: tuple[int, ...], share: float) -> None:
    estimate: Any = SimpleNamespace(twist=MEASURED)
    off, other = _squares(predicted(lost), estimate, ONES), _squares(predicted(()), estimate, ONES)
    assert np.isnan(off).mean() == pytest.approx(share)
    assert _mean(off) == pytest.approx(_mean(other))
    row = _judged(2.0, other, off, None, np.arange(ROWS) // EACH)
    assert row.lost == pytest.approx(share)
    assert row.before == pytest.approx(row.after) == pytest.approx(0.01 * (EACH - 1) / EACH)


def test_of_a_model_that_is_lost_everywhere_there_is_no_error() -> None:
    """Not one of zero, which is what the rows that its predictions start with would make."""
    off = _squares(predicted((0, 1, 2)), SimpleNamespace(twist=MEASURED), ONES)  # type: ignore[arg-type]
    assert np.isnan(off).all()
    assert _mean(off) is None
    row = _judged(2.0, off, off, None, np.arange(ROWS) // EACH)
    assert (row.before, row.after, row.before_ci95, row.ratio_ci95, row.lost) == (None, None, None, None, 1.0)
    shown = document._horizon(row)
    assert (shown["nmse_before"], shown["ratio"], shown["ratio_ci95"]) == (None, None, None)


def test_blocks_that_are_lost_pull_no_interval_to_nothing() -> None:
    """Each of those that are left is as far off."""
    estimate: Any = SimpleNamespace(twist=MEASURED)
    row = _judged(2.0, *[_squares(predicted((0, 1)), estimate, ONES)] * 2, None, np.arange(ROWS) // EACH)
    assert row.before_ci95 == pytest.approx((row.before, row.before))
    assert row.ratio_ci95 == pytest.approx((1.0, 1.0))


def test_half_a_take_that_leads_astray_leaves_the_fit_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    def astray(*_: Any) -> Any:
        raise FloatingPointError("a prediction left the finite numbers")

    whole: Any = object()
    half: Any = None
    monkeypatch.setattr(prediction_error, "on_half", astray)
    assert _on_half(whole, half, half) is whole
