"""The servo that the vehicle file does not state: dead time beside it, a bound of its search, and what is not told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fleet import KINDS, draw_drive

from bcid.estimate import steering
from bcid.estimate.steering import D_RANGE, T_S_RANGE, identify_steering
from bcid.estimate.tuning import Noise, SteeringOrigin, Tuning
from bcid.recording.assemble import assemble_recording
from bcid.recording.checks.raw_motion import DEFAULT_TIME_CONSTANT_S
from bcid.recording.checks.steering_fit import SteeringFit, fit_steering


def identify(seed: int, driver: str = "targets", dead_time_s: float = 0.0) -> tuple[float, float, SteeringOrigin]:
    """The servo that is identified from a minute of the 1:10 car, whose commands act `dead_time_s` later."""
    drive = draw_drive(seed, "rc", driver, 60.0)
    raw = replace(drive.raw, command_time_s=drive.raw.command_time_s - dead_time_s)
    vehicle = drive.kind.vehicle(minimal=True)
    return identify_steering([assemble_recording(raw, vehicle)], vehicle)


def describe(T_s: float, d: float, origin: SteeringOrigin) -> list[tuple[str, str]]:
    """What is said of a servo."""
    return Tuning(noise=Noise(), T_s=T_s, d=d, steering=origin).describe_steering()


@pytest.mark.parametrize("dead_time_s", [0.0, 0.08, 0.25])
@pytest.mark.parametrize(("seed", "driver"), [(31001, "wanders"), (31002, "waves")])
def test_a_dead_time_is_not_taken_for_the_servo_s_lag(seed: int, driver: str, dead_time_s: float) -> None:
    T_s, _, origin = identify(seed, driver, dead_time_s)
    truth = KINDS["rc"].plant.servo_time
    assert origin.T_s == "identified"
    assert T_s == pytest.approx(truth, rel=0.1)
    assert origin.T_s_ci95 is not None
    assert origin.T_s_ci95[0] < truth < origin.T_s_ci95[1]


@pytest.fixture
def fitted(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[SteeringFit], SteeringFit]], None]:
    """A function that has every fit of a servo go through a change."""

    def change_fits(change: Callable[[SteeringFit], SteeringFit]) -> None:
        def fit(*given: Any, **named: Any) -> SteeringFit:
            return change(fit_steering(*given, **named))

        monkeypatch.setattr(steering, "fit_steering", fit)

    return change_fits


def test_a_time_constant_that_is_not_told_is_the_documented_one(fitted: Any) -> None:
    """As where the error is so large that not even its size is known."""

    def doubt(fit: SteeringFit) -> SteeringFit:
        covariance = fit.covariance.copy()
        covariance[0, 0] = 1.0
        return replace(fit, covariance=covariance)

    fitted(doubt)
    T_s, d, origin = identify(31001)
    assert (T_s, origin.T_s, origin.T_s_ci95) == (DEFAULT_TIME_CONSTANT_S, "default", None)
    assert ("T_s", "0.15 s (default: the turning does not tell it)") in describe(T_s, d, origin)


@pytest.mark.parametrize(("index", "value", "name", "end"), [
    (0, 1e-3, "T_s", T_S_RANGE[0]), (0, 9.0, "T_s", T_S_RANGE[1]), (1, 100.0, "d", D_RANGE[1]),
])  # fmt: skip
def test_what_ends_at_a_bound_has_no_interval(index: int, value: float, name: str, end: float, fitted: Any) -> None:
    def move(fit: SteeringFit) -> SteeringFit:
        theta = fit.theta.copy()
        theta[index] = np.log(value)
        return replace(fit, theta=theta)

    fitted(move)
    T_s, d, origin = identify(40)
    assert ({"T_s": T_s, "d": d}[name], origin.at_bound) == (end, (name,))
    assert {"T_s": origin.T_s_ci95, "d": origin.d_ci95}[name] is None
    told = describe(T_s, d, origin)
    assert any("identified, at the bound of its search" in text for label, text in told if label == name)
    assert ("steering", f"{name} at a bound: not well identified") in told
