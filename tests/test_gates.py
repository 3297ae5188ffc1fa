"""What effects gain by chance, each for itself: levels that any of them exceeds as rarely as is said."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bcid.diagnosis.limits import limit_set_to
from bcid.diagnosis.search import screen
from bcid.effects.table import ENTRIES
from bcid.likelihood.projection import ProjectedChanges
from bcid.likelihood.score_test import Trial, TrialChanges, null_gains

SEGMENTS, LOUD, P = 40, 3, 1e-2
NAMES = ("motor_dead_zone", "yaw_scrub", "mass_change", "mass_change")


@pytest.fixture
def changes() -> ProjectedChanges:
    """Four changes, the last of which shows nearly in three segments alone, that are six times as loud as others."""
    rng = np.random.default_rng(3)
    J = rng.standard_normal((SEGMENTS, len(NAMES)))
    J[LOUD:, -1] *= 0.1
    r = rng.standard_normal(SEGMENTS)
    r[:LOUD] *= 6.0
    J[:LOUD, :-1] *= 0.1
    information = J**2
    return ProjectedChanges(
        information[None], J * r[:, None], np.ones(SEGMENTS), information.sum(axis=0)[None], r**2,
        np.full(SEGMENTS, 90.0), np.zeros((0, len(NAMES))), np.zeros(0),
    )  # fmt: skip


@pytest.fixture
def drawn(changes: ProjectedChanges, monkeypatch: pytest.MonkeyPatch) -> screen.NullGains:
    vectors = [[[0.1] * len(ENTRIES[name].parameters)] for name in NAMES]
    trials = [Trial(name, own, slice(k, k + 1)) for k, (name, own) in enumerate(zip(NAMES, vectors, strict=True))]
    monkeypatch.setattr(screen, "linearise_fit", lambda *_: None)
    monkeypatch.setattr(screen, "project_out_fit", lambda *_, **__: changes)
    nothing: Any = type("Nothing", (), {"segments": SEGMENTS})()
    with limit_set_to("gate_p_value", P):
        return screen.sample_null_gains(nothing, nothing, TrialChanges(np.zeros((0, 3, 4)), trials))


def test_what_one_effect_gains_by_chance_is_no_reason_to_doubt_another(drawn: screen.NullGains) -> None:
    assert set(drawn.levels) == set(NAMES)
    assert drawn.levels["mass_change"] > 3.0 * max(drawn.levels["motor_dead_zone"], drawn.levels["yaw_scrub"])
    assert drawn.chance_level > 2.0 * drawn.levels["motor_dead_zone"]


def test_any_effect_exceeds_its_own_level_as_rarely_as_is_said(
    changes: ProjectedChanges, drawn: screen.NullGains, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Over signs that were not drawn for the levels."""
    monkeypatch.setattr("bcid.likelihood.score_test.NULL_DRAWS", 200_000)
    monkeypatch.setattr("bcid.likelihood.score_test.SEED", 7)
    gains = null_gains(changes, [slice(k, k + 1) for k in range(len(NAMES))])
    levels = np.array([drawn.levels[name] for name in NAMES])
    share = float(np.mean((gains > levels[:, None]).any(axis=0)))
    assert 0.1 * P < share < 2.0 * P
