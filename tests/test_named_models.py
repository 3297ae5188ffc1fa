"""Models by name: what `fit` saves is found by every command; what it scores is what the report says."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from exported_models import MODELS
from typer.testing import CliRunner

from bcid.cli.app import app
from bcid.errors import InputRefused
from bcid.models.saving import load_model, save_model
from bcid.pipeline.named_models import find_model, name_of_fit, saved_models

PIPELINE = """\
vehicle = "{vehicle}"
training = ["{training}"]
validation = "{validation}"
models = ["newton-euler", "k-sindy", "newton-euler-linear"]
[fit.newton-euler]
loss = "one-step"
[report]
timing_repeats = 0
losses = ["one-step"]
"""


@pytest.fixture
def lab(tmp_path: Path, takes: dict[str, Path], vehicle_file: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a pipeline.toml, in which commands are typed."""
    text = PIPELINE.format(
        vehicle=vehicle_file.as_posix(), training=takes["motive"].as_posix(), validation=takes["other"].as_posix()
    )
    (tmp_path / "pipeline.toml").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def typed(*words: str, code: int = 0) -> tuple[str, str]:
    """What a command prints on stdout and stderr, whose exit code is 0."""
    done = CliRunner().invoke(app, [*words], catch_exceptions=False)
    assert done.exit_code == code, done.stderr
    return done.stdout, done.stderr


def saved(folder: Path, name: str = "newton-euler-augmented") -> Path:
    folder.mkdir(parents=True)
    save_model(MODELS[name], folder)
    return folder


def test_a_name_and_a_path_lead_to_a_model(tmp_path: Path) -> None:
    one, other = saved(tmp_path / "w" / "models" / "one"), saved(tmp_path / "w" / "diagnosis" / "model")
    whole = saved(tmp_path / "w" / "diagnosis" / "with_remainder")
    assert saved_models(tmp_path / "w") == {"one": one, "diagnosis": other, "with_remainder": whole}
    assert saved_models(tmp_path / "w" / "diagnosis") == {"diagnosis": other, "with_remainder": whole}
    assert find_model("one", lambda: tmp_path / "w") == one
    assert find_model("diagnosis", lambda: tmp_path / "w") == other

    def no_workspace_is_needed() -> Path:
        raise AssertionError

    assert find_model(str(other), no_workspace_is_needed) == other


@pytest.mark.parametrize("named", ["two", "../models/one", "models/one", "", "."])
def test_a_name_that_there_is_not_is_refused_with_those_that_there_are(tmp_path: Path, named: str) -> None:
    saved(tmp_path / "w" / "models" / "one")
    with pytest.raises(InputRefused) as refused:
        find_model(named, lambda: tmp_path / "w")
    if named == "two":
        assert "choose one of one" in str(refused.value)


def test_without_models_or_workspace_the_refusal_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match="bcid fit"):
        find_model("one", lambda: tmp_path)
    with pytest.raises(InputRefused, match="pipeline file with -p"):
        find_model("one", lambda: None)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputRefused, match="holds no fitted model"):
        find_model(str(tmp_path / "empty"), lambda: None)


def test_a_fit_on_another_loss_has_a_name_of_its_own() -> None:
    assert name_of_fit("newton-euler", None, "rollout") == "newton-euler"
    assert name_of_fit("newton-euler", "rollout", "rollout") == "newton-euler"
    assert name_of_fit("newton-euler", "poses", "rollout") == "newton-euler-poses"
    assert name_of_fit("newton-euler-linear", None, None) == "newton-euler-linear"


