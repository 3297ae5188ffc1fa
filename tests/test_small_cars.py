"""Small cars in simulation and blind test: their physics, their rooms, their tiers, what a lab has of them."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid.aliases import Floats
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.effects.actuators import actuation_at, actuator_chain
from bcid.effects.car import BodyState
from bcid.effects.constants import Constants
from bcid.effects.motion import integrate_body, steady_lags
from bcid.effects.table import EFFECTS, ENTRIES, effect_switches
from bcid.estimate.run import estimate_motion
from bcid.physics.car import Car
from bcid.proof.blind import diagnose_case
from bcid.proof.blind.blind_case import BlindCase
from bcid.proof.blind.blind_test import write_case_files
from bcid.proof.blind.cases import draw_suite
from bcid.proof.blind.concealed_effects import MORE_OUTSIDE_EFFECTS, OUTSIDE_EFFECTS, ConcealedEffect
from bcid.proof.blind.run_cases import case_truth
from bcid.proof.blind.seal import answer_seal, case_answer
from bcid.proof.blind.small_case import SmallCase
from bcid.proof.blind.small_effects import (
    OUTSIDE_CHANNELS,
    SMALL_OUTSIDE_SIZES,
    SMALL_SIZES,
    draw_small_effect,
    kinds_of_car,
)
from bcid.proof.blind.small_files import PUBLISHED, published_simulation_text, small_vehicle_text
from bcid.proof.blind.small_suite import NAMED_CONSTANTS
from bcid.proof.scores.calibration import calibration
from bcid.proof.scores.localisation import effect_channels
from bcid.proof.scores.tiers import is_right, score_tiers
from bcid.recording.read import read_recording
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import Drive, simulate_drive
from bcid.simulation.drive_train import HEATING_S, heating_rate, requested_motor_force
from bcid.simulation.open_loop import simulate_open_loop
from bcid.simulation.room_drive import ROOM, simulate_room_drive
from bcid.simulation.room_drivers import DRIVERS
from bcid.simulation.small_car import OWN_CONSTANTS, SMALL_CAR_SENSOR, SmallCar, draw_small_car
from bcid.simulation.surroundings import pull_of_place
from bcid.vehicle import read_vehicle
from bcid.virtual_lab import TUNING, read_simulation_text, read_vehicle_text, record_drive

QUIET = Sensor(rate_hz=100.0, position_noise=0.0, yaw_noise=0.0, dropouts_per_minute=0.0)
SECONDS = 16.0
SMALL = [c for c in draw_suite(5, 1, 20, 0, 0) if isinstance(c, SmallCase)]


def tier(name: str) -> list[SmallCase]:
    return [c for c in SMALL if c.tier == name]


# --- two implementations -----------------------------------------------------------------------------------------


def smooth_car(seed: int, rear_drive: float) -> SmallCar:
    """A drawn car with all that a published one can have, on a smooth floor."""
    car = draw_small_car(np.random.default_rng([seed, 9]), having=OWN_CONSTANTS)
    return car._replace(plant=car.plant._replace(rough_force=0.0, rough_moment=0.0, rear_drive=rear_drive))


def models_car(p: Plant) -> Car:
    return Car(
        m=p.mass, I_z=p.inertia, l_f=p.front_lever, l_r=p.rear_lever, T_s=p.servo_time, d=p.servo_rate,
        F_m_max=p.motor_limit, K_t=p.throttle_force, K_b=p.brake_gain, C_f=p.front_stiffness, C_r=p.rear_stiffness,
        F_f_max=p.front_grip, F_r_max=p.rear_grip, R_1=p.rolling_drag, R_2=p.rolling_drag_2, v_0=p.slip_speed,
        front_share=1.0 - p.rear_drive, sets_force=1.0, u_0=0.0, K_v=p.motor_fade,
    )  # fmt: skip


def own_switches(p: Plant, **more: float) -> Any:
    return effect_switches({f"{e}__{s}": getattr(p, c) for c, (e, s) in PUBLISHED.items()} | more)


def models_motion(p: Plant, e: Any, drive: Drive) -> Floats:
    """Pose and twist (K, 6) by the models' equations under a drive's commands, where its true motion is told."""
    h, car, constants = 1.0 / 480.0, models_car(p), Constants(track=p.asymmetry_track)
    n = round(SECONDS / h)
    chain = actuator_chain(drive.command_time, drive.command, 0.0, n, h, car, p.angle_limit, e)
    start = BodyState(*drive.truth[0, 1:7])
    lags = steady_lags(start, actuation_at(0, chain, SECONDS), car, e, constants)._replace(F_mf=0.0, F_mr=0.0)
    path = np.asarray(integrate_body(start, lags, 0, n, chain, SECONDS, np.zeros((1, 3)), n, car, e, constants))
    return path[np.rint(drive.truth[:, 0] / h).astype(int), :6]


@pytest.mark.parametrize("driver", DRIVERS)
@pytest.mark.parametrize("rear_drive", [0.0, 1.0, 0.45])
def test_a_small_car_is_the_one_of_the_models(driver: str, rear_drive: float) -> None:
    """Two implementations that share no code: force-law motor with dead zone, fade and lag, bent asymmetric servo."""
    car = smooth_car(DRIVERS.index(driver), rear_drive)
    run = simulate_room_drive(car.plant, QUIET, SECONDS, 4, driver, (car.slow, car.fast), 20.0)
    apart = np.abs(models_motion(car.plant, own_switches(car.plant), run) - run.truth[:, 1:7]).max(axis=0)
    assert (apart < [5e-4, 5e-4, 5e-4, 2e-4, 2e-4, 1e-3]).all(), apart
    assert np.ptp(run.truth[:, 4]) > 0.5


SENSED = ("pose_latency", "clock_drift", "marker_offset", "body_yaw_misalignment", "pose_scale")
FIELDS = {"motor_power_limit": "motor_power_limit__inverse_P"}


@pytest.mark.parametrize("effect", [e for e in SMALL_SIZES if e not in SENSED])
@pytest.mark.parametrize("rear_drive", [0.0, 0.5])
def test_an_effect_does_the_same_to_a_small_car_in_both(effect: str, rear_drive: float) -> None:
    """Under the commands of a drive that has it, the models move as the plant does, and would not without it."""
    car = smooth_car(3, rear_drive)
    constants = [c for c, (published, _) in PUBLISHED.items() if published == effect]
    bare = car.plant._replace(**dict.fromkeys(constants, 0.0))
    hidden = draw_small_effect(effect, bare, np.random.default_rng(8), SECONDS)
    plant = bare._replace(**hidden.plant)
    if effect in ("rough_patch", "slippery_patch"):  # somewhere where the drive surely comes
        moved = {f"{effect}_x": 0.0, f"{effect}_y": 0.0, f"{effect}_radius": 0.9}
        plant, hidden = plant._replace(**moved), replace(hidden, parameters={**hidden.parameters, "x": 0.0, "y": 0.0,
                                                                             "radius": 0.9})  # fmt: skip
    run = simulate_room_drive(plant, QUIET, SECONDS, 2, "steps", (0.5, 2.4), 20.0)
    fields = {f"{effect}__{symbol}": value for symbol, value in hidden.parameters.items()}
    ours, without = (models_motion(bare, own_switches(bare, **more), run) for more in (fields, {}))
    change = np.abs(run.truth[:, 1:7] - without).max(axis=0)
    assert (np.abs(ours - run.truth[:, 1:7]).max(axis=0) < 0.03 * change + [1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 5e-3]).all()
    if effect not in ("steering_rate_asymmetry", "friction_circle"):  # which this drive hardly asks for
        assert change[:2].max() > 4e-3, change


def test_a_throttle_sets_the_published_force() -> None:
    """(K - k v)(u - w) - K_v v above the dead zone w, nothing within it, and a brake share below zero."""
    p = Plant(throttle_force=25.358, pulsed_fade=4.815, motor_dead_zone=0.164, motor_fade=0.3, brake_gain=5.0)

    def force(throttle: float, v: float) -> float:
        return float(requested_motor_force(throttle, v, 0.0, 1.0, 0.0, p))

    for throttle, v in ((0.3, 0.7), (1.0, 2.5), (0.17, 0.0)):
        assert force(throttle, v) == pytest.approx((25.358 - 4.815 * v) * (throttle - 0.164) - 0.3 * v)
    assert force(0.164, 1.0) == force(0.1, 1.0) == 0.0
    assert force(-0.4, 1.5) == pytest.approx(-0.4 * 5.0 * 1.5)


# --- rooms, drivers, rates ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("driver", DRIVERS)
def test_a_driver_keeps_a_small_car_in_its_room_and_moves_it(driver: str) -> None:
    for seed in range(4):
        car = draw_small_car(np.random.default_rng([seed, 2]))
        run = simulate_room_drive(car.plant, SMALL_CAR_SENSOR, 90.0, seed, driver, (car.slow, car.fast), 10.0)
        assert np.abs(run.truth[:, 1]).max() < 0.5 * ROOM.length == 3.0
        assert np.abs(run.truth[:, 2]).max() < 0.5 * ROOM.width == 2.2
        assert np.ptp(run.truth[:, 1]) > 2.0
        steer, throttle = run.command.T
        assert steer.min() < -0.5 * car.plant.angle_limit
        assert steer.max() > 0.5 * car.plant.angle_limit
        assert np.abs(steer).max() <= car.plant.angle_limit
        assert throttle.max() <= 1.0
        assert np.ptp(throttle) > 0.1
        assert np.quantile(run.truth[:, 4], 0.95) > 0.8
        assert len(np.unique(run.command, axis=0)) > 30


def test_drivers_differ_and_stop_and_go_brakes_and_stands() -> None:
    car = draw_small_car(np.random.default_rng(1))
    runs = {
        d: simulate_room_drive(car.plant, SMALL_CAR_SENSOR, 60.0, 1, d, (car.slow, car.fast), 20.0) for d in DRIVERS
    }
    assert len({run.command[400:600].tobytes() for run in runs.values()}) == len(DRIVERS)
    stopping = runs["stop-and-go"]
    assert (np.abs(stopping.truth[:, 4]) < 0.05).mean() > 0.02
    assert (stopping.command[:, 1] < -0.1).mean() > 0.05


@pytest.mark.parametrize("command_hz", [10.0, 25.0, 50.0])
def test_commands_come_at_their_rate_and_at_any_phase(command_hz: float) -> None:
    """The first is given before the first pose; where others stand against the poses is drawn."""
    car = draw_small_car(np.random.default_rng(1))
    phases = []
    for seed in range(5):
        run = simulate_room_drive(car.plant, SMALL_CAR_SENSOR, 5.0, seed, "hand", (0.5, 2.0), command_hz)
        np.testing.assert_allclose(np.diff(run.command_time), 1.0 / command_hz)
        assert -1.0 / command_hz < run.command_time[0] <= 0.0
        phases.append(-run.command_time[0] * command_hz)
    assert np.ptp(phases) > 0.3


def test_a_room_drive_is_its_seed_and_acts_when_its_commands_do() -> None:
    """A drive without a driver, under the same commands at the same times, moves the same car alike."""
    car = smooth_car(2, 1.0)
    one, same, other = (
        simulate_room_drive(car.plant, QUIET, 8.0, s, "hand", (car.slow, car.fast), 10.0) for s in (5, 5, 6)
    )
    np.testing.assert_array_equal(one.pose, same.pose)
    assert not np.allclose(one.command, other.command)
    times = np.arange(81) / 10.0
    # ten seconds in which the other's servo, which begins at zero, gets to the first command
    held = np.vstack([[one.command[0, 0], 0.0], one.command])
    command_s = np.r_[0.0, np.maximum(one.command_time, 0.0) + 10.0]
    again = simulate_open_loop(car.plant, command_s, held, np.r_[0.0, times + 10.0], (0.0, 0.0), 1)
    moved = again.states[1:, :2] - again.states[1, :2]
    turned = one.truth[0, 3] - again.states[1, 2]
    spin = np.array([[np.cos(turned), np.sin(turned)], [-np.sin(turned), np.cos(turned)]])
    np.testing.assert_allclose(moved @ spin + one.truth[0, 1:3], one.truth[:, 1:3], atol=1e-4)


# --- what has no name --------------------------------------------------------------------------------------------


def test_there_are_more_than_twelve_kinds_without_a_name_for_either_car() -> None:
    big = {c.answer[0] for c in draw_suite(1, 1, 0, 0, 0) if c.tier == "outside"}
    small = {c.answer[0]: c.channel for c in tier("small-outside")}
    assert big == set(small) == {*OUTSIDE_EFFECTS, *MORE_OUTSIDE_EFFECTS} == set(SMALL_OUTSIDE_SIZES)
    assert len(big) >= 12
    assert not big & set(EFFECTS)
    assert {"fx", "fy", "mz", "motor", "steering", "pose"} == set(small.values())
    assert all(channel in effect_channels(name, channel) for name, channel in small.items())


@pytest.mark.parametrize("name", list(SMALL_OUTSIDE_SIZES))
def test_what_has_no_name_acts_on_a_small_car(name: str) -> None:
    """At its size, and not at all at zero."""
    case = next(c for c in tier("small-outside") if c.answer == (name,))
    (hidden,) = case.concealed
    zero = ConcealedEffect(
        name, {k: v if "_" in k and k != name else 0.0 for k, v in hidden.plant.items() if k == name},
        dict.fromkeys(hidden.sensor, 0.0),
    )  # fmt: skip
    short = replace(case, duration_s=45.0)
    there, off, never = (replace(short, concealed=c).simulate().pose for c in ((hidden,), (zero,), ()))
    np.testing.assert_array_equal(off, never)
    assert np.nanmax(np.abs(there[:, :2] - never[:, :2])) > 1.5e-3


def test_a_magnet_pulls_most_at_its_reach_and_fades() -> None:
    p = Plant(attraction=3.0, attraction_x=1.0, attraction_reach=0.5)
    pulls = [pull_of_place(1.0 - r, 0.0, 0.0, p)[0] for r in (0.01, 0.25, 0.5, 1.0, 4.0)]
    assert np.argmax(pulls) == 2
    assert pulls[2] == pytest.approx(3.0)
    assert pulls[-1] < 1.0
    assert pull_of_place(1.5, 0.0, 0.0, p)[0] == pytest.approx(-3.0)


def test_what_is_hot_gives_way_and_cools() -> None:
    p = Plant(motor_heating=0.3, brake_fading=0.5)
    assert heating_rate(0.0, 200.0, p) > 0.0
    assert heating_rate(0.0, -200.0, p) > 0.0
    assert heating_rate(0.4, 0.0, p) == pytest.approx(-0.4 / HEATING_S)
    assert heating_rate(0.0, 200.0, Plant(brake_fading=0.5)) == 0.0
    cold, hot = (requested_motor_force(2.0, 1.0, 0.0, 1.0, heat, p) for heat in (0.0, 1.0))
    assert hot == pytest.approx(0.7 * cold)
    cold, hot = (requested_motor_force(-0.5, 1.0, 0.0, 1.0, heat, p) for heat in (0.0, 1.0))
    assert hot == pytest.approx(0.5 * cold)


def test_a_load_on_springs_weighs_what_it_weighs_and_swings() -> None:
    """Pulled steadily, the car with its load is as heavy as without springs; pushed, the load rings."""
    pull = np.tile([0.0, 2.0], (20 * 20, 1))
    free = {"rolling_drag": 3.0, "rolling_drag_2": 0.0}
    firm, swinging = (
        simulate_drive(Plant(swinging_load=share, **free), QUIET, 20.0, 1, given_commands=pull).truth
        for share in (0.0, 0.3)
    )
    apart = swinging[:, 4] - firm[:, 4]
    assert np.abs(apart).max() > 0.02
    assert np.abs(apart[150:]).max() < 5e-3
    assert (np.diff(np.sign(apart[2:40])) != 0.0).sum() >= 2


# --- what a lab has ----------------------------------------------------------------------------------------------


def reference_of(case: BlindCase) -> ReferenceModel:
    files = case.lab_files
    vehicle = read_vehicle_text(files.vehicle)
    recording = record_drive(replace(case, duration_s=45.0).simulate(), case.rate_hz, vehicle)
    return read_simulation_text(files.simulation, estimate_motion(recording, vehicle, TUNING), vehicle)


def test_a_published_simulation_is_the_car_less_what_is_withheld() -> None:
    for case in (tier("small-exact")[2], tier("small-wrong")[1], tier("small-plus")[0], tier("small-null")[0]):
        reference, p = reference_of(case), case.car.plant
        assert reference.relative_sd == case.trust
        known = {s: getattr(models_car(p), s) for s in ("I_z", "K_t", "K_v", "K_b", "C_f", "C_r", "F_f_max", "R_1")}
        assert {s: getattr(reference.car, s) for s in known} == pytest.approx(known, rel=1e-12)
        whole = {f"{e}__{s}": getattr(p, c) for c, (e, s) in PUBLISHED.items() if getattr(p, c) != 0.0}
        lacks = {f: v for f, v in whole.items() if f.partition("__")[0] in case.withheld}
        assert len(lacks) == len(case.withheld)
        assert reference.effects == pytest.approx({f: v for f, v in whole.items() if f not in lacks}, rel=1e-12)


@pytest.mark.parametrize(("rear_drive", "share"), [(0.0, 1.0), (1.0, 0.0), (0.4, 0.6)])
def test_a_vehicle_file_says_which_axle_is_driven(rear_drive: float, share: float) -> None:
    plant = draw_small_car(np.random.default_rng(1)).plant._replace(rear_drive=rear_drive)
    vehicle = read_vehicle_text(small_vehicle_text(plant))
    assert vehicle.front_share == pytest.approx(share)
    assert vehicle.motor.law == "force"
    assert (vehicle.mass_kg, vehicle.steering.max_angle_rad) == (plant.mass, plant.angle_limit)


def test_a_drawn_car_is_a_small_one_and_has_what_is_asked_for() -> None:
    cars = [draw_small_car(np.random.default_rng(seed)).plant for seed in range(60)]
    assert all(1.5 <= p.mass <= 6.0 and 0.17 <= p.front_lever + p.rear_lever <= 0.35 for p in cars)
    assert {0.0, 1.0} < {p.rear_drive for p in cars}
    assert any(0.3 < p.rear_drive < 0.7 for p in cars)
    assert {np.sign(p.steering_side_gain) for p in cars} == {-1.0, 1.0}
    for name in ("steering_drag", "tyre_soft_saturation", "pulsed_fade"):
        assert 10 < sum(getattr(p, name) > 0.0 for p in cars) < 50
        assert getattr(draw_small_car(np.random.default_rng(3), having=(name,)).plant, name) > 0.0
    assert draw_small_car(np.random.default_rng(3), lacking=("motor_lag",)).plant.motor_lag == 0.0
    assert cars[0].throttle_force > 0.0 < cars[0].motor_dead_zone


# --- tiers -------------------------------------------------------------------------------------------------------


def differences(case: SmallCase) -> set[str]:
    """Constants in which the driven car and its capture are otherwise than published."""
    pairs = (case.plant(), case.car.plant), (case.sensor(), SMALL_CAR_SENSOR._replace(rate_hz=case.rate_hz))
    return {k for own, usual in pairs for k, v in own._asdict().items() if v != getattr(usual, k)}


def test_the_tiers_of_small_cars_are_what_they_are_called() -> None:
    assert (
        {c.answer[0] for c in tier("small-exact")} == {c.answer[0] for c in tier("small-wrong")} == set(NAMED_CONSTANTS)
    )
    assert {c.answer[0] for c in tier("small-plus")} == set(SMALL_SIZES) == set(EFFECTS) - {"motor_regeneration"}
    for case in tier("small-exact"):
        (effect,) = case.withheld
        assert differences(case) == set()
        assert effect not in case.lab_files.simulation
        assert list(case.concealed[0].parameters.values()) == [getattr(case.plant(), NAMED_CONSTANTS[effect])]
    for case in tier("small-plus"):
        assert differences(case) == {*case.concealed[0].plant, *case.concealed[0].sensor}
        assert case.answer[0] in kinds_of_car(case.plant())
        assert f"{case.answer[0]} =" not in case.lab_files.simulation
        assert set(case.concealed[0].parameters) == {p.symbol for p in EFFECTS[case.answer[0]].parameters}
    for case in tier("small-null"):
        assert (differences(case), case.answer, case.withheld) == (set(), (), ())
    for case in tier("small-outside"):
        assert differences(case) == {*case.concealed[0].plant, *case.concealed[0].sensor}
        assert case.channel == OUTSIDE_CHANNELS[case.answer[0]]


def test_where_four_things_are_wrong_they_are_so_in_the_car_alone() -> None:
    for case in tier("small-wrong"):
        published, p = case.car.plant, case.plant()
        assert abs(p.throttle_force / published.throttle_force - 1.0) == pytest.approx(0.10)
        assert abs(p.front_grip / published.front_grip - 1.0) == pytest.approx(0.15)
        assert p.rear_grip / published.rear_grip == pytest.approx(p.front_grip / published.front_grip)
        assert p.steering_backlash > 0.0
        assert np.hypot(case.sensor().marker_offset_x, case.sensor().marker_offset_y) == pytest.approx(0.01)
        assert set(case.also) == {"steering_backlash", "marker_offset"} <= set(EFFECTS)
        assert set(case.nameable_effects) == set(case.withheld)
        assert repr(p.throttle_force) not in case.lab_files.simulation
        assert case.trust == 0.1


def test_takes_of_small_cars_are_of_all_lengths_rates_and_drivers() -> None:
    assert all(45.0 <= c.duration_s <= 180.0 for c in SMALL)
    assert np.ptp([c.duration_s for c in SMALL]) > 100.0
    assert {c.command_hz for c in SMALL} == {10.0, 20.0, 25.0, 50.0}
    assert {c.driver for c in SMALL} == set(DRIVERS)
    assert {c.driver for c in SMALL if c.answer in (("brake_fading",), ("stick_slip",))} == {"stop-and-go"}
    assert len({c.digest() for c in SMALL}) == len(SMALL)
    again = [c for c in draw_suite(5, 1, 20, 0, 0) if isinstance(c, SmallCase)]
    assert again == SMALL
    other = [c for c in draw_suite(6, 1, 20, 0, 0) if isinstance(c, SmallCase)]
    assert not {c.digest() for c in other} & {c.digest() for c in SMALL}


def test_a_digest_holds_what_is_driven_and_what_the_lab_has() -> None:
    case = tier("small-exact")[0]
    changes: tuple[dict[str, Any], ...] = (
        {"trust": 0.03}, {"command_hz": 13.0}, {"withheld": ()}, {"driver": "nobody"}, {"duration_s": 50.0},
    )  # fmt: skip
    assert len({case.digest(), *(replace(case, **change).digest() for change in changes)}) == 6
    assert replace(case, tier="another").digest() == case.digest()
    wrong = tier("small-wrong")[0]
    assert case_answer(wrong)["also"] == wrong.also
    assert "also" not in case_answer(case)
    assert answer_seal(replace(wrong, flaws=()), "salt") != answer_seal(wrong, "salt")


def test_small_cars_come_after_all_other_cases() -> None:
    """So that no other case has another number, and with it another drive, than before."""
    suite = list(draw_suite(1, 1, 5, 0, 0))
    first = next(i for i, c in enumerate(suite) if isinstance(c, SmallCase))
    assert all(isinstance(c, SmallCase) for c in suite[first:])
    assert [c.number for c in suite] == list(range(len(suite)))


# --- what is handed over and how it counts -----------------------------------------------------------------------


def test_the_diagnosis_of_a_small_car_is_handed_no_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    handed = list[Any]()

    def diagnosed(*given: Any, **more: Any) -> None:
        handed.append((given, more))
        raise ArithmeticError("asked")

    monkeypatch.setattr(diagnose_case, "diagnose_recordings", diagnosed)
    case = replace(next(c for c in tier("small-wrong") if c.answer == ("motor_lag",)), duration_s=45.0)
    files = case.lab_files
    with pytest.raises(ArithmeticError, match="asked"):
        diagnose_case.diagnose_concealed_drive(
            case.simulate(), case.rate_hz, (), case.nameable_effects, files.vehicle, files.simulation
        )
    ((given, more),) = handed
    assert [type(v).__name__ for v in given] == ["list", "list", "Vehicle"]
    assert set(more) == {"reference", "excluded"}
    reference = more["reference"]
    assert not [f for f in reference.effects if f.startswith(("motor_lag", "steering_backlash", "marker_offset"))]
    assert reference.car.K_t == pytest.approx(case.car.plant.throttle_force)
    assert reference.car.K_t != pytest.approx(case.plant().throttle_force)


def test_a_small_case_is_written_with_its_simulation(tmp_path: Path) -> None:
    case = replace(tier("small-wrong")[0], duration_s=45.0)
    path = write_case_files(case, tmp_path)
    vehicle = read_vehicle(tmp_path / "small_car.toml")
    read, asked = read_recording(path, vehicle), record_drive(case.simulate(), case.rate_hz, vehicle)
    np.testing.assert_allclose(read.poses.values, asked.poses.values, atol=1e-6)
    written = tomllib.loads((tmp_path / "simulation.toml").read_text(encoding="utf-8"))
    assert case.withheld[0] not in written["effects"]
    assert set(json.loads((tmp_path / f"{case.name}.answer.json").read_text())["also"]) == set(case.also)


def row(case: SmallCase, named: list[str], **more: Any) -> dict[str, Any]:
    findings = [
        {"effect": e, "kind": EFFECTS[e].kind, "twins": [], "probability": 0.9, "gain": 100.0, "heldout": 90.0,
         "values": {EFFECTS[e].parameters[0].symbol: [1.0, 0.1]}}
        for e in named
    ]  # fmt: skip
    said = {"verdict": "named" if named else "nothing-found", "findings": findings, "remainder": {"channel": "fx"}}
    return {**case_truth(case), **said, "seconds": 1.0, **more}


def test_what_else_is_wrong_may_be_named_and_is_no_answer() -> None:
    case = next(c for c in tier("small-wrong") if c.answer == ("motor_lag",))
    said = (["motor_lag"], ["motor_lag", "steering_backlash", "marker_offset"], ["steering_backlash", "motor_lag"])
    assert all(is_right(row(case, named)) for named in said)
    assert not is_right(row(case, ["steering_backlash"]))  # the one that is asked for is not named
    assert not is_right(row(case, ["motor_lag", "rear_toe"]))
    (scores,) = score_tiers([row(case, named) for named in said])
    assert (scores.top1, scores.set, scores.wrong, scores.missed) == (pytest.approx(2 / 3), 1.0, 0.0, ())
    (scores,) = score_tiers([row(case, ["motor_lag", "rear_toe"])])
    assert "wrong" in scores.missed
    assert calibration([row(case, ["steering_backlash"])]).bins[0].there == 1.0


def test_nothing_is_unknown_in_an_exact_small_car() -> None:
    case = tier("small-null")[0]
    assert is_right(row(case, []))
    assert not is_right(row(case, [], verdict="unknown"))
    assert not is_right(row(case, ["rear_toe"]))


def test_what_has_no_name_is_right_in_its_own_channel_alone() -> None:
    gusts = next(c for c in tier("small-outside") if c.answer == ("gusts",))
    assert all(is_right(row(gusts, [], verdict="unknown", remainder={"channel": c})) for c in ("fx", "fy"))
    assert not is_right(row(gusts, [], verdict="unknown", remainder={"channel": "motor"}))
    assert not is_right(row(gusts, ["rear_toe"]))


def test_published_effects_are_entries_that_can_be_fitted() -> None:
    for constant, (effect, symbol) in PUBLISHED.items():
        assert constant in OWN_CONSTANTS
        assert symbol in {p.symbol for p in ENTRIES[effect].parameters}
    assert set(PUBLISHED) == set(OWN_CONSTANTS)
    assert "motor_lag" not in published_simulation_text(smooth_car(1, 0.0).plant, 0.1, ("motor_lag",))
