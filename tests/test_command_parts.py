"""Commands that change between the grid's rows: their parts, means and losses, and what models make of them."""

from __future__ import annotations

import numpy as np
import pytest

from bcid.effects.constants import Constants
from bcid.estimate.command_parts import (
    cut_into_parts,
    hold_for_periods,
    join_parts,
    mean_commands,
    shift_to_commands,
    stack_parts,
    variance_lost,
)  # fmt: skip
from bcid.estimate.limits import LIMITS
from bcid.models import published
from bcid.models.interface import history_at_rest, mean_command, rollout
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.linear import NewtonEulerLinear
from bcid.models.newton_euler.model import NewtonEuler
from bcid.physics.car import advance_period
from tests.cars import CAR

PERIOD_S = 0.1


def test_parts_are_the_commands_between_rows() -> None:
    command_s = np.array([0.0, 0.13, 0.17, 0.17 + 1e-8, 0.3, 0.45])
    command = np.array([[0.0, 1.0], [0.2, 1.0], [0.2, 1.0], [0.3, 1.0], [0.4, 2.0], [0.4, 2.0]])
    parts = cut_into_parts(command_s, command, PERIOD_S * np.arange(5), PERIOD_S)
    assert parts.shape == (5, 3, 4)
    np.testing.assert_allclose(parts[:, :, 0].sum(axis=1), PERIOD_S)
    np.testing.assert_allclose(parts[0, :, :3], [[0.1, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 1.0]], atol=1e-12)
    np.testing.assert_allclose(parts[1, :, :3], [[0.03, 0.0, 1.0], [0.04, 0.2, 1.0], [0.03, 0.3, 1.0]], atol=1e-7)
    np.testing.assert_allclose(parts[3, 0], [0.1, 0.4, 2.0, 0.0], atol=1e-12)  # a change on the row counts from it on
    np.testing.assert_allclose(mean_commands(parts)[1], [(0.04 * 0.2 + 0.03 * 0.3) / 0.1, 1.0], atol=1e-7)
    assert mean_command(parts, 1) == pytest.approx(mean_commands(parts)[1].tolist())


def test_the_first_command_holds_before_its_time() -> None:
    parts = cut_into_parts(np.array([0.25, 0.35]), np.array([[0.1, 1.0], [0.2, 1.0]]), np.array([0.0, 0.2]), 0.2)
    np.testing.assert_allclose(parts[0, :, :3], [[0.2, 0.1, 1.0], [0.0, 0.1, 1.0]])
    np.testing.assert_allclose(parts[1, :, :3], [[0.15, 0.1, 1.0], [0.05, 0.2, 1.0]])


def test_commands_faster_than_any_servo_are_averaged() -> None:
    time_s = np.arange(2000) / 1000.0
    command = np.column_stack([np.sin(7.0 * time_s), np.where(np.arange(2000) % 2, 1.0, 3.0)])
    parts = cut_into_parts(time_s, command, PERIOD_S * np.arange(15), PERIOD_S)
    assert parts.shape == (15, LIMITS.max_command_parts, 4)
    np.testing.assert_allclose(parts[:, :, 2].mean(axis=1), 2.0, atol=1e-9)
    expected = [command[100 * n : 100 * (n + 1), 0].mean() for n in range(15)]
    np.testing.assert_allclose(mean_commands(parts)[:, 0], expected, atol=1e-9)


def test_arrays_of_parts_join_by_parts_of_no_duration() -> None:
    wide = cut_into_parts(np.array([0.0, 0.05]), np.array([[0.0, 1.0], [1.0, 1.0]]), np.array([0.0, 0.1]), PERIOD_S)
    narrow = hold_for_periods(np.array([[0.3, 2.0], [0.4, 2.0]]), PERIOD_S)
    assert stack_parts([wide, narrow]).shape == (2, 2, 2, 4)
    joined = join_parts([narrow, wide])
    np.testing.assert_allclose(mean_commands(joined), [[0.3, 2.0], [0.4, 2.0], [0.5, 1.0], [1.0, 1.0]])


@pytest.mark.parametrize("phase", [0.0, 0.01, 0.05, 0.0937])
def test_the_grid_is_in_step_with_regular_commands(phase: float) -> None:
    rng = np.random.default_rng(0)
    command_s, command = phase + PERIOD_S * np.arange(600), rng.normal(size=(600, 2))
    shift = shift_to_commands(command_s + 1e-4 * rng.normal(size=600), command, PERIOD_S)
    assert (shift - phase + 0.05) % PERIOD_S == pytest.approx(0.05, abs=1e-3)
    begin = shift_to_commands(command_s, command, PERIOD_S) + PERIOD_S * np.arange(2, 590)
    assert max(variance_lost(cut_into_parts(command_s, command, begin, PERIOD_S))) < 1e-6


