"""Newton steps that are judged after the free parts have settled: along a valley, over dents, and where they end."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bcid.errors import PredictionDiverged
from bcid.likelihood import newton, refit_with_pushes
from bcid.likelihood.newton import RefitState, bounded_newton_step
from bcid.likelihood.refit_with_pushes import PATIENCE, SLACK, refit_by_leaps

FAR = 40.0
STEP = 0.5  # that Newton's method dares, whatever lies ahead


class Valley:
    """A hypothesis of one parameter whose objective is known everywhere, and seen to a step ahead only."""

    size, bound = 1, np.inf
    is_place = np.array([False])

    def __init__(self, monkeypatch: pytest.MonkeyPatch, objective: Callable[[float, int], float]) -> None:
        self.calls, self._objective = 0, objective
        self.asked: list[float] = []  # where it was asked how predictions answer
        monkeypatch.setattr(refit_with_pushes, "_evaluate_twice", self._standing)
        monkeypatch.setattr(newton, "tangent_at", lambda problem, now: self.asked.append(float(now.phi[0])))
        monkeypatch.setattr(newton, "slope_and_curvature", self._slope)

    hypothesis = property(lambda self: self)

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        return np.array([-np.inf]), np.array([self.bound])

    def _standing(self, problem: Any, phi: np.ndarray, start: Any, scales: Any) -> RefitState:
        self.calls += 1
        objective = self._objective(float(phi[0]), self.calls)
        if np.isnan(objective):
            raise PredictionDiverged
        nothing: Any = None
        return RefitState(phi, start, scales, nothing, nothing, nothing, objective)

    def _slope(self, problem: Any, tangent: Any, now: RefitState) -> tuple[np.ndarray, np.ndarray]:
        return np.clip([FAR - now.phi[0]], -STEP, STEP), np.eye(1)


def leap(valley: Valley) -> float:
    problem: Any = valley
    return float(refit_by_leaps(problem, np.zeros(1), *(None, None), 24)[1].phi[0])  # type: ignore[arg-type]


def test_a_straight_valley_is_crossed_in_ever_longer_leaps(monkeypatch: pytest.MonkeyPatch) -> None:
    valley = Valley(monkeypatch, lambda phi, n: -abs(phi - FAR))
    assert leap(valley) == pytest.approx(FAR, abs=STEP)
    assert valley.calls < FAR / STEP  # that steps of their own length would take


def test_a_dent_is_no_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """Settling anew makes the same parameters better or worse by so much; a deep one is not crossed."""
    for depth, end in ((0.9 * SLACK, FAR), (50.0, 0.0)):
        valley = Valley(monkeypatch, lambda phi, n, depth=depth: -depth if 1e-9 < phi < 1.2 * STEP else 10.0 * phi)
        valley.bound = FAR
        assert leap(valley) == pytest.approx(end, abs=STEP)


def test_the_best_that_was_passed_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of leaps that lose a little each, as many as patience bears."""
    valley = Valley(monkeypatch, lambda phi, n: -0.1 * phi)
    assert leap(valley) == 0.0
    assert valley.calls <= 1 + 2 * PATIENCE


def test_what_settles_on_and_on_is_no_reason_to_go_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every settling of the same parameters may gain a little more."""
    valley = Valley(monkeypatch, lambda phi, n: phi - 0.95**n)
    valley.bound = 3.0
    assert leap(valley) == 3.0
    assert valley.calls < 20


def test_where_predictions_have_no_slope_no_refit_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    valley = Valley(monkeypatch, lambda phi, n: phi)
    slope = valley._slope

    def edge(problem: Any, tangent: Any, now: RefitState) -> tuple[np.ndarray, np.ndarray]:
        if now.phi[0] > 5.0:
            raise PredictionDiverged
        return slope(problem, tangent, now)

    monkeypatch.setattr(newton, "slope_and_curvature", edge)
    assert 3.0 < leap(valley) <= 5.0


def test_the_ends_of_the_numbers_and_of_the_bounds_are_not_crossed(monkeypatch: pytest.MonkeyPatch) -> None:
    assert leap(Valley(monkeypatch, lambda phi, n: phi if phi < 7.0 else np.nan)) == pytest.approx(7.0, abs=STEP)
    valley = Valley(monkeypatch, lambda phi, n: phi)
    valley.bound = 3.0
    assert leap(valley) == 3.0


def test_how_predictions_answer_is_asked_only_where_a_leap_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is half the work, and of no use where a step is turned down."""
    valley = Valley(monkeypatch, lambda phi, n: -50.0 if phi > 1e-9 else 0.0)
    assert leap(valley) == 0.0
    assert valley.calls > 1
    assert valley.asked == [0.0]
    valley = Valley(monkeypatch, lambda phi, n: -abs(phi - 4.0 * STEP))  # a stretch goes too far at last
    assert leap(valley) == pytest.approx(4.0 * STEP, abs=STEP)
    assert len(valley.asked) < valley.calls


