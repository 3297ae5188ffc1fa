"""The simulation: its exact zero is the paper's car, its extras act, its logs are what was committed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bcid.files.parquet import read_columns
from bcid.models import published
from bcid.physics import car as equations
from bcid.recording.formats.motive import read_motive_poses
from bcid.recording.read import read_raw_take
from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.drive import COMMAND_HZ, Drive, simulate_drive
from bcid.simulation.driver import SimulatedArena
from bcid.simulation.samples import TAKES, TRUTH_UNITS, write_sample_logs
from bcid.vehicle import Vehicle

SAMPLES = Path(__file__).parent.parent / "sample_logs"
QUIET = Sensor(position_noise=0.0, yaw_noise=0.0, dropouts_per_minute=0.0)


def test_with_every_extra_at_zero_it_is_the_newton_euler_car() -> None:
    """Against the models' own equations at a fine step: another implementation, the same motion."""
    run = simulate_drive(Plant(), QUIET, 60.0, 3)
    car = published.newton_euler().car._replace(R_2=4.0)
    per_command, h = 96, 1.0 / (COMMAND_HZ * 96)
    state, twists = (0.0, 0.0, 0.0, 0.0), [(0.0, 0.0, 0.0)]
    for k, (u_s, u_m) in enumerate(run.command.tolist()):
        for _ in range(per_command):
            state = equations.rk4_step(state, u_s, u_m, car, h)
        if k % 2:
            twists.append(state[:3])
    np.testing.assert_allclose(np.array(twists), run.truth[: len(twists), 4:7], atol=2e-4)


def test_the_driver_keeps_the_car_inside_and_uses_the_whole_steering() -> None:
    arena = SimulatedArena()
    for seed in range(4):
        run = simulate_drive(Plant(**REAL_EXTRAS), Sensor(), 300.0, seed)
        assert np.abs(run.truth[:, 1]).max() < 0.5 * arena.length
        assert np.abs(run.truth[:, 2]).max() < 0.5 * arena.width
        assert run.truth[:, 7].max() > 1.9
        assert run.truth[:, 7].min() < -1.9
        assert (run.truth[:, 4] < -0.1).mean() > 0.03  # reversing


def test_a_drive_is_its_seed() -> None:
    one, same, other = (simulate_drive(Plant(), Sensor(), 20.0, s) for s in (5, 5, 6))
    np.testing.assert_array_equal(one.pose, same.pose)
    assert not np.allclose(one.command[: len(other.command)], other.command)


def test_a_car_without_throttle_only_loses_energy() -> None:
    """No extra and no rough floor may feed the car."""
    start = np.tile([0.4, 2.0], (COMMAND_HZ * 4, 1))
    coast = np.tile([0.9, 0.0], (COMMAND_HZ * 10, 1))
    extras = {k: v for k, v in REAL_EXTRAS.items() if not k.startswith("rough")}
    run = simulate_drive(Plant(**extras), QUIET, 14.0, 1, given_commands=np.vstack([start, coast]))
    p = Plant()
    energy = 0.5 * p.mass * (run.truth[:, 4] ** 2 + run.truth[:, 5] ** 2) + 0.5 * p.inertia * run.truth[:, 6] ** 2
    rolling = energy[42:]
    assert (np.diff(rolling) <= 1e-9).all()
    assert rolling[-1] < 0.2 * rolling[0]


def circle(plant: Plant, sensor: Sensor = QUIET, steer: float = 0.6) -> Drive:
    return simulate_drive(plant, sensor, 20.0, 1, given_commands=np.tile([steer, 2.0], (COMMAND_HZ * 20, 1)))


BASE = Plant()


@pytest.mark.parametrize(
    "name", [f for f in Plant._fields[Plant._fields.index("rear_track") :] if BASE._asdict()[f] == 0.0]
)
def test_every_switch_at_zero_changes_nothing_to_the_last_bit(name: str) -> None:
    """Zero written out is the default; and every switch that is no place or time does something when it is on."""
    same = circle(Plant(**{name: 0.0}))
    np.testing.assert_array_equal(same.truth, circle(BASE).truth)


ACTING = {
    "rear_track": 0.6, "rear_bearing": 6.0, "rear_rolling": 8.0, "softness": 0.6, "tyre_fall": 0.5, "rough_force": 4.0,
    "rough_moment": 2.0, "rear_rolling_coulomb": 20.0, "rear_rolling_viscous": 20.0, "front_coulomb_friction": 50.0,
    "quadratic_drag": 10.0, "rear_drag_asymmetry": 10.0, "steering_drag": 20.0, "steering_friction": 20.0,
    "rough_patch": 30.0, "floor_slope_x": 0.03, "floor_slope_y": 0.03,
    "tether_pull": 8.0, "mass_change": 0.1, "yaw_scrub": 10.0, "yaw_coulomb": 15.0,
    "drive_lateral_offset": 0.1, "tyre_relaxation": 0.04, "friction_circle": 2.0, "tyre_soft_saturation": 0.8,
    "load_transfer": 0.1, "front_ply_steer": 20.0, "rear_toe": 0.01, "slippery_patch": 0.3, "motor_delay": 0.05,
    "motor_lag": 0.05, "motor_dead_zone": 0.1, "motor_sag": 0.3, "inverse_power_limit": 1 / 180.0,
    "motor_regeneration": 0.2,
    "steering_offset": 0.01, "steering_backlash": 0.02, "steering_dead_band": 0.05, "steering_delay": 0.013,
    "steering_lag": 0.014, "steering_nonlinearity": 0.008, "steering_side_gain": 0.01, "steering_speed_gain": 0.03,
    "steering_rate_asymmetry": 0.01, "steering_compliance": 1e-4,
}  # fmt: skip


