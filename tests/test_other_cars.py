"""Small cars that are other than their published simulation: laws of other formulas, another day's figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bcid.diagnosis.reference_model import ReferenceModel
from bcid.effects.table import EFFECTS
from bcid.estimate.run import estimate_motion
from bcid.estimate.tune import tune_estimator
from bcid.proof.blind.blind_test import BlindTest, SuiteSizes
from bcid.proof.blind.cases import draw_suite
from bcid.proof.blind.diagnose_case import MAX_GAP_S, PERIOD_S
from bcid.proof.blind.nearest_figures import (
    fit_linkage,
    fit_motor,
    fit_rolling_drag,
    fit_servo,
    fit_servo_of_two_lags,
    fit_steered_drag,
    fit_tyres,
    nearest_figures,
)
from bcid.proof.blind.other_suite import (
    FIGURES_OF_OTHER_LAWS,
    GRIP_DAY,
    MOTOR_DAY,
    ROLLING_DAY,
    TRIM_DAY_RAD,
    WITHHELD_OF_OTHER_LAWS,
    ZONE_DAY,
)
from bcid.proof.blind.published_case import PublishedCase
from bcid.proof.blind.run_cases import case_truth, run_blind_case
from bcid.proof.blind.seal import case_answer
from bcid.proof.blind.small_files import plant_figures
from bcid.proof.blind.small_suite import NAMED_CONSTANTS
from bcid.proof.scores.calibration import calibration
from bcid.proof.scores.outcome import count_confusions
from bcid.proof.scores.tiers import is_right, score_tiers
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive_train import requested_motor_force
from bcid.simulation.open_loop import simulate_open_loop
from bcid.simulation.other_laws import (
    dry_steered_drag,
    magic_side_force,
    regularised_speed,
    servo_acceleration,
    throttle_gate,
    two_sided_angle,
)
from bcid.simulation.room_drive import ROOM, simulate_room_drive
from bcid.simulation.room_drivers import DRIVERS
from bcid.simulation.small_car import SMALL_CAR_SENSOR, SmallCar, draw_car_of_other_laws
from bcid.virtual_lab import read_simulation_text, read_vehicle_text, record_drive

QUIET = Sensor(rate_hz=100.0, position_noise=0.0, yaw_noise=0.0, dropouts_per_minute=0.0)
OTHER = [c for c in draw_suite(5, 1, 0, 0, 0, other_laws=16, other_day=14) if isinstance(c, PublishedCase)]


def tier(name: str) -> list[PublishedCase]:
    return [c for c in OTHER if c.tier == name]


def other_car(seed: int) -> SmallCar:
    return draw_car_of_other_laws(np.random.default_rng([seed, 4]), with_dry_steered_drag=True)


# --- the laws ----------------------------------------------------------------------------------------------------


def test_a_gate_opens_at_the_dead_zone_s_end_and_is_hard_where_it_is_steep() -> None:
    assert throttle_gate(0.164, 0.164, 100.0) == 0.5
    assert throttle_gate(0.2, 0.164, 100.0) == pytest.approx(0.5 * (1.0 + math.tanh(3.6)))
    assert throttle_gate(0.17, 0.164, 1e6) == 1.0
    assert throttle_gate(0.16, 0.164, 1e6) == 0.0
    given = {"throttle_force": 25.358, "pulsed_fade": 4.815, "motor_dead_zone": 0.164}
    smooth, steep, hard = (Plant(**given, zone_steepness=k) for k in (100.0, 1e7, 0.0))
    for u, v in ((0.17, 0.4), (0.3, 0.7), (1.0, 2.5), (0.1, 1.0)):
        published = (25.358 - 4.815 * v) * 0.5 * (1.0 + math.tanh(100.0 * (u - 0.164))) * (u - 0.164)
        assert requested_motor_force(u, v, 0.0, 1.0, 0.0, smooth) == pytest.approx(published, rel=1e-12)
        force = requested_motor_force(u, v, 0.0, 1.0, 0.0, hard)
        assert requested_motor_force(u, v, 0.0, 1.0, 0.0, steep) == pytest.approx(force)
    assert requested_motor_force(-0.3, 1.0, 0.0, 1.0, 0.0, smooth) == requested_motor_force(-0.3, 1.0, 0, 1, 0, hard)


def test_the_magic_formula_has_the_stiffness_and_the_grip_that_it_is_given() -> None:
    """Its slope at no slip is 1 in the force without a limit; at C = 1, E = 0 it is F x/√(1 + x²); its peak is D."""
    for shape, curvature in ((0.84, 0.0), (1.4, -0.5), (1.3, 0.5)):
        assert magic_side_force(1e-4, 3.0, shape, curvature) == pytest.approx(1e-4, rel=1e-6)
        assert magic_side_force(-2.0, 3.0, shape, curvature) == -magic_side_force(2.0, 3.0, shape, curvature)
    for x in (0.3, 1.0, 4.0):
        assert magic_side_force(3.0 * x, 3.0, 1.0, 0.0) == pytest.approx(3.0 * x / math.hypot(1.0, x))
    far = [magic_side_force(f, 3.0, 1.4, 0.2) for f in np.geomspace(0.1, 1e4, 400)]
    assert max(far) == pytest.approx(3.0, rel=1e-3)
    assert far[-1] == pytest.approx(3.0 * math.sin(1.4 * math.pi / 2.0), rel=1e-2)  # falls past its peak
    # the DART's front tyre, as published: D sin(C atan(B slip))
    D, C, B = 0.841, 0.841, 8.598
    assert magic_side_force(B * C * D * 0.2, D, C, 0.0) == pytest.approx(D * math.sin(C * math.atan(B * 0.2)))


def test_slip_is_divided_by_the_speed_alone_where_that_is_large() -> None:
    assert regularised_speed(0.0, 1.0, 3.0) == 1.0
    assert regularised_speed(-2.0, 1.0, 3.0) == pytest.approx(2.0, abs=1e-5)
    assert regularised_speed(0.5, 1.0, 3.0) == pytest.approx(0.5 + math.exp(-0.75))


def test_a_steered_wheel_s_drag_is_nearly_dry_and_resists() -> None:
    assert dry_steered_drag(0.0, 1.0, 4.0, 0.3) == 0.0
    assert dry_steered_drag(0.3, 1.0, 4.0, 0.0) == pytest.approx(4.0 * 0.3, rel=1e-3)  # whatever the speed
    assert dry_steered_drag(0.3, 2.0, 4.0, 0.0) == pytest.approx(dry_steered_drag(-0.3, 1.0, 4.0, 0.0), rel=1e-3)
    assert dry_steered_drag(0.3, -1.0, 4.0, 0.3) == -dry_steered_drag(0.3, 1.0, 4.0, 0.3) < 0.0
    assert dry_steered_drag(0.3, 0.0, 4.0, 0.0) < 1e-4
    assert dry_steered_drag(0.3, 1.5, 4.0, 0.3) == pytest.approx(4.0 * 0.3 * 1.3, rel=1e-3)


def test_a_linkage_bends_towards_its_own_limit_on_either_side() -> None:
    def angle(servo: float) -> float:
        return two_sided_angle(servo, 0.01, 0.4, 0.6)

    assert angle(0.01) == 0.0
    assert (angle(0.011) - angle(0.009)) / 0.002 == pytest.approx(1.0, abs=1e-4)
    assert angle(20.0) == pytest.approx(0.4)
    assert angle(-20.0) == pytest.approx(-0.6)
    assert angle(0.31) == pytest.approx(0.4 * math.tanh(0.75), rel=1e-6)


def test_a_servo_of_second_order_rings_as_its_damping_says_and_trails_a_turn_by_its_time() -> None:
    """At a step the first overshoot is exp(-π ζ/√(1 - ζ²)); beyond its fastest rate it does not get faster."""
    plant = Plant(servo_time=0.08, servo_damping=0.5, servo_rate=1e3, angle_limit=10.0)
    pose_s = np.arange(0.0, 2.0, 1.0 / 480.0)
    step = simulate_open_loop(plant, np.array([0.0]), np.array([[0.3, 0.0]]), pose_s, (0.0, 0.0), 1).states[:, 6]
    assert step[-1] == pytest.approx(0.3, abs=1e-6)
    assert step.max() / 0.3 - 1.0 == pytest.approx(math.exp(-math.pi * 0.5 / math.sqrt(0.75)), abs=2e-4)
    turning = np.arange(0.0, 2.0, 1.0 / 480.0)
    commands = np.column_stack([0.4 * turning, np.zeros(len(turning))])
    turn = simulate_open_loop(plant, turning, commands, pose_s, (0.0, 0.0), 1).states[:, 6]
    assert 0.4 * pose_s[-1] - turn[-1] == pytest.approx(0.4 * (0.08 + 0.5 / 480.0), rel=1e-2)
    slow = plant._replace(servo_rate=0.5)
    limited = simulate_open_loop(slow, np.array([0.0]), np.array([[0.3, 0.0]]), pose_s, (0.0, 0.0), 1).states[:, 6]
    assert np.diff(limited).max() * 480.0 == pytest.approx(0.5, rel=1e-6)
    assert servo_acceleration(0.1, 0.6, 0.08, 0.5, 0.5) == 0.0 > servo_acceleration(-0.1, 0.6, 0.08, 0.5, 0.5)


# each of the plant's constants of another law, with what else has to be there for it to act
CONSTANTS: dict[str, dict[str, float]] = {
    "zone_steepness": {}, "dry_speed": {}, "front_magic": {}, "rear_magic": {},
    "magic_curvature": {"front_magic": 1.0, "rear_magic": 1.0}, "slip_fade": {}, "dry_steered_drag": {},
    "dry_steered_rise": {"dry_steered_drag": 4.0}, "left_reach": {"right_reach": 0.5},
    "right_reach": {"left_reach": 0.5},
    "linkage_centre": {"left_reach": 0.5, "right_reach": 0.5}, "servo_damping": {},
}  # fmt: skip


@pytest.mark.parametrize("constant", list(CONSTANTS))
def test_each_law_moves_the_car_and_does_nothing_at_zero(constant: str) -> None:
    car, needed = other_car(3), CONSTANTS[constant]
    usual = car.plant._replace(**dict.fromkeys(CONSTANTS, 0.0))
    # published dead zones end so sharply that no driver would notice
    value = 15.0 if constant == "zone_steepness" else getattr(car.plant, constant)
    there = usual._replace(**needed, **{constant: value})
    zero = usual._replace(**needed, **{constant: 0.0})
    without = usual._replace(**needed) if constant not in ("left_reach", "right_reach") else usual
    drives = [
        simulate_room_drive(p, QUIET, 12.0, 4, "hand", (car.slow, car.fast), 20.0).pose for p in (there, zero, without)
    ]
    np.testing.assert_array_equal(drives[1], drives[2])
    assert np.abs(drives[0] - drives[1])[:, :2].max() > 1e-3


@pytest.mark.parametrize("driver", DRIVERS)
def test_a_driver_keeps_a_car_of_other_laws_in_its_room_and_moves_it(driver: str) -> None:
    for seed in range(4):
        car = draw_car_of_other_laws(np.random.default_rng([seed, 2]))
        run = simulate_room_drive(car.plant, SMALL_CAR_SENSOR, 90.0, seed, driver, (car.slow, car.fast), 10.0)
        assert np.abs(run.truth[:, 1]).max() < 0.5 * ROOM.length
        assert np.abs(run.truth[:, 2]).max() < 0.5 * ROOM.width
        assert np.quantile(run.truth[:, 4], 0.95) > 0.7


# --- what an author fits to them ---------------------------------------------------------------------------------


LARGEST_ERRORS = {
    fit_motor: 0.1, fit_rolling_drag: 0.06, fit_tyres: 0.05, fit_linkage: 0.05, fit_servo: 0.08, fit_steered_drag: 0.35,
}  # fmt: skip


@pytest.mark.parametrize("fit", list(LARGEST_ERRORS))
def test_the_vocabulary_s_laws_are_near_the_car_s_and_not_them(fit: Any) -> None:
    errors = [fit(other_car(seed).plant).error for seed in range(8)]
    assert 1e-3 < min(errors) <= max(errors) < LARGEST_ERRORS[fit]


def test_a_law_that_is_the_vocabulary_s_is_found_again() -> None:
    """Near a limit in which a law of other formula is one of the vocabulary, its figures are the plant's."""
    p = other_car(1).plant
    motor = fit_motor(p._replace(zone_steepness=1e6))
    assert motor.figures["K_t"] == pytest.approx(p.throttle_force, rel=1e-4)
    assert motor.figures["width"] == pytest.approx(p.motor_dead_zone, rel=1e-4)
    assert motor.error < 1e-3
    drag = fit_rolling_drag(p._replace(dry_speed=0.05))
    assert (drag.figures["c"], drag.figures["R_1"], drag.figures["R_2"]) == pytest.approx(
        (p.rear_rolling_coulomb, p.rolling_drag, p.rolling_drag_2), rel=1e-3
    )
    linkage = fit_linkage(p._replace(left_reach=5.0, right_reach=5.0, linkage_centre=0.01))
    assert linkage.figures["o"] == pytest.approx(-0.01, rel=0.05)
    assert linkage.figures["k"] == pytest.approx(-1.0 / (3.0 * 5.0**2), rel=0.05)  # tanh x = x - x³/3
    # heavily damped, one of the two rates is that of a first-order servo
    servo = fit_servo(p._replace(servo_time=0.08, servo_damping=1.0))
    assert servo.figures["T_s"] + servo.figures["tau"] == pytest.approx(0.08, rel=0.12)


