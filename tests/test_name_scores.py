"""What an effect would add beside a remainder, to first order: against explicit projections, and of takes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from concealed import concealing

from bcid.diagnosis.limits import SEARCH_LIMITS
from bcid.diagnosis.remainder.explain import basis_for, explain
from bcid.diagnosis.remainder.fit import RemainderFit, fit_with_remainder
from bcid.diagnosis.remainder.information import gather_information
from bcid.diagnosis.search import name_scores
from bcid.diagnosis.search.name_scores import _products_with_trials, score_names
from bcid.diagnosis.search.screen import CandidateEffect, screen_effects, simulate_trials
from bcid.likelihood.refit import Fit, evaluate_fixed
from bcid.likelihood.score_test import TrialChanges
from bcid.likelihood.take import N_NUISANCE, Take


def scored(fit: Fit, take: Take) -> tuple[RemainderFit, TrialChanges, list[CandidateEffect]]:
    """A fit with a remainder beside it, the trials, and the effects by their scores beside it."""
    seen = explain(fit, take, basis_for(fit, take))
    rest, trials = fit_with_remainder(fit, take, seen), simulate_trials(fit, take)
    return rest, trials, score_names(rest, take, trials)


def by_effect(candidates: list[CandidateEffect]) -> dict[str, float]:
    """Scores, best first."""
    return {c.effect: c.score for c in candidates}


def test_products_with_trials_are_those_of_the_explicit_projection() -> None:
    """Of names, functions and trials together, segment by segment, initial states and pushes projected out."""
    fit, take = concealing(60.0, yaw_scrub=20.0)
    basis = basis_for(fit, take)
    at = gather_information(fit, take, basis, np.zeros(len(basis.size)))
    columns = simulate_trials(fit, take).columns[:, :, :6] / fit.scales.r[:, None]
    weights = np.random.default_rng(0).uniform(0.2, 1.0, take.segments)
    slope, G = _products_with_trials(at, columns, weights)
    n, precision = fit.hypothesis.named_size, fit.scales.nuisance_precision()
    b, expected = np.zeros(len(slope)), np.zeros_like(G)
    for s, (i, j) in enumerate(zip(at.first, at.first[1:], strict=False)):
        own, mine = at.rows[i:j].reshape(3 * (j - i), -1), columns[i:j].reshape(3 * (j - i), -1)
        A, J, Q, r = np.split(own, [N_NUISANCE, N_NUISANCE + n, -1], axis=1)
        P = np.eye(len(A)) - A @ np.linalg.inv(A.T @ A + precision) @ A.T
        X = np.column_stack([J, Q @ at.values[s], mine])
        b += weights[s] * (X.T @ P @ r)[:, 0]
        expected += weights[s] * X.T @ P @ X
    expected[:n, :n] += np.diag(at.prior.stiffness(at.phi))
    b[:n] -= at.prior.stiffness(at.phi) * (at.phi - at.prior.centre)
    np.testing.assert_allclose(slope, b, atol=1e-6 * np.abs(b).max())
    scale = np.sqrt(np.abs(np.diag(expected)))
    np.testing.assert_allclose(G / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-6)


@pytest.mark.parametrize(("name", "size"), [("yaw_scrub", 20.0), ("quadratic_drag", 15.0), ("steering_delay", 0.013)])
def test_the_true_name_promises_most_beside_a_remainder(name: str, size: float) -> None:
    """And stand-ins, which the plain score test promises much of as well, next to nothing beside it."""
    fit, take = concealing(**{name: size})
    _, trials, candidates = scored(fit, take)
    scores = by_effect(candidates)
    (first, second), plain = sorted(scores.values(), reverse=True)[:2], screen_effects(fit, take, trials)
    assert scores[name] > first - 1.0  # a short delay and a lag are as good as each other
    assert first > 10.0
    others = [c.score for c in plain if c.effect != name]
    assert max(others) > 2.0 * max(second, 1.0)  # look-alikes keep most, where there are any
    assert 0.0 < candidates[0].values[0] < 3.0 * size


def test_of_two_that_are_missing_each_promises_much_beside_what_the_other_leaves() -> None:
    """A name takes the place of its own channel's functions, and those of the other channel stay."""
    fit, take = concealing(yaw_scrub=20.0, rear_rolling_coulomb=20.0)
    rest, trials, candidates = scored(fit, take)
    without = by_effect(score_names(RemainderFit.without_functions(fit, rest.seen), take, trials))
    assert set(list(without)[:2]) == {"yaw_scrub", "rear_rolling_coulomb"}
    assert list(without.values())[1] > 1.5 * list(without.values())[2]
    # about the fit with a remainder others may promise much, too: both are among those that are refitted
    scores = by_effect(candidates)
    tried = list(scores)[: SEARCH_LIMITS.max_candidates]
    assert {"yaw_scrub", "rear_rolling_coulomb"} <= set(tried)
    assert min(scores[n] for n in ("yaw_scrub", "rear_rolling_coulomb")) > 25.0


