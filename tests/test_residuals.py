"""Whether a model's residuals on its own takes show that physics is missing from it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from exported_models import MODELS

from bcid.cli.show_fits import ScoredFit, warnings_of_fits
from bcid.errors import InputRefused
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.evaluation.limits import LIMITS
from bcid.evaluation.residuals import FILE_NAME, ResidualsDocument, load_residuals, measure_residuals, save_residuals
from bcid.models import published
from bcid.models.interface import FitTask
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.parameters import BIASED_TWISTS
from bcid.recording.read import read_recording
from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.samples import SampleTake, write_sample_take
from bcid.vehicle import Vehicle


def fitted(folder: Path, extras: dict[str, Any], vehicle: Vehicle, tuning: Tuning) -> tuple[NewtonEuler, Estimate]:
    """A car fitted to two minutes of a simulated one with `extras` that the model does not know, and that motion."""
    path = write_sample_take(folder, SampleTake("t", "mcap", 120.0), Plant(**extras), Sensor(), 3)
    estimate = estimate_motion(read_recording(path, vehicle), vehicle, tuning)
    return NewtonEuler.fit(FitTask([estimate], vehicle, {"loss": "one-step", "starts": 2}, 1)), estimate


@pytest.mark.parametrize(("extras", "missing"), [({}, False), (REAL_EXTRAS, True)], ids=["paper's car", "real car"])
def test_residuals_tell_a_model_that_lacks_physics(
    tmp_path: Path, vehicle: Vehicle, tuning: Tuning, extras: dict[str, Any], missing: bool
) -> None:
    model, estimate = fitted(tmp_path, extras, vehicle, tuning)
    told = measure_residuals(model, [estimate])
    assert told.show_missing_physics == missing
    assert told.predictions > 90
    assert told.multiple == pytest.approx((told.ratio or math.nan) / LIMITS.usual_residual_ratio)
    save_residuals(told, tmp_path)
    assert load_residuals(tmp_path) == told


def test_a_wrong_constant_is_seen(tmp_path: Path, vehicle: Vehicle, tuning: Tuning) -> None:
    model, estimate = fitted(tmp_path, {}, vehicle, tuning)
    wrong = NewtonEuler(model.car._replace(C_f=0.8 * model.car.C_f), model.period_s, model.facts)
    told, right = (measure_residuals(m, [estimate]) for m in (wrong, model))
    assert told.show_missing_physics
    assert told.multiple > 1.3 * right.multiple


@pytest.mark.parametrize("name", sorted(MODELS))
def test_only_of_cars_without_effects_is_there_a_ratio(name: str, estimates: list[Estimate]) -> None:
    """Kinematic models start from slip angles, others from many rows: what a wrong start makes of them is not known."""
    told, is_car = measure_residuals(MODELS[name], estimates), name in ("newton-euler", "newton-euler-linear")
    assert (told.ratio is not None, told.predictions > 0) == (is_car, is_car)
    if not is_car:
        assert told.as_json()["ratio"] is None
        assert not told.show_missing_physics


def test_takes_that_are_too_short_say_nothing(vehicle: Vehicle, estimates: list[Estimate]) -> None:
    told = measure_residuals(published.newton_euler(), [estimates[0].select_rows(slice(0, 4))])
    assert told == ResidualsDocument(horizon_s=1.0, predictions=0, ratio=None)
    assert not told.show_missing_physics
    assert math.isnan(told.multiple)


@pytest.mark.parametrize(("loss", "biased"), [("one-step", True), ("rollout", True), ("poses", False)])
def test_constants_fitted_to_velocities_are_told_without_their_bias(tmp_path: Path, loss: str, biased: bool) -> None:
    facts = {"fitted": {"C_f": {"unit": "N/rad", "meaning": "C_f", "relative_se": 0.0012}}, "loss": loss}
    model = replace(published.newton_euler(), facts=facts)
    told = warnings_of_fits([ScoredFit("car", tmp_path, tmp_path, model, None, None)])
    assert told == ([f"car: {BIASED_TWISTS}"] if biased else [])
    assert "for constants use --loss poses" in BIASED_TWISTS


def test_a_damaged_file_is_refused_and_a_missing_one_says_nothing(tmp_path: Path) -> None:
    assert load_residuals(tmp_path) is None
    for text in ("{", '{"schema": "bcid.residuals/2"}', '{"schema": "bcid.residuals/1", "horizon_s": "x"}'):
        (tmp_path / FILE_NAME).write_text(text, encoding="utf-8")
        with pytest.raises(InputRefused, match=FILE_NAME):
            load_residuals(tmp_path)