@pytest.mark.parametrize("damping", [0.65, 0.8, 1.0])
def test_a_servo_of_second_order_is_nearer_to_two_lags_than_to_one(damping: float) -> None:
    """So that a further lag of the steering is there to be named; damped critically, it is two lags."""
    plant = other_car(1).plant._replace(servo_time=0.08, servo_damping=damping)
    one, two = fit_servo(plant), fit_servo_of_two_lags(plant)
    assert two.error < 0.85 * one.error
    assert two.figures["lag"] == pytest.approx(0.04, rel=0.15)
    if damping == 1.0:
        assert two.error < 1e-3


def test_a_further_lag_is_no_false_name_of_a_servo_of_second_order() -> None:
    """Its size is none to be met: what is published for the first lag decides what is left to it."""
    assert all(case.also["steering_lag"] == {} for case in (*tier("other-laws"), *tier("other-laws-less")))
    assert not any("steering_lag" in case.also for case in tier("other-day"))


def test_nearest_figures_have_few_digits_so_that_any_machine_finds_them_alike() -> None:
    """The answers that are sealed hold them."""
    figures = nearest_figures(other_car(2).plant)
    own = ("I_z", "K_b")
    fitted = [v for s, v in figures.parameters.items() if s not in own]
    fitted += [v for e, values in figures.effects.items() if e != "motor_lag" for v in values.values()]
    assert all(value == float(f"{value:.5g}") for value in fitted)
    assert set(figures.parameters) | set(figures.effects) <= set(FIGURES_OF_OTHER_LAWS)


