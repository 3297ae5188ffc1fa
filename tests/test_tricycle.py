"""The tricycle of the simulation: closed forms, energy, symmetries; its drives, and its tier of the blind test."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bcid.effects.table import EFFECTS
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.take import SEGMENT_S
from bcid.proof.blind.blind_test import BlindTest, SuiteSizes
from bcid.proof.blind.cases import draw_suite
from bcid.proof.blind.seal import answer_seal
from bcid.proof.blind.tricycle_case import TricycleCase
from bcid.proof.limits import GOALS
from bcid.simulation.car import Sensor
from bcid.simulation.dynamics import STEPS_PER_S
from bcid.simulation.tricycle import (
    GRAVITY,
    RIM,
    SERVO,
    TRICYCLE_STATE_SIZE,
    Tricycle,
    TricycleInputs,
    advance_tricycle,
    draw_tricycle,
    kinetic_energy,
    slip_force,
    tricycle_derivative,
)
from bcid.simulation.tricycle_drive import HALL, Encoder, TricycleHandling, simulate_tricycle
from bcid.virtual_lab import read_vehicle_text, record_drive

EXACT = Sensor(rate_hz=50.0, position_noise=0.0, yaw_noise=0.0, dropouts_per_minute=0.0)
BOTH_WAYS = TricycleHandling(0.3, 1.2, 0.5)
SUITE = [c for c in draw_suite(5, 1, 2, 0, 0, tricycles=16) if isinstance(c, TricycleCase)]


def driven(p: Tricycle, s: np.ndarray, seconds: float, steer: float, speed: float) -> np.ndarray:
    inputs = TricycleInputs(steer, speed, 0.0, 0.0, 0.0)
    for _ in range(round(seconds * STEPS_PER_S)):
        s = advance_tricycle(s, inputs, 1.0 / STEPS_PER_S, p)
    return s


def at_rest(angle: float = 0.0) -> np.ndarray:
    s = np.zeros(TRICYCLE_STATE_SIZE)
    s[SERVO] = angle
    return s


def body_twist(s: np.ndarray) -> np.ndarray:
    cos_h, sin_h = math.cos(s[2]), math.sin(s[2])
    return np.array([cos_h * s[3] + sin_h * s[4], cos_h * s[4] - sin_h * s[3], s[5]])


# --- the plant -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("angle", [0.0, 0.3, -0.9, 1.3])
def test_a_slow_tricycle_rolls_as_geometry_says(way: float, angle: float) -> None:
    """v_x = w cos(delta), yaw rate = w sin(delta)/L, v_y = l_r times that: of a rim's speed w, forward and backward."""
    p, rim = Tricycle(rolling_share=0.0, rolling_growth=0.0), 0.1 * way
    v_x, v_y, turn = body_twist(driven(p, at_rest(angle), 6.0, angle, rim))
    expected = np.array([math.cos(angle), p.rear_lever * math.sin(angle) / p.wheelbase, math.sin(angle) / p.wheelbase])
    np.testing.assert_allclose([v_x, v_y, turn], rim * expected, atol=2e-4)


def test_a_tricycle_slips_by_what_its_wheels_resist() -> None:
    """Straight on: the slip's force balances the rear wheels' resistance, c N."""
    p = Tricycle(rolling_share=0.03, rolling_growth=0.0)
    v_x = body_twist(driven(p, at_rest(), 12.0, 0.0, 1.0))[0]
    rear_share = p.front_lever / p.wheelbase
    slip = p.rolling_share * rear_share / (1.0 - rear_share) / p.slip_stiffness
    assert 1.0 - v_x == pytest.approx(slip, rel=1e-6)


def test_a_tyre_never_holds_more_than_its_grip() -> None:
    p, rng = Tricycle(), np.random.default_rng(0)
    for along, across, rolling, load in rng.uniform([-3, -3, -2, 1], [3, 3, 2, 2000], (200, 4)):
        pull, side = slip_force(along, across, rolling, load, p)
        assert math.hypot(pull, side) <= p.grip * load * (1.0 + 1e-12)
        assert pull * along + side * across < 0.0
    # a little slip: the stiffness, along and across alike
    small = slip_force(1e-6, 0.0, 1.0, 1000.0, p)[0], slip_force(0.0, 1e-6, 1.0, 1000.0, p)[1]
    assert small == pytest.approx((-p.slip_stiffness * 1e-3,) * 2, rel=1e-6)