@pytest.mark.parametrize("name", list(ACTING))
def test_every_switch_acts(name: str) -> None:
    commands = np.tile([0.1, 2.0], (COMMAND_HZ * 20, 1))
    commands[100:140] = [2.0, 2.0]  # fast into full lock: the tyres saturate
    commands[140:220] = [-0.4, 2.0]
    commands[220:260] = [0.2, 0.3]  # a reference far below the speed
    commands[260:300] = [1.0, -0.4]
    one, other = (
        simulate_drive(Plant(**change, slippery_patch_radius=50.0), QUIET, 20.0, 1, given_commands=commands)
        for change in ({}, {name: ACTING[name]})
    )
    assert np.abs(one.truth[:, 1:7] - other.truth[:, 1:7]).max() > 1e-4


@pytest.mark.parametrize(
    "name", ["steering_side_gain", "rear_drag_asymmetry", "steering_compliance", "front_ply_steer"]
)
def test_signs_matter(name: str) -> None:
    one, other = (circle(Plant(**{name: s * ACTING[name]})) for s in (1.0, -1.0))
    assert np.abs(one.truth - other.truth).max() > 1e-4


def test_lags_reach_their_limit() -> None:
    """Ever smaller lags come ever closer to none."""
    for name, sizes in {
        "tyre_relaxation": (0.02, 0.001),
        "steering_lag": (0.01, 7e-4),
        "motor_lag": (0.03, 7e-4),
    }.items():
        far, near = (np.abs(circle(Plant(**{name: s})).truth - circle(BASE).truth).max() for s in sizes)
        assert near < 0.2 * far, name


@pytest.mark.parametrize(
    "name", ["pose_latency", "clock_drift", "marker_offset_x", "marker_offset_y", "body_yaw_misalignment", "pose_scale"]
)
def test_measurement_switches_touch_the_pose_only(name: str) -> None:
    one, other = circle(BASE), circle(BASE, QUIET._replace(**{name: 0.02}))
    np.testing.assert_array_equal(one.truth, other.truth)
    n = min(len(one.pose), len(other.pose))
    assert np.abs(one.pose[:n] - other.pose[:n]).max() > 1e-3


@pytest.mark.parametrize("tau", [0.05, 0.004, 0.009])
def test_a_latency_is_equal_delays_of_both_commands(tau: float) -> None:
    """effects.md: exactly the same, once the start is over; also where tau is no whole number of fine steps."""
    commands = np.tile([0.6, 2.0], (COMMAND_HZ * 20, 1))
    commands[:10] = 0.0
    commands[100:140] = [-1.5, 0.8]
    late = simulate_drive(BASE, QUIET._replace(pose_latency=tau), 20.0, 1, given_commands=commands)
    slow = simulate_drive(Plant(steering_delay=tau, motor_delay=tau), QUIET, 20.0, 1, given_commands=commands)
    np.testing.assert_allclose(late.pose, slow.pose, atol=5e-6)


@pytest.mark.parametrize("tau", [0.004, 0.009])
def test_a_steering_delay_is_that_long_at_the_rate_limit_too(tau: float) -> None:
    """While the servo of one car and of another with late commands run at the limit, one is d tau behind."""
    commands = np.zeros((COMMAND_HZ * 20, 2))
    for k, angle in enumerate([2.0, -2.0, 1.5, -1.0, 2.0, -2.0, 0.5, 1.9]):
        commands[10 + 45 * k : 55 + 45 * k, 0] = angle
    prompt, late = (
        simulate_drive(Plant(steering_delay=delay), QUIET, 20.0, 1, given_commands=commands).truth[:, 7]
        for delay in (0.0, tau)
    )
    step = BASE.servo_rate * 0.1
    moves = np.diff(np.column_stack([prompt, late]), axis=0)
    limited = np.flatnonzero((np.abs(np.abs(moves) - step) < 1e-9).all(axis=1))
    assert len(limited) > 40
    behind = np.sign(moves[limited, 0]) * (prompt - late)[limited]
    np.testing.assert_allclose(behind / BASE.servo_rate, tau, atol=1e-6)


def test_the_committed_logs_are_what_the_command_makes(tmp_path: Path, vehicle: Vehicle) -> None:
    write_sample_logs(tmp_path, 1)
    assert {p.name for p in tmp_path.iterdir()} == {p.name for p in SAMPLES.iterdir()}
    assert sum(p.stat().st_size for p in SAMPLES.rglob("*") if p.is_file()) < 12e6
    for take in TAKES:
        name = f"{take.name}.{'mcap' if take.format == 'mcap' else 'csv'}"
        made, committed = (read_raw_take(folder / name, vehicle) for folder in (tmp_path, SAMPLES))
        for attribute in ("pose_time_s", "pose", "command_time_s", "command"):
            np.testing.assert_allclose(getattr(made, attribute), getattr(committed, attribute), atol=2e-6, rtol=0)
        truth = [read_columns(folder / "truth" / f"{take.name}.parquet", TRUTH_UNITS) for folder in (tmp_path, SAMPLES)]
        np.testing.assert_allclose(*truth, atol=1e-6)
    assert (tmp_path / "bumper_car.toml").read_text() == (SAMPLES / "bumper_car.toml").read_text()


def test_training_is_long_enough() -> None:
    training = [t for t in TAKES if t.name.startswith("training")]
    assert sum(t.duration_s for t in training) >= 1200.0
    assert len(training) == 4
    assert {t.format for t in training} == {"motive", "mcap"}


def test_motive_export_names_its_format(vehicle: Vehicle) -> None:
    assert read_motive_poses(SAMPLES / "validation.csv", vehicle).rate_hz == 60.0