# --- the cases ---------------------------------------------------------------------------------------------------


def reference_of(case: PublishedCase) -> ReferenceModel:
    files = case.lab_files
    vehicle = read_vehicle_text(files.vehicle)
    recording = record_drive(replace(case, duration_s=45.0).simulate(), case.rate_hz, vehicle)
    tuning = tune_estimator([recording], vehicle, PERIOD_S, MAX_GAP_S, {})
    return read_simulation_text(files.simulation, estimate_motion(recording, vehicle, tuning), vehicle)


def test_the_tiers_are_what_they_are_called() -> None:
    assert [len(tier(name)) for name in ("other-laws", "other-laws-less", "other-day", "other-day-less")] == [
        16, 16, 14, 14,
    ]  # fmt: skip
    assert not any(c.answer or c.withheld for c in (*tier("other-laws"), *tier("other-day")))
    assert {c.withheld for c in tier("other-laws-less")} == set(WITHHELD_OF_OTHER_LAWS)
    assert {c.answer for c in tier("other-day-less")} == {(effect,) for effect in NAMED_CONSTANTS}
    assert len({c.digest() for c in OTHER}) == len(OTHER)
    for case in OTHER:
        assert not [name for name in case.withheld if f"{name} =" in case.lab_files.simulation]
        assert set(case.answer) <= set(case.withheld)
        assert not set(case.answer) & set(case.also)
        assert set(case.also) <= set(EFFECTS) | {"motor_fade"}
        truth = {name: values for name, values in case.true_figures.effects.items() if name in case.answer}
        assert case.nameable_effects == truth


