"""Commands beyond the stop, in single precision, in degrees, chattering, and of two sources."""

from __future__ import annotations

import numpy as np
import pytest

from bcid.errors import InputRefused
from bcid.recording.checks.plausibility import check_commands
from bcid.recording.checks.samples import Samples, check_command_times, clocks_alternate
from bcid.vehicle import Vehicle


def car(limit: float) -> Vehicle:
    return Vehicle.model_validate({
        "name": "car", "body": {"cog_to_front_m": 0.16, "cog_to_rear_m": 0.15}, "steering": {"max_angle_rad": limit},
    })  # fmt: skip


def commands(steering: np.ndarray) -> np.ndarray:
    return np.column_stack([steering, np.ones(len(steering))])


@pytest.mark.parametrize("limit", [0.1, 0.3, 0.4, 0.436332, 0.7, 2.012])
def test_full_lock_in_single_precision_is_not_beyond_the_stop(limit: float) -> None:
    lock = np.where(np.arange(400) % 40 < 20, limit, -limit).astype(np.float32).astype(float)
    assert check_commands(commands(lock), car(limit), "take") == []


@pytest.mark.parametrize("asked", [0.41, 0.5, 0.8, 1.5])
def test_planners_that_ask_beyond_the_stop_are_counted(asked: float) -> None:
    (told,) = check_commands(commands(np.where(np.arange(400) % 40 < 32, asked, 0.1)), car(0.4), "take")
    assert (told.kind, told.action, told.count) == ("steering command", "fixed", 320)
    assert f"up to {asked:.3g}, act as the limit" in told.detail


@pytest.mark.parametrize("limit", [0.3, 0.4, 0.7, 2.012])
@pytest.mark.parametrize("share", [0.15, 0.5, 1.0])
def test_degrees_are_refused(limit: float, share: float) -> None:
    degrees = np.degrees(share * limit) * np.sin(np.arange(400) / 20.0)
    with pytest.raises(InputRefused, match="degrees"):
        check_commands(commands(degrees), car(limit), "take")


def samples(time_s: np.ndarray, values: np.ndarray) -> Samples:
    return Samples(time_s, values, [])


def test_a_controller_that_chatters_is_one_source() -> None:
    """Between two levels, with noise, at 50 Hz, whatever its jitter."""
    rng = np.random.default_rng(1)
    sign = np.where(np.arange(1000) % 2 == 0, 1.0, -1.0)
    for jitter in (0.0, 1e-4, 2e-3, 5e-3):
        time_s = np.arange(1000) / 50.0 + rng.uniform(0.0, jitter, 1000)
        check_command_times(samples(time_s, commands(0.3 * sign + rng.normal(0.0, 0.02, 1000))), 0.5, "take")


@pytest.mark.parametrize("lag", [0.005, 0.02, 0.03])
@pytest.mark.parametrize("drift", [0.0, 2e-5])
def test_two_clocks_with_values_by_turns_are_two_sources(lag: float, drift: float) -> None:
    rng = np.random.default_rng(2)
    one = np.arange(600) / 20.0
    other = one + lag + drift * np.arange(600) + rng.normal(0.0, 5e-4, 600)
    time_s = np.r_[one, other]
    values = np.r_[0.3 * np.sin(one), np.zeros(600)]
    order = np.argsort(time_s)
    assert clocks_alternate(time_s[order])
    with pytest.raises(InputRefused, match="two sources of commands alternate"):
        check_command_times(samples(time_s[order], commands(values[order])), 0.5, "take")


def test_two_publishers_in_step_are_told_by_their_channels() -> None:
    time_s = np.arange(1200) / 40.0
    values = commands(np.where(np.arange(1200) % 2 == 0, 0.3 * np.sin(time_s), 0.0))
    check_command_times(samples(time_s, values), 0.5, "take")
    with pytest.raises(InputRefused, match="two sources"):
        check_command_times(samples(time_s, values), 0.5, "take", several_publishers=True)


def test_times_of_one_clock_do_not_alternate() -> None:
    rng = np.random.default_rng(4)
    even = np.arange(600) / 20.0
    for time_s in (
        even, even + rng.normal(0.0, 5e-3, 600), np.cumsum(rng.exponential(0.05, 600)),
        even + 3.0 * (np.arange(600) > 200), np.delete(even, [5, 80, 81, 300]), even[:4],
    ):  # fmt: skip
        assert not clocks_alternate(time_s)
