"""Models with effects of a user's own: named by a diagnosis, saved, trusted, driven and exported."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from exported_models import augmented_car, written
from own_effects import ACTUATORS, MAGNET, own_file
from own_plant import drive_over_strip
from test_export import needs_casadi, needs_compiler, worst_error
from typer.testing import CliRunner

import bcid
from bcid.cli.app import app
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.effects.own_file import IN_USE, own_effects_in_use
from bcid.errors import InputRefused, UsageError
from bcid.export.augmented_formulas import trace_augmented
from bcid.export.exported import export_model
from bcid.export.reference_drive import EXACT, STEPS
from bcid.models.interface import history_at_rest, rollout
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.saving import load_model, save_model
from bcid.pipeline.config import read_pipeline_file
from bcid.pipeline.run import Pipeline
from bcid.simulation.writing import write_motive_take

ALL_OWN = {"worn_horn__a": 0.1, "warm_motor__s": 0.3, "oblique_drag__b": 9.0}
STIFFNESS, SECONDS = 60.0, 120.0  # N/m, s


def run(*words: str | Path) -> Any:
    return CliRunner().invoke(app, [str(word) for word in words])


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    """The folder of a saved model with the magnet; the file that declares it is effects.py beside it."""
    folder = tmp_path / "model"
    folder.mkdir()
    with own_effects_in_use(own_file(tmp_path, MAGNET)):
        save_model(augmented_car({"magnet_strip__k": 60.0, "yaw_scrub__c": 4.0}), folder)
    return folder


# --- trust --------------------------------------------------------------------------------------------------------


def test_a_saved_model_is_the_same_where_its_file_is_named_again(saved: Path) -> None:
    commands = np.tile([0.3, 1.0], (100, 1))
    with own_effects_in_use(own_file(saved.parent, MAGNET)):
        model = load_model(saved)
        assert isinstance(model, AugmentedNewtonEuler)
        assert model.effects == {"magnet_strip__k": 60.0, "yaw_scrub__c": 4.0}
        assert "magnet_strip: F = " in model.describe()
        ours, its = (rollout(m, history_at_rest(m.lags), commands) for m in (augmented_car(dict(model.effects)), model))
        other = rollout(augmented_car({"yaw_scrub__c": 4.0}), history_at_rest(model.lags), commands)
    np.testing.assert_array_equal(ours, its)
    assert np.abs(ours - other).max() > 1e-3
    assert (saved / "own_effects.py").read_text(encoding="utf-8") == MAGNET


def test_no_code_that_lies_beside_a_model_is_run(saved: Path, tmp_path: Path) -> None:
    """The copy of the file is for people: only a file that was named runs, and only the very same will do."""
    trap = tmp_path / "sprung"
    (saved / "own_effects.py").write_text(f"open({str(trap)!r}, 'w').close()\n", encoding="utf-8")
    with pytest.raises(InputRefused, match="nothing runs them unasked") as refused:
        load_model(saved)
    assert f"--effects {saved / 'own_effects.py'}" in str(refused.value)
    assert not trap.exists()
    with own_effects_in_use(own_file(tmp_path, MAGNET + "\n")), pytest.raises(InputRefused, match="of another file"):
        load_model(saved)


def test_a_digest_cannot_be_left_out(saved: Path) -> None:
    data = json.loads((saved / "model.json").read_text())
    del data["own_effects_sha256"], data["sha256"]
    (saved / "model.json").write_text(json.dumps(data))
    with own_effects_in_use(own_file(saved.parent, MAGNET)), pytest.raises(InputRefused, match="of another file"):
        load_model(saved)
    with pytest.raises(InputRefused, match="there is no 'magnet_strip__k'"):
        load_model(saved)


def test_models_without_such_effects_are_saved_as_ever(tmp_path: Path) -> None:
    (tmp_path / "plain").mkdir()
    with own_effects_in_use(own_file(tmp_path, MAGNET)):
        save_model(augmented_car({"yaw_scrub__c": 4.0}), tmp_path / "plain")
    assert [path.name for path in (tmp_path / "plain").iterdir()] == ["model.json"]
    assert load_model(tmp_path / "plain").effects == {"yaw_scrub__c": 4.0}  # type: ignore[attr-defined]


# --- exports ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "effects"),
    [(MAGNET, {"magnet_strip__k": 60.0}), (ACTUATORS, ALL_OWN), (ACTUATORS, {**ALL_OWN, "motor_lag__tau": 0.1})],
    ids=["push", "actuators", "beside a lag"],
)
def test_laws_are_traced_exactly(text: str, effects: dict[str, float], tmp_path: Path) -> None:
    with own_effects_in_use(own_file(tmp_path, text)):
        model = augmented_car(effects)
        assert worst_error(trace_augmented(model), model) < EXACT


@needs_compiler
@needs_casadi
def test_exports_drive_as_the_model_does(tmp_path: Path) -> None:
    with own_effects_in_use(own_file(tmp_path, MAGNET)):
        exported = export_model(augmented_car({"magnet_strip__k": 60.0}), "0" * 64, None, "over_magnets")
        document = written(exported, ["c", "python", "casadi"], tmp_path / "out")
    assert len(document.vectors.commands) == STEPS >= 200
    for made in document.formats:
        assert made.error is not None
        assert made.error < 1e-9
    assert "magnet_strip__k" in (tmp_path / "out" / "over_magnets.c").read_text()


# --- commands -----------------------------------------------------------------------------------------------------


def test_effects_lists_those_of_a_file(tmp_path: Path) -> None:
    own_file(tmp_path, ACTUATORS)
    listed = run("effects", "--effects", tmp_path / "effects.py", "--format", "json")
    assert [e["effect"] for e in json.loads(listed.stdout)["effects"]] == ["worn_horn", "warm_motor", "oblique_drag"]
    told = run("effects", "--effects", tmp_path / "effects.py", "worn_horn")
    assert "δ_w = (1 + a·[δ > 0])·δ" in told.stdout
    assert f"law: {tmp_path / 'effects.py'}:" in told.stdout.replace("\n", "")
    assert "worn_horn" not in run("effects").stdout


def test_commands_that_use_a_model_ask_for_its_file(saved: Path, tmp_path: Path, vehicle_file: Path) -> None:
    take = tmp_path / "strip.csv"
    write_motive_take(take, drive_over_strip(STIFFNESS, 30.0, 4), 60.0, 0)
    effects, commands = tmp_path / "effects.py", tmp_path / "drive.commands.csv"
    rows = "".join(f"{0.1 * k:.1f},0.2,1.0\n" for k in range(50))
    commands.write_text(f"time_s,steering_rad,throttle_mps\n{rows}", encoding="utf-8")
    of_command: dict[str, list[str | Path]] = {
        "export": [saved, "--format", "python"],
        "simulate": ["driven", "--model", saved, "--commands", commands],
        "predict": [saved, "--commands", commands],
        "view": [take, "--vehicle", vehicle_file, "--model", saved],
        "adapt": [saved, take, "--vehicle", vehicle_file],
    }
    files = {"predict": "table.csv", "view": "take.mcap"}
    for command, words in of_command.items():
        (tmp_path / command).mkdir()
        out = tmp_path / command / files.get(command, "made")
        refused = run(command, *words, "--out", out)
        assert isinstance(refused.exception, InputRefused)
        assert "--effects" in str(refused.exception)
        assert not out.exists() or command == "adapt"  # which keeps the take's motion there
        done = run(command, *words, "--out", out, "--effects", effects)
        assert done.exit_code == 0, (command, done.output, done.exception)
        assert out.is_file() or list(out.iterdir())
    alone = run("simulate", "--effects", effects)
    assert isinstance(alone.exception, UsageError)


def test_a_pipeline_file_names_a_file_of_effects(saved: Path, vehicle_file: Path) -> None:
    """By a path from its own folder; the file is in use where models are read, and only there."""
    path = saved.parent / "pipeline.toml"
    text = f'vehicle = "{vehicle_file}"\ntraining = ["take.csv"]\nworkspace = "work"\n[estimate]\nperiod_s = 0.02\n'
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputRefused, match="--effects"):
        Pipeline(read_pipeline_file(path)).load_for_comparison(saved)
    path.write_text(f'effects = "effects.py"\n{text}', encoding="utf-8")
    assert Pipeline(read_pipeline_file(path)).load_for_comparison(saved).folder == saved
    assert not IN_USE
    (saved.parent / "effects.py").write_text("import os\n", encoding="utf-8")
    with pytest.raises(InputRefused, match="imports os"):
        Pipeline(read_pipeline_file(path)).load_for_comparison(saved)


def test_a_pipeline_file_that_was_only_found_runs_no_code(
    saved: Path, vehicle_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stages that need no effects never run the file, and others run it where a person named it or what names it."""
    home = saved.parent
    monkeypatch.chdir(home)
    write_motive_take(home / "take.csv", drive_over_strip(STIFFNESS, 30.0, 4), 60.0, 0)
    (home / "sprung.py").write_text(f"open({str(home / 'sprung')!r}, 'w').close()\n{MAGNET}", encoding="utf-8")
    (home / "pipeline.toml").write_text(
        f'effects = "sprung.py"\nvehicle = "{vehicle_file}"\ntraining = ["take.csv"]\nworkspace = "work"\n',
        encoding="utf-8",
    )
    for words in (["ingest"], ["ingest", "-p", "pipeline.toml"], ["estimate"]):
        done = run(*words)
        assert done.exit_code == 0, (done.output, done.exception)
    refused = run("diagnose")
    assert isinstance(refused.exception, InputRefused)
    assert "if you trust it, give --effects sprung.py, or -p pipeline.toml" in str(refused.exception)
    refused = run("adapt", saved, "take.csv")
    assert isinstance(refused.exception, InputRefused)
    assert "sprung.py" in str(refused.exception)
    assert not (home / "sprung").exists()
    named = run("adapt", saved, "take.csv", "-p", "pipeline.toml")
    assert isinstance(named.exception, InputRefused)
    assert "of another file" in str(named.exception)
    assert (home / "sprung").exists()


