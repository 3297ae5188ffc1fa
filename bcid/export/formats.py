"""The formats of an export: which files each has, and how it is checked."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bcid.export.c_source import write_c_header, write_c_source
from bcid.export.casadi_source import write_casadi_source
from bcid.export.check import Checked, check_c, check_python
from bcid.export.check_programs import write_c_test, write_python_test
from bcid.export.exported import Exported
from bcid.export.python_source import write_python_source
from bcid.libraries import is_installed


@dataclass(frozen=True)
class ExportFormat:
    """One format."""

    summary: str
    write: Callable[[Exported], dict[str, str]]  # the texts of its files by their names
    check: Callable[[Path, Exported], Checked]  # in the folder in which the files lie


def _write_c(e: Exported) -> dict[str, str]:
    """NAME.h, NAME.c and NAME_test.c."""
    return {
        f"{e.name}.h": write_c_header(e.name, e.formulas, e.about),
        f"{e.name}.c": write_c_source(e.name, e.formulas, e.about),
        f"{e.name}_test.c": write_c_test(e.name, e.vectors),
    }


def _write_python(e: Exported) -> dict[str, str]:
    """NAME.py and NAME_test.py."""
    return {
        f"{e.name}.py": write_python_source(e.formulas, e.about),
        f"{e.name}_test.py": write_python_test(e.name, e.vectors),
    }


def _write_casadi(e: Exported) -> dict[str, str]:
    """NAME_casadi.py and NAME_casadi_test.py."""
    return {
        f"{e.name}_casadi.py": write_casadi_source(e.name, e.formulas, e.about),
        f"{e.name}_casadi_test.py": write_python_test(f"{e.name}_casadi", e.vectors, in_casadi=True),
    }


def _check_casadi(folder: Path, e: Exported) -> Checked:
    """Run the test in CasADi, where that is installed."""
    if not is_installed("casadi"):
        return Checked(None, "casadi is not installed")
    return check_python(folder, f"{e.name}_casadi_test.py", "CasADi")


FORMATS: dict[str, ExportFormat] = {
    "c": ExportFormat("C99 of doubles and math.h alone", _write_c, lambda folder, e: check_c(folder, e.name)),
    "python": ExportFormat(
        "Python that needs nothing else", _write_python,
        lambda folder, e: check_python(folder, f"{e.name}_test.py", "Python"),
    ),
    "casadi": ExportFormat("CasADi, to differentiate and optimise", _write_casadi, _check_casadi),
}  # fmt: skip
"""All formats by name."""
