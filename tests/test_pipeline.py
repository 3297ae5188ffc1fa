"""The pipeline end to end on short takes: what is made, what is reused, what is invalidated."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from faults.counting import flips
from making import clear_source_caches

from bcid.aliases import Progress
from bcid.errors import InputRefused
from bcid.files import source_code as code_module
from bcid.pipeline import diagnosis_stages, model_stages, origin, take_stages
from bcid.pipeline.config import read_pipeline_file
from bcid.pipeline.run import Pipeline
from bcid.pipeline.watching import Watcher
from bcid.recording.formats.detect import recording_files
from bcid.store.artifact import file_sha256

PLAN = """
vehicle = "{vehicle}"
training = ["{training}"]
validation = "{validation}"
truth = "{truth}"
workspace = "{workspace}"
models = ["newton-euler", "newton-euler-linear", "narx-mlp", "k-mlp", "k-sindy", "k-sindy-mlp"]
[fit.newton-euler]
population = 20
generations = 5
[fit.narx-mlp]
epochs = {narx_epochs}
hidden = [16, 8]
[fit.k-mlp]
epochs = 4
learning_rate = 1e-3
hidden = [16, 8]
[fit.k-sindy-mlp]
epochs = 4
hidden = [16, 8]
[report]
timing_repeats = 2
"""


class Record(Watcher):
    """A watcher that remembers what was made and what was reused."""

    def __init__(self) -> None:
        self.made: list[str] = []
        self.known: list[str] = []

    @contextmanager
    def stage(self, title: str) -> Iterator[Progress]:
        self.made.append(title)
        yield lambda share, text: None

    def report_reused(self, title: str) -> None:
        self.known.append(title)

    def note(self, text: str) -> None:
        raise AssertionError(text)


@pytest.fixture(scope="module")
def plan_file(tmp_path_factory: pytest.TempPathFactory, takes: dict[str, Path], vehicle_file: Path) -> Path:
    path = tmp_path_factory.mktemp("plan") / "pipeline.toml"
    write(path, takes, vehicle_file)
    return path


def write(path: Path, takes: dict[str, Path], vehicle_file: Path, narx_epochs: int = 4) -> None:
    path.write_text(
        PLAN.format(
            vehicle=vehicle_file, training=takes["mcap"], validation=takes["other"],
            truth=takes["mcap"].parent / "truth",
            workspace=path.parent / "workspace", narx_epochs=narx_epochs,
        ), encoding="utf-8"
    )  # fmt: skip


def run(plan_file: Path) -> tuple[Record, Path]:
    record = Record()
    work = Pipeline(read_pipeline_file(plan_file), record)
    return record, work.publish(work.report(), "index.html", "report.json", to="report")


@pytest.fixture(scope="module")
def first(plan_file: Path) -> tuple[Record, Path]:
    return run(plan_file)


def test_everything_is_made_once(first: tuple[Record, Path], plan_file: Path) -> None:
    record, page = first
    assert len(record.made) == len(set(record.made)) == 2 + 1 + 2 + 2 + 6 + 6 + 1
    assert page == plan_file.parent / "workspace" / "report" / "index.html"
    again, _ = run(plan_file)
    assert again.made == []
    assert sorted(again.known) == sorted(record.made)


def test_a_run_reads_each_recording_once(
    first: tuple[Record, Path], plan_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However many models are compared, and by both losses; the next run reads it again, and sees what has changed."""
    read: list[Path] = []

    def read_and_count(path: Path) -> str:
        read.append(path)
        return file_sha256(path)

    for module in (take_stages, model_stages, diagnosis_stages, origin):
        monkeypatch.setattr(module, "file_sha256", read_and_count)
    config = read_pipeline_file(plan_file)
    recordings = {part for recording in config.recordings() for part in recording_files(recording)}
    for times in (1, 2):
        run(plan_file)
        assert {path: read.count(path) for path in recordings} == dict.fromkeys(recordings, times)


def test_the_report_is_complete_and_offline(first: tuple[Record, Path]) -> None:
    page = first[1].read_text(encoding="utf-8")
    for model in ("newton-euler", "newton-euler-linear", "narx-mlp", "k-mlp", "k-sindy", "k-sindy-mlp"):
        assert f"<td>{model}</td>" in page
    assert page.count('role="img"') == 6 + 1 + 3  # a path for each model, errors by steering angle and by channel
    assert "published" not in page  # figures that nobody gave are not shown
    assert "Content-Security-Policy" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "https://" not in page
    assert "<script" not in page
    report = json.loads((first[1].parent / "report.json").read_text())
    assert report["schema"] == "bcid.report/1"
    assert len(report["models"]) == 6
    for row in report["models"]:
        assert {"model", "nmse", "nmse_vx", "nmse_vy", "nmse_yaw_rate", "rollout_ms", "parameters"} <= set(row)
        if row["nmse"] is not None:
            mean = (row["nmse_vx"] + row["nmse_vy"] + row["nmse_yaw_rate"]) / 3
            assert row["nmse"] == pytest.approx(mean)
            assert row["nmse_ci95"][0] <= row["nmse"] <= row["nmse_ci95"][1]


def test_epochs_of_one_model_refit_that_model_and_the_report_only(
    first: tuple[Record, Path], plan_file: Path, takes: dict[str, Path], vehicle_file: Path
) -> None:
    write(plan_file, takes, vehicle_file, narx_epochs=5)
    record, _ = run(plan_file)
    assert record.made == ["fit narx-mlp", "evaluate narx-mlp", "report"]
    write(plan_file, takes, vehicle_file)
    assert run(plan_file)[0].made == []


