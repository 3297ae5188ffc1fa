"""Many logs at once: what is made of each is what single commands make of it, whatever happens to the others."""

from __future__ import annotations

import io
import json
import os
import pickle
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from pools import FakePool
from rich.console import Console

from bcid.cli.fleets import _raise_what_failed, _tables
from bcid.documents.fleet import FleetDocument, FleetLog, KeptArtifact
from bcid.errors import InputRefused, PartLost
from bcid.execution.cluster import Cluster
from bcid.execution.jobs import Pool
from bcid.execution.pool import WorkerPool
from bcid.fleet.labels import label_logs
from bcid.fleet.logs import find_logs
from bcid.fleet.run import run_fleet
from bcid.fleet.tasks import FleetOrder, LogEvaluation, WorkedLog, evaluate_on, work_on_log
from bcid.pipeline.config import PipelineConfig, read_pipeline_file
from bcid.pipeline.run import Pipeline
from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.samples import VEHICLE, SampleTake, write_sample_take
from bcid.store.artifact import Store

SETTINGS = """\
vehicle = "vehicle.toml"
training = ["logs/a.csv"]
workspace = "none"
[fit.newton-euler]
population = 10
generations = 2
"""
STAGES = ("ingest", "tune", "estimate", "fit", "evaluate")


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a vehicle file, quick settings, and three short logs of one car."""
    folder = tmp_path_factory.mktemp("lab")
    (folder / "vehicle.toml").write_text(VEHICLE, encoding="utf-8")
    (folder / "quick.toml").write_text(SETTINGS, encoding="utf-8")
    for seed, (name, kind) in enumerate({"a": "motive", "b": "mcap", "c": "motive"}.items()):
        write_sample_take(folder / "logs", SampleTake(name, kind, 30.0), Plant(**REAL_EXTRAS), Sensor(), 70 + seed)
    return folder


@pytest.fixture(scope="module")
def logs(lab: Path) -> list[Path]:
    return find_logs([lab / "logs"]).logs


def config(lab: Path, workspace: Path, **changes: Any) -> PipelineConfig:
    quick = read_pipeline_file(lab / "quick.toml")
    return quick.model_copy(update={"workspace": workspace, "training": [], **changes})


def artifacts(workspace: Path) -> dict[str, bytes]:
    """The manifests of all artifacts, which hold the hashes of their files, by stage and key."""
    found = workspace.glob("*/*/manifest.json")
    return {str(p.relative_to(workspace)): p.read_bytes() for p in found if p.parts[-3] in STAGES}


@pytest.fixture(scope="module")
def one_by_one(lab: Path, logs: list[Path]) -> dict[str, bytes]:
    """What single commands make of each log, its model then tried on the next."""
    for log, unseen in zip(logs, [*logs[1:], logs[0]], strict=True):
        work = Pipeline(config(lab, lab / "single", training=[log], validation=unseen))
        work.score(work.fit_for_comparison("newton-euler"))
    return artifacts(lab / "single")


def run(
    lab: Path, workspace: Path, logs: list[Path], pool: AbstractContextManager[Pool] | None = None,
    progress: Callable[[float, str], None] = lambda share, text: None,
) -> FleetDocument:  # fmt: skip
    order = FleetOrder(config(lab, workspace), ("newton-euler",), diagnose=False)
    return run_fleet(
        order, logs, label_logs(logs, [log.stem for log in logs]), "bumper-car", pool or WorkerPool(2), progress
    )


def test_two_processes_make_what_single_commands_make_and_nothing_twice(
    lab: Path, logs: list[Path], one_by_one: dict[str, bytes], tmp_path: Path
) -> None:
    said: list[tuple[float, str]] = []
    document = run(lab, tmp_path, logs, progress=lambda share, text: said.append((share, text)))
    assert [(log.name, log.state, log.go) for log in document.logs] == [(n, "done", True) for n in "abc"]
    assert [[(s.model, s.on) for s in log.scores] for log in document.logs] == [[("newton-euler", n)] for n in "bca"]
    assert all(log.scores[0].nmse is not None for log in document.logs)
    assert artifacts(tmp_path) == one_by_one
    listed = {f"{a.stage}/{a.key}/manifest.json" for log in document.logs for a in log.artifacts}
    # the other log's motion, as it is estimated for a model's score, is no log's own
    assert set(one_by_one) - listed == {name for name in set(one_by_one) - listed if name.startswith("estimate/")}
    assert listed <= set(one_by_one)
    shares = [share for share, _ in said]
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)
    written = {p: p.stat().st_mtime_ns for p in tmp_path.glob("*/*/*")}
    assert run(lab, tmp_path, logs) == document
    assert {p: p.stat().st_mtime_ns for p in tmp_path.glob("*/*/*")} == written


def test_an_artifact_that_somebody_edited_is_made_anew_and_told(lab: Path, logs: list[Path], tmp_path: Path) -> None:
    fitted = next(a for a in run(lab, tmp_path, logs).logs[1].artifacts if a.stage == "fit")
    edited = tmp_path / "fit" / fitted.key / "model.json"
    edited.write_text(edited.read_text(encoding="utf-8") + " ", encoding="utf-8")
    notes = [log.notes for log in run(lab, tmp_path, logs).logs]
    assert notes[0] == notes[2] == ()
    assert "was changed after it was written: it is made anew" in notes[1][0]


def test_a_copy_of_a_log_is_told_and_is_no_unseen_drive(lab: Path, logs: list[Path], tmp_path: Path) -> None:
    """Models of a log are not tried on a copy of it, and what all logs say counts it once."""
    copy = tmp_path / "copies" / "again.mcap"
    copy.parent.mkdir()
    shutil.copy(logs[1], copy)
    document = run(lab, tmp_path / "work", [logs[0], logs[1], copy])
    assert [(log.name, log.state, log.same_drive_as) for log in document.logs] == [
        ("a", "done", ""), ("b", "done", ""), ("again", "done", "b")
    ]  # fmt: skip
    assert [log.scores[0].on for log in document.logs] == ["b", "a", "a"]
    assert "again is the same drive as b, at least in part: only that one is counted." in _words_of(document)


def _words_of(document: FleetDocument) -> list[str]:
    """The lines that a command prints of a fleet."""
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(_tables(document, Path("work")))
    return console.export_text().splitlines()


def test_logs_that_cannot_be_used_cost_the_others_nothing(
    lab: Path, logs: list[Path], one_by_one: dict[str, bytes], tmp_path: Path
) -> None:
    """One is cut off within a line, one has its commands in reverse; the models of b are tried on c all the same."""
    whole = logs[0].read_bytes()
    (tmp_path / "cut_off.csv").write_bytes(whole[: len(whole) // 3])
    (tmp_path / "cut_off.commands.csv").write_bytes(b"")
    mixed_up = tmp_path / "mixed_up.csv"
    mixed_up.write_bytes(logs[2].read_bytes())
    head, *lines = logs[2].with_suffix(".commands.csv").read_text(encoding="utf-8").split()
    times, commands = zip(*(line.split(",", 1) for line in lines), strict=True)
    text = "\n".join([head, *map(",".join, zip(times, reversed(commands), strict=True))])
    (tmp_path / "mixed_up.commands.csv").write_text(f"{text}\n", encoding="utf-8")
    document = run(lab, tmp_path / "work", [logs[0], tmp_path / "cut_off.csv", logs[1], mixed_up, logs[2]])
    assert {log.name: log.state for log in document.logs} == {
        "a": "done", "cut_off": "failed", "b": "done", "mixed_up": "failed", "c": "done",
    }  # fmt: skip
    rows = {log.name: log for log in document.logs}
    assert rows["cut_off"].go is None
    assert rows["cut_off"].problems[0].error == "InputRefused"
    assert "next: " in rows["cut_off"].problems[0].text
    assert rows["mixed_up"].go is False
    assert "no-go" in rows["mixed_up"].problems[0].text
    assert [rows[n].scores[0].on for n in "abc"] == ["b", "c", "a"]
    made = artifacts(tmp_path / "work")
    assert {name: made[name] for name in one_by_one} == one_by_one


def test_a_machine_that_sees_no_vehicle_file_costs_its_logs_only(lab: Path, logs: list[Path], tmp_path: Path) -> None:
    order = FleetOrder(config(lab, tmp_path, vehicle=tmp_path / "gone.toml"), ("newton-euler",), diagnose=False)
    worked = work_on_log(order, logs[0], "a", waits=True)
    assert worked is not None
    (problem,) = worked.row.problems
    assert (worked.row.state, problem.stage, problem.error) == ("failed", "settings", "InputRefused")
    evaluation = evaluate_on(order, logs[0], ["newton-euler"], logs[1], "b", waits=True)
    assert evaluation is not None
    assert [p.error for p in evaluation.problems] == ["InputRefused"]


def test_what_fails_of_all_logs_together_costs_none_of_them(
    lab: Path, logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise FloatingPointError("no number")

    monkeypatch.setattr("bcid.fleet.run.diagnose_together", fail)
    document = run(lab, lab / "single", logs[:2], WorkerPool(1))
    assert [log.state for log in document.logs] == ["done", "done"]
    assert [(p.stage, p.error) for p in document.problems] == [("what all logs say together", "FloatingPointError")]
    with pytest.raises(PartLost, match="what all logs say together failed"):
        _raise_what_failed(document)


def test_a_locked_log_is_put_off_and_come_back_to(
    lab: Path, logs: list[Path], one_by_one: dict[str, bytes], tmp_path: Path
) -> None:
    """As long as this process holds the lock of the first log, the second one is worked on."""
    key = Pipeline(config(lab, lab / "single", training=[logs[0]])).ingest(logs[0]).key
    lock = Store(tmp_path).exclusive_lock(f"ingest-{key}")
    ended: list[str] = []

    def progress(share: float, text: str) -> None:
        ended.append(text)
        if text.endswith("; b"):
            lock.__exit__(None, None, None)

    lock.__enter__()
    document = run(lab, tmp_path, logs[:2], WorkerPool(1), progress)
    assert ended[0] == "0 of 2 logs; a is locked, put off"
    assert ended[1:3] == ["1 of 2 logs; b", "2 of 2 logs; a"]
    assert [log.state for log in document.logs] == ["done", "done"]
    assert artifacts(tmp_path).items() >= {k: v for k, v in one_by_one.items() if key in k}.items()


class ToldPool(FakePool):
    """One place whose calls are told, not done, and give made-up rows; the log a is locked until it is waited for."""

    def __init__(self) -> None:
        self.size, self.told = 1, list[str]()
        self._result = list[tuple[Any, Any]]()

    @property
    def free(self) -> int:
        return self.size - len(self._result)

    def submit(self, key: Any, call: Callable[[], Any]) -> None:
        assert isinstance(call, partial)
        log, waits, evaluates = call.args[1], call.args[-1], call.func is evaluate_on
        self.told.append(("evaluate " if evaluates else "") + log.stem + (", waiting" if waits else ""))
        made = tuple(KeptArtifact(stage=stage, key="0", model="newton-euler") for stage in ("estimate", "fit"))
        row = FleetLog(name=log.stem, file=str(log), state="done", artifacts=made)
        locked = log.stem == "a" and not waits
        self._result = [(key, None if locked else LogEvaluation() if evaluates else WorkedLog(row))]

    def next_results(self) -> list[tuple[Any, Any]]:
        result, self._result = self._result, []
        return result


def test_a_locked_log_is_waited_for_when_no_evaluation_can_begin(lab: Path, logs: list[Path], tmp_path: Path) -> None:
    """The models of b can be evaluated on c before a is there; those of a, and of c on a, cannot."""
    pool = ToldPool()
    document = run(lab, tmp_path, logs, pool)
    assert {log.state for log in document.logs} == {"done"}
    assert pool.told == [
        "a", "b", "c", "evaluate b", "a, waiting", "evaluate a", "evaluate c", "evaluate a, waiting",
    ]  # fmt: skip


def kill_in_the_middle(mark: Path, call: Callable[[], Any]) -> Any:
    """What `call` gives, unless nothing has been marked yet: then the process is killed as it writes an estimate."""
    if not mark.exists():
        from bcid.pipeline.stages import estimate

        def die(folder: Path, *others: object) -> None:
            (folder / "half").write_text("written", encoding="utf-8")
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)

        estimate.run_estimate_stage = die  # type: ignore[assignment]
    return call()


class KillsOnce(WorkerPool):
    """Processes, the first of which is killed in the middle of its work."""

    mark: Path

    def submit(self, key: Any, call: Callable[[], Any]) -> None:
        super().submit(key, partial(kill_in_the_middle, self.mark, call))


class ClusterKillsOnce(Cluster):
    """A cluster, a worker of which is killed in the middle of its work."""

    mark: Path

    def submit(self, key: Any, call: Callable[[], Any]) -> None:
        super().submit(key, partial(kill_in_the_middle, self.mark, call))


def test_a_killed_process_changes_nothing(
    lab: Path, logs: list[Path], one_by_one: dict[str, bytes], tmp_path: Path
) -> None:
    pool = KillsOnce(1)
    pool.mark = tmp_path / "mark"
    document = run(lab, tmp_path / "work", logs, pool)
    assert pool.mark.exists()
    assert {log.state for log in document.logs} == {"done"}
    assert artifacts(tmp_path / "work") == one_by_one


@pytest.mark.slow
def test_a_cluster_makes_the_same_and_a_killed_worker_changes_nothing(
    scheduler: str, lab: Path, logs: list[Path], one_by_one: dict[str, bytes], tmp_path: Path
) -> None:
    cluster = ClusterKillsOnce(scheduler)
    cluster.mark = tmp_path / "mark"
    document = run(lab, tmp_path / "work", logs, cluster)
    assert cluster.mark.exists()
    assert {log.state for log in document.logs} == {"done"}
    assert artifacts(tmp_path / "work") == one_by_one
    assert document == run(lab, tmp_path / "work", logs, Cluster(scheduler))


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


class DiesOfB(WorkerPool):
    """Processes that die of the log b each time, as one does that needs more memory than there is."""

    def submit(self, key: Any, call: Callable[[], Any]) -> None:
        super().submit(key, die if getattr(call, "args", (None, Path()))[1].stem == "b" else call)


def test_a_log_that_kills_each_process_is_given_up_and_the_others_are_done(
    lab: Path, logs: list[Path], tmp_path: Path
) -> None:
    document = run(lab, tmp_path, logs, DiesOfB(1))
    rows = {log.name: log for log in document.logs}
    assert {name: log.state for name, log in rows.items()} == {"a": "done", "b": "failed", "c": "done"}
    assert rows["b"].problems[0].error == "ProcessLost"
    assert [rows[n].scores[0].on for n in "ac"] == ["c", "a"]


def test_an_order_can_be_sent_and_its_paths_hold_everywhere(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(lab)
    order = FleetOrder(config(lab, Path("work"), vehicle=Path("vehicle.toml")), ("newton-euler",), diagnose=False)
    sent: FleetOrder = pickle.loads(pickle.dumps(order))  # noqa: S301  # as processes are sent it
    monkeypatch.chdir("/")
    assert sent == order
    alone = sent.config_of(Path("logs", "a.csv"))
    assert (alone.training, alone.validation, alone.diagnose) == ([lab / "logs" / "a.csv"], None, [])
    made = sent.config_of(Path("logs", "a.csv"), Path("logs", "b.mcap"))
    assert (made.training, made.validation, made.diagnose) == ([lab / "logs" / "a.csv"], lab / "logs" / "b.mcap", [])
    assert (made.workspace, made.vehicle) == (lab / "work", lab / "vehicle.toml")


def test_a_folder_s_recordings_are_told_by_their_content(lab: Path, tmp_path: Path) -> None:
    for name in ("a.csv", "a.commands.csv", "b.mcap"):
        (tmp_path / name).write_bytes((lab / "logs" / name).read_bytes())
    (tmp_path / "b.mcap").rename(tmp_path / "b.recorded")
    (tmp_path / "notes.md").write_text("wet floor", encoding="utf-8")
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "truth").mkdir()
    found = find_logs([tmp_path, tmp_path / "a.csv"])
    assert [p.name for p in found.logs] == ["a.csv", "b.recorded", "empty.mcap"]
    assert [p.name for p in found.passed_over] == ["notes.md", "truth"]
    with pytest.raises(InputRefused, match="holds no recording"):
        find_logs([tmp_path / "truth"])


def test_the_table_of_labels_in_a_folder_of_logs_is_no_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("a.csv", "fleet.csv"):
        (tmp_path / name).write_text("log,day,car\na,2026-11-28,red\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    found = find_logs([tmp_path], Path("fleet.csv"))
    assert ([p.name for p in found.logs], found.passed_over) == (["a.csv"], [])
    # another table of that name is one more file that is called like a recording
    assert [p.name for p in find_logs([tmp_path], Path("elsewhere") / "fleet.csv").logs] == ["a.csv", "fleet.csv"]


def bcid(*words: str | Path, cwd: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "bcid", *map(str, words)], capture_output=True, text=True, cwd=cwd, timeout=300,
        check=False, env=os.environ | {"PYTHONPATH": os.environ.get("PYTHONPATH", str(Path(__file__).parent.parent))},
    )  # fmt: skip


@pytest.mark.slow
def test_the_command_names_what_failed_and_ends_with_3(lab: Path, logs: list[Path], tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").touch()
    words = ("fleet", "logs", tmp_path, "-p", "quick.toml", "--out", tmp_path / "work", "--no-diagnose", "--jobs", "1")
    done = bcid(*words, cwd=lab)
    assert done.returncode == 3, done.stderr
    assert "1 of 4 logs failed: empty" in done.stderr
    assert "empty.mcap: file: is empty" in done.stdout
    assert "next: record or export the take again" in done.stdout
    document = FleetDocument.read(tmp_path / "work" / "fleet.json")
    assert [log.state for log in document.logs] == ["done", "done", "done", "failed"]
    again = bcid(*words, "--format", "json", cwd=lab)
    assert json.loads(again.stdout)["schema"] == "bcid.fleet/1"
    assert "error: 1 of 4" in again.stderr
    (tmp_path / "work" / "fleet.json").write_text("mine", encoding="utf-8")
    assert bcid(*words, cwd=lab).returncode == 4
    (tmp_path / "work" / "fleet.json").unlink()
    assert bcid(*words, "--dask", "tcp://127.0.0.1:9", cwd=lab).returncode == 2


@pytest.mark.proof
def test_a_log_is_diagnosed_as_a_single_command_does(lab: Path, logs: list[Path], tmp_path: Path) -> None:
    alone = Pipeline(config(lab, tmp_path / "single", training=logs[:1]))
    page = alone.diagnosis_page(alone.diagnose())
    order = FleetOrder(config(lab, tmp_path / "work"), (), diagnose=True)
    (row,) = run_fleet(order, logs[:1], label_logs(logs[:1], ["a"]), "bumper-car", WorkerPool(1)).logs
    assert (row.state, row.problems) == ("done", ())
    assert [(a.stage, a.key) for a in row.artifacts[-2:]] == [
        ("diagnose", alone.diagnose().key), ("diagnosis_page", page.key)
    ]  # fmt: skip
    assert row.diagnosis is not None
    assert row.diagnosis.sentence
    ours, theirs = ((tmp_path / w / "diagnose" / row.artifacts[-2].key / "manifest.json") for w in ("work", "single"))
    assert ours.read_bytes() == theirs.read_bytes()