def test_what_is_published_is_the_nearest_law_within_what_it_says() -> None:
    for case in (*tier("other-laws"), *tier("other-laws-less")):
        true, published, sd = case.true_figures, case.published_figures, dict(case.relative_sd_of)
        assert all(0.1 <= share <= 0.3 for share in sd.values())
        pairs = {s: (value, published.parameters[s]) for s, value in true.parameters.items()}
        pairs |= {
            e: (next(iter(v.values())), next(iter(published.effects[e].values()))) for e, v in true.effects.items()
        }
        off = {name: (said - value) / (sd[name] * abs(value)) for name, (value, said) in pairs.items()}
        assert all(abs(share) <= 2.01 for share in off.values()), off
        assert case.other_parameters == {s: v for s, v in true.parameters.items() if v != published.parameters[s]}
    scores = [e / dict(c.relative_sd_of)[name] for c in tier("other-laws") for name, e in c.errors]
    assert abs(np.mean(scores)) < 0.2
    assert np.std(scores) == pytest.approx(0.95, abs=0.1)  # a normal law's, cut at two


def test_what_a_day_changes_is_what_a_day_can_change() -> None:
    changes = []
    for case in (*tier("other-day"), *tier("other-day-less")):
        published, p = case.car.plant, case.plant()
        changes.append((
            p.throttle_force / published.throttle_force - 1.0, p.motor_dead_zone - published.motor_dead_zone,
            p.rolling_drag / published.rolling_drag - 1.0, p.front_grip / published.front_grip - 1.0,
            p.steering_offset - published.steering_offset,
        ))  # fmt: skip
        assert p.rear_grip / published.rear_grip == pytest.approx(p.front_grip / published.front_grip)
        assert p.rear_rolling_coulomb / published.rear_rolling_coulomb == pytest.approx(
            p.rolling_drag / published.rolling_drag
        )
        assert set(case.other_parameters) == {"K_t", "R_1", "R_2", "F_f_max", "F_r_max"}
        assert set(case.also) == {"motor_dead_zone", "rear_rolling_coulomb", "steering_offset"} - set(case.answer)
        assert case.published_figures == plant_figures(published)
        assert case.true_figures == plant_figures(p)
    most = np.abs(changes).max(axis=0)
    limits = np.array([MOTOR_DAY, ZONE_DAY, ROLLING_DAY, GRIP_DAY, TRIM_DAY_RAD])
    assert (most <= limits).all()
    assert (most > 0.7 * limits).all()


