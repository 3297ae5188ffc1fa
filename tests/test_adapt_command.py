"""`bcid adapt` over a recording: what is written, and that the filter in C does what was done here."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result
from exported_models import CAR, k_sindy
from typer.testing import CliRunner

from bcid.adaptation.adapt import adapt, as_adaptable, poses_at_rows
from bcid.cli.app import app
from bcid.documents.adapt import AdaptDocument
from bcid.errors import InputRefused, UsageError
from bcid.estimate.run import estimate_motion
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.saving import save_model
from bcid.recording.types import Stream
from bcid.simulation.car import configure_simulation
from bcid.simulation.drive import simulate_drive
from bcid.simulation.samples import SampleTake, write_sample_take
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
        assert float(done.stdout) < 1e-9


def test_what_is_no_car_is_refused(folder: Path, tmp_path: Path) -> None:
    save_model(k_sindy(), tmp_path)
    vehicle = folder / "vehicle.toml"
    result = run(tmp_path, folder / "take.csv", "--vehicle", vehicle, "--out", tmp_path / "out", "--ignore-health")
    assert isinstance(result.exception, UsageError)
    assert not (tmp_path / "out" / "adapt.json").exists()


def test_what_is_known_goes_on_over_a_gap() -> None:
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
    assert found.track.sd[second, 0] < found.quantities[0].sd
    with pytest.raises(UsageError, match="no constants of a car"):
        as_adaptable(k_sindy(), vehicle, estimate)