def test_without_grip_energy_and_momentum_stay_and_with_a_still_rim_energy_only_falls() -> None:
    start = np.array([0.0, 0.0, 0.4, 0.8, -0.5, 0.9, 0.6, 0.0])
    free = Tricycle(grip=1e-9, rolling_share=0.0, rolling_growth=0.0)
    after = driven(free, start, 2.0, 0.6, 0.0)
    assert kinetic_energy(after, free) == pytest.approx(kinetic_energy(start, free), rel=1e-6)
    np.testing.assert_allclose(after[3:5], start[3:5], atol=1e-6)
    p, s, energies = Tricycle(), start, []
    for _ in range(STEPS_PER_S):
        s = advance_tricycle(s, TricycleInputs(0.6, 0.0, 0.0, 0.0, 0.0), 1.0 / STEPS_PER_S, p)
        energies.append(kinetic_energy(s, p))
    assert np.diff([kinetic_energy(start, p), *energies]).max() <= 1e-12
    assert energies[-1] < 0.01 * kinetic_energy(start, p)


def test_backward_all_forces_are_turned_round_and_mirrored_the_motion_is_mirrored() -> None:
    p, rng = Tricycle(), np.random.default_rng(1)
    mirror = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0, -1.0, 1.0])
    for s in rng.uniform(-1.0, 1.0, (50, TRICYCLE_STATE_SIZE)):
        inputs = TricycleInputs(s[SERVO], s[RIM], 0.0, 0.0, 0.0)
        back = s * [1, 1, 1, -1, -1, -1, 1, -1]
        there = tricycle_derivative(s, inputs, p)
        again = tricycle_derivative(back, inputs._replace(speed=back[RIM]), p)
        np.testing.assert_allclose(again[3:6], -there[3:6], atol=1e-12)
        left = tricycle_derivative(s * mirror, inputs._replace(steer=-s[SERVO]), p)
        np.testing.assert_allclose(left, there * mirror, atol=1e-12)


def test_a_slow_tricycle_comes_back_on_its_own_track() -> None:
    p = Tricycle(rolling_share=0.0, rolling_growth=0.0, rim_acceleration=50.0, rim_time=0.02)
    there = driven(p, driven(p, at_rest(0.7), 20.0, 0.7, 0.1), 1.0, 0.7, 0.0)
    back = driven(p, driven(p, there, 20.0, 0.7, -0.1), 1.0, 0.7, 0.0)
    assert np.hypot(*there[:2]) > 0.5
    # but for what it slides outward, either way
    np.testing.assert_allclose(back[:3], 0.0, atol=2e-3)


def test_its_integration_has_converged() -> None:
    p = draw_tricycle(np.random.default_rng(3))
    s = np.array([0.0, 0.0, 0.0, 0.5, 0.1, 0.3, 0.2, 1.0])
    inputs = TricycleInputs(0.9, 0.3, 0.0, 0.0, 0.0)
    once, often = s, s
    for _ in range(48):
        once = advance_tricycle(once, inputs, 1.0 / STEPS_PER_S, p)
        for _ in range(8):
            often = advance_tricycle(often, inputs, 0.125 / STEPS_PER_S, p)
    np.testing.assert_allclose(once, often, atol=1e-6)


# --- its drives ----------------------------------------------------------------------------------------------------


def test_a_drive_stays_in_the_hall_both_ways_and_its_log_holds_the_rim_s_speed() -> None:
    p = draw_tricycle(np.random.default_rng(2))
    drive = simulate_tricycle(p, EXACT, 120.0, 4, 20.0, BOTH_WAYS)
    time, x, y, _, v_x, v_y, turn, angle = drive.truth.T
    assert np.abs(x).max() < 0.5 * HALL.length
    assert np.abs(y).max() < 0.5 * HALL.width
    assert np.ptp(angle) > 1.2
    # what the front wheel does, beside its slip
    logged = np.interp(time, drive.command_time, drive.command[:, 1])
    roll = np.cos(angle) * v_x + np.sin(angle) * (v_y + p.front_lever * turn)
    assert np.abs(logged - roll).mean() < 0.01
    assert 0.3 < np.mean(roll[np.abs(roll) > 0.05] < 0.0) < 0.7
    late = simulate_tricycle(p, EXACT, 120.0, 4, 20.0, BOTH_WAYS, Encoder(late_s=0.1))
    np.testing.assert_allclose(late.command[2:, 1], drive.command[:-2, 1], atol=1e-9)
    np.testing.assert_array_equal(late.pose, drive.pose)
    forward = simulate_tricycle(p, EXACT, 60.0, 4, 10.0, BOTH_WAYS._replace(reverse_share=0.0))
    assert forward.command[:, 1].min() >= 0.0


