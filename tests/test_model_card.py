"""What a card says of the data: what was driven to fit to, apart from what was driven to judge."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from bcid.cli.app import app
from bcid.documents.model_card import DataFile
from bcid.errors import UsageError
from bcid.evaluation.validity import QUANTITIES, DataRange
from bcid.pipeline.model_card import Origin, describe_comparison
from bcid.report.formats import SPAN_NAMES, format_number
from bcid.report.templates import write_page


def driven(top_speed: float) -> DataRange:
    low, high = ((v,) * len(QUANTITIES) for v in (0.0, top_speed))
    return DataRange(low, high)


@pytest.mark.parametrize("trained", [True, False])
def test_what_only_judges_is_told_apart(tmp_path: Path, trained: bool) -> None:
    """A validation take at 3 m/s does not widen the range that models of 2 m/s were fitted in."""
    origin = Origin("car", DataFile(name="car.toml", sha256="ab" * 32), (), "bcid report")
    card = describe_comparison(origin, driven(2.0) if trained else None, driven(3.0))
    assert {s.high for s in card.spans} == ({2.0} if trained else set())
    assert {s.high for s in card.validation_spans} == {3.0}
    page = tmp_path / "card.html"
    write_page(page, "model_card.html.j2", {"number": format_number}, card=card, span_names=SPAN_NAMES)
    text = page.read_text(encoding="utf-8")
    assert ("driven in the training takes" in text) == trained
    assert "driven in the validation take" in text


def test_two_runs_can_leave_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    """SOURCE_DATE_EPOCH is the date of a card, as it is of reproducible builds; else a card has today's."""
    origin = Origin("car", DataFile(name="car.toml", sha256="ab" * 32), (), "bcid report")
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    assert origin.card(not_for=()).made != "2027-01-15T08:00:00Z"
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1800000000")
    assert origin.card(not_for=()).made == "2027-01-15T08:00:00Z"


@pytest.mark.parametrize("stated", ["today", "1.8e9", "9" * 30, "9" * 5000])
def test_a_stated_date_that_is_none_is_refused_before_any_work(stated: str) -> None:
    refused = CliRunner().invoke(app, ["effects"], env={"SOURCE_DATE_EPOCH": stated})
    assert isinstance(refused.exception, UsageError)
    assert str(refused.exception).startswith("SOURCE_DATE_EPOCH: ")
    assert len(str(refused.exception)) < 200
    assert CliRunner().invoke(app, ["effects"], env={"SOURCE_DATE_EPOCH": "1800000000"}).exit_code == 0
