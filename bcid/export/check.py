"""Exports are run: compiled, imported or loaded as their users will, and compared with the model itself."""

from __future__ import annotations

import functools
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from bcid.errors import InputRefused

LONGEST_RUN_S = 300.0
COMPILERS = ("cc", "gcc", "clang")
C_FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic")
NO_COMPILER = f"no C compiler ({', '.join(COMPILERS)}) was found that works"
OWN_FAULT = "report this: it is a fault of bcid"
NOT_THE_MODEL = "does not do what the model does"

_PROBE = "#include <math.h>\nint main(int n, char **words) { return words[0] == 0 && sin((double)n) > 2.0; }\n"


class Checked(NamedTuple):
    """What became of a check: the largest error, or why none could be made."""

    error: float | None
    not_checked: str = ""


def check_c(folder: Path, name: str) -> Checked:
    """Compile NAME.c and its test in `folder` and run it; without a C compiler nothing can be checked.

    Returns the largest error of a twist (m/s, rad/s) over the reference drive, or why there is none.

    Raises:
        InputRefused: it does not compile, is not as exact as it must be, or does not end.
    """
    compiler = find_compiler()
    if compiler is None:
        return Checked(None, NO_COMPILER)
    program = executable(folder, f"{name}_test")
    try:
        compile_c(compiler, [f"{name}.c", f"{name}_test.c"], program, "C")
        return Checked(float(run_program([str(program)], folder, "C")))
    finally:
        program.unlink(missing_ok=True)


def check_python(folder: Path, test: str, what: str) -> Checked:
    """Run the test in Python of the file name `test` in `folder`, by this Python; returns its largest error.

    Raises:
        InputRefused: it fails, is not as exact as it must be, or does not end; `what` says of which format it is.
    """
    try:
        return Checked(float(run_program([sys.executable, "-B", test], folder, what)))
    finally:
        shutil.rmtree(folder / "__pycache__", ignore_errors=True)


def find_compiler() -> str | None:
    """The path of a C compiler that compiles a program with `math.h`; None where there is none."""
    return next((path for path in map(shutil.which, COMPILERS) if path and _can_compile(path)), None)


@functools.cache
def _can_compile(compiler: str) -> bool:
    """Whether the C `compiler` at a path makes a program of two lines; it is tried once."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "probe.c").write_text(_PROBE, encoding="utf-8")
        try:
            compile_c(compiler, ["probe.c"], executable(Path(folder), "probe"), "C")
        except (InputRefused, OSError):
            return False
    return True


def executable(folder: Path, name: str) -> Path:
    """The absolute path of a program called `name` in `folder`, as compilers of this operating system write it."""
    return folder.resolve() / (f"{name}.exe" if sys.platform == "win32" else name)


def compile_c(compiler: str, sources: Sequence[str], made: Path, what: str, flags: Sequence[str] = ()) -> None:
    """Compile the C `sources`, names of files beside what is `made` of them, with further `flags`.

    Raises:
        InputRefused: they do not compile, or not in time; `what` says of which format they are.
    """
    command = [compiler, *C_FLAGS, *flags, *sources, "-lm", "-o", made.name]
    run_program(command, made.parent, what, "does not compile")


def run_program(command: Sequence[str], folder: Path, what: str, failure: str = NOT_THE_MODEL) -> str:
    """What a program prints, run in `folder`.

    Raises:
        InputRefused: it does not end with 0, of which `failure` is the cause, or not in time; `what` says of which
            format it is.
    """
    try:
        done = subprocess.run(  # noqa: S603  # a compiler, this Python, or what was just written
            command, cwd=folder, capture_output=True, text=True, timeout=LONGEST_RUN_S, check=False
        )
    except subprocess.TimeoutExpired:
        cause = f"{Path(command[0]).name} has not ended after {LONGEST_RUN_S:g} s"
        raise InputRefused(folder, f"export to {what}", cause, "export when the computer has less to do") from None
    if done.returncode != 0:
        said = (done.stdout + done.stderr).strip()[-800:]
        raise InputRefused(folder, f"export to {what}", f"{failure}: {said}", OWN_FAULT)
    return done.stdout
