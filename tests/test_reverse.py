"""Cars that reverse: a throttle below zero drives backward, and the brake is a channel of its own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bcid.effects.constants import Constants
from bcid.errors import InputRefused
from bcid.estimate.command_parts import cut_into_parts, hold_for_periods, mean_commands
from bcid.estimate.run import estimate_motion
from bcid.models.interface import FitTask, history_at_rest, rollout
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.linear import NewtonEulerLinear
from bcid.models.newton_euler.model import NewtonEuler
from bcid.physics.car import Car, motor_force
from bcid.recording.checks.plausibility import check_plausibility
from bcid.recording.types import Stream
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import COMMAND_HZ, simulate_drive
from bcid.vehicle import Vehicle
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle
from tests.cars import CAR

REVERSING = CAR._replace(reverses=1.0)
FORCE = REVERSING._replace(sets_force=1.0, K_t=300.0, u_0=0.1, K_v=60.0)


@pytest.mark.parametrize("car", [REVERSING, FORCE], ids=["speed", "force"])
def test_the_motor_is_the_same_backward(car: Car) -> None:
    rng = np.random.default_rng(0)
    for u_m, v_w in rng.uniform(-2.0, 2.0, (50, 2)):
        assert motor_force(u_m, v_w, car) == -motor_force(-u_m, -v_w, car)
    assert motor_force(-1.0, 0.0, car) < 0.0 < motor_force(-1.0, 0.5, car._replace(reverses=0.0)) + 1e3
    assert motor_force(-1.0, 0.5, car._replace(reverses=0.0)) < 0.0 == motor_force(-1.0, 0.0, CAR)


def models(car: Car) -> list[NewtonEuler | NewtonEulerLinear | AugmentedNewtonEuler]:
    still = AugmentedNewtonEuler(car, {}, Constants(), 1.9, 100.0, 0.1, {})
    return [NewtonEuler(car, 0.1, {}), NewtonEulerLinear(car, 1.0, 0.1), still]


def test_cars_drive_backward_as_forward() -> None:
    ahead = np.tile([0.0, 1.2], (60, 1))
    for model in models(REVERSING):
        rest = history_at_rest(model.lags)
        forward, backward = rollout(model, rest, ahead), rollout(model, rest, -ahead)
        np.testing.assert_allclose(backward[:, 0], -forward[:, 0], atol=1e-12)
        assert forward[-1, 0] > 0.9


def test_the_brake_is_a_channel_of_its_own() -> None:
    """It slows a car down in either direction, from the moment at which it is on."""
    command_s = np.array([0.0, 3.03])
    for way in (1.0, -1.0):
        driven = np.array([[0.0, 1.2 * way, 0.0], [0.0, 0.0, 0.8]])
        coasting = cut_into_parts(command_s, driven[:, :2], 0.1 * np.arange(40), 0.1)
        braked = cut_into_parts(command_s, driven, 0.1 * np.arange(40), 0.1)
        assert braked[30, :, 3].tolist() == [0.0, 0.8]
        np.testing.assert_array_equal(mean_commands(braked), mean_commands(coasting))
        speeds = []
        for model in models(REVERSING):
            rest = history_at_rest(model.lags)
            free, slowed = (rollout(model, rest, p)[:, 0] for p in (coasting, braked))
            np.testing.assert_array_equal(free[:31], slowed[:31])
            assert 0.0 < way * slowed[-1] < 0.5 * way * free[-1]
            speeds.append(slowed[-1])
        assert speeds[0] == pytest.approx(speeds[2], rel=1e-3)
    # and many at once
    model = NewtonEuler(REVERSING, 0.1, {})
    start = np.zeros((3, 4))
    _, many = model.scan_many(start, np.tile(braked, (3, 1, 1, 1)))
    np.testing.assert_array_equal(many[1], rollout(model, history_at_rest(0), braked)[1:])


def test_commands_and_brake_are_driven_together(vehicle: Vehicle) -> None:
    commands = Stream(np.array([0.0, 1.0, 2.0]), np.array([[0.1, 1.0], [0.2, 1.0], [0.3, 0.0]]))
    drive = simulate_drive(Plant(), Sensor(), 5.0, 1)
    recording = replace(record_drive(drive, 60.0, simulated_vehicle()), commands=commands)
    np.testing.assert_array_equal(recording.driven.values[:, 2], 0.0)
    brake = Stream(np.array([-1.0, 0.5, 1.5, 2.0]), np.array([[0.0], [0.7], [0.2], [0.0]]))
    driven = replace(recording, channels={"brake_share": brake}).driven
    np.testing.assert_array_equal(driven.time_s, [0.0, 0.5, 1.0, 1.5, 2.0])
    np.testing.assert_array_equal(driven.values[:, 0], [0.1, 0.1, 0.2, 0.2, 0.3])
    np.testing.assert_array_equal(driven.values[:, 2], [0.0, 0.7, 0.7, 0.2, 0.0])


def test_a_brake_in_percent_is_refused() -> None:
    raw = record_drive(simulate_drive(Plant(), Sensor(), 40.0, 1), 60.0, simulated_vehicle())
    for values, fine in ((raw.commands.time_s % 2.0 < 0.5, True), (80.0 * (raw.commands.time_s % 2.0 < 0.5), False)):
        channels = {"brake_share": Stream(raw.commands.time_s, np.asarray(values, dtype=float)[:, None])}
        braked = replace(raw, channels=channels)
        if fine:
            check_plausibility(braked, simulated_vehicle())
        else:
            with pytest.raises(InputRefused, match="percent"):
                check_plausibility(braked, simulated_vehicle())


def test_a_drive_to_and_fro_is_fitted() -> None:
    """The simulation's own car, which reverses; its constants are found as well as those of one that does not."""
    rng, seconds = np.random.default_rng(5), 120.0
    pieces = round(seconds / 3.0)
    held = np.column_stack([rng.uniform(-0.8, 0.8, pieces), rng.choice([1.4, 0.9, -0.7, -1.2], pieces)])
    commands = np.repeat(held, 3 * COMMAND_HZ, axis=0)
    plant = Plant(reverses=1.0)
    drive = simulate_drive(plant, Sensor(rate_hz=100.0), seconds, 3, given_commands=commands)
    vehicle = simulated_vehicle()
    motor = vehicle.motor.model_copy(update={"reverses": True})
    vehicle = vehicle.model_copy(update={"motor": motor})
    recording = record_drive(drive, 100.0, vehicle)
    assert not [i for i in recording.irregularities if i.action == "no-go"]
    estimate = estimate_motion(recording, vehicle, TUNING)
    assert estimate.twist[:, 0].min() < -0.3
    model = NewtonEuler.fit(FitTask([estimate], vehicle, {"loss": "rollout"}, 1))
    assert model.facts["fitted"]["K_b"]["relative_se"] is None  # nothing braked
    assert model.car.reverses == 1.0
    assert model.car.K_t == pytest.approx(CAR.K_t, rel=0.1)
    predicted = rollout(model, history_at_rest(0), hold_for_periods(np.array([[0.0, -1.0]] * 40), 0.1))
    assert predicted[-1, 0] < -0.7
