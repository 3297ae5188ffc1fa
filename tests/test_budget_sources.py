"""Between what an error is divided: findings, corrections together, and of too many findings the last together."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from bcid.evaluation.error_budget import ErrorPart, ErrorParts
from bcid.pipeline import error_budget
from bcid.pipeline.error_budget import CORRECTIONS, _describe_parts, _error_sources
from bcid.pipeline.limits import LIMITS


def diagnosis_of(count: int) -> Any:
    """What is read of a diagnosis with so many findings."""
    findings = [SimpleNamespace(effect=f"effect_{k}") for k in range(count)]
    return SimpleNamespace(judgement=SimpleNamespace(findings=findings), fit=None)


@pytest.mark.parametrize("corrections", [(), ("two_rear_wheels", "tyre_fall")])
@pytest.mark.parametrize("count", range(8))
def test_every_finding_is_in_one_source_and_there_are_not_too_many(
    count: int, corrections: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(error_budget, "fitted_corrections", lambda fit: corrections)
    sources = _error_sources(diagnosis_of(count))
    assert [e for effects in sources.values() for e in effects] == [f"effect_{k}" for k in range(count)] + [
        *corrections
    ]
    assert len(sources) == min(count + bool(corrections), LIMITS.max_budget_sources)
    assert (CORRECTIONS in sources) == bool(corrections)


@pytest.mark.parametrize("floor", [(), (0.05, 0.1)])
def test_what_is_left_is_unexplained_only_where_the_noise_is_known(floor: tuple[float, ...]) -> None:
    parts = [ErrorPart(share, (share - 0.1, share + 0.1)) for share in (0.2, 0.3, *floor, 0.5 - sum(floor))]
    sources = {CORRECTIONS: ("tyre_fall",), "yaw_scrub": ("yaw_scrub",)}
    told = _describe_parts(ErrorParts(0.01, tuple(parts[:2]), tuple(parts[2:-1]), parts[-1]), sources)
    rest = ["noise", "disturbances", "unexplained"] if floor else ["left-noise-included"]
    assert [p.cause for p in told] == ["effect", "corrections", *rest]
    assert sum(p.share for p in told) == pytest.approx(1.0)
