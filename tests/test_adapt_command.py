"""`bcid adapt` over a recording: what is written, and that the filter in C does what was done here."""

from __future__ import annotations

import math
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cars import CAR as SIMULATED_CAR
from click.testing import Result
from exported_models import CAR, k_sindy
from typer.testing import CliRunner

import bcid
from bcid.adaptation.adapt import Adaptation, MeasuredDrive, adapt, as_adaptable, filter_drive, poses_at_rows
from bcid.adaptation.on_line import AdaptedCar, CarUnderWay
from bcid.adaptation.recovery import ErrorsOverTime
from bcid.adaptation.settings import FORGET_S
from bcid.aliases import Floats
from bcid.cli.app import app
from bcid.documents.adapt import AdaptDocument
from bcid.errors import InputRefused, UsageError
from bcid.estimate.run import estimate_motion
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.saving import load_model, save_model
from bcid.recording.read import read_recording
from bcid.recording.types import Stream
from bcid.simulation.car import configure_simulation
from bcid.simulation.drive import COMMAND_HZ, simulate_drive
from bcid.simulation.samples import SampleTake, write_sample_take
from bcid.vehicle import read_vehicle
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

PERIOD_S = 0.05
CC = shutil.which("gcc")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, vehicle_file: Path) -> Path:
    """A take of half a minute, its vehicle file, and a model of a car that is no more than like it."""
    home = tmp_path_factory.mktemp("adapt")
    plant, sensor = configure_simulation(True, [], 60.0)
    write_sample_take(home, SampleTake("take", "motive", 40.0), plant, sensor, 3)
    shutil.copy(vehicle_file, home / "vehicle.toml")
    (home / "model").mkdir()
    save_model(NewtonEuler(CAR._replace(F_m_max=430.0, K_t=250.0), PERIOD_S, {}), home / "model")
    return home


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(app, ["adapt", *map(str, words)])


