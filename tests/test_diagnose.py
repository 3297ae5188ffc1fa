"""From a recording to a verdict, its JSON, its page and its model; each verdict on a small log."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from bcid.cli.app import app
from bcid.diagnosis import diagnose
from bcid.diagnosis.diagnose import Diagnosis, diagnose_recordings
from bcid.diagnosis.locate.regression import DisturbanceRegression
from bcid.effects.table import EFFECTS
from bcid.errors import PredictionDiverged
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.likelihood.take import cut_segments, drop_contacts
from bcid.models.saving import load_model
from bcid.recording.checks.contacts import find_contacts
from bcid.recording.read import read_recording
from bcid.recording.types import Recording, Stream
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.samples import SampleTake as Order
from bcid.simulation.samples import write_sample_take
from bcid.vehicle import Vehicle

ROUGH = {"rough_force": 3.0, "rough_moment": 1.5}
SECONDS = 120.0


def taken(
    folder: Path, vehicle: Vehicle, tuning: Tuning, plant: Plant, seed: int, sensor: Sensor | None = None
) -> tuple[Recording, Estimate]:
    path = write_sample_take(folder, Order(f"take{seed}", "mcap", SECONDS), plant, sensor or Sensor(), seed)
    recording = read_recording(path, vehicle)
    return recording, estimate_motion(recording, vehicle, tuning)


def verdict_on(
    folder: Path, vehicle: Vehicle, tuning: Tuning, plant: Plant, left_out: tuple[str, ...] = ()
) -> Diagnosis:
    recording, estimate = taken(folder, vehicle, tuning, plant, 5)
    return diagnose_recordings([recording], [estimate], vehicle, excluded=left_out)


@pytest.mark.parametrize(
    ("trusted", "bent", "fails", "passes"),
    [
        (False, [False], False, ["at rest"]),  # what was found explains all
        (False, [True], False, ["at rest", "under pushes"]),
        (False, [], True, ["at rest", "under pushes"]),  # no tangent follows
        (True, [True], False, ["under pushes"]),
        (True, [False, False], False, ["at rest"]),
    ],
)
def test_pushes_are_for_what_is_bent_beside_the_best(
    trusted: bool, bent: list[bool], fails: bool, passes: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def of_take(of: Any, progress: Any, left_out: tuple[str, ...], dropped: tuple[str, ...] = ()) -> Any:
        done.append("under pushes" if of.take.pushed else "at rest")
        out.append((*left_out, *dropped))
        if fails and not of.take.pushed:
            raise PredictionDiverged
        search = SimpleNamespace(proxies=("pose_latency",), at_bounds=("mass_change",))
        return SimpleNamespace(judgement=SimpleNamespace(fit=None, search=search), take=of.take)

    fit = SimpleNamespace(hypothesis=SimpleNamespace(trusted_simulation=(1.0,) if trusted else None))
    base = diagnose.BaseFit(SimpleNamespace(pushed=False), (), fit, None)  # type: ignore[arg-type]
    done, out, answers = list[str](), list[tuple[str, ...]](), list(bent)
    monkeypatch.setattr(diagnose, "fit_base_model", lambda *_: base)
    monkeypatch.setattr(diagnose.prepare, "refit_base_with_pushes", lambda *_: (SimpleNamespace(pushed=True), fit))
    monkeypatch.setattr(diagnose, "_diagnose_take", of_take)
    monkeypatch.setattr(diagnose.prepare, "needs_pushes", lambda *_: answers.pop(0))
    nothing: Any = None
    assert diagnose_recordings([], [], nothing, excluded=("motor_lag",)).take.pushed is (passes[-1] == "under pushes")
    assert done == passes
    dropped = ("pose_latency",) if len(passes) == 2 and not fails else ()  # pushes would hide that it stands in
    assert out[-1] == ("motor_lag", *dropped)
    assert not answers


@pytest.mark.slow
def test_nothing_is_found_where_nothing_is_missing(tmp_path: Path, vehicle: Vehicle, tuning: Tuning) -> None:
    found = verdict_on(tmp_path, vehicle, tuning, Plant(**ROUGH))
    assert found.judgement.verdict == "nothing-found"
    assert found.judgement.findings == ()
    assert found.p_value > 0.01


@pytest.mark.slow
def test_an_effect_is_named_with_its_value(tmp_path: Path, vehicle: Vehicle, tuning: Tuning) -> None:
    found = verdict_on(tmp_path, vehicle, tuning, Plant(**ROUGH, yaw_scrub=14.0))
    assert found.judgement.verdict == "named"
    (finding,) = found.judgement.findings
    assert finding.effect == "yaw_scrub"
    value, se = finding.values["c"]
    assert value == pytest.approx(14.0, abs=4.0 * se)
    assert finding.held_out.ci95[0] > 0.0
    assert finding.probability > 0.9
    assert found.location.remaining.channel == "mz"


@pytest.mark.slow
def test_what_is_not_in_the_vocabulary_is_unknown_with_its_channel(
    tmp_path: Path, vehicle: Vehicle, tuning: Tuning
) -> None:
    along = tuple(n for n, e in EFFECTS.items() if e.channel == "fx")
    found = verdict_on(tmp_path, vehicle, tuning, Plant(**ROUGH, rear_rolling_viscous=25.0), along)
    left: DisturbanceRegression = found.judgement.unexplained.regression
    assert found.judgement.verdict == "unknown"
    assert found.judgement.findings == ()
    assert left.predictable
    assert found.judgement.unexplained.channel == "fx"
    assert "v_x" in left.depends_on
    assert left.form is not None
    assert "v_x" in left.form


@pytest.mark.slow
def test_a_late_pose_has_the_pair_of_delays_as_its_twin(tmp_path: Path, vehicle: Vehicle, tuning: Tuning) -> None:
    recording, estimate = taken(tmp_path, vehicle, tuning, Plant(**ROUGH), 6, Sensor(pose_latency=0.015))
    found = diagnose_recordings([recording], [estimate], vehicle)
    assert found.judgement.verdict == "ambiguous"
    (finding,) = found.judgement.findings
    assert finding.effect == "pose_latency"
    assert "steering_delay+motor_delay" in finding.twins
    assert EFFECTS[finding.effect].kind == "measurement"


def test_a_car_that_stands_after_a_blow_has_crashed(tmp_path: Path, vehicle: Vehicle, tuning: Tuning) -> None:
    recording, estimate = taken(tmp_path, vehicle, tuning, Plant(**ROUGH), 7)
    fastest = estimate.time_s[int(np.argmax(np.abs(estimate.kinematic[:, 0])))]
    time, values = recording.poses.time_s, recording.poses.values.copy()
    hit = int(np.searchsorted(time, fastest))
    values[hit:] = values[hit] + np.random.default_rng(0).normal(0.0, 5e-4, values[hit:].shape)
    (crash,) = find_contacts(replace(recording, poses=Stream(time, values)))
    assert crash.kind == "crash"
    assert crash.begin_s == pytest.approx(time[hit] - time[0], abs=0.2)


@pytest.mark.parametrize(("every", "bump"), [(1, 1.2), (2, 1.2), (6, 2.0)])
def test_contacts_are_found_excluded_and_nothing_else_is(
    every: int, bump: float, tmp_path: Path, vehicle: Vehicle, tuning: Tuning
) -> None:
    """At 60, 30 and 10 poses a second, where a blow has to be harder to be told from driving."""
    recording, estimate = taken(tmp_path, vehicle, tuning, Plant(**ROUGH), 7)
    poses = Stream(recording.poses.time_s[::every], recording.poses.values[::every])
    recording = replace(recording, poses=poses, rate_hz=recording.rate_hz / every)
    assert find_contacts(recording) == []
    time, values = recording.poses.time_s, recording.poses.values.copy()
    hit = int(np.searchsorted(time, 60.0))
    values[hit:, 0] += bump * (time[hit:] - time[hit])  # a bumper changes the speed at once
    bumped = replace(recording, poses=Stream(time, values))
    (contact,) = find_contacts(bumped)
    assert contact.kind == "contact"
    assert contact.begin_s <= 60.0 <= contact.end_s
    whole = cut_segments(bumped, estimate)
    rest = drop_contacts(whole, [contact])
    assert 1 <= whole.segments - rest.segments <= 3
    assert not np.any((rest.begin_s < 60.0) & (rest.begin_s + 1.5 > 60.0))


@pytest.mark.slow
def test_the_command_writes_json_page_and_a_model_that_others_take(tmp_path: Path, vehicle_file: Path) -> None:
    write_sample_take(tmp_path, Order("drag", "mcap", SECONDS), Plant(**ROUGH, rear_rolling_coulomb=25.0), Sensor(), 8)
    out = tmp_path / "out"
    words = ["diagnose", str(tmp_path / "drag.mcap"), "--vehicle", str(vehicle_file), "--out", str(out)]
    result = CliRunner().invoke(app, [*words, "--format", "json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found == json.loads((out / "diagnosis.json").read_text())
    assert found["schema"] == "bcid.diagnosis/2"
    assert found["verdict"] == "named"
    assert [f["effect"] for f in found["findings"]] == ["rear_rolling_coulomb"]
    (parameter,) = found["findings"][0]["parameters"].values()
    assert parameter["value"] == pytest.approx(25.0, abs=4.0 * parameter["se"])
    assert found["mismatch"]["where"]["channel"] == "fx"
    assert found["fit"]["nmse_after"] < found["fit"]["nmse_before"]
    assert found["fit"]["ratio_ci95"][1] < 1.0
    assert [h["horizon_s"] for h in found["horizons"]] == [0.5, 2.0, 10.0]
    assert "rear rolling coulomb" in (out / "diagnosis.html").read_text()
    assert "rear_rolling_coulomb" in load_model(out / "model").describe()


def test_a_plan_is_written_as_commands(tmp_path: Path, vehicle_file: Path) -> None:
    out = tmp_path / "plan.commands.csv"
    words = ["plan", "yaw_scrub", "--vehicle", str(vehicle_file), "--out", str(out), "--format", "json"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["parts"]
    assert "yaw_scrub" in found["smallest"]
    assert out.read_text().startswith("time_s,steering_rad,throttle_mps")
