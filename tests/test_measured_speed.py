"""A throttle column that is the driven wheel's measured speed: the law, its corrections, and what a fit makes of it."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cars import CAR
from concealed import record_case

from bcid.diagnosis.diagnose import fit_base_model
from bcid.effects.actuators import actuator_chain
from bcid.effects.constants import Constants
from bcid.effects.table import effect_switches
from bcid.estimate.command_parts import cut_into_parts, hold_for_periods
from bcid.experiment.plan import nominal_car
from bcid.likelihood.hypothesis import NEEDS_THROTTLE, Hypothesis
from bcid.models.interface import history_at_rest, rollout
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.parameters import ConstantBox, constant_units
from bcid.physics.car import LONGEST_STEP_S, integration_step, motor_force
from bcid.proof.blind.tricycle_case import TricycleCase
from bcid.recording.measured_speed import let_measured_speed_run
from bcid.recording.types import Recording, SourceFile, Stream
from bcid.simulation.car import Sensor
from bcid.simulation.tricycle import Tricycle
from bcid.simulation.tricycle_drive import Encoder, TricycleHandling
from bcid.vehicle import Vehicle

FOLLOWING = CAR._replace(follows_wheel=1.0, reverses=1.0, K_t=CAR.m / 0.03, K_b=0.0, F_m_max=1e3 * CAR.m)
TEXT: dict[str, Any] = {
    "name": "cart", "body": {"cog_to_front_m": 0.9, "cog_to_rear_m": 0.6, "mass_kg": 200.0},
    "steering": {"max_angle_rad": 1.3}, "motor": {"law": "measured-speed"},
}  # fmt: skip
CART = Vehicle.model_validate(TEXT)


# --- the law -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("reverses", [0.0, 1.0])
def test_a_wheel_s_slip_is_its_force_driving_and_braking_forward_and_backward(reverses: float) -> None:
    car = FOLLOWING._replace(reverses=reverses)
    for u_m, v_w in np.random.default_rng(0).uniform(-2.0, 2.0, (50, 2)):
        assert motor_force(u_m, v_w, car) == pytest.approx(car.K_t * (u_m - v_w), rel=1e-12)
    assert motor_force(0.5, -9.0, car._replace(F_m_max=10.0)) == 10.0
    assert motor_force(-0.5, 9.0, car._replace(F_m_max=10.0)) == -10.0


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_car_follows_its_wheel_within_the_time_m_over_k(way: float) -> None:
    command_s = np.arange(0.0, 6.0, 0.02)
    speed = way * np.where(command_s < 3.0, 1.0, 0.4)
    parts = cut_into_parts(command_s, np.column_stack([0.0 * speed, speed]), 0.1 * np.arange(60), 0.1)
    drag = FOLLOWING._replace(R_1=30.0, R_2=0.0)
    model = NewtonEuler(drag, 0.1, {})
    v_x = rollout(model, history_at_rest(0), parts)[:, 0]
    share = drag.K_t / (drag.K_t + drag.R_1)  # what slips away
    settled = (0.03 * share) / np.log(10.0)
    assert settled < 0.1
    np.testing.assert_allclose(v_x[5:30], way * share, rtol=1e-4)
    np.testing.assert_allclose(v_x[36:], way * 0.4 * share, rtol=1e-4)
    assert v_x[1] == pytest.approx(way * share * (1.0 - np.exp(-0.1 / (0.03 * share))), rel=1e-3)


def test_a_stiff_car_with_its_wheel_turned_across_stays_stable_one_by_one_and_side_by_side() -> None:
    car = FOLLOWING._replace(K_t=CAR.m / 0.006)
    model, commands = NewtonEuler(car, 0.1, {}), np.tile([1.5, 1.0], (40, 1))
    alone = rollout(model, history_at_rest(0), commands)
    np.testing.assert_allclose(alone[-1, 2], np.sin(1.5) / (car.l_f + car.l_r), rtol=0.1)
    held = np.tile(hold_for_periods(commands, 0.1), (3, 1, 1, 1))
    for several in (np.tile(commands, (3, 1, 1)), held):
        np.testing.assert_allclose(model.scan_many(np.zeros((3, 4)), several)[1][1], alone[1:], atol=1e-9)


def test_integration_steps_know_how_stiffly_a_wheel_is_followed() -> None:
    slow, usual, fast = (integration_step(FOLLOWING._replace(K_t=CAR.m / tau)) for tau in (0.1, 0.01, 0.005))
    # all that a fit may make of it need the same
    assert slow == usual > fast
    assert fast * (1.0 + CAR.l_f / CAR.l_r) / 0.005 < 2.78
    # a motor that is told what to do is as slow as its car
    assert integration_step(FOLLOWING._replace(follows_wheel=0.0)) == integration_step(CAR) <= LONGEST_STEP_S
    # a driven wheel turned across turns the car: l_f^2/I_z beside 1/m
    across = FOLLOWING._replace(K_t=CAR.m / 0.006)
    assert integration_step(across) < integration_step(across._replace(front_share=0.0))


def test_a_measured_speed_has_a_sign_of_its_own() -> None:
    assert CART.motor.reverses
    assert not Vehicle.model_validate({**TEXT, "motor": {"law": "measured-speed", "reverses": False}}).motor.reverses
    assert not Vehicle.model_validate({**TEXT, "motor": {"law": "speed"}}).motor.reverses


# --- what is fitted ------------------------------------------------------------------------------------------------


def test_of_a_motor_that_is_followed_only_the_stiffness_is_fitted() -> None:
    hypothesis = Hypothesis(("throttle_timing",), FOLLOWING, 1.3, Constants())
    assert hypothesis.log_parameters == ("K_t", "I_z", "C_f", "C_r", "F_f_max", "F_r_max")
    assert not set(NEEDS_THROTTLE) & set(hypothesis.entries)
    assert "throttle_timing" in hypothesis.entries
    assert "throttle_timing" not in replace(hypothesis, nominal=CAR).entries
    low, high = hypothesis.bounds()
    # no motor of 45 s
    assert CAR.m / np.exp([low[0], high[0]]) == pytest.approx([0.1, 0.01])
    phi = hypothesis.phi_of(FOLLOWING._replace(K_t=2e4), [0.004])
    assert hypothesis.car(phi).K_t == pytest.approx(2e4)
    assert hypothesis.car(phi).follows_wheel == 1.0


def test_models_of_twists_begin_with_a_stiff_motor() -> None:
    box = ConstantBox(CART, 0.15, 2.0, 1.0, 1.5)
    car = box.car(np.full(len(box.constants), 0.5))
    assert [p.symbol for p in box.constants if p.symbol in ("F_m_max", "K_t", "K_b", "K_v", "u_0")] == ["K_t"]
    assert 0.02 < car.m / car.K_t < 0.05
    assert (car.follows_wheel, car.reverses, car.K_b) == (1.0, 1.0, 0.0)
    assert nominal_car(CART).follows_wheel == 1.0
    assert "F_m_max" not in constant_units(car)
    assert "measured speed" in NewtonEuler(car, 0.1, {}).describe()


def test_the_throttle_s_timing_moves_the_throttle_alone() -> None:
    times = 0.1 * np.arange(50)
    commands = np.column_stack([0.5 * np.sin(times), np.cos(times)])

    def chain(**on: float) -> Any:
        return actuator_chain(times, commands, 0.5, 200, 0.02, FOLLOWING, 1.3, effect_switches(on))

    plain, late, delayed = chain(), chain(throttle_timing__tau=0.03), chain(motor_delay__tau=0.03)
    early = chain(throttle_timing__tau=-0.1)
    np.testing.assert_array_equal(late.delta, plain.delta)
    np.testing.assert_array_equal(late.u_m, delayed.u_m)
    np.testing.assert_allclose(early.u_m[:-6], plain.u_m[5:-1])


# --- between samples -----------------------------------------------------------------------------------------------


def recorded(time_s: Any, steering: Any, speed: Any) -> Recording:
    commands = Stream(np.array(time_s), np.column_stack([steering, speed]))
    poses = Stream(np.array(time_s), np.zeros((len(commands), 3)))
    return Recording("x", (SourceFile("x", "", "csv"),), poses, commands, 10.0, 0.5)


def test_a_measured_speed_runs_on_between_samples_and_a_command_holds() -> None:
    time_s, steering, speed = [0.0, 0.1, 0.15, 1.0, 1.1], [0.1, 0.2, 0.3, 0.4, 0.5], [0.0, 1.0, 0.5, 0.8, -0.2]
    recording = recorded(time_s, steering, speed)
    commands = let_measured_speed_run(recording, CART).commands
    t, (u_s, u_m) = commands.time_s, commands.values.T
    np.testing.assert_array_equal(u_s, recording.commands.held_at(t)[:, 0])
    # the area under the straight lines, but for the pause of 0.85 s, through which nothing is known
    areas = [np.sum(u_m[:-1][(t[:-1] >= a) & (t[:-1] < b)] * np.diff(t)[(t[:-1] >= a) & (t[:-1] < b)])
             for a, b in itertools.pairwise(time_s)]  # fmt: skip
    np.testing.assert_allclose(areas, [0.05, 0.0375, 0.85 * 0.5, 0.03], atol=1e-12)
    assert np.diff(t)[t[:-1] < 0.14].max() < 0.0201
    assert set(time_s) <= set(t.round(12))
    told = CART.model_copy(update={"motor": CART.motor.model_copy(update={"law": "speed"})})
    assert let_measured_speed_run(recording, told) is recording


# --- a take --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("late_s", [-0.012, 0.012])
def test_the_base_model_of_a_tricycle_has_its_tyres_and_a_motor_of_hundredths_of_a_second(late_s: float) -> None:
    """Where its throttle was taken for a reference, it had a motor of 45 s and hardly any tyres at the rear."""
    p, still = Tricycle(mass=180.0, inertia=90.0), Sensor(position_noise=1.5e-3, yaw_noise=1.5e-3, marker_offset_x=0.7)
    case = TricycleCase(
        "tricycle", 0, (), seed=3, tricycle=p, handling=TricycleHandling(0.3, 1.4, 0.5), encoder=Encoder(late_s, 1e-3),
        tracker=still, command_hz=20.0, rate_hz=40.0, duration_s=120.0,
    )  # fmt: skip
    drive = record_case(case)
    fit = fit_base_model([drive.recording], [drive.estimate], drive.vehicle).fit
    car, timing = fit.car(), fit.effect_estimates()["throttle_timing__tau"][0]
    # force by slip over the rolling speed, that of a third of the weight at 0.5 to 1.4 m/s
    stiff = p.mass / (p.slip_stiffness * 9.81 * p.mass * p.rear_lever / p.wheelbase)
    assert 0.4 * stiff < car.m / car.K_t < 2.0 * stiff
    assert timing == pytest.approx(-late_s, abs=0.008)
    assert car.I_z == pytest.approx(p.inertia, rel=0.3)
    assert car.T_s == pytest.approx(p.servo_time, abs=0.02)
    assert car.d == pytest.approx(p.servo_rate, rel=0.05)
    assert min(car.C_f, car.C_r) > 4.0 * p.mass
    assert fit.scales.r[:2] == pytest.approx([1.5e-3 / np.sqrt(2.0)] * 2, rel=0.25)
