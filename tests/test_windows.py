"""What Windows does otherwise, as far as it shows elsewhere: names of files, modules it lacks, its paths and encoding.

`make check` has mypy read bcid as it would run there.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path, PureWindowsPath

import pytest

from bcid.errors import UsageError
from bcid.export.names import check_name
from bcid.files.names import FORBIDDEN, is_device_name, is_plain_name
from bcid.pipeline import takes as take_names
from bcid.simulation.samples import SAMPLE_TEXTS, TAKES, sample_files

ROOT = Path(__file__).parent.parent
FOLDERS = ("bcid", "docs", "pipelines", "sample_logs", "tests")
LONGEST = 120
"""Characters of a path from the root of the checkout; Windows wants 260 with all that stands before."""
POSIX_MODULES = {"fcntl", "grp", "posix", "pty", "pwd", "readline", "resource", "syslog", "termios", "tty"}


def committed_files() -> list[Path]:
    files = (path for name in FOLDERS for path in (ROOT / name).rglob("*") if "__pycache__" not in path.parts)
    return [path.relative_to(ROOT) for path in files if path.is_file()]


def test_every_file_can_be_checked_out() -> None:
    paths = committed_files()
    assert [path for path in paths if not all(map(is_plain_name, path.parts))] == []
    assert [path for path in paths if len(path.as_posix()) > LONGEST] == []
    folded = [path.as_posix().casefold() for path in paths]
    assert sorted({name for name in folded if folded.count(name) > 1}) == []


def imported_modules(path: Path) -> set[str]:
    """Top-level names of all modules that the file at `path` imports anywhere."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    direct = {alias.name.partition(".")[0] for n in nodes if isinstance(n, ast.Import) for alias in n.names}
    return direct | {n.module.partition(".")[0] for n in nodes if isinstance(n, ast.ImportFrom) and n.module}


def test_no_module_imports_what_is_not_there() -> None:
    found = {path.relative_to(ROOT).as_posix(): imported_modules(path) for path in (ROOT / "bcid").rglob("*.py")}
    assert {path: names & POSIX_MODULES for path, names in found.items() if names & POSIX_MODULES} == {}


def test_no_compiled_function_is_kept_under_a_name_that_is_no_file_s() -> None:
    """A function in a function has < and > in its qualified name, of which kernel_cache makes the name of a folder."""
    nested = [
        f"{path.relative_to(ROOT).as_posix()}: {inner.name}"
        for path in (ROOT / "bcid").rglob("*.py")
        for outer in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(outer, ast.FunctionDef)
        for inner in ast.walk(outer)
        if isinstance(inner, ast.FunctionDef) and inner is not outer
        if any("njit" in ast.unparse(decorator) for decorator in inner.decorator_list)
    ]
    assert nested == []


@pytest.mark.parametrize("name", ["con", "CON", "Nul.csv", "com1", "lpt9.tar.gz", "aux .txt", "CONIN$"])
def test_names_of_devices_are_told(name: str) -> None:
    assert is_device_name(name)
    assert not is_plain_name(name)


@pytest.mark.parametrize("name", ["cone", "com", "com10", "console", "take.con", "drive 1", "müller_2", "-", "a.b.c"])
def test_names_that_only_look_like_a_device_s_are_plain(name: str) -> None:
    assert not is_device_name(name)
    assert is_plain_name(name)


@pytest.mark.parametrize("name", ["", " ", ".", "..", *(f"a{letter}b" for letter in sorted(FORBIDDEN)), "a\nb", "a\0"])
def test_what_is_no_name_of_a_file_is_not_plain(name: str) -> None:
    assert not is_plain_name(name)


@pytest.mark.parametrize("name", ["con", "aux", "nul", "com3"])
def test_no_export_is_called_as_a_device(name: str) -> None:
    with pytest.raises(UsageError, match="no file on Windows"):
        check_name(name)


def test_takes_on_several_drives_are_told_apart_by_names_with_slashes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Names of takes are compared, and stand in documents: they are the same on every system."""
    monkeypatch.setattr(take_names, "Path", PureWindowsPath)
    paths = [PureWindowsPath(text) for text in (r"C:\lab\may\a.csv", r"C:\lab\june\a.csv", r"D:\b.csv", "b.mcap")]
    names = take_names.name_takes(paths)  # type: ignore[arg-type]  # as Path is there
    assert list(names.values()) == ["may/a", "june/a", "b.csv", "b.mcap"]


def test_sample_logs_are_the_same_in_every_encoding() -> None:
    """They are written in the system's."""
    assert all(text.isascii() for text in SAMPLE_TEXTS.values())
    assert all(is_plain_name(Path(name).name) for name in sample_files(TAKES))


@pytest.mark.parametrize("words", [("--help",), ("bench", "--help"), ("effects", "yaw_scrub"), ("models",)])
def test_a_pipe_that_knows_few_letters_takes_what_is_printed(words: tuple[str, ...]) -> None:
    """As pipes on Windows do, by default."""
    run = [sys.executable, "-m", "bcid", *words]
    done = subprocess.run(
        run, capture_output=True, cwd=ROOT, env=os.environ | {"PYTHONIOENCODING": "cp1252"}, check=False
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert done.stdout.decode("cp1252")