def test_the_grid_stays_where_no_other_is_better() -> None:
    rng = np.random.default_rng(1)
    command_s, command = np.sort(rng.uniform(0.0, 60.0, 400)), rng.normal(size=(400, 2))
    assert shift_to_commands(command_s, command, PERIOD_S) == 0.0
    assert shift_to_commands(0.05 * np.arange(1200), rng.normal(size=(1200, 2)), PERIOD_S) == 0.0
    assert shift_to_commands(command_s, np.ones((400, 2)), PERIOD_S) == 0.0


def changing_commands(seconds: float = 20.0, phase: float = 0.037) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    command_s = np.r_[0.0, np.arange(phase, seconds, 0.25)]
    return command_s, np.column_stack([rng.uniform(-1.0, 1.0, len(command_s)), rng.uniform(-0.3, 2.0, len(command_s))])


@pytest.mark.parametrize("kind", ["newton-euler", "newton-euler-linear", "newton-euler-augmented"])
def test_models_in_continuous_time_know_when_commands_change(kind: str) -> None:
    """Steps of 0.1 s with parts agree with steps of 1 ms, in which no command changes."""
    car = CAR._replace(R_1=30.0)
    models = {
        "newton-euler": lambda h: NewtonEuler(car, h, {}),
        "newton-euler-linear": lambda h: NewtonEulerLinear(car, 1.0, h),
        "newton-euler-augmented": lambda h: AugmentedNewtonEuler(
            car, {"steering_delay__tau": 0.12, "motor_delay__tau": 0.04}, Constants(), 1.9, 100.0, h, {}
        ),
    }
    command_s, command = changing_commands()
    coarse_s, fine_s = PERIOD_S * np.arange(200), 1e-3 * np.arange(20000)
    coarse, fine = models[kind](PERIOD_S), models[kind](1e-3)
    rest = history_at_rest(coarse.lags)
    exact = rollout(fine, rest, cut_into_parts(command_s, command, fine_s, 1e-3))[::100]
    found = rollout(coarse, rest, cut_into_parts(command_s, command, coarse_s, PERIOD_S))
    held = rollout(coarse, rest, command[np.searchsorted(command_s, coarse_s + 1e-9) - 1])
    error = np.abs(found - exact).max(axis=0)
    # the linear car's steering angle runs straight within a step
    assert (error < (0.1 if "linear" in kind else 0.02) * exact.std(axis=0)).all(), error
    assert (np.abs(held - exact).max(axis=0) > 5.0 * error).all()


def test_steering_to_and_fro_at_20_hz_is_no_circle() -> None:
    """Only every second command stands on a row of the grid; the others count as much."""
    command_s = 0.05 * np.arange(400)
    command = np.column_stack([np.where(np.arange(400) % 2, -0.3, 0.3), np.full(400, 1.2)])
    coarse_s = PERIOD_S * np.arange(200)
    sindy, car = published.k_sindy(), NewtonEuler(CAR, PERIOD_S, {})
    circling = rollout(car, history_at_rest(0), command[::2])[50:, 2].mean()
    assert circling > 0.3
    parts = cut_into_parts(command_s, command, coarse_s, PERIOD_S)
    assert abs(rollout(sindy, history_at_rest(0), parts)[50:, 2].mean()) < 1e-9
    # the servo, always at its rate limit, swings between straight ahead and a little to the left, where it began
    finely = cut_into_parts(command_s, command, 0.01 * np.arange(2000), 0.01)
    fine = rollout(car.with_period(0.01), history_at_rest(0), finely)
    np.testing.assert_allclose(rollout(car, history_at_rest(0), parts), fine[::10], atol=2e-3)
    assert 0.0 < fine[1000:2000, 2].mean() < 0.15 * circling


def test_a_period_of_one_command_is_as_before() -> None:
    """To the last digit: a period whose command holds is two RK4 steps of half its length."""
    command = np.random.default_rng(4).uniform([-1.0, 0.0], [1.0, 2.0], (50, 2))
    model, state = NewtonEuler(CAR, PERIOD_S, {}), (0.0, 0.0, 0.0, 0.0)
    found = rollout(model, history_at_rest(0), hold_for_periods(command, PERIOD_S))[1:]
    for row, (u_s, u_m) in zip(found, command, strict=True):
        state = advance_period(state, u_s, u_m, CAR, PERIOD_S)
        np.testing.assert_array_equal(row, state[:3])
