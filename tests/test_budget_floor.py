"""The error that a perfect model would have is measured as that of the model is: with parameters that were fitted."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from bcid.diagnosis.judge.prediction_error import simulate_fitted_car
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning
from bcid.likelihood.prepare import base_hypothesis, prepare_and_fit_base
from bcid.likelihood.refit import refit
from bcid.likelihood.take import build_take
from bcid.models.fitting.windows import inverse_spread
from bcid.models.newton_euler.initial_guess import guess_car
from bcid.pipeline import error_budget
from bcid.recording.read import read_recording
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.samples import SampleTake, write_sample_take
from bcid.vehicle import Vehicle


def test_a_drive_of_the_fitted_car_itself_leaves_nothing_unexplained(
    tmp_path: Path, vehicle: Vehicle, tuning: Tuning, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the measured drive is the one that the fitted car drives in simulation, v(all) is the floor.

    Were the floor's car to know its parameters, what estimating them makes would be called unexplained.
    """
    path = write_sample_take(tmp_path, SampleTake("t", "mcap", 60.0), Plant(rough_force=3.0), Sensor(), 1)
    driven = read_recording(path, vehicle)
    motion = estimate_motion(driven, vehicle, tuning)
    start = guess_car([motion], vehicle, *motion.steering_constants(), 0.05)
    with threadpool_limits(1, "blas"):
        hypothesis = base_hypothesis(vehicle, start, [motion])
        take, _, (fit, _) = prepare_and_fit_base([driven], [motion], hypothesis, ())
        own = simulate_fitted_car(fit, take, driven)
        own_motion = estimate_motion(own, vehicle, tuning, motion.period_s)
        own_take, _ = build_take([own], [own_motion], fit.car(), hypothesis.angle_limit)
        own_fit = refit(own_take, hypothesis, fit.phi, own_take.start, fit.scales)
        weights, block = inverse_spread(motion.twist), error_budget._blocks(own_motion, own, own_take)
        held_out = error_budget._held_out_squares(own_fit, own_take, own_motion, block, weights)
        diagnosis: Any = SimpleNamespace(fit=fit, take=take)
        floor, floor_block = error_budget._floor_squares(diagnosis, driven, vehicle, tuning, motion)
    assert floor.sum(axis=0) == pytest.approx(held_out, rel=1e-6, nan_ok=True)
    assert np.array_equal(floor_block, block)
    assert np.nanmean(floor[0]) < np.nanmean(floor.sum(axis=0)), "disturbances add to what noise makes"
    monkeypatch.setattr(error_budget, "simulate_fitted_car", lambda *_: None)
    monkeypatch.setattr(error_budget, "none_if_diverged", lambda function, *arguments: function(*arguments))
    assert error_budget._floor_squares(diagnosis, driven, vehicle, tuning, motion)[0].shape == (0, len(motion))
