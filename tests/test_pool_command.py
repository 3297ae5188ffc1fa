"""Recordings of one car pooled: loads are weighed, and the car of all is better than that of any one of them."""

from __future__ import annotations

import pickle
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cars import CAR
from typer.testing import CliRunner

from bcid.cli.app import app
from bcid.cli.pooling import doubts_of_factors
from bcid.documents.pool import PoolDocument, PooledAlternative
from bcid.effects.constants import Constants
from bcid.errors import InputRefused, PartLost, UsageError
from bcid.estimate.run import estimate_motion
from bcid.estimate.types import Estimate
from bcid.evaluation.seen_takes import load_seen_takes
from bcid.fleet import pool_recordings
from bcid.fleet.pool_recordings import FittedRecording, estimate_and_fit, fit_recording
from bcid.fleet.pooled_car import CarSummary, pool_car, summarise_fit, weigh_alternatives
from bcid.likelihood.hypothesis import Hypothesis
from bcid.models.saving import load_model
from bcid.pipeline.config import PipelineConfig
from bcid.recording.types import Recording
from bcid.simulation.car import configure_simulation
from bcid.simulation.drive import simulate_drive
from bcid.simulation.samples import SampleTake, write_sample_take
from bcid.vehicle import Vehicle
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


def test_a_load_on_tyres_that_grip_the_better_for_it_is_not_taken_for_none(summaries: list[CarSummary]) -> None:
    """Per mass their grip, and drag, are what they were: only the motor is weaker."""
    loaded = []
    for load, each in zip(LOADS, summaries, strict=True):
        grows = np.array([s in ("C_f", "C_r", "F_f_max", "F_r_max") for s in each.symbols])
        phi = each.summary.phi + grows * np.log(1.0 + load)
        phi[[each.symbols.index("R_1"), each.symbols.index("R_2")]] *= 1.0 + load
        loaded.append(each._replace(summary=each.summary._replace(phi=phi)))
    as_mass = pool_car(loaded, ["mass"])
    assert np.ptp(as_mass.factors([0, 2])[0]) < 0.05
    best = weigh_alternatives(loaded, as_mass)[0]
    assert best.other in ("load", "motor")
    assert best.nats > 4.0
    factors, _ = pool_car(loaded, ["load"]).factors([0, 2])
    assert factors[:, 0] == pytest.approx([1.0 + load for load in LOADS], rel=0.04)
    assert weigh_alternatives(summaries, pool_car(summaries, ["mass"]))[0].nats < 0.0


def test_what_may_stand_in_a_factor_s_place_is_said() -> None:
    def doubts_at(*nats: float) -> list[str]:
        others = [
            PooledAlternative(named="mass", other=o, nats=n) for o, n in zip(("load", "motor"), nats, strict=True)
        ]
        return doubts_of_factors(
            PoolDocument(vehicle="car", constants=(), recordings=(), spreads={"mass": 0.1}, alternatives=tuple(others))
        )

    assert doubts_at(31.0, 20.0) == ["mass: the recordings are 31 nats likelier if load differs in its place (--own)"]
    # a load on such tyres, or an empty battery
    assert doubts_at(31.0, 30.0)[0].endswith("if load or motor differs in its place (--own)")
    assert doubts_at(1.0, -3.0) == ["mass: the recordings do not tell it from load or motor"]
    assert doubts_at(-9.0, -30.0) == []


def test_what_is_said_twice_differs_once(summaries: list[CarSummary]) -> None:
    once, twice = pool_car(summaries, ["mass"]), pool_car(summaries, ["mass", "mass"])
    assert twice.names == ("mass",)
    assert twice.factors([0, 2])[0] == pytest.approx(once.factors([0, 2])[0])


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


@pytest.mark.parametrize(
    ("takes", "words", "cause"),
    [(2, ["--own", "colour"], "nothing that differs is called colour"), (1, [], "nothing to be pooled with")],
)
def test_what_cannot_be_pooled_is_refused_before_anything_is_fitted(
    takes: int, words: list[str], cause: str, tmp_path: Path, vehicle_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool_recordings, "fit_recordings", lambda *_: pytest.fail("fitted"))
    plant, sensor = configure_simulation(True, [], 60.0)
    files = [
        write_sample_take(tmp_path, SampleTake(f"day_{i}", "motive", 20.0), plant, sensor, i) for i in range(takes)
    ]
    command = ["pool", *map(str, files), "--vehicle", str(vehicle_file), "--out", str(tmp_path / "work"), *words]
    refused = CliRunner().invoke(app, command).exception
    assert isinstance(refused, UsageError)
    assert cause in str(refused)


def test_a_drive_that_is_there_twice_is_refused(tmp_path: Path, vehicle_file: Path) -> None:
    plant, sensor = configure_simulation(True, [], 60.0)
    take = write_sample_take(tmp_path, SampleTake("day_0", "motive", 20.0), plant, sensor, 0)
    part = f"{take}[2:15]"
    command = ["pool", str(take), part, "--vehicle", str(vehicle_file), "--out", str(tmp_path / "work")]
    refused = CliRunner().invoke(app, [*command, "--ignore-health"]).exception
    assert isinstance(refused, InputRefused)
    assert f"{part} is {take} once more, or a part of it" in str(refused)