def test_values_errors_and_the_filter_in_c_are_written(folder: Path) -> None:
    common = [folder / "model", folder / "take.csv", "--vehicle", folder / "vehicle.toml", "--out", folder / "out"]
    result = run(*common, "-q", "mass", "-q", "steering_offset", "--ignore-health")
    assert result.exit_code == 0, result.output
    found = AdaptDocument.read(folder / "out" / "adapt.json")
    assert [q.name for q in found.quantities] == ["mass", "steering_offset"]
    assert found.quantities[1].first == 0.0
    assert found.errors.adapted is not None
    assert found.errors.frozen is not None
    assert found.errors.adapted < found.errors.frozen
    table = np.loadtxt(folder / "out" / "adapted.csv", delimiter=",", skiprows=1)
    assert table[-1, 1] == pytest.approx(found.quantities[0].last, rel=1e-6)
    assert isinstance(run(*common, "--ignore-health").exception, InputRefused)
    if CC is not None:
        strict = ["-std=c99", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic"]
        files = ["car_adapt.c", "car_adapt_test.c", "-lm", "-o", "check"]
        subprocess.run([CC, *strict, *files], cwd=folder / "out", check=True)
        done = subprocess.run([folder / "out" / "check"], capture_output=True, text=True, check=False)
        assert done.returncode == 0
        worst, worst_variance = map(float, done.stdout.split())
        assert worst < 1e-9
        assert worst_variance < 1e-6


def test_what_is_no_car_is_refused(folder: Path, tmp_path: Path) -> None:
    save_model(k_sindy(), tmp_path)
    vehicle = folder / "vehicle.toml"
    result = run(tmp_path, folder / "take.csv", "--vehicle", vehicle, "--out", tmp_path / "out", "--ignore-health")
    assert isinstance(result.exception, UsageError)
    assert not (tmp_path / "out" / "adapt.json").exists()


def test_what_is_known_goes_on_over_a_gap_and_fades() -> None:
    vehicle = simulated_vehicle()
    plant, sensor = configure_simulation(True, [], 60.0)
    recording = record_drive(simulate_drive(plant, sensor, 60.0, 4), 60.0, vehicle)
    keep = (recording.poses.time_s < 30.0) | (recording.poses.time_s > 34.0)
    cut = replace(recording, poses=Stream(recording.poses.time_s[keep], recording.poses.values[keep]))
    estimate = estimate_motion(cut, vehicle, TUNING, PERIOD_S)
    assert len(estimate.segments()) > 1
    assert np.isfinite(poses_at_rows(cut, estimate)).mean() > 0.98
    model = as_adaptable(NewtonEuler(CAR, PERIOD_S, {}), vehicle, estimate)
    found = adapt(model, ["mass"], cut, estimate)
    second = estimate.segments()[1].start
    assert found.track.values[second, 0] == found.track.values[second - 1, 0]
    assert found.track.values[second, 0] != 1.0
    # by exp(-gap/tau), on the way from what it was to what it was at first
    faded = 1.0 - math.exp(-(estimate.time_s[second] - estimate.time_s[second - 1]) / FORGET_S)
    variance, P_0 = found.track.sd[:, 0] ** 2, found.quantities[0].sd ** 2
    assert variance[second] == pytest.approx(variance[second - 1] + faded * (P_0 - variance[second - 1]), rel=1e-9)
    assert variance[second - 1] < variance[second] < P_0
    later = replace(estimate, time_s=estimate.time_s + np.where(np.arange(len(estimate)) >= second, 600.0, 0.0))
    much_later = filter_drive(found.filter, found.formulas, MeasuredDrive(later, found.drive.poses), found.noise)
    assert 0.98 * P_0 < much_later.sd[second, 0] ** 2 < P_0
    assert much_later.sd[-1, 0] < 0.75 * much_later.sd[second, 0]
    with pytest.raises(UsageError, match="no constants of a car"):
        as_adaptable(k_sindy(), vehicle, estimate)


def adapt_after_standing(seconds: float) -> Adaptation:
    """The mass followed over a minute of driving that begins after some `seconds` in which the car stands."""
    vehicle = simulated_vehicle()
    plant, sensor = configure_simulation(False, [], 60.0)
    driven = simulate_drive(plant, sensor, 60.0, 4).command
    commands = np.vstack([np.zeros((round(COMMAND_HZ * seconds), 2)), driven])
    drive = simulate_drive(plant, sensor, 60.0 + seconds, 4, given_commands=commands)
    recording = record_drive(drive, 60.0, vehicle)
    estimate = estimate_motion(recording, vehicle, TUNING, PERIOD_S)
    return adapt(
        as_adaptable(NewtonEuler(SIMULATED_CAR, PERIOD_S, {}), vehicle, estimate), ["mass"], recording, estimate
    )


def test_a_car_that_stands_first_is_followed_as_one_that_drives_at_once() -> None:
    at_once, later = adapt_after_standing(0.0), adapt_after_standing(60.0)
    assert later.noise.twist_sd == pytest.approx(at_once.noise.twist_sd, rel=0.1)
    assert later.noise.q == pytest.approx(at_once.noise.q, rel=0.25)
    assert later.track.sd[-1, 0] == pytest.approx(at_once.track.sd[-1, 0], rel=0.1)
    assert later.track.values[-1, 0] == pytest.approx(at_once.track.values[-1, 0], abs=0.05)


def test_a_car_that_never_moves_is_refused() -> None:
    vehicle = simulated_vehicle()
    plant, sensor = configure_simulation(True, [], 60.0)
    drive = simulate_drive(plant, sensor, 20.0, 1, given_commands=np.zeros((20 * COMMAND_HZ, 2)))
    recording = record_drive(drive, 60.0, vehicle)
    estimate = estimate_motion(recording, vehicle, TUNING, PERIOD_S)
    model = as_adaptable(NewtonEuler(SIMULATED_CAR, PERIOD_S, {}), vehicle, estimate)
    with pytest.raises(InputRefused, match="show no car that moves"):
        adapt(model, ["mass"], recording, estimate)


def test_what_the_filter_cannot_use_is_refused() -> None:
    vehicle = simulated_vehicle()
    plant, sensor = configure_simulation(True, [], 60.0)
    recording = record_drive(simulate_drive(plant, sensor, 20.0, 1), 60.0, vehicle)
    estimate = estimate_motion(recording, vehicle, TUNING, PERIOD_S)
    model = as_adaptable(NewtonEuler(SIMULATED_CAR, PERIOD_S, {}), vehicle, estimate)
    for forget_s in (0.0, -5.0, math.nan):
        with pytest.raises(UsageError, match="nothing is forgotten"):
            adapt(model, ["mass"], recording, estimate, forget_s=forget_s)
    parts = estimate.parts.copy()
    parts[..., 3] = 0.5
    with pytest.raises(InputRefused, match="a brake of its own"):
        adapt(model, ["mass"], recording, replace(estimate, parts=parts))


def test_while_a_brake_of_its_own_acts_nothing_is_followed() -> None:
    drive = adapt_after_standing(0.0).drive
    parts = drive.estimate.parts.copy()
    parts[..., 3] = 0.01  # a pedal that idles
    parts[100:120, :, 3] = 0.5
    braked = drive._replace(estimate=replace(drive.estimate, parts=parts)).without_braking()
    apart = [(s.start, s.stop) for s in braked.stretches()]
    assert apart == [(0, 100), (120, len(drive.estimate))]


def test_following_is_said_to_be_worse_only_where_it_is() -> None:
    rng = np.random.default_rng(3)
    frozen = np.abs(rng.normal(0.03, 0.01, 60))

    def interval(adapted: Floats) -> tuple[float, float] | None:
        return ErrorsOverTime(np.arange(60.0), frozen, adapted).loss_interval()

    alike, worse = interval(np.abs(frozen + rng.normal(0.0, 0.005, 60))), interval(frozen + 0.01)
    assert alike is not None
    assert alike[0] < 0.0 < alike[1]
    assert worse is not None
    assert worse[0] > 0.0
    assert interval(np.full(60, np.inf)) is None
    assert ErrorsOverTime(np.zeros(3), frozen[:3], frozen[:3]).loss_interval() is None


def test_a_drive_s_first_motion_leaves_out_where_the_car_stands() -> None:
    drive = adapt_after_standing(3.0).drive
    v_f = np.full(len(drive.estimate), 0.5)
    v_f[:40] = v_f[60:65] = 0.0
    kinematic = np.column_stack([v_f, drive.estimate.kinematic[:, 1:]])
    motion = drive._replace(estimate=replace(drive.estimate, kinematic=kinematic)).first_motion(0.1, 60 * PERIOD_S)
    assert [(s.start, s.stop) for s in motion.stretches()] == [(0, 20), (25, 65)]
    assert (motion.estimate.time_s == drive.estimate.time_s[40:105]).all()
    assert (motion.poses == drive.poses[40:105]).all()


def test_on_line_the_filter_does_what_it_does_over_a_recording(folder: Path) -> None:
    """Step by step from the recording's start, with a gap in it, as over all of it at once."""
    vehicle = read_vehicle(folder / "vehicle.toml")
    recording = read_recording(folder / "take.csv", vehicle)
    estimate = estimate_motion(recording, vehicle, TUNING, PERIOD_S)
    car = as_adaptable(load_model(folder / "model"), vehicle, estimate)
    whole = adapt(car, ["mass", "steering_offset"], recording, estimate)
    cut = len(estimate) // 2
    apart = replace(estimate, segment=estimate.segment + (np.arange(len(estimate)) >= cut))
    drive = MeasuredDrive(apart, whole.drive.poses)
    track = filter_drive(whole.filter, whole.formulas, drive, whole.noise)
    first = np.array([q.start for q in whole.quantities]), np.array([q.sd for q in whole.quantities])
    unknown = replace(whole, track=whole.track._replace(values=first[0][None], covariance=np.diag(first[1] ** 2)))
    under_way = None
    for rows in drive.stretches():
        start = (apart.pose[rows.start], apart.twist[rows.start], float(apart.kinematic[rows.start, 3]))
        if under_way is None:
            under_way = AdaptedCar(unknown).begin(*start)
        else:
            gap_s = float(apart.time_s[rows.start] - apart.time_s[rows.start - 1])
            under_way.restart(start[0], gap_s, start[1], start[2])
        for row in range(rows.start + 1, rows.stop):
            pose = drive.poses[row]
            under_way.step(apart.command[row - 1], None if np.isnan(pose).any() else pose)
            np.testing.assert_allclose(under_way.values, track.values[row], rtol=1e-12)
            np.testing.assert_allclose(under_way.sd, track.sd[row], rtol=1e-9)
    assert under_way is not None
    np.testing.assert_allclose(track.covariance, under_way.covariance, rtol=1e-9)
    assert abs(track.covariance[0, 1]) > 0.0
    # another drive begins with all that was known at the end of the last
    np.testing.assert_array_equal(AdaptedCar(replace(whole, track=track)).begin().covariance, track.covariance)
    assert under_way.names == ("mass", "steering_offset")
    assert under_way.model().car.m == pytest.approx(car.car.m * under_way.values[0])
    assert np.hypot(*(under_way.pose - apart.pose[-1])[:2]) < 0.05
    assert np.linalg.eigvalsh(under_way.covariance).min() > 0.0


@pytest.mark.parametrize(
    ("step", "said"),
    [
        (lambda car: car.step([0.1]), "is not a command"), (lambda car: car.step([0.1, math.nan]), "is not a command"),
        (lambda car: car.step([0.1, 0.2], [1.0, 2.0]), "is not a pose"),
        (lambda car: car.step([0.1, "x"]), "is not a command"),  # type: ignore[list-item]  # what must not be given
        (lambda car: car.restart([0.0, 0.0, 0.0], -1.0), "a gap cannot last"),
    ],
)  # fmt: skip
def test_what_is_no_command_or_pose_is_refused_and_changes_nothing(
    step: Callable[[CarUnderWay], None], said: str, folder: Path
) -> None:
    adapted = bcid.adapt(
        folder / "model", folder / "take.csv", vehicle=folder / "vehicle.toml", out=folder / "w", ignore_health=True
    )
    assert adapted.values.shape == (len(adapted.time_s), 1)
    car = adapted.begin()
    car.step([0.1, 0.5], [0.01, 0.0, 0.0])
    before = car.values, car.covariance
    with pytest.raises(UsageError, match=said):
        step(car)
    assert np.array_equal(car.values, before[0])
    assert np.array_equal(car.covariance, before[1])