def test_a_tricycle_s_recording_is_read_without_alarm() -> None:
    case = next(c for c in SUITE if c.handling.reverse_share and c.answer == ("marker_offset",))
    vehicle = read_vehicle_text(case.lab_files.vehicle)
    recording = record_drive(case.simulate(), case.rate_hz, vehicle)
    assert [i for i in recording.irregularities if i.action == "no-go" or i.kind == "vehicle file"] == []
    assert recording.commands.values[:, 1].min() < -0.2
    assert np.diff(recording.commands.time_s).max() <= 0.0201


# --- its tier ------------------------------------------------------------------------------------------------------


def test_the_tier_comes_after_all_others_and_older_runs_have_none() -> None:
    before, after = list(draw_suite(5, 1, 2, 0, 0)), list(draw_suite(5, 1, 2, 0, 0, tricycles=16))
    assert [c.name for c in after[: len(before)]] == [c.name for c in before]
    assert [c.tier for c in after[len(before) :]] == ["tricycle"] * 16
    old = {"repeats": 1, "nulls": 2, "imperfect_nulls": 0, "pairs": 0, "every": 1}
    assert not any(c.tier == "tricycle" for c in BlindTest(5, sizes=SuiteSizes.of_stored_run(old)).cases)
    assert GOALS["tricycle"]["right"][0] == 0.9


def test_what_tricycles_conceal() -> None:
    assert [len(c.answer) for c in SUITE] == [1, 1, 1, 2] * 4
    assert {c.answer for c in SUITE if len(c.answer) == 1} == {(e,) for e in ("steering_offset", "marker_offset",
                                                                             "pose_latency")}  # fmt: skip
    assert sum(c.handling.reverse_share > 0.0 for c in SUITE) == 8
    # each effect with a car that reverses and with one that does not
    assert {(c.answer[0], c.handling.reverse_share) for c in SUITE if len(c.answer) == 1} == {
        (e, share) for e in ("steering_offset", "marker_offset", "pose_latency") for share in (0.0, 0.5)
    }  # fmt: skip
    for case in SUITE:
        sensor, p = case.sensor(), case.driven_tricycle()
        assert 1.35 <= p.wheelbase <= 1.65
        assert 100.0 <= p.mass <= 300.0
        assert case.duration_s / SEGMENT_S > 4 * LIKELIHOOD_LIMITS.min_segments
        truth = {f"{c.effect}__{s}": v for c in case.concealed for s, v in c.parameters.items()}
        assert p.steering_offset == truth.get("steering_offset__o", 0.0)
        assert sensor.pose_latency == truth.get("pose_latency__tau", 0.0)
        believed = read_vehicle_text(case.lab_files.vehicle).mocap.marker_offset_m
        assert believed is not None
        off = np.array([sensor.marker_offset_x, sensor.marker_offset_y]) - believed
        expected = [truth.get(f"marker_offset__{s}", 0.0) for s in ("d_x", "d_y")]
        np.testing.assert_allclose(off, expected, atol=1e-12)
        assert {*case.answer, *case.also} <= set(EFFECTS)
        drag = sum(case.also["rear_rolling_coulomb"].values()) + sum(case.also["rear_rolling_viscous"].values())
        coasting = tricycle_derivative(np.array([0, 0, 0, 1.0, 0, 0, 0, 1.0]), TricycleInputs(0, 1.0, 0, 0, 0),
                                       p._replace(steering_offset=0.0))[3]  # fmt: skip
        assert -p.mass * coasting == pytest.approx(drag, rel=1e-9)
    assert len({c.digest() for c in SUITE}) == len({answer_seal(c, "salt") for c in SUITE}) == len(SUITE)
    again = [c for c in draw_suite(5, 1, 2, 0, 0, tricycles=16) if isinstance(c, TricycleCase)]
    assert [c.digest() for c in again] == [c.digest() for c in SUITE]


def test_a_tricycle_weighs_on_its_wheels() -> None:
    """Nose to tail, the loads are those of a beam on two supports."""
    p = Tricycle(rolling_share=0.02, rolling_growth=0.0, grip=1e-9)
    rate = tricycle_derivative(np.array([0, 0, 0, 1.0, 0, 0, 0, 1.0]), TricycleInputs(0, 1.0, 0, 0, 0), p)[3]
    assert rate == pytest.approx(-0.02 * GRAVITY * p.front_lever / p.wheelbase, rel=1e-6)