@pytest.mark.slow
def test_the_command_writes_factors_and_the_car_of_all(tmp_path: Path, vehicle_file: Path) -> None:
    takes = []
    for seed, load in enumerate((0.0, 0.2)):
        plant, sensor = configure_simulation(False, [f"mass_change={load}", "mass_change_at=0"], 60.0)
        takes.append(write_sample_take(tmp_path, SampleTake(f"day_{seed}", "motive", 45.0), plant, sensor, 60 + seed))
    words = ["pool", *map(str, takes), "--vehicle", str(vehicle_file), "--out", str(tmp_path / "work")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert len(list((tmp_path / "work" / "tune").iterdir())) == 2  # the estimator is tuned to each by itself
    found = PoolDocument.read(tmp_path / "work" / "pool.json")
    assert [r.reference for r in found.recordings] == [True, False]
    assert found.recordings[0].factors[0].factor == 1.0
    assert found.recordings[1].factors[0].factor == pytest.approx(1.2, rel=0.05)
    car = load_model(tmp_path / "work" / "models" / "pooled").car  # type: ignore[attr-defined]  # a newton-euler model
    assert {c.symbol: c.value for c in found.constants}["C_f"] == pytest.approx(car.C_f)
    assert np.isfinite([c.se for c in found.constants]).all()
    seen = load_seen_takes(tmp_path / "work" / "models" / "pooled")
    assert seen is not None
    assert len(seen) == 2
    assert isinstance(CliRunner().invoke(app, [*words, "--reference", "typo.csv"]).exception, UsageError)
    again = tmp_path / "again.csv"
    for path, copy in ((takes[0], again), (commands_beside(takes[0]), commands_beside(again))):
        copy.write_bytes(path.read_bytes())
    twice = CliRunner().invoke(app, [*words[:1], str(again), *words[1:]]).exception
    assert isinstance(twice, InputRefused)
    assert "the same drive" in str(twice)
    assert CliRunner().invoke(app, words).exit_code == 0
    (tmp_path / "work" / "pool.json").write_text("mine", encoding="utf-8")
    assert isinstance(CliRunner().invoke(app, words).exception, InputRefused)
    assert (tmp_path / "work" / "pool.json").read_text(encoding="utf-8") == "mine"
    refuse_over_an_edited_model(words, tmp_path / "work")


def test_a_recording_that_cannot_be_fitted_costs_the_others_nothing(
    tmp_path: Path, vehicle_file: Path, summaries: list[CarSummary], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is named at the end, with exit code 3; without the one that all are compared with nothing is pooled."""
    plant, sensor = configure_simulation(True, [], 60.0)
    takes = [write_sample_take(tmp_path, SampleTake(f"day_{i}", "motive", 20.0), plant, sensor, i) for i in range(3)]
    known = iter([*summaries[:2], *summaries[:2]])

    def fit(recording: Recording, estimate: Estimate, vehicle: Vehicle) -> FittedRecording:
        if recording.name == "day_1":
            raise InputRefused(recording.name, "poses", "no model can follow them", "leave it out")
        return FittedRecording(recording.name, recording.duration_s, next(known))

    monkeypatch.setattr(pool_recordings, "fit_recording", fit)
    words = ["pool", *map(str, takes), "--vehicle", str(vehicle_file), "--out", str(tmp_path / "work"), "--jobs", "1"]
    lost = CliRunner().invoke(app, [*words, "--ignore-health"]).exception
    assert isinstance(lost, PartLost)
    assert "1 of 3 recordings are not pooled" in str(lost)
    assert "day_1: poses: no model can follow them" in str(lost)
    found = PoolDocument.read(tmp_path / "work" / "pool.json")
    assert [r.name for r in found.recordings] == ["day_0", "day_2"]
    seen = load_seen_takes(tmp_path / "work" / "models" / "pooled")
    assert seen is not None
    assert len(seen) == 2
    refused = CliRunner().invoke(app, [*words, "--ignore-health", "--reference", str(takes[1])]).exception
    assert isinstance(refused, InputRefused)
    assert PoolDocument.read(tmp_path / "work" / "pool.json") == found


def test_a_pool_s_job_can_be_sent_and_says_which_step_failed(
    tmp_path: Path, vehicle_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where the log has gone since; paths count from the folder in which the job was made."""
    monkeypatch.chdir(tmp_path)
    Path("car.toml").write_bytes(vehicle_file.read_bytes())
    gone = Path("gone.csv")
    settings = PipelineConfig(vehicle=Path("car.toml"), training=[gone], workspace=Path("work"), source="test")
    job = partial(estimate_and_fit, settings.for_recording(tmp_path, gone), "gone")
    sent = pickle.loads(pickle.dumps(job))  # noqa: S301  # as processes are sent it
    monkeypatch.chdir("/")
    result, (problem,) = sent()
    assert result is None
    assert (problem.stage, problem.error) == ("estimate gone", "InputRefused")
    assert str(tmp_path / gone) in problem.text


def commands_beside(take: Path) -> Path:
    """The commands file of a take."""
    return take.with_name(f"{take.stem}.commands.csv")


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
        assert sorted(path.name for path in model.iterdir()) == ["model.json", "takes.json"]
        assert (model / "model.json").read_text(encoding="utf-8") == written
        (workspace / "pool.json").unlink()
    assert CliRunner().invoke(app, words).exit_code == 0


def test_a_constant_that_ended_at_a_bound_says_nothing() -> None:
    """Its slope is not zero there; the others count as they are beside it."""
    hypothesis = Hypothesis((), CAR, 2.012, Constants())
    phi, (low, _), n = hypothesis.phi_of(CAR), hypothesis.bounds(), hypothesis.base_size
    k = hypothesis.log_parameters.index("I_z")
    phi[k] = low[k]
    fit: Any = SimpleNamespace(hypothesis=hypothesis, phi=phi, covariance=1e-4 * np.eye(len(phi)), car=lambda: CAR)
    information = summarise_fit(fit).summary.information
    assert not information[k].any()
    assert not information[:, k].any()
    assert (np.diag(information)[np.arange(n) != k] > 0.0).all()