def test_over_an_edge_all_else_goes_on_without_the_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """A place that Newton's method would move falls off an edge at once; the rest has a valley to go along."""

    class Floor(Valley):
        edge = 1e-9
        size, is_place = 2, np.array([False, True])

        def bounds(self) -> tuple[np.ndarray, np.ndarray]:
            return np.array([-np.inf, -10.0]), np.array([np.inf, 10.0])

        def _standing(self, problem: Any, phi: np.ndarray, start: Any, scales: Any) -> RefitState:
            state = super()._standing(problem, phi, start, scales)
            return state._replace(objective=state.objective - (100.0 if phi[1] > self.edge else -phi[1]))

        def _slope(self, problem: Any, tangent: Any, now: RefitState) -> tuple[np.ndarray, np.ndarray]:
            slope, _ = super()._slope(problem, tangent, now)
            return np.array([slope[0], 0.1]), np.eye(2)

    problem: Any = Floor(monkeypatch, lambda phi, n: -abs(phi - FAR))
    end = refit_by_leaps(problem, np.zeros(2), *(None, None), 24)[1].phi  # type: ignore[arg-type]
    assert end[0] == pytest.approx(FAR, abs=STEP)
    assert end[1] == 0.0
    monkeypatch.setattr(Floor, "edge", 1.0)  # before which the place gains by moving too
    end = refit_by_leaps(problem, np.zeros(2), *(None, None), 24)[1].phi  # type: ignore[arg-type]
    assert end[0] == pytest.approx(FAR, abs=STEP)
    assert 0.0 < end[1] <= 1.0


def test_what_has_no_room_bends_no_other_step() -> None:
    """Two components that pull on each other: the one that is held takes no part, not even for a moment."""
    slope, curvature = np.array([0.2, 2.0]), np.array([[1.0, 0.9], [0.9, 1.0]])
    low, high = np.array([-1.0, 0.0]), np.array([1.0, 0.0])
    np.testing.assert_allclose(bounded_newton_step(np.zeros(2), slope, curvature, (low, high)), [0.2, 0.0])


@pytest.mark.parametrize(("then", "settled"), [(5.0, 5.0), (0.1, 0.0), (-1.0, 0.0), (np.nan, 0.0)])
def test_free_parts_settle_anew_for_the_scales_found_with_them_where_that_gains(
    then: float, settled: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[Any] = []

    def standing_at(problem: Any, phi: Any, start: Any, scales: Any, em: int) -> RefitState:
        given.append((start, scales))
        n, objective = len(given), (0.0, then)[len(given) - 1]
        if np.isnan(objective):
            raise PredictionDiverged
        nothing: Any = None
        return RefitState(phi, n, n, nothing, ("tangent", n), nothing, objective)  # type: ignore[arg-type]

    monkeypatch.setattr(newton, "evaluate_at", standing_at)
    anything: Any = None
    now = refit_with_pushes._evaluate_twice(anything, np.zeros(1), *(0, 0))  # type: ignore[arg-type]
    assert now.objective == settled
    assert ("tangent", now.start) == now.A  # the tangent belongs to it
    assert given == [(0, 0), (1, 1)]  # from what was found first
