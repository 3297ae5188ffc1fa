"""How much curvature overstates what a take says: nothing of a right model, and what is missing of a wrong one."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bcid.likelihood import overconfidence as module
from bcid.likelihood.overconfidence import overconfidence

SEGMENTS, N = 4000, 5


def factor_of(monkeypatch: pytest.MonkeyPatch, pulls: float, idle: bool = False, at_bound: bool = False) -> float:
    """Of segments whose slopes scatter as their information says, and by `pulls` times as much."""
    rng = np.random.default_rng(7)
    roots = rng.standard_normal((SEGMENTS, N, N))
    if idle:
        roots[:, 2] = 0.0
    information = roots @ roots.transpose(0, 2, 1)
    slopes = pulls * np.einsum("sij,sj->si", roots, rng.standard_normal((SEGMENTS, N)))
    bends = np.ones(N, dtype=bool)
    if at_bound:
        slopes[:, 4], bends[4] = 1e3, False
    at = SimpleNamespace(weights=np.ones(SEGMENTS), information=information, slopes=slopes, bends=bends)
    monkeypatch.setattr(module, "linearise_fit", lambda fit, take: at)
    fit: Any = SimpleNamespace(hypothesis=SimpleNamespace(named_size=N))
    take: Any = None
    return overconfidence(fit, take)


def test_a_right_model_is_as_sure_as_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    assert factor_of(monkeypatch, 1.0) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("pulls", [2.0, 5.0])
def test_pulls_of_what_is_missing_make_it_surer_than_it_is_by_their_square(
    pulls: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert factor_of(monkeypatch, pulls) == pytest.approx(pulls**2, rel=0.05)


def test_parameters_at_a_bound_or_not_shown_do_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    assert factor_of(monkeypatch, 3.0, idle=True) == pytest.approx(9.0, rel=0.05)
    assert factor_of(monkeypatch, 3.0, at_bound=True) == pytest.approx(9.0, rel=0.05)


def test_less_scatter_than_expected_is_chance(monkeypatch: pytest.MonkeyPatch) -> None:
    assert factor_of(monkeypatch, 0.5) == 1.0
