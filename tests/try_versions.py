"""Run tests under every version of Python that bcid is for, each in an environment of its own.

    python tests/try_versions.py [VERSION ...] [-- WORDS OF PYTEST ...]

Interpreters are uv's where uv is installed (it downloads those that are missing), pyenv's, or those on the path:
`python3.12`.  Versions that cannot be had are named, and count as failed only where they were asked for.  Environments
are kept in `.venv-VERSION`, without torch, whose tests are skipped; exact versions are those of `constraints.txt`.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
VERSIONS = ("3.11", "3.12", "3.13")
EXTRAS = ".[checks,export,dev]"
TESTS = (
    "bcid", "tests/test_structure.py", "tests/test_docs.py", "tests/test_documents.py", "tests/test_wheel.py",
    "tests/test_windows.py", "tests/test_physics.py", "tests/test_kernel_key.py", "tests/test_compiled_cache.py",
    "tests/test_csv_text.py", "tests/test_readers.py", "tests/test_rosbag.py", "tests/test_store.py",
    "tests/test_outputs.py", "tests/test_export.py", "tests/test_export_languages.py", "tests/test_models.py",
    "tests/test_cli.py",
)  # fmt: skip
"""What can differ between versions: syntax and byte code, libraries, files, kernels and their keys, commands."""


def main(words: list[str]) -> int:
    """Test each version; returns 1 where tests of one fail, or one that was asked for cannot be had."""
    at = words.index("--") if "--" in words else len(words)
    asked, tests = words[:at], words[at + 1 :] or [*TESTS, "-m", "not slow and not proof"]
    outcomes = {version: _test_version(version, tests) for version in asked or VERSIONS}
    for version, outcome in outcomes.items():
        sys.stderr.write(f"Python {version}: {outcome}\n")
    failed = [v for v, outcome in outcomes.items() if outcome == "failed" or (v in asked and outcome != "passed")]
    return 1 if failed or "passed" not in outcomes.values() else 0


def _test_version(version: str, tests: list[str]) -> str:
    """Run `tests` under a version of Python: "passed", "failed", or why it cannot be had."""
    python = _find_python(version)
    if python is None:
        return "not found: install uv, or put it on the path"
    programs = _environment(version, python)
    one_thread = dict.fromkeys(("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    # kernels compiled by another version are no use to this one
    kept = {"NUMBA_CACHE_DIR": str(ROOT / f".venv-{version}" / "kernels")}
    done = subprocess.run(
        [str(programs / "python"), "-m", "pytest", "-q", "-n", "2", "--dist", "loadfile", *tests],
        cwd=ROOT, env=os.environ | one_thread | kept, check=False,
    )  # fmt: skip
    return "passed" if done.returncode == 0 else "failed"


def _find_python(version: str) -> str | None:
    """The path of an interpreter of this version; None where there is none."""
    found = [shutil.which(f"python{version}"), sys.executable]
    if uv := shutil.which("uv"):
        subprocess.run([uv, "python", "install", "-q", version], check=False, capture_output=True)
        told = subprocess.run([uv, "python", "find", version], check=False, capture_output=True, text=True)
        found.insert(0, told.stdout.strip())
    if pyenv := shutil.which("pyenv"):
        told = subprocess.run([pyenv, "prefix", version], check=False, capture_output=True, text=True)
        found.insert(0, str(Path(told.stdout.strip()) / "bin" / "python"))
    return next((path for path in found if path and _version_of(path) == version), None)


def _version_of(python: str) -> str:
    """Version of an interpreter as "3.12"; empty where it does not run."""
    ask = "import sys; print('%d.%d' % sys.version_info[:2])"
    try:
        return subprocess.run([python, "-c", ask], check=False, capture_output=True, text=True).stdout.strip()
    except OSError:
        return ""


def _environment(version: str, python: str) -> Path:
    """The folder of the programs in `.venv-VERSION`, made where it is missing or what it is made of has changed."""
    home, files = ROOT / f".venv-{version}", [ROOT / "pyproject.toml", ROOT / "constraints.txt"]
    programs, ready = home / ("Scripts" if os.name == "nt" else "bin"), home / "ready"
    made_of = hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()
    if not ready.is_file() or ready.read_text(encoding="utf-8") != made_of:
        subprocess.run([python, "-m", "venv", "--clear", str(home)], check=True)
        pip = [str(programs / "python"), "-m", "pip", "install", "-q", "--disable-pip-version-check"]
        subprocess.run([*pip, "-c", "constraints.txt", "-e", EXTRAS], check=True, cwd=ROOT)
        ready.write_text(made_of, encoding="utf-8")
    return programs


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
