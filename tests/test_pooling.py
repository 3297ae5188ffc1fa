"""Recordings of one car pooled: what all share, what is each one's own, and how much these differ."""

from __future__ import annotations

import numpy as np
import pytest

from bcid.aliases import Floats
from bcid.fleet.pooled_car import expected_spreads
from bcid.fleet.pooling import SpreadPrior, Summary, pool, pool_at

N, FORCES = 4, np.array([[-1.0], [-1.0], [-1.0], [0.0]])
TRUE = np.array([1.0, -0.5, 2.0, 0.3])
EXPECTED = SpreadPrior(np.log([0.3]), np.eye(1))


def draw_summaries(count: int, spread: float, seed: int, strength: float = 400.0) -> tuple[list[Summary], Floats]:
    """Summaries of recordings of a car whose load differs by `spread`, and the loads."""
    rng = np.random.default_rng(seed)
    loads, summaries = spread * rng.standard_normal(count), []
    for load in loads:
        root = rng.standard_normal((N, N))
        H = strength * (root @ root.T / N + 0.2 * np.eye(N))
        phi = TRUE + FORCES[:, 0] * load
        summaries.append(Summary(rng.multivariate_normal(phi, np.linalg.inv(H)), H, np.zeros(N)))
    return summaries, loads


def test_without_differences_pooling_is_the_weighted_mean() -> None:
    summaries, _ = draw_summaries(5, 0.0, 1)
    pooled = pool_at(summaries, FORCES, np.array([1e-9]))
    H = sum(s.information for s in summaries)
    mean = np.linalg.solve(H, sum(s.information @ s.phi for s in summaries))  # type: ignore[arg-type]
    assert pooled.shared == pytest.approx(mean, rel=1e-6)
    assert pooled.shared_covariance == pytest.approx(np.linalg.inv(H), rel=1e-5)  # type: ignore[arg-type]
    assert np.abs(pooled.own).max() < 1e-9


def test_with_free_differences_each_recording_has_its_own() -> None:
    """With nothing known of tau, recordings of a car of one constant keep their own values."""
    alone = [Summary(np.array([x]), np.array([[50.0]]), np.zeros(1)) for x in (1.0, 2.0, 4.0)]
    pooled = pool_at(alone, np.array([[1.0]]), np.array([1e4]))
    assert (pooled.shared + pooled.own[:, 0]).tolist() == pytest.approx([1.0, 2.0, 4.0], abs=1e-4)


def test_the_spread_of_loads_is_found() -> None:
    found = []
    for seed in range(8):
        summaries, _ = draw_summaries(40, 0.15, seed)
        found.append(float(pool(summaries, FORCES, EXPECTED).spread[0]))
    assert np.mean(found) == pytest.approx(0.15, rel=0.1)


def test_intervals_of_loads_and_constants_hold() -> None:
    off = []
    for seed in range(12):
        summaries, loads = draw_summaries(20, 0.15, seed)
        pooled = pool(summaries, FORCES, EXPECTED)
        off += ((pooled.own[:, 0] - loads) / pooled.own_sd[:, 0]).tolist()
        sd = np.sqrt(np.diag(pooled.shared_covariance))
        off.append((pooled.shared[3] - TRUE[3]) / sd[3])
    assert np.mean(np.abs(off) < 1.96) > 0.9
    assert 0.5 < np.mean(np.square(off)) < 1.3


def test_pooling_is_better_than_each_alone() -> None:
    summaries, loads = draw_summaries(20, 0.15, 3, strength=40.0)
    pooled = pool(summaries, FORCES, EXPECTED)
    true = [TRUE + FORCES[:, 0] * load for load in loads]
    alone = np.mean([np.sum((s.phi - t) ** 2) for s, t in zip(summaries, true, strict=True)])
    together = np.mean([np.sum((pooled.constants_of(i, FORCES) - t) ** 2) for i, t in enumerate(true)])
    assert together < 0.5 * alone


def test_a_slope_leads_to_the_optimum() -> None:
    """A recording linearised elsewhere, with its slope there, says the same as at its optimum."""
    summaries, _ = draw_summaries(6, 0.1, 4)
    shift = np.array([0.05, -0.02, 0.04, 0.01])
    moved = [Summary(s.phi + shift, s.information, -s.information @ shift) for s in summaries]
    one, other = (pool(each, FORCES, EXPECTED) for each in (summaries, moved))
    assert other.shared == pytest.approx(one.shared, rel=1e-8)
    assert other.own == pytest.approx(one.own, abs=1e-8)


def test_the_spread_that_is_found_is_the_likeliest_beside_its_prior() -> None:
    summaries, _ = draw_summaries(30, 0.15, 5)

    def log_posterior(log_tau: Floats) -> float:
        beside = float(log_tau[0] - EXPECTED.mean[0])
        return pool_at(summaries, FORCES, np.exp(log_tau)).log_likelihood - 0.5 * beside**2

    found = np.log(pool(summaries, FORCES, EXPECTED).spread)
    assert log_posterior(found) > max(log_posterior(found - 0.01), log_posterior(found + 0.01))


def test_a_constant_that_no_recording_shows_does_no_harm() -> None:
    summaries, _ = draw_summaries(6, 0.1, 6)
    blind = [Summary(np.append(s.phi, 7.0), np.pad(s.information, (0, 1)), np.append(s.slope, 0.0)) for s in summaries]
    pooled = pool(blind, np.append(FORCES, [[0.0]], axis=0), EXPECTED)
    assert pooled.shared[N] == pytest.approx(7.0)
    assert pooled.shared[:N] == pytest.approx(pool(summaries, FORCES, EXPECTED).shared, rel=1e-5)


def test_the_slope_is_the_derivative_of_the_likelihood() -> None:
    summaries, _ = draw_summaries(7, 0.15, 8)
    directions, spread = np.column_stack([FORCES, np.eye(N)]), np.array([0.2, 0.03, 0.05, 0.01, 0.1])
    slope = pool_at(summaries, directions, spread).slope
    for number in range(len(spread)):
        step = 1e-4 * np.eye(len(spread))[number]
        high, low = (pool_at(summaries, directions, spread * np.exp(sign * step)) for sign in (1.0, -1.0))
        assert slope[number] == pytest.approx((high.log_likelihood - low.log_likelihood) / 2e-4, rel=1e-5)


@pytest.mark.parametrize("drives", [2, 3, 5])
@pytest.mark.parametrize("scatter", [0.005, 0.03])
def test_factors_of_few_drives_have_honest_errors(drives: int, scatter: float) -> None:
    """Constants that agree by chance in two drives do not make their load certain."""
    rng, constants, se, off = np.random.default_rng([drives, round(1000 * scatter)]), 8, 0.01, list[float]()
    directions = np.column_stack([-np.ones(constants), np.eye(constants)])
    for _ in range(30):
        loads = rng.uniform(0.0, 0.35, drives)
        sd = scatter * np.exp(0.5 * rng.standard_normal(constants))
        phi = -loads[:, None] + sd * rng.standard_normal((drives, constants))
        phi += se * rng.standard_normal((drives, constants))
        information = np.eye(constants) / se**2
        summaries = [Summary(each, information, np.zeros(constants)) for each in phi]
        pooled = pool(summaries, directions, expected_spreads(1, constants))
        apart = pooled.own[1:, 0] - pooled.own[0, 0] - (loads[1:] - loads[0])
        off += [x / pooled.difference_sd([i], [0])[0] for i, x in enumerate(apart.tolist(), 1)]
    assert np.mean(np.abs(off) < 2.0) > 0.85
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.6