def test_editing_the_tyre_refits_what_runs_it(
    first: tuple[Record, Path], plan_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A callee three imports away from the fit stage; keys are computed from an edited copy of the sources."""
    import shutil

    copy = tmp_path / "src"
    shutil.copytree(code_module._ROOT / "bcid", copy / "bcid", ignore=shutil.ignore_patterns("__pycache__"))
    tyres = copy / "bcid" / "physics" / "tyres.py"
    tyres.write_text(tyres.read_text().replace("-C * alpha", "-1.01 * C * alpha"))
    monkeypatch.setattr(code_module, "_ROOT", copy)
    clear_source_caches()
    work = Pipeline(read_pipeline_file(plan_file), Record())
    stale = [work.config.workspace / "fit" / _key(work, model) for model in ("newton-euler", "k-mlp")]
    clear_source_caches()
    assert [folder.exists() for folder in stale] == [False, True]


def _key(work: Pipeline, model: str) -> str:
    """The key that `model`'s fit would have, without making anything."""
    keys: list[str] = []

    def note(recipe, make):  # type: ignore[no-untyped-def]
        keys.append(recipe.key)
        folder = work.config.workspace / recipe.stage / recipe.key
        from bcid.store.artifact import Artifact

        return Artifact(folder, recipe.key, reused=True)

    real = work.runner.store.get_or_make

    def upstream_is_real(recipe, make):  # type: ignore[no-untyped-def]
        return note(recipe, make) if recipe.stage == "fit" else real(recipe, make)

    work.runner.store.get_or_make = upstream_is_real  # type: ignore[method-assign]
    work.runner.known.clear()
    return work.fit(model).key


def test_a_plan_with_problems_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    with pytest.raises(InputRefused, match="bcid init"):
        read_pipeline_file(path)
    path.write_text('vehicle = "v.toml"\ntraining = []\ntrainings = ["x"]\n[estimate]\nperiod = 0.1\n')
    with pytest.raises(InputRefused, match=r"did you mean training") as caught:
        read_pipeline_file(path)
    assert "period_s" in str(caught.value)
    path.write_text('vehicle = "v.toml"\ntraining = ["a"]\n[fit.k-mlp]\nepoch = 3\n')
    with pytest.raises(InputRefused, match="did you mean epochs"):
        read_pipeline_file(path)
    path.write_text('vehicle = "v.toml"\ntraining = ["a"]\nmodels = ["k-nn"]\n')
    with pytest.raises(InputRefused, match="k-nn"):
        read_pipeline_file(path)
    path.write_text('vehicle = "v.toml"\ntraining = ["a"]\nseed = true\n[fit.newton-euler]\npopulation = "many"\n')
    with pytest.raises(InputRefused, match=r"seed.*fit\.newton-euler\.population"):
        read_pipeline_file(path)
    path.write_text("vehicle = ")
    with pytest.raises(InputRefused, match="not valid TOML"):
        read_pipeline_file(path)


@pytest.mark.parametrize(
    "quoted", [r'"C:\logs\take.csv"', r'"C:\users\take.csv"', r'"logs\take.csv"', r"'logs\take.csv'"]
)
def test_backslashes_in_paths_are_explained(tmp_path: Path, quoted: str) -> None:
    path = tmp_path / "p.toml"
    path.write_text(f'vehicle = "v.toml"\ntraining = [{quoted}]\n')
    with pytest.raises(InputRefused, match=r"next: write paths with /.*single quotes"):
        read_pipeline_file(path)
    # a file of such a name may be there all the same
    if quoted.startswith("'"):
        (tmp_path / quoted.strip("'")).touch()
        assert len(read_pipeline_file(path).training) == 1


def test_what_a_stage_does_not_look_at_does_not_invalidate_it(
    first: tuple[Record, Path], plan_file: Path, takes: dict[str, Path], vehicle_file: Path, tmp_path: Path
) -> None:
    """The mass is the fits' alone; the truth is nobody's but the check's."""
    heavier = tmp_path / "heavier.toml"
    heavier.write_text(vehicle_file.read_text(encoding="utf-8").replace("mass_kg = 319.6", "mass_kg = 320.0"))
    write(plan_file, takes, heavier)
    made = run(plan_file)[0].made
    write(plan_file, takes, vehicle_file)
    assert {m.split()[0] for m in made} == {"fit", "evaluate", "report"}
    plan_file.write_text(plan_file.read_text(encoding="utf-8").replace("truth = ", "# truth = "), encoding="utf-8")
    made = run(plan_file)[0].made
    write(plan_file, takes, vehicle_file)
    assert made == ["report"]


def test_three_hundred_flipped_bits_in_every_kind_of_artifact_are_noticed(
    first: tuple[Record, Path], plan_file: Path
) -> None:
    """Of each stage's largest artifact: bits anywhere in its files, the manifest among them."""
    found = flips(plan_file.parent / "workspace", 300)
    stages = ("check", "estimate", "evaluate", "fit", "ingest", "report", "tune")
    assert found == dict.fromkeys(stages, 300)


def test_a_model_folder_that_a_kill_left_half_published_is_published_anew(
    first: tuple[Record, Path], plan_file: Path
) -> None:
    work = Pipeline(read_pipeline_file(plan_file), Record())
    artifact = work.fit("k-sindy")
    home = plan_file.parent / "workspace" / "there"
    target = work.publish(artifact, "model.json", to="there")
    (home / ".model.json.new.unfinished").write_text("half")
    (home / ".k.old.unfinished").mkdir()
    again = work.publish(artifact, "model.json", to="there")
    assert again == target
    assert again.read_bytes() == (artifact.folder / "model.json").read_bytes()
    assert sorted(p.name for p in home.iterdir()) == ["model.json"]
