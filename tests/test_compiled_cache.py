"""Where compiled kernels are kept, and that they run where nothing can be kept."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import bcid

STEP = "from bcid.physics.steering import steering_step as s; print(s(0.0, 0.1, 0.1, 1.0, 0.1)); print(s.stats)"
NOWHERE = "/dev/null/nowhere"  # no folder, whoever asks


def run_step(package_parent: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    kept = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME", "HOME")}
    command = [sys.executable, "-c", STEP]
    where = {**kept, "PYTHONPATH": str(package_parent), **environment}
    return subprocess.run(command, capture_output=True, text=True, check=False, env=where, cwd=package_parent)


@pytest.fixture
def read_only(tmp_path: Path) -> Path:
    """A copy of the package whose folder for caches nobody can make, not even root: a file stands in its place."""
    package = Path(bcid.__file__).parent
    shutil.copytree(package, tmp_path / "bcid", ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "bcid" / "__pycache__").write_text("")
    return tmp_path


def test_a_read_only_installation_without_a_home_runs_and_says_what_would_help(read_only: Path) -> None:
    done = run_step(read_only, HOME=NOWHERE)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout.splitlines()[0]) > 0.0
    assert len(done.stderr.splitlines()) == 1
    assert "NUMBA_CACHE_DIR" in done.stderr


def test_a_read_only_installation_keeps_kernels_in_the_home(read_only: Path) -> None:
    home = read_only / "home"
    home.mkdir()
    for _ in range(2):
        done = run_step(read_only, HOME=str(home))
        assert (done.returncode, done.stderr) == (0, "")
    assert list((home / ".cache" / "bcid" / "numba").rglob("*.nbi"))
    assert "cache_hits={}" not in done.stdout.replace(" ", "")
    assert not list(read_only.glob("bcid/**/*.nbi"))


def test_a_damaged_file_is_made_anew(tmp_path: Path) -> None:
    parent = Path(bcid.__file__).parent.parent
    first = run_step(parent, NUMBA_CACHE_DIR=str(tmp_path))
    (kept,) = tmp_path.rglob("*.nbc")
    kept.write_bytes(kept.read_bytes()[:1000])
    for hits in ("Counter()", "Counter({"):
        done = run_step(parent, NUMBA_CACHE_DIR=str(tmp_path))
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.splitlines()[0] == first.stdout.splitlines()[0]
        assert f"cache_hits={hits}" in done.stdout


def test_an_edited_law_is_compiled_anew_and_an_edited_docstring_is_not(read_only: Path, tmp_path: Path) -> None:
    law, cache = read_only / "bcid" / "physics" / "steering.py", str(tmp_path / "cache")
    whole = law.read_text()
    results = {}
    for name, text in {"as it is": whole, "docstring": whole.replace('"""', '"""A new word: ', 1)}.items():
        law.write_text(text)
        results[name] = run_step(read_only, NUMBA_CACHE_DIR=cache).stdout.splitlines()
    assert "cache_hits=Counter({" in results["docstring"][1]
    assert results["docstring"][0] == results["as it is"][0]
    law.write_text(whole.replace("return u_s - miss", "return 0.1 + u_s - miss"))
    edited = run_step(read_only, NUMBA_CACHE_DIR=cache).stdout.splitlines()
    assert "cache_hits=Counter()" in edited[1]
    assert float(edited[0]) == pytest.approx(0.1 + float(results["as it is"][0]))


def test_a_folder_that_cannot_be_written_to_is_named(read_only: Path) -> None:
    done = run_step(read_only, HOME=str(read_only), NUMBA_CACHE_DIR=NOWHERE)
    assert done.returncode == 0, done.stderr
    assert NOWHERE in done.stderr
    assert len(done.stderr.splitlines()) == 1
