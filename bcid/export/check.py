"""Exports are run: compiled, imported or loaded as their users will, and compared with the model itself."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from bcid.errors import InputRefused

LONGEST_RUN_S = 300.0
COMPILERS = ("cc", "gcc", "clang")
C_FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic")


class Checked(NamedTuple):
    """What became of a check: the largest error, or why none could be made."""

    error: float | None
    left_out: str = ""


def check_c(folder: Path, name: str) -> Checked:
    """Compile NAME.c and its test in `folder` and run it; without a C compiler nothing can be checked.

    Raises:
        InputRefused: it does not compile, or is not as exact as it must be.
    """
    compiler = find_compiler()
    if compiler is None:
        return Checked(None, f"no C compiler ({', '.join(COMPILERS)}) was found")
    program = folder / f"{name}_test"
    sources = [f"{name}.c", f"{name}_test.c"]
    try:
        _run([compiler, *C_FLAGS, *sources, "-lm", "-o", program.name], folder, "C")
        return _read_error([str(program)], folder, "C")
    finally:
        program.unlink(missing_ok=True)


def check_python(folder: Path, test: str, what: str) -> Checked:
    """Run the test in Python of the file name `test` in `folder`, by this Python.

    Raises:
        InputRefused: it fails, or is not as exact as it must be.
    """
    try:
        return _read_error([sys.executable, "-B", test], folder, what)
    finally:
        shutil.rmtree(folder / "__pycache__", ignore_errors=True)


def find_compiler() -> str | None:
    """The path of a C compiler; None where there is none."""
    return next((path for path in map(shutil.which, COMPILERS) if path), None)


def _read_error(command: list[str], folder: Path, what: str) -> Checked:
    """The largest error, which the program of a check prints."""
    return Checked(float(_run(command, folder, what)))


def _run(command: list[str], folder: Path, what: str) -> str:
    """What a program prints, run in `folder`.

    Raises:
        InputRefused: it does not end with 0.
    """
    done = subprocess.run(  # noqa: S603  # a compiler, this Python, or what was just written
        command, cwd=folder, capture_output=True, text=True, timeout=LONGEST_RUN_S, check=False
    )
    if done.returncode != 0:
        said = (done.stdout + done.stderr).strip()[-800:]
        cause = f"does not do what the model does: {said}"
        raise InputRefused(folder, f"export to {what}", cause, "report this: it is a fault of bcid")
    return done.stdout