@pytest.mark.parametrize("by", ["argument", "pipeline file", "context"])
def test_in_python_a_diagnosis_ends_with_the_model_that_has_the_effect(
    saved: Path, vehicle_file: Path, monkeypatch: pytest.MonkeyPatch, by: str
) -> None:
    """Its last line loads the model; the diagnosis itself, which takes minutes, is put in its place."""
    home, effects = saved.parent, saved.parent / "effects.py"
    seen = []

    def diagnosed(work: Pipeline, simulation: str | None) -> SimpleNamespace:
        assert work.runner.own_effects is not None
        seen.append(work.runner.own_effects.sha256)
        return SimpleNamespace(folder=home)

    monkeypatch.setattr(Pipeline, "diagnose", diagnosed)
    monkeypatch.setattr(DiagnosisDocument, "read", lambda path: None)
    (home / "pipeline.toml").write_text(
        f'effects = "effects.py"\nvehicle = "{vehicle_file}"\ntraining = ["take.csv"]\n', encoding="utf-8"
    )
    if by == "argument":
        found = bcid.diagnose("take.csv", vehicle=vehicle_file, out=home / "work", effects=effects)
    elif by == "pipeline file":
        found = bcid.diagnose(pipeline=home / "pipeline.toml")
    else:
        with bcid.own_effects(effects):
            found = bcid.diagnose("take.csv", vehicle=vehicle_file, out=home / "work")
    with bcid.own_effects(effects):
        prediction = bcid.predict(found.model, np.tile([0.2, 1.0], (5, 1)))
        assert len(bcid.load(saved).predict(np.tile([0.2, 1.0], (5, 1)))) == len(prediction) == 6
    assert seen == [own_file(home, MAGNET).sha256]
    assert not IN_USE


