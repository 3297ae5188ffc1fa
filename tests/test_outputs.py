"""What commands write: whole or not at all, in the place of nothing that was to be kept; and how commands end."""

from __future__ import annotations

import errno
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bcid.cli.reporting import DIAGNOSIS_FILES, REPORT_FILES
from bcid.errors import DiskFull, InputRefused
from bcid.files import outputs
from bcid.files.outputs import refuse_to_overwrite, staged_outputs, write_output
from bcid.files.source_code import StageCode
from bcid.pipeline.publishing import artifact_digests, publish_copies
from bcid.simulation.samples import VEHICLE
from bcid.store.artifact import Artifact, Recipe, Store
from bcid.store.receipt import refuse_to_renew, renew_results

ROOT = Path(__file__).parent.parent
KEPT = "mine, not to be lost"


def never(path: Path) -> bool:
    return False


def always(path: Path) -> bool:
    return True


def contents(folder: Path) -> dict[str, str]:
    """Text of all files in a folder, by name, hidden ones among them."""
    return {
        p.relative_to(folder).as_posix(): p.read_text(errors="replace")
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


def write_two(folder: Path, may_replace: Callable[[Path], bool]) -> None:
    with staged_outputs(folder, may_replace) as staged:
        (staged / "sub").mkdir()
        (staged / "a.txt").write_text("new a")
        (staged / "sub" / "b.txt").write_text("new b")


def test_all_files_are_written_or_none(tmp_path: Path) -> None:
    home = tmp_path / "made" / "for it"
    write_two(home, never)
    assert contents(home) == {"a.txt": "new a", "sub/b.txt": "new b"}
    (home / "a.txt").unlink()
    (home / "sub" / "b.txt").write_text(KEPT)
    with pytest.raises(InputRefused, match=r"b\.txt: output: exists already.*\n  next: .*--force"):
        write_two(home, never)
    assert contents(home) == {"sub/b.txt": KEPT}
    write_two(home, always)
    assert contents(home) == {"a.txt": "new a", "sub/b.txt": "new b"}


def test_all_that_would_be_overwritten_is_named(tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).write_text(KEPT)
    (tmp_path / "gone").symlink_to(tmp_path / "nowhere")
    with pytest.raises(InputRefused, match=r"so would .*b, .*gone"):
        refuse_to_overwrite([tmp_path / n for n in ("a", "new", "b", "gone")], never)
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputRefused, match="no file that could be replaced"):
        refuse_to_overwrite([tmp_path / "folder"], always)
    with pytest.raises(InputRefused, match="no file that could be replaced"):
        refuse_to_overwrite([Path(os.devnull)], always)


@pytest.mark.parametrize("failing", [0, 1])
@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError(errno.EIO, "broken disk", "a.txt")])
def test_what_is_interrupted_while_files_are_moved_is_undone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: int, error: BaseException | type[BaseException]
) -> None:
    (tmp_path / "a.txt").write_text(KEPT)
    moved, real = list[Path](), Path.replace

    def replace(path: Path, target: Path) -> Path:
        if "new" in path.parts:
            moved.append(path)
            if len(moved) == failing + 1:
                raise error
        return real(path, target)

    monkeypatch.setattr(Path, "replace", replace)
    with pytest.raises((KeyboardInterrupt, OSError, InputRefused)):
        write_two(tmp_path, always)
    assert contents(tmp_path) == {"a.txt": KEPT}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.txt"]


def test_an_interruption_while_they_are_written_leaves_nothing(tmp_path: Path) -> None:
    def fails(path: Path) -> None:
        path.write_text("half", encoding="utf-8")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_output(tmp_path / "new" / "a.txt", fails, never, "elsewhere")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("home", ["new/inner", "."])
def test_an_interruption_just_after_any_folder_is_made_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, home: str
) -> None:
    make, left = Path.mkdir, [0]

    def make_and_be_interrupted(folder: Path, *words: Any, **named: Any) -> None:
        make(folder, *words, **named)
        left[0] -= 1
        if left[0] < 0:
            raise KeyboardInterrupt

    monkeypatch.setattr(Path, "mkdir", make_and_be_interrupted)
    os.mkdir(tmp_path / "elsewhere")
    left[0] = 1000
    write_two(tmp_path / "elsewhere" / home, never)
    shutil.rmtree(tmp_path / "elsewhere")
    for calls_before in range(1000 - left[0]):
        left[0] = calls_before
        with pytest.raises(KeyboardInterrupt):
            write_two(tmp_path / home, never)
        assert list(tmp_path.iterdir()) == []
    left[0] = 20
    write_two(tmp_path / home, never)
    assert sorted(p.name for p in (tmp_path / home).iterdir()) == ["a.txt", "sub"]


