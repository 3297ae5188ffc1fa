"""Where a mismatch enters: the free functions against the effects that they hold, and channels of concealed ones."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from cars import CAR

from bcid.diagnosis.judge.verdict import Judgement, judge_search
from bcid.diagnosis.limits import LOCATE_LIMITS
from bcid.diagnosis.locate.basis_functions import BASIS_SIZES
from bcid.diagnosis.locate.channel_gains import NO_CIRCLE, channel_gains, pose_changes_by_channel
from bcid.diagnosis.locate.mismatch import RemainingMismatch
from bcid.diagnosis.locate.push_directions import direction_gains
from bcid.diagnosis.locate.pushes import estimate_disturbances
from bcid.diagnosis.locate.regression import DisturbanceRegression, regress_disturbances
from bcid.diagnosis.search.forward_backward import search_effects
from bcid.effects.constants import Constants
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.marginal import Scales
from bcid.likelihood.nuisance import pose_residuals
from bcid.likelihood.predict import wrap_yaw
from bcid.likelihood.prepare import fit_base
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take, cut_segments
from bcid.recording.read import read_recording
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.samples import SampleTake as Order
from bcid.simulation.samples import write_sample_take
from bcid.vehicle import Vehicle

SCALES = Scales(np.array([5e-4, 5e-4, 1e-3]), np.array([0.02, 0.02, 0.02]))
SECONDS = 120.0


@dataclass
class Maker:
    """Makes takes of the simulation, and the base model's fit to them."""

    folder: Path
    vehicle: Vehicle
    tuning: Tuning

    def fitted(self, plant: Plant, sensor: Sensor, seed: int = 3) -> tuple[Fit, Take]:
        path = write_sample_take(self.folder, Order(f"take{seed}", "motive", SECONDS), plant, sensor, seed)
        recording = read_recording(path, self.vehicle)
        take = cut_segments(recording, estimate_motion(recording, self.vehicle, self.tuning))
        return fit_base(take, Hypothesis((), CAR, 2.012, Constants()), SCALES), take


@pytest.fixture(scope="module")
def maker(tmp_path_factory: pytest.TempPathFactory, vehicle: Vehicle, tuning: Tuning) -> Maker:
    return Maker(tmp_path_factory.mktemp("channels"), vehicle, tuning)


@pytest.fixture(scope="module")
def null(maker: Maker) -> tuple[Fit, Take]:
    return maker.fitted(Plant(), Sensor())


@pytest.fixture(scope="module")
def changes(null: tuple[Fit, Take]) -> tuple[np.ndarray, dict[str, slice]]:
    return pose_changes_by_channel(*null, NO_CIRCLE)


ALIKE = [
    ("rear_rolling_viscous", "fx", 1, -0.1), ("front_coulomb_friction", "fx", 4, -0.1),
    ("steering_drag", "fx", 6, -0.1), ("yaw_scrub", "mz", 0, -0.1),
    ("steering_offset", "steering", 2, 1e-5), ("steering_nonlinearity", "steering", 5, 1e-5),
    ("steering_delay", "steering", 6, None), ("steering_speed_gain", "steering", 0, -1e-5),
    ("steering_compliance", "steering", 1, 1e-9), ("body_yaw_misalignment", "pose", 2, 1e-5),
    ("marker_offset", "pose", 0, 1e-4), ("pose_scale", "pose", 3, 1e-5),
]  # fmt: skip
"""Effect, channel and number of the function in it, and a small size; None where only the direction is the same."""


@pytest.mark.parametrize(("effect", "channel", "number", "size"), ALIKE)
def test_a_function_changes_what_its_effect_changes(
    effect: str, channel: str, number: int, size: float | None, null: tuple[Fit, Take],
    changes: tuple[np.ndarray, dict[str, slice]],
) -> None:  # fmt: skip
    """Per unit, by differences of the model with the effect: another code."""
    fit, take = null
    columns, of = changes
    column = columns[:, :, of[channel].start + number]
    more = fit.hypothesis.with_effects(effect)
    parameter = more.entries[effect].parameters[0]
    step = size or 0.02 * parameter.size
    values = [abs(step) if p is parameter else p.off for p in more.entries[effect].parameters]
    r = pose_residuals(take, fit.hypothesis.prediction_inputs(fit.phi, take), fit.start)
    phi = more.phi_of(fit.car(), values)
    there = wrap_yaw(r - pose_residuals(take, more.prediction_inputs(phi, take), fit.start)) / step
    usual = np.abs(there - np.median(there)).max(axis=1) < np.quantile(np.abs(there), 0.999)  # no kink was met
    alike = np.corrcoef(column[usual].ravel(), there[usual].ravel())[0, 1]
    assert abs(alike) > 0.99
    if size is not None:
        assert float((column * there).sum() / (there**2).sum()) == pytest.approx(1.0, abs=0.05)


