"""A kernel is kept under what it is made of, and machine code is made of whole kernels alone."""

from __future__ import annotations

import importlib.util
from itertools import count
from pathlib import Path
from types import ModuleType

import numba
import numpy as np
import pytest
from numba.core.codegen import JITCodeLibrary

from bcid.compiled.kernel_key import kernel_digest
from bcid.compiled.late_code import LateLibrary
from bcid.compiled.njit import njit, njit_parallel
from bcid.effects import car, motion
from bcid.likelihood.predict import predict_poses

SOURCE = '''
from typing import NamedTuple
import numpy as np
from bcid.compiled.lanes import where
from bcid.compiled.njit import njit, njit_inline
from bcid.physics import steering

GAIN, OFFSET = 2.0, 3.0
TABLE = np.array([1.0, 2.0])
MODES = ("slow", 4)

class Tyre(NamedTuple):
    stiffness: float
    grip: float

class Car(NamedTuple):
    m: float
    tyre: Tyre

@njit_inline
def law(x):
    """A law."""
    return GAIN * x if x in {1.0, 2.0} else MODES[1] * x

@njit
def unrelated(x):
    return OFFSET * x

@njit
def kernel(x: float, car: Car) -> float:
    """A kernel."""
    return law(x) + car.m + TABLE[0] + where(x > 0.0, 1.0, steering.steering_step(x, x, x, x, x))
'''
names = count()


def load(folder: Path, source: str) -> ModuleType:
    path = folder / f"kernels_{next(names)}.py"
    path.write_text(source)
    spec = importlib.util.spec_from_file_location("kernels", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def digest(folder: Path, source: str) -> str:
    return kernel_digest(load(folder, source).kernel.py_func)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("A law.", "Another text."), ("A kernel.", "Another text."), ("OFFSET = 2.0, 3.0", "OFFSET = 2.0, 4.0"),
        ("OFFSET * x", "x - OFFSET"), ("@njit\ndef unrelated", "# a comment\n\n@njit\ndef unrelated"),
    ],
)  # fmt: skip
def test_an_edit_of_what_a_kernel_does_not_run_leaves_its_key(old: str, new: str, tmp_path: Path) -> None:
    assert SOURCE.count(old) == 1
    assert digest(tmp_path, SOURCE.replace(old, new)) == digest(tmp_path, SOURCE)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("GAIN * x", "x * GAIN * x"), ("OFFSET = 2.0, 3.0", "OFFSET = 2.5, 3.0"), ("{1.0, 2.0}", "{1.0, 2.5}"),
        ("np.array([1.0, 2.0])", "np.array([1.5, 2.0])"), ('("slow", 4)', '("slow", 5)'), ("x > 0.0", "x >= 0.0"),
        ("@njit_inline", "@njit"), ("@njit\ndef kernel", "@njit_inline\ndef kernel"),
        ("    m: float\n    tyre: Tyre", "    tyre: Tyre\n    m: float"),
        ("    stiffness: float\n    grip: float", "    grip: float\n    stiffness: float"),
        ("steering.steering_step(x, x, x, x, x)", "x"), ("TABLE[0]", "TABLE[1]"),
    ],
)  # fmt: skip
def test_an_edit_of_what_a_kernel_runs_changes_its_key(old: str, new: str, tmp_path: Path) -> None:
    assert SOURCE.count(old) == 1
    assert digest(tmp_path, SOURCE.replace(old, new)) != digest(tmp_path, SOURCE)


def test_a_prediction_is_keyed_by_the_laws_it_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    before = kernel_digest(predict_poses.py_func)
    monkeypatch.setattr(car, "COMPLIANCE_TOLERANCE_RAD", 1e-6)
    changed = kernel_digest(predict_poses.py_func)
    assert changed != before
    monkeypatch.undo()
    monkeypatch.setattr(motion, "__doc__", "Another text.")
    assert kernel_digest(predict_poses.py_func) == before


@njit
def root(x: float) -> float:
    if x < 0.0:
        raise ValueError("no root of a negative number")
    return float(np.sqrt(x))


@njit
def sum_of_roots(x: np.ndarray) -> float:
    total = 0.0
    for value in x:
        total += root(value)
    return total


@njit_parallel
def add_root_sums(x: np.ndarray) -> np.ndarray:
    out = np.zeros(len(x))
    for i in numba.prange(len(x)):
        out[i] = sum_of_roots(x[i])
    return out


def test_a_function_serves_python_and_other_kernels() -> None:
    assert sum_of_roots(np.array([4.0, 9.0])) == 5.0
    assert root(16.0) == 4.0
    np.testing.assert_array_equal(add_root_sums(np.array([[4.0, 9.0], [0.0, 1.0]])), [5.0, 1.0])


def test_an_error_in_a_called_function_reaches_python() -> None:
    with pytest.raises(ValueError, match="no root of a negative number"):
        sum_of_roots(np.array([1.0, -1.0]))


def test_machine_code_is_made_of_the_kernel_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []
    monkeypatch.setattr(
        JITCodeLibrary, "_optimize_final_module", lambda self: made.append(self.name), raising=True
    )  # fmt: skip
    kernels = load(tmp_path, SOURCE)
    assert kernels.kernel(1.0, kernels.Car(1.0, kernels.Tyre(1.0, 1.0))) == 5.0
    assert made == ["kernel"]


def test_numba_makes_all_code_late() -> None:
    assert all(isinstance(compiled.library, LateLibrary) for compiled in root.overloads.values())