@pytest.mark.parametrize("name", ["other-laws", "other-laws-less", "other-day", "other-day-less"])
def test_the_published_file_is_read_with_what_it_says(name: str) -> None:
    case = tier(name)[1]
    reference, figures = reference_of(case), case.published_figures.without(case.withheld)
    assert {s: getattr(reference.car, s) for s in figures.parameters} == pytest.approx(figures.parameters)
    assert reference.effects == {f"{e}__{s}": v for e, values in figures.effects.items() for s, v in values.items()}
    assert reference.relative_sd == case.trust
    given = {*figures.parameters, *figures.effects}
    known = {s: sd for s, sd in reference.relative_sd_of.items() if s in given}
    assert known == {s: sd for s, sd in case.relative_sd_of if s in given}
    assert ("time_constant_s" in case.lab_files.vehicle) is not case.other_laws


def test_a_servo_of_a_known_vehicle_is_written_as_before() -> None:
    """The files of small cars of the vocabulary's laws are those that they had: their digests hold them."""
    text = tier("other-day")[0].lab_files.vehicle
    assert "\nmax_rate_radps = " in text
    assert text.index("max_rate_radps") < text.index("time_constant_s") < text.index("[motor]")
    assert "relative_sd_of" not in next(c for c in draw_suite(5, 1, 0, 0, 0) if c.tier == "small-exact").lab_files[3]


def test_no_other_case_has_another_number_and_answers_hold_what_is_otherwise() -> None:
    before, after = list(draw_suite(7, 1, 2, 1, 2)), list(draw_suite(7, 1, 2, 1, 2, 2, 1))
    assert after[: len(before)] == before
    assert [c.tier for c in after[len(before) :]] == [
        "other-laws", "other-laws", "other-laws-less", "other-laws-less", "other-day", "other-day-less",
    ]  # fmt: skip
    assert [c.number for c in after] == list(range(len(after)))
    answer = case_answer(after[-1])
    assert set(answer["other_parameters"]) == {"K_t", "R_1", "R_2", "F_f_max", "F_r_max"}
    assert not [c for c in before if "other_parameters" in case_answer(c)]


def test_a_stored_run_that_knows_no_other_cars_has_none() -> None:
    stored = {"repeats": 3, "nulls": 300, "imperfect_nulls": 100, "pairs": 50, "every": 40}
    sizes = SuiteSizes.of_stored_run(stored)
    assert (sizes.repeats, sizes.every, sizes.other_laws, sizes.other_day) == (3, 40, 0, 0)
    assert not [c for c in BlindTest(7, sizes=sizes).cases if c.tier.startswith("other")]
    assert SuiteSizes() == SuiteSizes.of_stored_run(
        {**stored, "every": 1, "other_laws": 40, "other_day": 40, "tricycles": 40}
    )


