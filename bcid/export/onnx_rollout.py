"""A model in ONNX: one period, and a rollout that goes through many of them, for whole batches in double precision."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bcid import __version__
from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.export.check import NOT_THE_MODEL, OWN_FAULT, Checked
from bcid.export.exported import Exported
from bcid.export.formulas import COMMANDS, START, TWIST, Variable
from bcid.export.onnx_graph import write_graph
from bcid.export.reference_drive import ReferenceDrive
from bcid.libraries import is_installed, require_library

if TYPE_CHECKING:
    from onnx import GraphProto, ModelProto

OPSET, IR_VERSION = 18, 8
"""Those of ONNX 1.13, so that runtimes of 2023 and later load the models."""

PLACE = "export to ONNX"

Computation = Callable[..., list[Floats]]
"""From the input matrices of a model of ONNX, in order, to its results, in order."""


def write_onnx(e: Exported) -> dict[str, bytes]:
    """The models NAME.onnx and NAME_rollout.onnx of an export, serialised, by the names of their files.

    NAME.onnx takes states x (B, n) and commands u (B, 2) of [u_s (rad), u_m], and gives the states x_next (B, n) after
    one period and the twists (B, 3) there, [v_x, v_y (m/s), yaw rate (rad/s)].  NAME_rollout.onnx takes x (B, n) and
    u (B, N, 2), and gives the twists (B, N, 3) after each command and the last states x_last (B, n).  What the columns
    are stands in their metadata.

    Raises:
        LibraryMissing: the library onnx is not installed.
    """
    require_library("onnx", PLACE)
    graphs = {"": _step_graph(e, "x", "u", "x_next", "twist"), "_rollout": _rollout_graph(e)}
    return {
        f"{e.name}{which}.onnx": _make_model(graph, e).SerializeToString(deterministic=True)
        for which, graph in graphs.items()
    }


def _step_graph(e: Exported, x: str, u: str, x_next: str, twist: str) -> GraphProto:
    """The graph of one period, from and to matrices of the names that are given."""
    f = e.formulas
    inputs = {x: [q.name for q in f.states], u: [q.name for q in COMMANDS]}
    return write_graph(f"{e.name}_step", inputs, {x_next: f.next_states, twist: f.twist}, f.networks)


def _rollout_graph(e: Exported) -> GraphProto:
    """The graph of many periods: the step, carried through by ONNX's `Scan`."""
    from onnx import TensorProto, helper

    # names within the step must be others than those around it
    step = _step_graph(e, "x_k", "u_k", "x_k_next", "twist_k")
    scan = helper.make_node(
        "Scan", ["x", "u"], ["x_last", "twists"], body=step, num_scan_inputs=1, scan_input_axes=[1],
        scan_output_axes=[1],
    )  # fmt: skip

    def matrix(name: str, *shape: str | int) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.DOUBLE, shape)

    n, commands, twist = len(e.formulas.states), len(COMMANDS), len(TWIST)
    inputs = [matrix("x", "B", n), matrix("u", "B", "N", commands)]
    return helper.make_graph(
        [scan], f"{e.name}_rollout", inputs, [matrix("twists", "B", "N", twist), matrix("x_last", "B", n)]
    )


def _make_model(graph: GraphProto, e: Exported | None = None) -> ModelProto:
    """The model of a graph, with what an export says of itself."""
    from onnx import helper

    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION, producer_name="bcid",
        producer_version=__version__, doc_string=e.about if e else "",
    )  # fmt: skip
    if e:
        columns = {"states": e.formulas.states, "commands": e.commands, "twist": e.twist}
        texts = {name: _quantities_text(quantities) for name, quantities in columns.items()}
        helper.set_model_props(model, {"period_s": repr(e.formulas.period_s), "model_digest": e.digest, **texts})
    return model


def _quantities_text(quantities: Sequence[Variable]) -> str:
    """The columns of a matrix as JSON: name, unit and meaning of each, in order."""
    return json.dumps([quantity._asdict() for quantity in quantities])


def check_onnx(folder: Path, e: Exported) -> Checked:
    """Check NAME.onnx and NAME_rollout.onnx in `folder` by ONNX's rules, and drive both as the model was driven.

    Returns the largest error of a twist (m/s, rad/s); none where onnxruntime, which drives them, is not installed.

    Raises:
        InputRefused: they break a rule, cannot be loaded, or are not as exact as they must be.
    """
    if not is_installed("onnx"):
        return Checked(None, "onnx is not installed")
    import onnx

    paths = [folder / f"{e.name}.onnx", folder / f"{e.name}_rollout.onnx"]
    for path in paths:
        try:
            onnx.checker.check_model(onnx.load(path), full_check=True)
        except (onnx.checker.ValidationError, onnx.shape_inference.InferenceError) as error:
            raise InputRefused(path, PLACE, f"breaks a rule of ONNX: {error}", OWN_FAULT) from None
    if not is_installed("onnxruntime"):
        return Checked(None, "onnxruntime is not installed")
    v, (step, rollout) = e.vectors, map(load_onnx, paths)
    worst = float(np.abs(np.array(_drive(e, step, rollout)) - v.twists).max())
    single = _single_error(v, step)
    for off, tolerance, what in ((worst, v.tolerance, "a drive"), (single, v.step_tolerance, "single periods")):
        if not off <= tolerance:
            raise InputRefused(folder, PLACE, f"{NOT_THE_MODEL}: off by {off:.3e} in {what}", OWN_FAULT)
    return Checked(worst)


def _single_error(v: ReferenceDrive, step: Computation) -> float:
    """The largest error of a state or twist after a single period, relative beyond the scales of `v`; NaN if one is."""
    s, scales = v.steps, np.r_[v.scales, 1.0, 1.0, 1.0]
    wanted = np.hstack([s.next_states, s.twists])
    return float(np.max(np.abs(np.hstack(step(s.states, s.commands)) - wanted) / np.maximum(scales, np.abs(wanted))))


def load_onnx(source: Path | bytes) -> Computation:
    """The model of ONNX in a file, or serialised, as a function of its inputs that onnxruntime computes on one core.

    Raises:
        InputRefused: onnxruntime cannot load it.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    try:
        session = onnxruntime.InferenceSession(source, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's errors have no other class in common
        name = source if isinstance(source, Path) else "a graph"
        raise InputRefused(name, PLACE, f"onnxruntime cannot load it: {error}", OWN_FAULT) from error
    names = [given.name for given in session.get_inputs()]
    return lambda *matrices: session.run(None, dict(zip(names, matrices, strict=True)))


def _drive(e: Exported, step: Computation, rollout: Computation) -> list[Floats]:
    """Twists (N, 3) of the reference drive: by single steps, and by the rollout."""
    v = e.vectors
    if v.states is not None:  # every command from a state of its own: a batch of single periods
        return [step(v.states, v.commands)[1], rollout(v.states, v.commands[:, None])[0][:, 0]]
    begin = x = _first_state(e)
    twists = []
    for command in v.commands:
        x, twist = step(x, command[None])
        twists.append(twist[0])
    return [np.array(twists), rollout(begin, v.commands[None])[0][0]]


def _first_state(e: Exported) -> Floats:
    """The state (1, n) in which the reference drive starts, by the formulas of first states, which no file holds."""
    v, f = e.vectors, e.formulas
    graph = write_graph("first_state", {"start": [q.name for q in START]}, {"x": f.first_states}, f.networks)
    return load_onnx(_make_model(graph).SerializeToString())(np.array([[*v.pose, *v.twist, v.delta]]))[0]
