"""Between what an error is divided: findings, corrections together, and of too many findings the last together."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from bcid.pipeline import error_budget
from bcid.pipeline.error_budget import CORRECTIONS, _things
from bcid.pipeline.limits import LIMITS


def diagnosis_of(count: int) -> Any:
    """What is read of a diagnosis with so many findings."""
    findings = [SimpleNamespace(effect=f"effect_{k}") for k in range(count)]
    return SimpleNamespace(judgement=SimpleNamespace(findings=findings), fit=None)


@pytest.mark.parametrize("corrections", [(), ("two_rear_wheels", "tyre_fall")])
@pytest.mark.parametrize("count", range(8))
def test_every_finding_is_in_one_thing_and_there_are_not_too_many(
    count: int, corrections: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(error_budget, "fitted_corrections", lambda fit: corrections)
    things = _things(diagnosis_of(count))
    assert [e for effects in things.values() for e in effects] == [f"effect_{k}" for k in range(count)] + [*corrections]
    assert len(things) == min(count + bool(corrections), LIMITS.max_budget_things)
    assert (CORRECTIONS in things) == bool(corrections)