# --- how they count ----------------------------------------------------------------------------------------------


def row(case: PublishedCase, *named: str, others: Sequence[str] = (), **more: Any) -> dict[str, Any]:
    """A row in which effects are named, and figures told that are `others` than published."""
    findings = [
        {"effect": n, "kind": EFFECTS[n].kind, "twins": [], "probability": 0.9, "gain": 100.0, "heldout": 90.0,
         "values": {}}
        for n in named
    ]  # fmt: skip
    verdict, told = "named" if named else "nothing-found", [{"symbol": s, "nats": 20.0} for s in others]
    said = {"verdict": verdict, "findings": findings, "other_figures": told, "remainder": {"channel": "fx"}}
    return {**case_truth(case), **said, "seconds": 1.0, **more}


def test_effects_that_are_there_besides_may_be_named() -> None:
    day, laws = tier("other-day")[0], tier("other-laws")[0]
    for said in ([], ["steering_offset"], ["rear_rolling_coulomb"], ["steering_offset", "motor_dead_zone"]):
        assert is_right(row(day, *said)), said
    for said in (["rear_toe"], ["steering_offset", "yaw_scrub"], ["tyre_soft_saturation"]):
        assert not is_right(row(day, *said)), said
    assert not is_right(row(laws, "pose_scale"))
    # other formulas have no name, and to say so is right; another day's car follows the formulas
    assert is_right(row(laws, verdict="unknown"))
    assert not is_right(row(day, verdict="unknown"))
    rows = [row(day), row(day, "rear_toe"), row(day, "steering_offset")]
    (scores,) = score_tiers(rows)
    assert (scores.false, scores.missed) == (pytest.approx(1 / 3), ("false",))
    assert calibration(rows).n == 2
    assert count_confusions(rows) == {"nothing": {"nothing": 1, "rear_toe": 1, "steering_offset": 1}}


def test_figures_that_are_told_to_be_others_and_are_not_are_counted() -> None:
    """A figure that is told counts as false if the car has it as published; without published figures none counts."""
    day = tier("other-day")[0]
    told = [["K_t", "motor_dead_zone__width"], ["C_f"], ["K_t", "C_f", "tyre_soft_saturation__s"], []]
    (scores,) = score_tiers([row(day, others=others) for others in told])
    assert scores.false_figures == pytest.approx(0.75)
    assert scores.right == 1.0
    failed = {**row(day, others=["C_f"]), "error": "left the numbers"}
    (scores,) = score_tiers([row(day, others=["K_t"]), failed])
    assert scores.false_figures == 0.0
    (scores,) = score_tiers([{k: v for k, v in row(day, others=["C_f"]).items() if k != "other_parameters"}])
    assert scores.false_figures is None


def test_what_is_withheld_is_to_be_named_and_first() -> None:
    less = next(c for c in tier("other-day-less") if c.answer == ("motor_lag",))
    right = [row(less, *said) for said in (["motor_lag"], ["motor_lag", "steering_offset"])]
    assert all(map(is_right, right))
    (scores,) = score_tiers(right)
    assert (scores.right, scores.top1, scores.wrong, scores.missed) == (1.0, 1.0, 0.0, ())
    wrong = [row(less, *said) for said in ([], ["motor_lag", "rear_toe"], ["steering_offset"])]
    assert not any(map(is_right, wrong))
    (scores,) = score_tiers(wrong)
    assert set(scores.missed) == {"right", "top1", "wrong"}


@pytest.mark.proof
@pytest.mark.parametrize("name", ["other-laws", "other-laws-less", "other-day", "other-day-less"])
def test_a_case_of_each_tier_is_diagnosed_from_end_to_end(name: str) -> None:
    case = tier(name)[0]
    said = run_blind_case(case)
    # a published simulation that could not be read, or a car that it does not explain at all, would end in neither
    assert said["verdict"] in ("named", "ambiguous", "unknown", "nothing-found")
    assert set(case.withheld).isdisjoint(said["corrections"])
    (scores,) = score_tiers([{**case_truth(case), **said}])
    assert (scores.n, scores.errors) == (1, 0)
    assert scores.unshown in ((None,) if not case.answer else (0.0, 1.0))