def test_what_is_fitted_is_scored_as_in_the_report_and_found_by_its_name(lab: Path) -> None:
    told = json.loads(typed("fit", "--model", "newton-euler", "--model", "k-sindy", "--format", "json")[0])
    assert {m["name"] for m in told["models"]} == {"newton-euler", "k-sindy"}
    scores = {m["name"]: m["score"]["nmse"] for m in told["models"]}
    assert [m["name"] for m in told["models"]] == sorted(scores, key=lambda name: scores[name])

    shown, notes = typed("report", "--format", "human")
    report = json.loads((lab / "workspace" / "report" / "report.json").read_text(encoding="utf-8"))
    assert {m["model"]: m["nmse"] for m in report["models"]} == scores
    assert "newton-euler-linear" not in shown
    assert "not fitted yet, so not compared: newton-euler-linear" in notes
    assert "pipeline file: pipeline.toml" in notes
    assert report["diagnosis"] is None
    # only fits that were made: none by the loss that a table of its own compares, but for what is that anyway
    assert {row["model"] for row in report["losses"]} <= set(scores)
    assert len(list((lab / "workspace" / "fit").iterdir())) == 2
    assert not (lab / "workspace" / "diagnose").exists()

    # asked for by name, it is fitted, and only this is compared
    typed("report", "--model", "newton-euler-linear")
    report = json.loads((lab / "workspace" / "report" / "report.json").read_text(encoding="utf-8"))
    assert [m["model"] for m in report["models"]] == ["newton-euler-linear"]

    typed("fit", "--model", "newton-euler", "--loss", "rollout")
    assert set(saved_models(lab / "workspace")) == {
        "newton-euler", "newton-euler-rollout", "newton-euler-linear", "k-sindy",
    }  # fmt: skip
    beside = json.loads(typed("report", "-m", "newton-euler", "-m", "newton-euler-rollout", "--format", "json")[0])
    assert len(beside["models"]) == 2

    typed("export", "newton-euler-rollout", "--format", "parameters", "--out", "code")
    assert (lab / "code" / "newton_euler_parameters.yaml").is_file()
    (lab / "go.csv").write_text("time_s,steering_rad,throttle_mps\n0,0.1,1\n5,0.1,1\n", encoding="utf-8")
    typed("simulate", "ahead", "--model", "newton-euler", "--commands", "go.csv", "--out", "ahead")
    assert (lab / "ahead" / "ahead.prediction.parquet").is_file()


def test_a_copy_that_was_edited_is_not_written_over(lab: Path) -> None:
    typed("fit", "--model", "newton-euler-linear")
    copy = lab / "workspace" / "models" / "newton-euler-linear" / "model.json"
    text = copy.read_text(encoding="utf-8")
    copy.write_text(text + "\n", encoding="utf-8")
    with pytest.raises(InputRefused, match=r"model\.json"):
        typed("fit", "--model", "newton-euler-linear")
    assert copy.read_text(encoding="utf-8") == text + "\n"
    typed("fit", "--model", "newton-euler-linear", "--force")
    assert copy.read_text(encoding="utf-8") == text


def test_a_fit_without_a_validation_take_says_that_it_has_no_score(lab: Path) -> None:
    plan = lab / "pipeline.toml"
    lines = [line for line in plan.read_text(encoding="utf-8").splitlines() if not line.startswith("validation")]
    plan.write_text("\n".join(lines), encoding="utf-8")
    shown, notes = typed("fit", "--model", "newton-euler-linear")
    assert "not scored: " in notes
    assert 'validation = "…"' in notes
    assert "NMSE" not in shown
    assert load_model(lab / "workspace" / "models" / "newton-euler-linear").name == "newton-euler-linear"


def test_equations_are_printed_where_they_are_asked_for(lab: Path) -> None:
    plain, _ = typed("fit", "--model", "newton-euler")
    with_equations, _ = typed("fit", "--model", "newton-euler", "--equations")
    assert "M_z =" not in plain
    assert "M_z =" in with_equations
    assert len(plain.splitlines()) < 20
    for text in (plain, with_equations):
        assert "front cornering stiffness" in text
        assert "±" in text


def test_recordings_beside_a_pipeline_file_need_neither_vehicle_nor_folder(lab: Path, takes: dict[str, Path]) -> None:
    shown, notes = typed("ingest", str(takes["mcap"]))
    assert "drive_m" in shown
    assert "pipeline file: pipeline.toml" in notes
    assert (lab / "workspace" / "ingest").is_dir()
