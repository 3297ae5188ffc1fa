"""The formats of an export: which files each has, what of other formats it needs, and how it is checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from bcid.export.c_source import write_c_header, write_c_source
from bcid.export.casadi_source import write_casadi_source
from bcid.export.check import Checked, check_c, check_python
from bcid.export.check_programs import write_c_test, write_python_test
from bcid.export.exported import Exported
from bcid.export.fmi.check_fmus import check_fmus
from bcid.export.fmi.fmu import write_fmus
from bcid.export.framework_files import write_acados_files, write_ros_node
from bcid.export.onnx_rollout import check_onnx, write_onnx
from bcid.export.parameter_file import write_parameter_file
from bcid.export.python_source import write_python_source
from bcid.libraries import is_installed
from bcid.physics.car import Car

Files = Mapping[str, str | bytes]
"""What is written, by the names of files."""


@dataclass(frozen=True)
class ExportFormat:
    """One format."""

    summary: str
    write: Callable[[Exported], Files]
    check: Callable[[Path, Exported], Checked] | None  # in the folder in which the files lie; None: nothing can be run
    needs: tuple[str, ...] = ()  # formats whose files must lie beside these
    of_cars_only: bool = False
    library: str | None = None  # without which it cannot be written

    def suits(self, e: Exported) -> bool:
        """Whether the model can have this format."""
        return not self.of_cars_only or isinstance(getattr(e.model, "car", None), Car)

    def missing_library(self) -> str | None:
        """The library that writes it, where that is not installed; None where it can be written."""
        return None if self.library is None or is_installed(self.library) else self.library


def _write_c(e: Exported) -> Files:
    """NAME.h, NAME.c and NAME_test.c."""
    return {
        f"{e.name}.h": write_c_header(e),
        f"{e.name}.c": write_c_source(e),
        f"{e.name}_test.c": write_c_test(e.name, e.vectors),
    }


def _write_python(e: Exported) -> Files:
    """NAME.py and NAME_test.py."""
    return {
        f"{e.name}.py": write_python_source(e),
        f"{e.name}_test.py": write_python_test(e.name, e.vectors),
    }


def _write_casadi(e: Exported) -> Files:
    """NAME_casadi.py and NAME_casadi_test.py."""
    return {
        f"{e.name}_casadi.py": write_casadi_source(e),
        f"{e.name}_casadi_test.py": write_python_test(f"{e.name}_casadi", e.vectors, in_casadi=True),
    }


def _check_in_python(test: str, what: str, library: str | None = None) -> Callable[[Path, Exported], Checked]:
    """A check that runs the Python file NAME followed by `test`, where the `library` that it needs is installed."""

    def check(folder: Path, e: Exported) -> Checked:
        if library is not None and not is_installed(library):
            return Checked(None, f"{library} is not installed")
        return check_python(folder, f"{e.name}{test}", what)

    return check


def _check_elsewhere(why: str) -> Callable[[Path, Exported], Checked]:
    """A check of what cannot be run here, for the reason `why`."""
    return lambda folder, e: Checked(None, why)


FORMATS: dict[str, ExportFormat] = {
    "c": ExportFormat("C99 of doubles and math.h alone", _write_c, lambda folder, e: check_c(folder, e.name)),
    "python": ExportFormat("Python that needs nothing else", _write_python, _check_in_python("_test.py", "Python")),
    "casadi": ExportFormat(
        "CasADi, to differentiate and optimise", _write_casadi, _check_in_python("_casadi_test.py", "CasADi", "casadi")
    ),
    "acados": ExportFormat(
        "an AcadosModel around the CasADi file", write_acados_files,
        _check_in_python("_acados_test.py", "acados", "casadi"), needs=("casadi",),
    ),
    "ros2": ExportFormat(
        "a node of ROS 2 around the Python file", write_ros_node, _check_elsewhere("it runs where rclpy is installed"),
        needs=("python",),
    ),
    "fmi": ExportFormat("FMUs of FMI 3.0 and 2.0 for co-simulation", write_fmus, check_fmus),
    "onnx": ExportFormat(
        "ONNX in double precision: a step and a rollout, of batches", write_onnx, check_onnx, library="onnx"
    ),
    "parameters": ExportFormat(
        "constants as CommonRoad and the F1TENTH gym call them",
        lambda e: {f"{e.name}_parameters.yaml": write_parameter_file(e)},
        None, of_cars_only=True,
    ),
}  # fmt: skip
"""All formats by name; what one needs comes before it."""