KILLED = """
import os, signal, sys
from pathlib import Path
from bcid.files.outputs import staged_outputs
with staged_outputs(Path(sys.argv[1]), lambda path: True) as staged:
    (staged / "a.txt").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(os.name == "nt", reason="signals are those of POSIX")
def test_a_kill_leaves_the_old_file_and_its_rest_is_swept_later(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(KEPT)
    done = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False, cwd=ROOT)
    assert done.returncode == -signal.SIGKILL
    assert (tmp_path / "a.txt").read_text() == KEPT
    (left,) = tmp_path.glob(f"{outputs.PREFIX}*")
    write_two(tmp_path, always)
    assert left.exists()  # perhaps a run that is still at work
    os.utime(left, (time.time() - 1e6, time.time() - 1e6))
    write_two(tmp_path, always)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.txt", "sub"]


def test_a_full_disk_and_a_file_for_a_folder_are_told(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(KEPT)

    def full(path: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    with pytest.raises(DiskFull, match="free some space"):
        write_output(tmp_path / "a.txt", full, always, "elsewhere")
    assert contents(tmp_path) == {"a.txt": KEPT}
    with pytest.raises(InputRefused, match=r"no folder\n  next: elsewhere that can be written to"):
        write_output(tmp_path / "a.txt" / "b.txt", Path.touch, always, "elsewhere")
    with pytest.raises(InputRefused, match=r"a\.txt/\.locks: output: .*no folder\n  next: .*workspace = "):
        Store(tmp_path / "a.txt").get_or_make(RECIPE, make)


@pytest.mark.parametrize("code", [errno.EACCES, errno.EROFS, errno.EPERM])
def test_a_folder_that_cannot_be_written_to_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int) -> None:
    def refuse(path: Path, *args: object, **options: object) -> None:
        raise OSError(code, os.strerror(code), str(path))

    monkeypatch.setattr(Path, "mkdir", refuse)
    with pytest.raises(InputRefused, match=r"cannot be written to: .*\n  next: elsewhere"):
        write_output(tmp_path / "new" / "a.txt", Path.touch, always, "elsewhere")
    with pytest.raises(InputRefused, match=r"cannot be written to: .*\n  next: .*workspace = "):
        Store(tmp_path / "w").get_or_make(RECIPE, make)


# --- results that are renewed, and nothing else ------------------------------------------------------------------

RECIPE = Recipe("report", {}, {}, StageCode("c0de", {}))


def make(folder: Path) -> None:
    (folder / "index.html").write_text("page 1")
    (folder / "model").mkdir()
    (folder / "model" / "model.json").write_text("model 1")


def test_results_are_renewed_unless_somebody_edited_them(tmp_path: Path) -> None:
    def write(text: str) -> dict[str, Callable[[Path], object]]:
        return {"prove.json": lambda path: path.write_text(text), "prove.html": lambda path: path.write_text(text)}

    renew_results(tmp_path, write("one"))
    renew_results(tmp_path, write("two"))
    assert (tmp_path / "prove.json").read_text() == "two"
    (tmp_path / "prove.html").write_text("two, with a note of mine")
    with pytest.raises(InputRefused, match=r"prove\.html"):
        refuse_to_renew(tmp_path, ["prove.json", "prove.html"])
    with pytest.raises(InputRefused, match=r"prove\.html"):
        renew_results(tmp_path, write("three"))
    assert (tmp_path / "prove.json").read_text() == "two"
    renew_results(tmp_path, write("three"), force=True)
    assert (tmp_path / "prove.html").read_text() == "three"


NAMES = ("index.html", "model", "next.csv")


def publish(artifact: Artifact, home: Path, force: bool = False) -> Path:
    return publish_copies(artifact.folder, NAMES, home, artifact_digests(artifact.folder.parent.parent), force)


def test_published_copies_are_renewed_and_nothing_else_is_replaced(tmp_path: Path) -> None:
    store, home = Store(tmp_path / "w"), tmp_path / "home"
    one = store.get_or_make(RECIPE, make)

    def make_more(folder: Path) -> None:
        make(folder)
        (folder / "index.html").write_text("page 2")
        (folder / "next.csv").write_text("next 2")

    two = store.get_or_make(Recipe("report", {"a": 2}, {}, RECIPE.code), make_more)
    publish(one, home)
    publish(two, home)
    assert contents(home) == {"index.html": "page 2", "next.csv": "next 2", "model/model.json": "model 1"}
    publish(one, home)
    assert "next.csv" not in contents(home)
    for name in ("index.html", "next.csv", "model/notes.txt"):
        before = contents(home)
        (home / name).write_text(KEPT)
        with pytest.raises(InputRefused, match=r"exists already.*\n  next: .*--force"):
            publish(two, home)
        assert contents(home) == before | {name: KEPT}
        publish(one, home, force=True)
        assert contents(home) == {"index.html": "page 1", "model/model.json": "model 1"}


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_an_artifact_lacks_goes_and_what_changes_its_kind_is_replaced(tmp_path: Path, kind: str) -> None:
    """A model of what has no name lies beside one diagnosis and not beside the next."""
    store, home = Store(tmp_path / "w"), tmp_path / "home"

    def make_bare(folder: Path) -> None:
        (folder / "index.html").write_text("page 3")
        if kind == "file":
            (folder / "model").write_text("one file")

    first = store.get_or_make(RECIPE, make)
    bare = store.get_or_make(Recipe("report", {"a": kind}, {}, RECIPE.code), make_bare)
    whole = {"index.html": "page 1", "model/model.json": "model 1"}
    left = {"index.html": "page 3"} | ({"model": "one file"} if kind == "file" else {})
    for artifact, expected in ((first, whole), (bare, left), (first, whole), (bare, left)):
        publish(artifact, home)
        assert contents(home) == expected
    assert sorted(p.name for p in home.iterdir()) == sorted(left)


def test_an_artifact_that_somebody_edited_is_set_aside_and_told(tmp_path: Path) -> None:
    told = list[str]()
    store = Store(tmp_path, notify=told.append)
    folder = store.get_or_make(RECIPE, make).folder
    assert told == []
    for _ in range(2):
        (folder / "index.html").write_text(KEPT)
        (folder / "notes.txt").write_text("my notes")
        assert not store.get_or_make(RECIPE, make).reused
    assert (folder / "index.html").read_text() == "page 1"
    kept = sorted((tmp_path / "set_aside" / "report").iterdir())
    assert [(k / "index.html").read_text() for k in kept] == [KEPT, KEPT]
    assert [(k / "notes.txt").read_text() for k in kept] == ["my notes", "my notes"]
    assert [str(k) in text for k, text in zip(kept, told, strict=True)] == [True, True]


# --- commands ----------------------------------------------------------------------------------------------------


def bcid(*words: str | Path, cwd: Path, **options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "bcid", *map(str, words)]
    given = {"stdout": subprocess.PIPE, "env": {**os.environ, "PYTHONPATH": str(ROOT)}, **options}
    return subprocess.run(command, text=True, cwd=cwd, timeout=300, check=False, stderr=subprocess.PIPE, **given)  # type: ignore[call-overload, no-any-return]


TAKE, CAR = ("simulate", "drive", "--duration", "2"), ("--vehicle", "car.toml")
WRITING = {
    "simulate": (TAKE, ("simulated/drive.csv", "simulated/drive.commands.csv", "simulated/truth/drive.parquet")),
    "simulate mcap": ((*TAKE, "--recorder", "mcap"), ("simulated/drive.mcap",)),
    "sample logs": (("simulate", "--sample-logs", "logs"), ("logs/README.md", "logs/truth/validation.parquet")),
    "plan": (("plan", "yaw_scrub", *CAR), ("plans/plan.commands.csv",)),
    "plan in a folder": (("plan", "yaw_scrub", *CAR, "--out", "."), ("plan.commands.csv",)),
    "init": (("init",), ("pipeline.toml", "vehicle.toml")),
    "bench": (("bench", "--only", "EKF", "--out", "b.json"), ("b.json",)),
    "one case": (("prove", "--out", "p", "--quick", "--case", "single-0"), ("p/single-0.mcap",)),
    "prove": (("prove", "--out", "p", "--quick"), ("p/prove.json", "p/prove.html")),
    "diagnose": (("diagnose", "take.csv", *CAR, "--out", "."), DIAGNOSIS_FILES),
    "report": (("report", "-p", "plan.toml"), tuple(f"workspace/report/{name}" for name in REPORT_FILES)),
}


@pytest.mark.parametrize("name", WRITING)
def test_no_command_overwrites_what_exists(tmp_path: Path, name: str) -> None:
    """Each of its files alone is reason enough; it is told at once, before any work."""
    words, targets = WRITING[name]
    (tmp_path / "car.toml").write_text(VEHICLE)
    (tmp_path / "plan.toml").write_text('vehicle = "car.toml"\ntraining = ["take.csv"]\nvalidation = "other.csv"\n')
    before = contents(tmp_path)
    if name == "one case":
        from bcid.proof.blind.blind_test import BlindTest

        case = BlindTest(quick=True).cases[0].name
        words, targets = (*words[:-1], case), (f"p/{case}.mcap", f"p/{case}.answer.json", "p/bumper_car.toml")
    for target in targets[:: max(1, len(targets) - 1)]:
        (tmp_path / target).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / target).write_text(KEPT)
        done = bcid(*words, cwd=tmp_path)
        assert done.returncode == 4, done.stderr
        assert "exists already" in done.stderr
        assert target in done.stderr
        assert "--force" in done.stderr.splitlines()[-1]
        assert contents(tmp_path) == before | {target: KEPT}
        (tmp_path / target).unlink()


def test_what_force_says_is_overwritten(tmp_path: Path) -> None:
    assert bcid(*TAKE, cwd=tmp_path).returncode == 0
    first = contents(tmp_path)
    assert {p.split("/")[0] for p in first} == {"simulated"}
    (tmp_path / "simulated" / "drive.csv").write_text(KEPT)
    (tmp_path / "simulated" / "bumper_car.toml").write_text("# mine\n")
    assert bcid(*TAKE, "--force", cwd=tmp_path).returncode == 0
    # the vehicle file holds for all takes, and is nobody's to replace
    assert contents(tmp_path) == first | {"simulated/bumper_car.toml": "# mine\n"}


@pytest.mark.parametrize(
    "name", ["", ".", "..", "a/b", "a\\b", "a\nb", "nul\x1b[31m", "c:d", "*", "con", "Aux.2026", "COM1", "lpt9.csv"]
)
def test_a_take_s_name_is_a_plain_one(tmp_path: Path, name: str) -> None:
    done = bcid("simulate", name, "--duration", "2", cwd=tmp_path)
    assert done.returncode == 2
    assert "no plain name" in done.stderr
    assert "\x1b" not in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name == "nt", reason="users and signals are those of POSIX")
def test_a_folder_without_permission_is_told(tmp_path: Path) -> None:
    """By another user, since root may write anywhere."""
    if os.geteuid() != 0:
        tmp_path.chmod(0o555)
        done = bcid(*TAKE, cwd=tmp_path)
    else:
        readable = all(os.stat(p).st_mode & 0o005 == 0o005 for p in (*tmp_path.parents, Path(sys.executable).parent))
        if not readable:
            pytest.skip("another user cannot come here")
        done = bcid(*TAKE, cwd=tmp_path, user=65534)
    tmp_path.chmod(0o755)
    assert done.returncode == 4, done.stderr
    assert "simulated" in done.stderr
    assert "--out" in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no full device here")
def test_a_full_disk_under_stdout_is_told_once(tmp_path: Path) -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:
        done = bcid("models", cwd=tmp_path, stdout=full)
    assert done.returncode == 4
    assert "stdout: the disk or the quota is full" in done.stderr
    assert len(done.stderr.splitlines()) == 2


@pytest.mark.skipif(os.name == "nt", reason="pipes are those of POSIX")
def test_a_stdout_that_nobody_reads_is_told_once(tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    done = bcid("effects", "--format", "json", cwd=tmp_path, stdout=write)
    os.close(write)
    assert done.returncode == 141
    assert done.stderr.startswith("error: stdout: was closed")
    assert len(done.stderr.splitlines()) == 2
    shell = shutil.which("sh")
    assert shell
    words = [shell, "-c", f'exec "{sys.executable}" -m bcid models >&-']
    closed = subprocess.run(words, capture_output=True, text=True, cwd=ROOT, check=False)
    assert (closed.returncode, closed.stderr) == (141, done.stderr)


@pytest.mark.skipif(os.name == "nt", reason="signals are those of POSIX")
@pytest.mark.parametrize(("number", "code", "text"), [(signal.SIGINT, 130, "interrupted: "), (signal.SIGTERM, 143, "")])
def test_an_interrupted_command_says_so_and_leaves_nothing(
    tmp_path: Path, number: signal.Signals, code: int, text: str
) -> None:
    words = [sys.executable, "-m", "bcid", "simulate", "long", "--duration", "7200", "--out", str(tmp_path / "out")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT) as run:
        until = time.monotonic() + 60.0
        while not (tmp_path / "out").exists() and time.monotonic() < until:
            time.sleep(0.05)
        run.send_signal(number)
        out, err = run.communicate(timeout=120)
    assert (run.returncode, out) == (code, "")
    assert err.startswith(text)
    assert len(err.splitlines()) == bool(text)
    assert list(tmp_path.iterdir()) == []
