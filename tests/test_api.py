"""The interface in Python: light to import, typed, and with the command line's results."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from test_docs import blocks, command_lines

import bcid
from bcid.documents.report import ReportDocument
from bcid.files.parquet import read_columns
from bcid.pipeline.report_stage import ReportExtent
from bcid.pipeline.run import Pipeline
from bcid.recording.saving import POSE_UNITS

ROOT = Path(__file__).parent.parent


def run(*words: str | Path, cwd: Path) -> str:
    """What `bcid` prints for these words."""
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-m", "bcid", *map(str, words)], cwd=cwd, capture_output=True, text=True, check=False, env=env
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_package_costs_nothing_until_it_is_used() -> None:
    text = "import bcid, sys; print([m for m in ('numpy', 'numba', 'pydantic', 'typer') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", text], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_checkers_of_types_know_the_words_that_there_are() -> None:
    stub = ast.parse((ROOT / "bcid" / "__init__.pyi").read_text(encoding="utf-8"))
    told = {f"{n.module}.{a.asname}" for n in ast.walk(stub) if isinstance(n, ast.ImportFrom) for a in n.names}
    assert told == {f"{home}.{name}" for home, names in bcid._HOMES.items() for name in names}
    for name in bcid.__all__:
        assert getattr(bcid, name).__doc__, name
        assert name in dir(bcid)
    with pytest.raises(AttributeError, match="no attribute 'sail'"):
        bcid.sail  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.slow
def test_functions_make_what_commands_make(takes: dict[str, Path], vehicle_file: Path, tmp_path: Path) -> None:
    take, other = takes["motive"], takes["other"]
    said = run("ingest", take, "--vehicle", vehicle_file, "--out", "cli", "--format", "json", cwd=tmp_path)
    (ingested,) = json.loads(said)["recordings"]
    recording = bcid.read(take, str(vehicle_file))
    poses = read_columns(tmp_path / ingested["folder"] / "poses.parquet", POSE_UNITS)
    np.testing.assert_array_equal(np.column_stack([recording.poses.time_s, recording.poses.values]), poses[:, :4])
    said = run(
        "fit", take, "-m", "newton-euler", "--vehicle", vehicle_file, "--out", "cli", "--format", "json", cwd=tmp_path
    )
    (made,) = json.loads(said)["models"]
    folder = tmp_path / made["folder"]
    model = bcid.fit(take, vehicle=vehicle_file, out=tmp_path / "py")
    assert model.folder.parent == tmp_path / "py" / "fit"
    for name in ("model.json", "limits.json", "takes.json"):
        assert (model.folder / name).read_bytes() == (folder / name).read_bytes()
    words = ["--from", other, "--at", "12.5", "--duration", "2", "--vehicle", vehicle_file]
    run("predict", folder, *words, "--out", "cli.csv", cwd=tmp_path)
    moment = bcid.Moment(bcid.estimate_motion(other, vehicle_file), 12.5)
    prediction = bcid.predict(folder, start=moment, duration_s=2.0)
    prediction.write(tmp_path / "py.csv")
    assert (tmp_path / "py.csv").read_bytes() == (tmp_path / "cli.csv").read_bytes()
    again = bcid.predict(model, start=moment, duration_s=2.0)
    np.testing.assert_array_equal(again.covariance, prediction.covariance)
    estimate = bcid.estimate_motion(take, vehicle_file, out=tmp_path / "py")
    np.testing.assert_array_equal(estimate.pose, bcid.estimate_motion(take, vehicle_file, out=tmp_path / "cli").pose)
    compared = bcid.compare([model, "newton-euler-linear"], other, [take], vehicle=vehicle_file, out=tmp_path / "py")
    pipeline = tmp_path / "pipeline.toml"
    texts = {"vehicle": str(vehicle_file), "validation": str(other), "workspace": "cli"}
    lines = [f"{key} = {json.dumps(value)}" for key, value in texts.items()]
    pipeline.write_text(
        "\n".join([*lines, f"training = [{json.dumps(str(take))}]", 'models = ["newton-euler-linear"]'])
    )
    run("report", "-p", pipeline, "-m", folder, "-m", "newton-euler-linear", cwd=tmp_path)
    told = ReportDocument.read(tmp_path / "cli" / "report" / "report.json")
    scores = [[(m.model, m.nmse) for m in document.models] for document in (compared.document, told)]
    assert scores[0] == scores[1]
    assert compared.page.is_file()


@pytest.mark.parametrize(
    ("models", "compared"), [([], ["k-sindy"]), (["narx-mlp"], ["narx-mlp"]), ([Path("saved")], [])]
)
def test_a_pipeline_file_s_models_are_compared_where_none_are_named(
    models: list[str | Path], compared: list[str], vehicle_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Saved models that are compared cost no fit of others, no fit by another loss and no diagnosis."""

    class Asked(Exception):
        """What a report would compare."""

    def report(work: Pipeline, saved: list[Path], extent: ReportExtent) -> None:
        raise Asked(work.config.models, saved, extent)

    monkeypatch.setattr(Pipeline, "report", report)
    pipeline = tmp_path / "pipeline.toml"
    pipeline.write_text(
        f'vehicle = "{vehicle_file}"\ntraining = ["take.csv"]\nmodels = ["k-sindy"]\ndiagnose = ["take.csv"]\n'
    )
    with pytest.raises(Asked) as asked:
        bcid.compare(models, pipeline=pipeline)
    assert asked.value.args == (compared, [m for m in models if isinstance(m, Path)], (False, False))