def test_columns_belong_to_one_channel_each(changes: tuple[np.ndarray, dict[str, slice]]) -> None:
    columns, of = changes
    assert set(of) == {"fx", "fy", "mz", "steering", "motor", "pose", "time"}
    owners = np.concatenate([np.arange(s.start, s.stop) for s in of.values()])
    assert sorted(owners.tolist()) == list(range(columns.shape[2]))
    assert of["steering"].stop - of["steering"].start == BASIS_SIZES["steering"] + 7
    assert np.isfinite(columns).all()


def test_nothing_enters_where_nothing_is_missing(null: tuple[Fit, Take]) -> None:
    gains = channel_gains(*null, None)
    assert max(gains.values()) < LOCATE_LIMITS.min_gain_nats
    assert list(gains.values()) == sorted(gains.values(), reverse=True)
    fit, take = null
    ways = direction_gains(estimate_disturbances(fit, take), fit.car())
    assert ways[0].gain_nats < LOCATE_LIMITS.min_gain_nats
    none = DisturbanceRegression("fy", 0.1, {"fy": 0.1}, (), 0.0, None, 0.25)
    assert RemainingMismatch(none, gains, ways).channel == "fy"  # where most would be predictable


@pytest.mark.parametrize(
    ("plant", "channel"),
    [
        ({"drive_unevenness": 35.0}, "fx"), ({"washboard": 25.0}, "fx"), ({"rear_roll_steer": 0.01}, "fy"),
        ({"tyre_wear": 0.4}, "fy"), ({"motor_dropout": 0.6}, "motor"), ({"steering_shimmy": 0.02}, "steering"),
    ],
)  # fmt: skip
def test_what_no_function_describes_pushes_in_its_channel_s_directions(
    plant: dict[str, float], channel: str, maker: Maker
) -> None:
    fit, take = maker.fitted(Plant()._replace(**plant), Sensor())
    way = direction_gains(estimate_disturbances(fit, take), fit.car())[0]
    assert way.channel == channel
    assert way.gain_nats > 20.0


@pytest.mark.parametrize(
    ("plant", "sensor", "channel"),
    [
        ({"steering_drag": 25.0}, {}, "fx"),
        ({"tyre_relaxation": 0.045}, {}, "fy"),
        ({"yaw_scrub": 14.0}, {}, "mz"),
        ({"motor_lag": 0.06}, {}, "motor"),
        ({"steering_delay": 0.013}, {}, "steering"),
        ({"steering_compliance": 1e-4}, {}, "steering"),
        ({}, {"marker_offset_x": 0.02, "marker_offset_y": 0.02}, "pose"),
        ({}, {"pose_latency": 0.012}, "time"),
    ],
)
def test_a_concealed_effect_enters_in_its_channel(
    plant: dict[str, float], sensor: dict[str, float], channel: str, maker: Maker
) -> None:
    gains = channel_gains(*maker.fitted(Plant()._replace(**plant), Sensor(**sensor)), None)
    assert next(iter(gains)) == channel
    assert gains[channel] > 20.0


def test_what_stands_in_for_something_else_is_dropped(maker: Maker) -> None:
    """A late pose in place of a late servo leaves the motor too late."""
    fit, take = maker.fitted(Plant(steering_delay=0.015), Sensor())
    whole = regress_disturbances(estimate_disturbances(fit, take), fit.car())
    left_out = ("steering_delay", "steering_lag", "tyre_relaxation", "steering_backlash", "steering_dead_band")
    found = search_effects(fit, take, whole, excluded=left_out)
    verdict: Judgement = judge_search(found, take)
    assert found.best.hypothesis.effects == ("pose_latency",)
    assert verdict.dropped == ("pose_latency",)
    assert verdict.verdict == "unknown"
    assert verdict.unexplained.channel == "steering"
    assert verdict.unexplained_nats > 100.0
