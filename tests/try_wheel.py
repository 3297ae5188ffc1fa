"""Install the wheel as a stranger would, and run it where nothing of this checkout is in reach.

    python tests/try_wheel.py

It builds the wheel, installs it with `constraints.txt` into a new environment of this Python in a temporary folder, and
there, in an empty folder, goes the way from `bcid init` to an exported model.  It ends at the first command that fails.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
import venv
from collections.abc import Sequence
from pathlib import Path

from wheel_building import ROOT, copy_sources

LONGEST_S = 900.0
TAKES = {"training": 1, "validation": 2}
"""Simulated takes by name, each with its seed."""
TAKE_S = "60"
FIT = ["fit", "--model", "newton-euler", "-p", "pipeline.toml", "--format", "json"]
EXPORT = ["export", "--format", "c", "--format", "python", "--format", "fmi"]
COMMANDS = (
    ["--version"],
    ["--help"],
    ["models"],
    ["init", "lab"],
    *(
        ["simulate", name, "--out", "logs", "--duration", TAKE_S, "--seed", str(seed)]
        for name, seed in TAKES.items()
    ),
    ["ingest", "--check", "logs/training.csv", "--vehicle", "logs/bumper_car.toml"],
    ["estimate", "logs/training.csv", "--vehicle", "logs/bumper_car.toml", "--out", "results"],
    ["report", "-p", "pipeline.toml"],
)  # fmt: skip
PIPELINE = """\
vehicle = "logs/bumper_car.toml"
training = ["logs/training.csv"]
validation = "logs/validation.csv"
models = ["newton-euler"]
"""


def main() -> int:
    """Try the wheel; the exit code is 0 where every command ended with 0."""
    with tempfile.TemporaryDirectory(prefix="bcid-wheel-", ignore_cleanup_errors=True) as name:
        home = Path(name)
        programs = _install(home)
        work = home / "work"
        work.mkdir()
        (work / "pipeline.toml").write_text(PIPELINE, encoding="utf-8")
        bcid = str(programs / "bcid")
        where = _run([str(programs / "python"), "-c", "import bcid; print(bcid.__file__)"], work)
        if not Path(where.strip()).resolve().is_relative_to(home.resolve()):
            raise SystemExit(f"bcid was imported from {where.strip()}, not from the wheel")
        for words in COMMANDS:
            _run([bcid, *words], work)
        (fitted,) = json.loads(_run([bcid, *FIT], work))["models"]
        _run([bcid, *EXPORT, fitted["folder"]], work)
        _run([str(programs / "python"), "newton_euler_test.py"], work / "export")
    sys.stderr.write("the wheel does all that it was asked for\n")
    return 0


def _install(home: Path) -> Path:
    """Build the wheel and install it into a new environment in `home`; returns the folder of its programs."""
    venv.create(home / "env", with_pip=True)
    programs = home / "env" / ("Scripts" if os.name == "nt" else "bin")
    pip = [str(programs / "python"), "-m", "pip", "-q", "--disable-pip-version-check"]
    # built as pip builds for a stranger: with what pyproject.toml asks for, and nothing else
    _run([*pip, "wheel", "--no-deps", "--wheel-dir", str(home / "dist"), str(copy_sources(home / "sources"))], home)
    (wheel,) = (home / "dist").glob("bcid-*.whl")
    _run([*pip, "install", "-c", str(ROOT / "constraints.txt"), str(wheel)], home)
    return programs


def _run(words: Sequence[str], folder: Path) -> str:
    """Run a program in `folder`, with nothing of this checkout on Python's path; returns what it printed.

    Raises:
        SystemExit: it does not end with 0, or not in time.
    """
    clean = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "NUMBA_CACHE", "VIRTUAL_ENV"))}
    begin = time.monotonic()
    try:
        done = subprocess.run(
            words, cwd=folder, env=clean, capture_output=True, text=True, encoding="utf-8", errors="replace",
            timeout=LONGEST_S, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise SystemExit(f"{' '.join(words)} has not ended after {LONGEST_S:g} s") from None
    shown = " ".join([Path(words[0]).stem, *words[1:]])
    sys.stderr.write(f"{time.monotonic() - begin:6.1f} s  {shown[:110]}\n")
    if done.returncode != 0:
        raise SystemExit(f"{shown} ended with {done.returncode}:\n{(done.stdout + done.stderr)[-3000:]}")
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
