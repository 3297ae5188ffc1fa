"""What is printed in each language: every operation, all effects at once, derivatives."""

from __future__ import annotations

import importlib.util
import math
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_models import (
    CAR,
    MODELS,
    all_effects_but,
    augmented_car,
    evaluate,
    load_module,
    make_export,
    typical,
    written,
)

from bcid.effects.table import ENTRIES
from bcid.export import check
from bcid.export.c_source import HELPERS, C
from bcid.export.casadi_source import _HELPERS as CASADI_HELPERS
from bcid.export.casadi_source import CASADI, write_casadi_source
from bcid.export.check import C_FLAGS, find_compiler
from bcid.export.exported import Exported, export_model
from bcid.export.graph import OPERATIONS, TRUTHS, Graph, Node
from bcid.export.python_source import PYTHON
from bcid.export.python_text import body_text
from bcid.export.statements import Language, Line, write_program
from bcid.models.interface import Model
from bcid.physics.car import Car

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
needs_casadi = pytest.mark.skipif(importlib.util.find_spec("casadi") is None, reason="casadi is not installed")

OF_ONE = ("neg", "abs", "floor", "sqrt", "exp", "sin", "cos", "atan", "tanh")
"""Operations on one number."""
NUMBERS = [
    (0.7, -1.3, 2.5), (-0.7, 1.3, -2.5), (1.3, 1.3, 0.0), (-1.3, -1.3, 0.5), (0.0, 0.4, -0.2), (3.0, -0.5, -0.5),
    (0.4, 0.9, 0.1), (2.0, 0.0, 3.0),
]  # fmt: skip


def operands_of(operation: str, a: Any, b: Any, c: Any) -> tuple[Any, ...]:
    """What an operation is tried on, numbers or nodes: truth values where it wants them, nothing without a result."""
    if operation in ("and", "or"):
        return a < b, b < c
    if operation == "select":
        return a < b, b, c
    if operation == "div":
        return a, b + 4.0
    if operation == "sqrt":
        return (a * a + 0.5,)
    return (a,) if operation in OF_ONE else (a, b)


def all_operations(a: Any, b: Any, c: Any, operate: Any) -> list[Any]:
    """The results of all operations; those that are truths as 1 and 0."""
    made = [(o, operate(o, *operands_of(o, a, b, c))) for o in OPERATIONS]
    return [operate("select", x, 1.0, 0.0) if o in TRUTHS else x for o, x in made]


def on_numbers(operation: str, *operands: Any) -> float:
    return float(OPERATIONS[operation](*operands))


def printed(language: Language) -> tuple[str, list[str]]:
    """The lines and the results of all operations in Python, by a `language` of it."""
    program = write_program(as_nodes(), language)
    return body_text(program), program.results


def as_nodes() -> list[Node]:
    graph = Graph()
    a, b, c = (graph.input(name) for name in "abc")
    return [graph.as_node(x) for x in all_operations(a, b, c, graph.operate)]


WANTED = [[float(x) for x in all_operations(*row, on_numbers)] for row in NUMBERS]


def test_every_operation_has_its_own_results() -> None:
    """Two operations that were exchanged would be told apart by these numbers."""
    columns = {tuple(column) for column in zip(*WANTED, strict=True)}
    assert len(columns) == len(OPERATIONS)
    for row, wanted in zip(NUMBERS, WANTED, strict=True):
        assert evaluate(tuple(as_nodes()), dict(zip("abc", row, strict=True))) == wanted


def test_every_operation_in_python(tmp_path: Path) -> None:
    body, results = printed(PYTHON)
    text = f"import math\n\n\ndef f(a, b, c):\n{body}    return [{', '.join(results)}]\n"
    (tmp_path / "operations.py").write_text(text, encoding="utf-8")
    f = load_module(tmp_path / "operations.py").f
    assert [f(*row) for row in NUMBERS] == WANTED


@needs_casadi
def test_every_operation_in_casadi(tmp_path: Path) -> None:
    import casadi as ca

    body, results = printed(CASADI)
    text = (
        f"import casadi as ca\n\n\n{CASADI_HELPERS}\n\n"
        f"def f(a, b, c):\n{body}    return ca.vertcat({', '.join(results)})\n"
    )
    (tmp_path / "casadi_operations.py").write_text(text, encoding="utf-8")
    f = load_module(tmp_path / "casadi_operations.py").f
    for kind in (ca.SX, ca.MX):
        x = kind.sym("x", 3)
        function = ca.Function("f", [x], [f(x[0], x[1], x[2])])
        made = np.hstack([np.array(function(row)) for row in NUMBERS]).T
        np.testing.assert_allclose(made, WANTED, rtol=4e-16, atol=1e-16)


