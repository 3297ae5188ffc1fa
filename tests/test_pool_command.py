"""Recordings of one car pooled: loads are weighed, and the car of all is better than that of any one of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bcid.cli.app import app
from bcid.documents.pool import PoolDocument
from bcid.errors import InputRefused, UsageError
from bcid.estimate.run import estimate_motion
from bcid.fleet.pool_recordings import fit_recording
from bcid.fleet.pooled_car import CarSummary, pool_car
from bcid.models.saving import load_model
from bcid.simulation.car import configure_simulation
from bcid.simulation.drive import simulate_drive
from bcid.simulation.samples import SampleTake, write_sample_take
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

LOADS = (0.0, 0.25, 0.0, 0.12)


@pytest.fixture(scope="module")
def summaries() -> list[CarSummary]:
    """What a minute's drives of a real car with loads LOADS say."""
    vehicle, found = simulated_vehicle(), []
    for seed, load in enumerate(LOADS):
        plant, sensor = configure_simulation(False, [f"mass_change={load}", "mass_change_at=0"], 60.0)
        recording = record_drive(simulate_drive(plant, sensor, 60.0, 40 + seed), 60.0, vehicle)
        found.append(fit_recording(recording, estimate_motion(recording, vehicle, TUNING), vehicle).summary)
    return found


def test_loads_are_weighed_within_three_percent(summaries: list[CarSummary]) -> None:
    pooled = pool_car(summaries, ["mass"])
    factors, sd = pooled.factors([0, 2])
    assert factors[:, 0] == pytest.approx([1.0 + load for load in LOADS], rel=0.03)
    assert (sd < 0.03).all()


def test_a_recording_s_car_has_its_load_in_its_forces(summaries: list[CarSummary]) -> None:
    pooled = pool_car(summaries, ["mass"])
    assert pooled.car_of(1).C_f / pooled.car_of(0).C_f == pytest.approx(1.0 / 1.25, rel=0.03)
    assert pooled.car_of(1).I_z == pytest.approx(pooled.car_of(0).I_z, rel=0.02)


def test_what_cannot_be_pooled_is_refused(summaries: list[CarSummary]) -> None:
    with pytest.raises(UsageError, match="nothing that differs is called colour"):
        pool_car(summaries, ["colour"])
    with pytest.raises(UsageError, match="nothing to be pooled with"):
        pool_car(summaries[:1], ["mass"])
    other = summaries[0]._replace(symbols=(*summaries[0].symbols[:-1], "R_3"))
    with pytest.raises(UsageError, match="other motors"):
        pool_car([summaries[1], other], ["mass"])


def test_the_command_writes_factors_and_the_car_of_all(tmp_path: Path, vehicle_file: Path) -> None:
    takes = []
    for seed, load in enumerate((0.0, 0.2)):
        plant, sensor = configure_simulation(False, [f"mass_change={load}", "mass_change_at=0"], 60.0)
        takes.append(write_sample_take(tmp_path, SampleTake(f"day_{seed}", "motive", 45.0), plant, sensor, 60 + seed))
    words = ["pool", *map(str, takes), "--vehicle", str(vehicle_file), "--out", str(tmp_path / "work")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    found = PoolDocument.read(tmp_path / "work" / "pool.json")
    assert [r.reference for r in found.recordings] == [True, False]
    assert found.recordings[0].factors[0].factor == 1.0
    assert found.recordings[1].factors[0].factor == pytest.approx(1.2, rel=0.05)
    car = load_model(tmp_path / "work" / "models" / "pooled").car  # type: ignore[attr-defined]  # a newton-euler model
    assert {c.symbol: c.value for c in found.constants}["C_f"] == pytest.approx(car.C_f)
    assert np.isfinite([c.se for c in found.constants]).all()
    assert CliRunner().invoke(app, words).exit_code == 0
    (tmp_path / "work" / "pool.json").write_text("mine", encoding="utf-8")
    assert isinstance(CliRunner().invoke(app, words).exception, InputRefused)
    assert (tmp_path / "work" / "pool.json").read_text(encoding="utf-8") == "mine"
    refuse_over_an_edited_model(words, tmp_path / "work")


def refuse_over_an_edited_model(words: list[str], workspace: Path) -> None:
    """The saved car is kept where a person edited it or put files beside it, and replaced whole by --force."""
    model = workspace / "models" / "pooled"
    (workspace / "pool.json").unlink()
    written = (model / "model.json").read_text(encoding="utf-8")
    for file, text in (("model.json", written + " "), ("limits.json", "{}")):
        (model / file).write_text(text, encoding="utf-8")
        refused = CliRunner().invoke(app, words).exception
        assert isinstance(refused, InputRefused)
        assert Path(refused.source) == model / file
        assert (model / file).read_text(encoding="utf-8") == text
        assert not (workspace / "pool.json").exists()
        assert CliRunner().invoke(app, [*words, "--force"]).exit_code == 0
        assert [path.name for path in model.iterdir()] == ["model.json"]
        assert (model / "model.json").read_text(encoding="utf-8") == written
        (workspace / "pool.json").unlink()
    assert CliRunner().invoke(app, words).exit_code == 0