def test_no_name_promises_much_where_nothing_is_missing() -> None:
    fit, take = concealing()
    scores = by_effect(scored(fit, take)[2])
    assert max(scores.values()) < 10.0
    assert list(scores.values()) == sorted(scores.values(), reverse=True)


def test_an_effect_of_one_sign_is_not_promised_with_the_other() -> None:
    """A car that is pushed where it should be braked has no negative friction."""
    fit, take = concealing(yaw_scrub=20.0)
    more, phi = fit.hypothesis.add_effect("yaw_scrub", fit.phi, [60.0])  # three times too much of it
    over = evaluate_fixed(take, more, phi, fit.scales)
    for c in scored(over, take)[2]:
        for p, value in zip(more.entries[c.effect].parameters, c.values, strict=True):
            # at no size it costs what its parameters cost, at least
            assert p.is_place or p.low < 0.0 or value > 0.0 or (value == 0.0 and c.score < 0.0), c


def test_scores_are_of_those_that_are_asked_for_only() -> None:
    fit, take = concealing(yaw_scrub=20.0)
    rest, trials, candidates = scored(fit, take)
    scores = by_effect(candidates)
    fewer = score_names(rest, take, trials.without(("yaw_scrub", "yaw_coulomb")))
    assert {c.effect for c in fewer} == set(scores) - {"yaw_scrub", "yaw_coulomb"}
    for c in fewer:
        assert c.score == pytest.approx(scores[c.effect], rel=1e-6, abs=1e-6)
    assert scores["yaw_scrub"] > SEARCH_LIMITS.min_score_share * 10.0


def test_the_greater_of_the_scores_with_and_without_the_remainder_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """With it the pushes are small, without it the fit may be far from where an effect belongs."""
    fit, take = concealing(yaw_scrub=20.0)
    rest, trials, candidates = scored(fit, take)
    assert rest.fit is not rest.named
    without = by_effect(score_names(RemainderFit.without_functions(fit, rest.seen), take, trials))
    about = list[Fit]()
    score_about = name_scores._score_about

    def seen_about(f: Fit, *given: Any) -> dict[str, CandidateEffect]:
        about.append(f)
        return score_about(f, *given)

    monkeypatch.setattr(name_scores, "_score_about", seen_about)
    scores = by_effect(score_names(rest, take, trials))
    assert about[0] is rest.named
    assert about[1] is rest.fit
    monkeypatch.setattr(name_scores, "_score_about", lambda f, *given: score_about(f, *given) if f is rest.fit else {})
    beside = by_effect(score_names(rest, take, trials))
    assert scores == {n: max(s[n] for s in (without, beside) if n in s) for n in scores}
    assert set(scores) == set(without) | set(beside)
    assert scores == by_effect(candidates)