@pytest.mark.slow
def test_a_diagnosis_names_the_effect_with_its_size(tmp_path: Path, vehicle_file: Path) -> None:
    """The plant's law is written anew in `own_plant`; the model that is made of it is driven on and exported."""
    own_file(tmp_path, MAGNET)
    write_motive_take(tmp_path / "strip.csv", drive_over_strip(STIFFNESS, SECONDS, 4), 60.0, 0)
    effects, out = tmp_path / "effects.py", tmp_path / "found"
    done = run(
        "diagnose", tmp_path / "strip.csv", "--vehicle", vehicle_file, "--out", out, "--effects", effects,
        "--format", "json",
    )  # fmt: skip
    assert done.exit_code == 0, (done.output, done.exception)
    found = json.loads(done.stdout)
    assert found["verdict"] == "named"
    assert [f["effect"] for f in found["findings"]] == ["magnet_strip"]
    k = found["findings"][0]["parameters"]["k"]
    assert k["unit"] == "N/m"
    assert k["value"] == pytest.approx(STIFFNESS, abs=3.0 * k["se"])
    assert k["se"] < 0.05 * STIFFNESS
    page = (out / "diagnosis.html").read_text(encoding="utf-8")
    assert "magnet strip" in page
    assert "exp(−((p_x − x_0)/w)²)" in page
    assert (out / "model" / "own_effects.py").read_text(encoding="utf-8") == MAGNET
    exported = run("export", out / "model", "--effects", effects, "--format", "python", "--out", tmp_path / "code")
    assert exported.exit_code == 0, (exported.output, exported.exception)


@pytest.mark.slow
def test_without_the_file_the_same_recording_is_unknown_and_lies_where_the_magnets_are(
    tmp_path: Path, vehicle_file: Path
) -> None:
    write_motive_take(tmp_path / "strip.csv", drive_over_strip(STIFFNESS, SECONDS, 4), 60.0, 0)
    done = run(
        "diagnose", tmp_path / "strip.csv", "--vehicle", vehicle_file, "--out", tmp_path / "found", "--format", "json"
    )
    assert done.exit_code == 0, (done.output, done.exception)
    found = json.loads(done.stdout)
    assert found["verdict"] == "unknown"
    assert found["mismatch"]["where"]["channel"] == "fx"
    assert "place" in found["mismatch"]["where"]["depends_on"]