def test_what_is_missing_is_said(tmp_path: Path) -> None:
    with pytest.raises(bcid.UsageError, match="not given: vehicle, out"):
        bcid.fit("take.csv")
    with pytest.raises(bcid.UsageError, match="not fitted on poses"):
        bcid.fit("take.csv", "k-sindy", vehicle="v.toml", out="work", loss="poses")
    with pytest.raises(bcid.UsageError, match="needs a vehicle file"):
        bcid.estimate_motion("take.csv")
    with pytest.raises(bcid.InputRefused, match="holds no fitted model"):
        bcid.load(tmp_path)
    with pytest.raises(bcid.UsageError, match="no format 'fortran'"):
        bcid.export_code(tmp_path, tmp_path, ["fortran"])
    assert issubclass(bcid.InputRefused, bcid.BcidError)


def tutorial(folder: Path, with_diagnosis: bool) -> str:
    """What docs/python.md prints, all of whose code is run in a folder; the diagnosis takes minutes."""
    for line in command_lines("docs/python.md"):
        if line.startswith("bcid simulate"):
            run(*line.split()[1:], cwd=folder)
    code = [b for b in blocks("docs/python.md", "python") if with_diagnosis or "bcid.diagnose(" not in b]
    program = folder / "tutorial.py"
    program.write_text("\n".join(code), encoding="utf-8")
    env = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-W", "error", program.name], cwd=folder, capture_output=True, text=True, check=False, env=env
    )
    assert done.returncode == 0, done.stderr
    assert (folder / "prediction.csv").is_file()
    assert (folder / "code").is_dir()
    return done.stdout


@pytest.mark.slow
def test_the_tutorial_runs(tmp_path: Path) -> None:
    said = tutorial(tmp_path, with_diagnosis=False)
    assert said.startswith("60 s, 3593 poses, 2 irregularities")
    assert "True beyond the data of newton-euler: u_s is 30 rad" in said
    assert "choose a moment in there" in said
    assert "['c', 'python']" in said
    assert "the covariance is of the start, the constants, what the model lacks" in said


@pytest.mark.proof
def test_the_tutorial_s_diagnosis_runs(tmp_path: Path) -> None:
    assert "Missing in the model" in tutorial(tmp_path, with_diagnosis=True)
