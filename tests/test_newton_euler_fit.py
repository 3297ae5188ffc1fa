"""The Newton-Euler fit: the vectorised objective is the plain model, and what is said of its constants is true."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from cars import CAR

from bcid.errors import InputRefused, PredictionDiverged
from bcid.estimate.types import Estimate
from bcid.models.fitting import levenberg_marquardt
from bcid.models.fitting.levenberg_marquardt import NormalEquations
from bcid.models.fitting.windows import Windows, cut_windows, inverse_spread, loss_steps
from bcid.models.interface import FitTask
from bcid.models.newton_euler import fit_to_twists
from bcid.models.newton_euler.fit_to_twists import TwistObjective
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.objective import TransposedWindows, predict_twists, twist_nmse
from bcid.models.newton_euler.parameters import ConstantBox
from bcid.physics.car import Car, rk4_step
from bcid.vehicle import Vehicle

PERIOD_S = 0.1


def plain(car: Car, w: Windows) -> np.ndarray:
    """Twists (B, S, 3) by `advance` alone, stretch by stretch."""
    out = np.empty((w.stretch_count, w.command.shape[1] - 1, 3))
    for b in range(w.stretch_count):
        state = (*w.twist[b, 0], w.kinematic[b, 0, 3])
        for k in range(out.shape[1]):
            for duration, u_s, u_m, _ in w.parts[b, k]:
                halves = 2 if duration > 0.5 * PERIOD_S + 1e-9 else 1
                for _ in range(halves if duration > 0.0 else 0):
                    state = rk4_step(state, u_s, u_m, car, duration / halves)
            out[b, k] = state[:3]
    return out


CARS = (CAR, CAR._replace(sets_force=1.0, K_t=500.0, u_0=0.1, K_v=40.0, front_share=0.3), CAR._replace(K_b=100.0))


@pytest.mark.parametrize("steps", [1, 20])
def test_the_objective_is_the_plain_model(steps: int, estimates: list[Estimate]) -> None:
    taken = cut_windows(estimates, steps, steps)
    of, weight = TransposedWindows.from_windows(taken, PERIOD_S), inverse_spread(taken.twist[:, 0])
    found, cost = predict_twists(CARS, of), twist_nmse(np.array(CARS), of, weight)
    for car, twists, nmse in zip(CARS, found, cost, strict=True):
        reference = plain(car, taken)
        np.testing.assert_allclose(twists.transpose(2, 0, 1), reference, rtol=0.0, atol=1e-11)
        assert nmse == pytest.approx(np.mean((weight * (reference - taken.twist[:, 1:])) ** 2), rel=1e-10)


def test_one_step_stretches_are_the_transitions(estimates: list[Estimate]) -> None:
    from bcid.models.fitting.windows import single_steps

    taken, one = cut_windows(estimates, 1, 1), single_steps(estimates)
    np.testing.assert_array_equal(taken.twist[:, 0], one.twist[:, 0])
    np.testing.assert_array_equal(taken.twist[:, 1], one.next_twist)
    np.testing.assert_array_equal(taken.command[:, 0], one.command[:, 0])
    assert loss_steps("one-step", 2.0, PERIOD_S) == 1
    assert loss_steps("rollout", 2.0, PERIOD_S) == 20


def test_no_stretch_straddles_two_segments(estimates: list[Estimate]) -> None:
    whole = estimates[0]
    cut = np.where(np.arange(len(whole)) < 100, 1, 2)
    taken = cut_windows([Estimate(**{**whole.__dict__, "segment": cut})], 20, 7, lags=2)
    rows = np.array([np.flatnonzero((whole.twist == t[0]).all(axis=1))[0] for t in taken.twist])
    assert ((rows + 22 < 100) | (rows >= 100)).all()
    assert taken.twist.shape[1] == 23


def normal_of(misses: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], NormalEquations]:
    """The normal equations of plain residuals, by central differences."""

    def at(x: np.ndarray) -> NormalEquations:
        r = misses(x)
        J = np.column_stack([(misses(x + 1e-6 * e) - misses(x - 1e-6 * e)) / 2e-6 for e in np.eye(len(x))])
        return NormalEquations(J.T @ J, J.T @ r, float(r @ r))

    return at


def test_the_normal_equations_are_those_of_the_whole_jacobian(estimates: list[Estimate], vehicle: Vehicle) -> None:
    taken = cut_windows(estimates, 5, 2)
    objective = TwistObjective(
        ConstantBox(vehicle, 0.155, 1.418, 1.0, 2.0),
        TransposedWindows.from_windows(taken, PERIOD_S),
        np.array([1.0, 2.0, 0.5]),
    )
    x = np.random.default_rng(0).uniform(0.3, 0.7, len(objective.box.constants))
    J, r, found = objective.jacobian(x), objective.residuals(x[None])[0], objective.normal_equations(x)
    np.testing.assert_allclose(found.JJ, J.T @ J, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.Jr, J.T @ r, rtol=1e-9, atol=1e-12)
    assert found.rr == pytest.approx(r @ r)
    assert found.rr == pytest.approx(objective.costs(x[None])[0])


def test_the_small_problem_has_the_same_slope_curvature_and_cost() -> None:
    rng = np.random.default_rng(1)
    J, r = rng.standard_normal((50, 4)), rng.standard_normal(50)
    J[:, 3] = 0.0  # a constant without effect
    f, small = levenberg_marquardt.compress_normal_equations(NormalEquations(J.T @ J, J.T @ r, float(r @ r)))
    np.testing.assert_allclose(small.T @ small, J.T @ J, atol=1e-10)
    np.testing.assert_allclose(small.T @ f, J.T @ r, atol=1e-10)
    assert f @ f == pytest.approx(r @ r)


def test_least_squares_goes_down_rosenbrock_s_valley() -> None:
    def misses(x: np.ndarray) -> np.ndarray:
        u = 3.0 * x - 1.0
        return np.array([10.0 * (u[1] - u[0] ** 2), 1.0 - u[0]])

    at = normal_of(misses)
    found = levenberg_marquardt.minimise_squares(at, at, [np.array([0.1, 0.9])], lambda share, text: None)
    np.testing.assert_allclose(3.0 * found.x - 1.0, 1.0, atol=1e-4)
    assert found.cost < 1e-8


def test_a_start_that_leaves_the_numbers_is_no_start() -> None:
    at = normal_of(lambda x: np.where(x > 0.5, np.nan, x - 0.2))
    found = levenberg_marquardt.minimise_squares(at, at, [np.array([0.9]), np.array([0.4])], lambda share, text: None)
    assert found.x == pytest.approx([0.2])
    with pytest.raises(PredictionDiverged):
        levenberg_marquardt.minimise_squares(at, at, [np.array([0.9])], lambda share, text: None)


def test_takes_that_no_car_follows_are_refused(
    estimates: list[Estimate], vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    def diverge(*_: object) -> None:
        raise PredictionDiverged("no start of the fit stays within the finite numbers")

    monkeypatch.setattr(fit_to_twists, "minimise_squares", diverge)
    with pytest.raises(InputRefused, match="cannot follow them: no start"):
        NewtonEuler.fit(FitTask(estimates, vehicle, {}, 1))


def test_the_description_says_what_is_tied_and_what_is_held(estimates: list[Estimate], tmp_path: Path) -> None:
    facts = {
        "optimiser": "Levenberg-Marquardt from 8 starts",
        "fit_quality": "rollout NMSE of the training takes 0.0015", "at_bound": ["F_r_max"],
        "correlated": [("K_t", "R_1", 0.97)], "mass_given": False,
        "fitted": {
            s: {"unit": "N", "low": 0.0, "high": 1.0, "meaning": "so", "relative_se": 0.01} for s in ("K_t", "F_r_max")
        },
    }  # fmt: skip
    text = NewtonEuler(CAR, PERIOD_S, facts).describe()
    assert "K_t and R_1 are correlated (+0.97)" in text
    assert "F_r_max   * not identified" in text
    assert "m, I_z and all forces scale together: m is fixed" in text
    assert "forces read as accelerations" in text
    assert "Levenberg-Marquardt from 8 starts; rollout NMSE of the training takes 0.0015" in text
