"""Models in ONNX: every operation, one period and rollouts of whole batches, beside the models themselves."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_models import CAR, MODELS, PERIOD_S, make_export

from bcid.errors import InputRefused, LibraryMissing
from bcid.export import onnx_rollout
from bcid.export.commands import commands_of
from bcid.export.exported import Exported
from bcid.export.formulas import TWIST
from bcid.export.graph import OPERATIONS, TRUTHS, Graph, Node
from bcid.export.model_formulas import TRACED
from bcid.export.onnx_graph import write_graph
from bcid.export.onnx_rollout import Computation, check_onnx, load_onnx, write_onnx
from bcid.export.reference_drive import drive_for_reference
from bcid.libraries import EXTRAS
from bcid.models.newton_euler.model import NewtonEuler

onnx = pytest.importorskip("onnx", reason="onnx is not installed")
pytest.importorskip("onnxruntime", reason="onnxruntime is not installed")

BATCH = 16
OF_ONE = ("neg", "abs", "floor", "sqrt", "exp", "sin", "cos", "atan", "tanh")
"""Operations on one number."""
every_model = pytest.mark.parametrize("name", list(MODELS))


def loaded(e: Exported) -> tuple[Computation, Computation]:
    """The step and the rollout."""
    step, rollout = map(load_onnx, write_onnx(e).values())
    return step, rollout


def computed(results: Sequence[Node], rows: np.ndarray) -> np.ndarray:
    """What onnxruntime makes of formulas of the inputs a, b, c, from rows (N, 3) of these."""
    graph = write_graph("formulas", {"x": ("a", "b", "c")}, {"y": results}, {})
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 18)], ir_version=8)
    onnx.checker.check_model(model, full_check=True)
    return load_onnx(model.SerializeToString())(rows)[0]


def random_rows(operation: str) -> np.ndarray:
    """Numbers of either sign from very small to large, with zeros, equal ones and whole ones among them."""
    rng = np.random.default_rng(3)
    rows = rng.choice([-1.0, 1.0], (600, 3)) * 10.0 ** rng.uniform(-6.0, 2.0, (600, 3))
    rows[:50, 0], rows[50:100, 1], rows[100:150, 1] = 0.0, 0.0, rows[100:150, 0]
    rows[150:160, :2] = 0.0
    rows[160:250] = np.round(rows[160:250]) + 0.0  # no zero with a sign: that is not kept
    if operation == "div":
        rows[:, 1] += rows[:, 1] == 0.0
    return np.abs(rows) if operation == "sqrt" else rows


def operands_of(operation: str, a: Any, b: Any, c: Any) -> tuple[Any, ...]:
    """What an operation is tried on, numbers or nodes: truth values where it wants them."""
    if operation in ("and", "or"):
        return a < b, b < c
    if operation == "select":
        return a < b, b, c
    return (a,) if operation in OF_ONE else (a, b)


def as_number(graph: Graph, result: Any) -> Node:
    """A result as a number: 1 of a condition that holds."""
    is_truth = isinstance(result, Node) and result.operation in TRUTHS
    return graph.as_node(graph.operate("select", result, 1.0, 0.0) if is_truth else result)


@pytest.mark.parametrize("operation", list(OPERATIONS))
def test_every_operation_on_numbers_is_pythons(operation: str) -> None:
    graph, rows = Graph(), random_rows(operation)
    inputs = [graph.input(name) for name in "abc"]
    node = as_number(graph, graph.operate(operation, *operands_of(operation, *inputs)))
    wanted = [float(OPERATIONS[operation](*operands_of(operation, *row))) for row in rows.tolist()]
    assert len(set(wanted)) > 1
    near_zero = 4e-16 if operation in ("sin", "cos") else 0.0
    np.testing.assert_allclose(computed([node], rows)[:, 0], wanted, rtol=1e-14, atol=near_zero)


@pytest.mark.parametrize("operation", ["lt", "le", "eq", "ne", "min", "hypot", "atan2", "copysign"])
def test_operations_on_an_input_and_a_constant_are_pythons(operation: str) -> None:
    graph, rows = Graph(), random_rows(operation)
    a, size, python = graph.input("a"), graph.parameter("size", 2.0), OPERATIONS[operation]
    nodes = [as_number(graph, graph.operate(operation, *pair)) for pair in ((a, 2.0), (-0.5, a), (a, size))]
    wanted = [[float(python(x, 2.0)), float(python(-0.5, x)), float(python(x, 2.0))] for x in rows[:, 0].tolist()]
    np.testing.assert_allclose(computed(nodes, rows), wanted, rtol=1e-14)


def test_angles_are_right_in_all_quadrants_and_where_there_is_no_ratio() -> None:
    graph = Graph()
    a, b = graph.input("a"), graph.input("b")
    turned = np.linspace(-3.1, 3.1, 401)
    rows = np.column_stack([np.sin(turned), np.cos(turned), turned])
    rows = np.vstack(
        [rows, [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [1e300, 1e-300, 0.0]]]
    )
    angle, of_tangent = computed([graph.operate("atan2", a, b), graph.operate("atan", a / b)], rows).T
    np.testing.assert_allclose(angle, np.arctan2(rows[:, 0], rows[:, 1]), rtol=0.0, atol=1e-15)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        np.testing.assert_allclose(of_tangent, np.arctan(rows[:, 0] / rows[:, 1]), rtol=0.0, atol=1e-15)


def test_a_result_that_depends_on_no_input_stands_in_every_row() -> None:
    graph = Graph()
    mass = graph.parameter("m", 3.0)
    results = [graph.constant(0.5), mass, graph.as_node(mass * 2.0), graph.input("a")]
    rows = np.array([[7.0, 0.0, 0.0], [8.0, 0.0, 0.0]])
    np.testing.assert_array_equal(computed(results, rows), [[0.5, 3.0, 6.0, 7.0], [0.5, 3.0, 6.0, 8.0]])


@pytest.mark.parametrize("name", [n for n in MODELS if n != "newton-euler-augmented"])
def test_a_step_of_a_batch_of_states_is_that_of_the_model(name: str) -> None:
    e, rng = make_export(name), np.random.default_rng(6)
    x = rng.uniform(-0.4, 0.8, (BATCH, len(e.formulas.states)))
    u = np.column_stack([rng.uniform(-0.5, 0.5, BATCH), rng.uniform(-0.5, 1.0, BATCH)])
    step, _ = loaded(e)
    after, twist = step(x, u)
    of_model = [e.model.step(state.copy(), command) for state, command in zip(x, u, strict=True)]
    np.testing.assert_allclose(after, [state for state, _ in of_model], rtol=0.0, atol=e.vectors.tolerance)
    np.testing.assert_allclose(twist, [there for _, there in of_model], rtol=0.0, atol=e.vectors.tolerance)


def test_a_batch_of_cars_with_effects_drives_as_the_model_drives_each() -> None:
    """Their states are no carries of the model, which keeps times: they come of 200 commands of their own."""
    e = make_export("newton-euler-augmented")
    drives = [drive_for_reference(e.model, e.formulas, None, seed=seed) for seed in range(BATCH)]
    step, rollout = loaded(e)
    x = np.tile(onnx_rollout._first_state(e), (BATCH, 1))
    u, wanted = (np.array([getattr(drive, field) for drive in drives]) for field in ("commands", "twists"))
    assert wanted.std(axis=0).max() > 0.03
    np.testing.assert_allclose(rollout(x, u)[0], wanted, rtol=0.0, atol=1e-9)
    for k in range(60):
        x, twist = step(x, u[:, k])
        np.testing.assert_allclose(twist, wanted[:, k], rtol=0.0, atol=1e-9)


@every_model
def test_a_rollout_is_a_loop_of_steps(name: str) -> None:
    e, rng = make_export(name), np.random.default_rng(7)
    x = rng.uniform(0.0, 0.5, (BATCH, len(e.formulas.states)))
    u = np.dstack([rng.uniform(-0.3, 0.3, (BATCH, 25)), rng.uniform(0.0, 1.0, (BATCH, 25))])
    step, rollout = loaded(e)
    twists, last = rollout(x, u)
    for k in range(u.shape[1]):
        x, twist = step(x, u[:, k])
        np.testing.assert_allclose(twists[:, k], twist, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(last, x, rtol=0.0, atol=1e-12)
    assert np.isfinite(last).all()


@every_model
def test_files_keep_the_rules_of_onnx_and_do_what_the_model_does(name: str, tmp_path: Path) -> None:
    e = make_export(name)
    files = write_onnx(e)
    assert list(files) == [f"{e.name}.onnx", f"{e.name}_rollout.onnx"]
    assert files == write_onnx(make_export(name))
    for file, content in files.items():
        (tmp_path / file).write_bytes(content)
        model = onnx.load_from_string(content)
        onnx.checker.check_model(model, full_check=True)
        assert (model.producer_name, model.doc_string) == ("bcid", e.about)
    checked = check_onnx(tmp_path, e)
    assert checked.error is not None
    assert checked.error <= e.vectors.tolerance


def test_a_file_says_what_its_columns_are() -> None:
    model = onnx.load_from_string(write_onnx(make_export("newton-euler"))["newton_euler.onnx"])
    said = {entry.key: entry.value for entry in model.metadata_props}
    assert float(said["period_s"]) == PERIOD_S
    assert [q["name"] for q in json.loads(said["states"])] == ["v_x", "v_y", "yaw_rate", "delta"]
    assert json.loads(said["commands"]) == [q._asdict() for q in commands_of(MODELS["newton-euler"])]
    assert json.loads(said["twist"]) == [
        q._replace(meaning=f"{q.meaning}, of the tracked point")._asdict() for q in TWIST
    ]
    constants = {c.name: float(onnx.numpy_helper.to_array(c)) for c in model.graph.initializer}
    assert constants["m"] == CAR.m
    shapes = {v.name: [d.dim_param or d.dim_value for d in v.type.tensor_type.shape.dim] for v in model.graph.input}
    assert shapes == {"x": ["B", 4], "u": ["B", 2]}


def test_a_network_is_products_of_matrices_once_for_all_its_outputs() -> None:
    model = onnx.load_from_string(write_onnx(make_export("narx-mlp"))["narx_mlp.onnx"])
    operators = [node.op_type for node in model.graph.node]
    assert operators.count("Gemm") == 3
    assert operators.count("Relu") == 2
    assert len(operators) < 20


def test_an_export_that_does_not_do_what_the_model_does_is_refused(tmp_path: Path) -> None:
    e = make_export("newton-euler")
    other = NewtonEuler(CAR._replace(m=CAR.m * (1.0 + 1e-6)), PERIOD_S, {})
    for file, content in write_onnx(replace(e, formulas=TRACED["newton-euler"](other))).items():
        (tmp_path / file).write_bytes(content)
    with pytest.raises(InputRefused, match="does not do what the model does: off by"):
        check_onnx(tmp_path, e)


def test_numbers_that_are_not_finite_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    e = make_export("k-sindy")
    for file, content in write_onnx(e).items():
        (tmp_path / file).write_bytes(content)
    right = e.vectors.twists
    monkeypatch.setattr(onnx_rollout, "_drive", lambda *given: [right, np.full_like(right, np.nan)])
    with pytest.raises(InputRefused, match="off by nan"):
        check_onnx(tmp_path, e)


def test_a_file_that_breaks_a_rule_or_has_no_kernels_is_refused(tmp_path: Path) -> None:
    e = make_export("k-sindy")
    files = write_onnx(e)
    model = onnx.load_from_string(files["k_sindy.onnx"])
    next(node for node in model.graph.node if node.op_type == "Cos").op_type = "Atan"
    with pytest.raises(InputRefused, match="onnxruntime cannot load it"):
        load_onnx(model.SerializeToString())
    model.graph.node[-1].input[0] = "nothing"
    (tmp_path / "k_sindy.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(InputRefused, match="breaks a rule of ONNX"):
        check_onnx(tmp_path, e)


def test_without_the_libraries_nothing_is_written_or_nothing_is_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    e = make_export("k-sindy")
    for file, content in write_onnx(e).items():
        (tmp_path / file).write_bytes(content)
    monkeypatch.setattr(onnx_rollout, "is_installed", lambda name: name != "onnxruntime")
    assert check_onnx(tmp_path, e) == (None, "onnxruntime is not installed")
    monkeypatch.setattr(onnx_rollout, "is_installed", lambda name: False)
    assert check_onnx(tmp_path, e) == (None, "onnx is not installed")
    monkeypatch.setattr("bcid.libraries.is_installed", lambda name: False)
    monkeypatch.setitem(EXTRAS, "onnx", "export")
    with pytest.raises(LibraryMissing, match="needs the library onnx"):
        write_onnx(e)
