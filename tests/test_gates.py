"""What effects gain by chance, each for itself: levels that any of them exceeds as rarely as is said."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bcid.diagnosis.limits import limit_set_to
from bcid.diagnosis.search import screen
from bcid.effects.table import ENTRIES
from bcid.likelihood.projection import ProjectedChanges
from bcid.likelihood.score_test import (
    Trial,
    TrialChanges,
    greatest_null_gain,
    null_gains,
    null_quantile,
    tail_scale,
)

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


def test_no_level_is_more_than_signs_can_reach(changes: ProjectedChanges, drawn: screen.NullGains) -> None:
    """A gain by chance is greatest when all segments pull the same way; the tail of the draws goes on beyond."""
    most = greatest_null_gain(changes, slice(3, 4))
    assert most == pytest.approx(0.5 * np.abs(changes.each_g[:, 3]).sum() ** 2 / changes.G[0, 3])
    gains = null_gains(changes, [slice(k, k + 1) for k in range(len(NAMES))])
    assert gains[3].max() < most
    assert drawn.levels["mass_change"] <= max(most, greatest_null_gain(changes, slice(2, 3)))
    beyond = null_quantile(gains[3], 1e-9, tail_scale(gains[3]))
    assert beyond > most  # as the tail of draws says


def test_a_level_is_met_as_rarely_where_segments_scatter_more_than_their_noise_says() -> None:
    """Gains are nine times half a chi-square, and none where the multiple would be negative."""
    rng = np.random.default_rng(1)

    def gains(n: int) -> np.ndarray:
        return 4.5 * np.maximum(rng.standard_normal(n), 0.0) ** 2

    levels = [null_quantile(known, 1e-4, tail_scale(known)) for known in (gains(999) for _ in range(40))]
    share = float(np.mean([np.mean(gains(200_000) > level) for level in levels]))
    assert 0.3e-4 < share < 4e-4
    assert np.mean(gains(200_000) > null_quantile(gains(999), 1e-4)) > 10e-4  # with a tail of e⁻ˣ
    assert tail_scale(gains(999) / 30.0) == 1.0  # no tail falls faster than e⁻ˣ


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