@needs_compiler
def test_every_operation_in_c(tmp_path: Path) -> None:
    program = write_program(as_nodes(), C)
    lines = "".join(
        f"const {'int' if line.is_truth else 'double'} {line.name} = {line.text};\n"
        for line in program.lines
        if isinstance(line, Line)
    )
    results = "".join(f'printf("%.17g\\n", (double)({text}));\n' for text in program.results)
    rows = "".join(f"f({', '.join(map(repr, row))});\n" for row in NUMBERS)
    source = "#include <math.h>\n#include <stdio.h>\n" + "\n".join(HELPERS.values())
    source += f"\nstatic void f(double a, double b, double c)\n{{\n{lines}{results}}}\n"
    source += f"int main(void)\n{{\n{rows}return 0;\n}}\n"
    (tmp_path / "operations.c").write_text(source, encoding="utf-8")
    compiler = find_compiler()
    assert compiler is not None
    command = [compiler, *C_FLAGS, "-Werror", "operations.c", "-lm", "-o", "operations"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
    said = subprocess.run([tmp_path / "operations"], check=True, capture_output=True, text=True, timeout=60).stdout
    made = np.array(said.split(), float).reshape(len(NUMBERS), -1)
    np.testing.assert_allclose(made, WANTED, rtol=4e-16, atol=1e-16)


@needs_compiler
@needs_casadi
@pytest.mark.parametrize("car", [CAR, CAR._replace(reverses=1.0, front_share=0.4)], ids=["brakes", "reverses"])
def test_programs_of_a_car_with_all_effects_do_what_the_model_does(
    car: Car, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Compiled without being optimised, which of so long a function takes ten times as long as all else here."""
    monkeypatch.setattr(check, "C_FLAGS", tuple(f for f in check.C_FLAGS if f != "-O2"))
    e = export_model(augmented_car(all_effects_but("clock_drift"), car), "0" * 64, None, "all_at_once")
    for made in written(e, ["c", "python", "casadi", "acados"], tmp_path).formats:
        assert made.error is not None
        assert made.error < 1e-12


@needs_compiler
@pytest.mark.parametrize("name", list(MODELS))
def test_c_compiles_without_a_warning(name: str, tmp_path: Path) -> None:
    e, compiler = make_export(name), find_compiler()
    written(e, ["c"], tmp_path)
    assert compiler is not None
    command = [compiler, *C_FLAGS, "-Werror", f"{e.name}.c", f"{e.name}_test.c", "-lm", "-o", "program"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr


@needs_casadi
@pytest.mark.parametrize("name", ["newton-euler", "newton-euler-augmented", "k-sindy-mlp"])
def test_casadi_differentiates_the_step(name: str, tmp_path: Path) -> None:
    import casadi as ca

    e = make_export(name)
    written(e, ["casadi"], tmp_path)
    module = load_module(tmp_path / f"{e.name}_casadi.py")
    function = module.step_function()
    X, U = ca.MX.sym("x", len(module.STATES)), ca.MX.sym("u", 2)
    jacobian = ca.Function("J", [X, U], [ca.jacobian(function(X, U)[0], ca.vertcat(X, U))])
    rng = np.random.default_rng(4)
    x, u = rng.uniform(0.1, 0.4, len(module.STATES)), np.array([0.2, 0.8])
    if "v_x" in module.STATES:
        x[module.STATES.index("v_x")] = 0.6
    z, h = np.r_[x, u], 1e-6

    def after(z: np.ndarray) -> np.ndarray:
        return np.array(function(z[:-2], z[-2:])[0]).ravel()

    differences = np.array([(after(z + h * e) - after(z - h * e)) / (2.0 * h) for e in np.eye(len(z))]).T
    # of a network in double precision, whose derivative jumps only where a unit changes its sign
    assert np.abs(np.array(jacobian(x, u)) - differences).max() < 1e-6 * max(1.0, np.abs(differences).max())


def jacobian_at_rest(e: Exported, folder: Path) -> np.ndarray:
    """The derivatives of the next state and the twist by state and command, of a vehicle at rest."""
    import casadi as ca

    path = folder / f"{e.name}_casadi.py"
    path.write_text(write_casadi_source(e), encoding="utf-8")
    module = load_module(path)
    step = module.step_function()
    x, u = ca.MX.sym("x", len(module.STATES)), ca.MX.sym("u", 2)
    jacobian = ca.Function("J", [x, u], [ca.jacobian(ca.vertcat(*step(x, u)), ca.vertcat(x, u))])
    return np.array(jacobian(ca.DM.zeros(len(module.STATES)), ca.DM.zeros(2)))


AT_REST: dict[str, Model] = {
    **MODELS, "all at once": augmented_car(all_effects_but("clock_drift")),
    **{effect: augmented_car(typical(ENTRIES[effect])) for effect in ENTRIES if effect != "clock_drift"},
}  # fmt: skip


@needs_casadi
@pytest.mark.parametrize("name", list(AT_REST))
def test_derivatives_at_rest_are_finite(name: str, tmp_path: Path) -> None:
    assert np.isfinite(jacobian_at_rest(export_model(AT_REST[name], "0" * 64, None, "at_rest"), tmp_path)).all()


@needs_casadi
@pytest.mark.parametrize("name", list(MODELS))
def test_functions_of_casadi_take_plain_numbers_of_a_vehicle_at_rest(name: str, tmp_path: Path) -> None:
    e = make_export(name)
    path = tmp_path / f"{e.name}_casadi.py"
    path.write_text(write_casadi_source(e), encoding="utf-8")
    module, start = load_module(path), e.vectors.starts[-1]
    x = module.init(start.pose.tolist(), start.twist.tolist(), start.delta)
    np.testing.assert_allclose(np.array(x).ravel(), start.state, atol=1e-12)
    for state in (x, start.state, start.state.tolist()):
        after, twist = module.step(state, [0.0, 0.0])
        assert np.isfinite(np.array(after)).all()
        pose = module.move([0.0, 0.0, 0.0], start.twist, twist)
        assert pose.numel() == 3
    assert math.isclose(float(module.move([1.0, 2.0, 0.5], [0.0] * 3, [0.0] * 3)[1]), 2.0)
