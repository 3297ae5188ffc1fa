"""A take is known again under another name, in another format or cut; what was made from it is not judged on it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from bcid.cli.app import app
from bcid.errors import InputRefused
from bcid.evaluation.limits import LIMITS
from bcid.evaluation.seen_takes import (
    FILE_NAME,
    TakeSteps,
    has_seen,
    is_same_drive,
    load_seen_takes,
    number_steps,
    read_take_steps,
    save_seen_takes,
    shared_share,
)  # fmt: skip
from bcid.files.json import read_json, write_json
from bcid.models import published
from bcid.models.saving import save_model
from bcid.pipeline.config import read_pipeline_file
from bcid.pipeline.run import Pipeline
from bcid.recording.read import read_recording
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle


def steps_of(recording: Recording, rows: slice = slice(None), resolution_m: float = 1e-6) -> TakeSteps:
    place = np.round(recording.poses.values[rows, :2] / resolution_m) * resolution_m
    return TakeSteps(recording.name, number_steps(place))


def test_the_same_drive_is_known_in_another_format_and_in_parts(takes: dict[str, Path], vehicle: Vehicle) -> None:
    motive, mcap, other = (read_recording(takes[name], vehicle) for name in ("motive", "mcap", "other"))
    assert shared_share(steps_of(motive), steps_of(mcap)) > 0.95
    assert is_same_drive(steps_of(motive, slice(900, 1200)), steps_of(mcap))
    assert not is_same_drive(steps_of(motive, slice(0, 1500)), steps_of(motive, slice(1500, None)))
    # however coarsely the system measures
    for resolution_m in (1e-6, 1e-3, 1e-2):
        assert (
            shared_share(*(steps_of(r, slice(None), resolution_m) for r in (motive, other))) < LIMITS.max_shared_steps
        )


def test_a_stand_is_no_step_and_no_steps_share_nothing() -> None:
    assert number_steps(np.zeros((100, 2))) == ()
    assert number_steps(np.array([[0.0, 0.0], [1.0, -1.0], [1.0, -1.0], [0.0, 0.0], [1.0, -1.0]])).__len__() == 2
    assert shared_share(TakeSteps("a", ()), TakeSteps("b", (1, 2))) == 0.0


def test_a_model_keeps_some_steps_of_its_takes(recording: Recording, tmp_path: Path) -> None:
    take = steps_of(recording)
    save_seen_takes([take], tmp_path)
    (kept,) = load_seen_takes(tmp_path) or []
    assert kept.name == take.name
    assert len(kept.steps) == LIMITS.kept_steps
    assert has_seen([kept], take)
    # a fifth of the take, and a thirtieth, of which as few are kept as of the whole
    assert has_seen([kept], steps_of(recording, slice(1000, 1720)))
    assert has_seen([kept], steps_of(recording, slice(1000, 1120)).keep_some())
    assert has_seen(None, take) is None
    (tmp_path / FILE_NAME).unlink()
    assert load_seen_takes(tmp_path) is None


@pytest.mark.parametrize("steps", [[-1], [2**60], ["1"], [1.5], [True], None, "many"])
def test_a_broken_list_of_takes_is_refused(tmp_path: Path, steps: object) -> None:
    save_seen_takes([TakeSteps("a", (1, 2))], tmp_path)
    data = read_json(tmp_path / FILE_NAME)
    data["takes"][0]["steps"] = steps
    write_json(tmp_path / FILE_NAME, data)
    with pytest.raises(InputRefused, match="fit the model again"):
        load_seen_takes(tmp_path)


# --- pipelines ---------------------------------------------------------------------------------------------------

PLAN = """
vehicle = "{vehicle}"
training = [{training}]
validation = "{validation}"
workspace = "{workspace}"
models = ["newton-euler"]
[fit.newton-euler]
population = 10
generations = 2
[report]
timing_repeats = 0
"""


def pipeline_file(folder: Path, vehicle: Path, training: list[Path], validation: Path) -> Path:
    named = ", ".join(f'"{path}"' for path in training)
    path = folder / "pipeline.toml"
    path.write_text(PLAN.format(vehicle=vehicle, training=named, validation=validation, workspace=folder / "workspace"))
    return path


def copied(take: Path, folder: Path, name: str = "copy") -> Path:
    folder.mkdir(exist_ok=True)
    shutil.copy(take.with_suffix(".commands.csv"), folder / f"{name}.commands.csv")
    return Path(shutil.copy(take, folder / f"{name}.csv"))


def test_a_take_that_is_given_twice_is_refused(takes: dict[str, Path], vehicle_file: Path, tmp_path: Path) -> None:
    """As validation and training, or twice in training or diagnosis; by any name, in any format, before any fit."""
    again, other = copied(takes["motive"], tmp_path / "other day"), takes["other"]
    for training, validation in ((takes["motive"], takes["motive"]), (takes["motive"], again), (takes["mcap"], again)):
        plan = pipeline_file(tmp_path, vehicle_file, [training], validation)
        with pytest.raises(InputRefused, match=r"validation: .*the same drive\n  next: .*cut one take into two"):
            Pipeline(read_pipeline_file(plan)).report()
    plan = pipeline_file(tmp_path, vehicle_file, [takes["motive"], again], other)
    with pytest.raises(InputRefused, match=r"training: .*copy\.csv is .*drive\.csv once more"):
        Pipeline(read_pipeline_file(plan)).fit("newton-euler")
    plan.write_text(f'vehicle = "{vehicle_file}"\ntraining = ["{other}"]\ndiagnose = ["{again}", "{takes["mcap"]}"]\n')
    with pytest.raises(InputRefused, match=r"diagnose: .*once more, .*: the same drive\n.*twice the evidence"):
        Pipeline(read_pipeline_file(plan)).diagnose()
    assert not (tmp_path / "workspace" / "fit").exists()
    words = ["fit", str(other), str(other), "--vehicle", str(vehicle_file), "--out", str(tmp_path / "w")]
    with pytest.raises(InputRefused, match="named twice"):
        CliRunner().invoke(app, words, catch_exceptions=False)


def test_a_model_that_saw_the_validation_take_is_marked_and_never_best(
    takes: dict[str, Path], vehicle_file: Path, tmp_path: Path
) -> None:
    plan = pipeline_file(tmp_path, vehicle_file, [takes["mcap"]], takes["other"])
    folders = {name: tmp_path / name for name in ("saw", "fresh", "unknown")}
    work = Pipeline(read_pipeline_file(plan))
    steps = {name: read_take_steps(work.ingest(takes[name]).folder) for name in ("mcap", "other")}
    for folder in folders.values():
        folder.mkdir()
        save_model(published.newton_euler(), folder)
    save_seen_takes([steps["mcap"], steps["other"]], folders["saw"])
    save_seen_takes([steps["mcap"]], folders["fresh"])
    words = [
        "report",
        "-p",
        str(plan),
        "-m",
        "newton-euler",
        *(w for f in folders.values() for w in ("--model", str(f))),
    ]
    done = CliRunner().invoke(app, words, catch_exceptions=False)
    report = json.loads((tmp_path / "workspace" / "report" / "report.json").read_text(encoding="utf-8"))
    saw = {m["model"]: m["saw_validation"] for m in report["models"]}
    labels = {name: f"newton-euler ({tmp_path.name}/{name})" for name in folders}
    assert saw == {"newton-euler": False, labels["saw"]: True, labels["fresh"]: False, labels["unknown"]: None}
    assert report["models"][-1]["model"] == labels["saw"]
    assert f"{labels['saw']} (made from this take)" in done.stdout
    assert f"{folders['unknown']}: not known from which takes" in done.stderr
    page = (tmp_path / "workspace" / "report" / "index.html").read_text(encoding="utf-8")
    assert page.count("(made from this take)") == 1
    assert f"<strong>{labels['saw']}" not in page
    # what the pipeline itself fits carries its takes along
    fitted = work.fit("newton-euler").folder
    assert has_seen(load_seen_takes(fitted), steps["mcap"])
    assert not has_seen(load_seen_takes(fitted), steps["other"])


def test_two_takes_of_one_name_are_told_apart(takes: dict[str, Path], vehicle_file: Path, tmp_path: Path) -> None:
    days = [copied(takes["motive"], tmp_path / "monday", "drive"), copied(takes["other"], tmp_path / "friday", "drive")]
    where = [*map(str, days), "--vehicle", str(vehicle_file), "--out", str(tmp_path / "w")]
    for command in ("ingest", "estimate"):
        done = CliRunner().invoke(app, [command, *where], catch_exceptions=False)
        assert "monday/drive" in done.stdout
        assert "friday/drive" in done.stdout
    plan = pipeline_file(tmp_path, vehicle_file, days[:1], days[1])
    report = Pipeline(read_pipeline_file(plan)).report()
    assert report.json("report.json")["validation"]["name"] == "friday/drive"
    page = (report.folder / "index.html").read_text(encoding="utf-8")
    assert "<td>monday/drive</td>" in page
    assert "<td>friday/drive</td>" in page
    # the truth of which of them?
    (tmp_path / "truth").mkdir()
    shutil.copy(takes["motive"].parent / "truth" / "drive.parquet", tmp_path / "truth")
    plan.write_text(plan.read_text().replace("models =", 'truth = "truth"\nmodels ='))
    with pytest.raises(InputRefused, match=r"truth: .*may be of any of .*monday.*friday"):
        Pipeline(read_pipeline_file(plan)).report()
