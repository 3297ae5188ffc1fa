"""What is exported does what the model does: formulas by their graph, programs by being run."""

from __future__ import annotations

import importlib.util
import itertools
import sys
import types
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from exported_models import (
    CAR,
    MODELS,
    PERIOD_S,
    all_effects_but,
    augmented_car,
    evaluate,
    evaluator,
    load_module,
    make_export,
    typical,
    written,
)

from bcid.documents.export import ExportDocument
from bcid.effects.table import ENTRIES
from bcid.errors import InputRefused, UsageError
from bcid.export.augmented_formulas import trace_augmented
from bcid.export.check import find_compiler
from bcid.export.exported import export_model
from bcid.export.formulas import StepFormulas
from bcid.export.graph import Graph, Node
from bcid.export.model_formulas import TRACED
from bcid.export.reference_drive import EXACT, drive_for_reference
from bcid.export.trace import Tracer
from bcid.models.interface import History
from bcid.models.newton_euler.model import NewtonEuler
from bcid.physics.car import Car

every_model = pytest.mark.parametrize("name", list(MODELS))
needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
needs_casadi = pytest.mark.skipif(importlib.util.find_spec("casadi") is None, reason="casadi is not installed")


def worst_error(formulas: StepFormulas, model: Any, time_s: float | None = None) -> float:
    """The largest error of a twist over the reference drive, of formulas that hold no network."""
    reference = drive_for_reference(model, formulas, None, time_s)
    start = [*reference.pose, *reference.twist, reference.delta]
    named = dict(
        zip([f"{q}_0" for q in ("p_x", "p_y", "theta", "v_x", "v_y", "yaw_rate", "delta")], start, strict=True)
    )
    x, worst, step = evaluate(formulas.first_states, named), 0.0, evaluator(formulas.results)
    for (u_s, u_m), twist in zip(reference.commands, reference.twists, strict=True):
        values = dict(zip([q.name for q in formulas.states], x, strict=True)) | {"u_s": u_s, "u_m": u_m}
        after = step(values)
        x, worst = after[:-3], max(worst, float(np.abs(after[-3:] - twist).max()))
    return worst


@pytest.mark.parametrize("effect", [e for e in ENTRIES if e != "clock_drift"])
def test_a_car_with_any_effect_is_traced_exactly(effect: str) -> None:
    model = augmented_car(typical(ENTRIES[effect]))
    assert worst_error(trace_augmented(model), model) < EXACT


@pytest.mark.parametrize("kind", ["rear drive", "force", "reverse", "measured speed"])
def test_a_car_with_all_effects_at_once_is_traced_exactly(kind: str) -> None:
    changes: dict[str, dict[str, Any]] = {
        "rear drive": {"front_share": 0.0}, "reverse": {"reverses": 1.0},
        "force": {"sets_force": 1.0, "u_0": 0.1, "K_v": 50.0, "front_share": 0.5},
        "measured speed": {"follows_wheel": 1.0, "K_t": 2000.0},
    }  # fmt: skip
    model = augmented_car(all_effects_but("clock_drift"), CAR._replace(**changes[kind]))
    assert worst_error(trace_augmented(model), model) < EXACT


@pytest.mark.parametrize("name", [n for n in TRACED if "mlp" not in n])
def test_models_without_networks_are_traced_exactly(name: str) -> None:
    assert worst_error(TRACED[name](MODELS[name]), MODELS[name]) < EXACT


def test_a_state_is_kept_for_what_an_effect_remembers_and_for_nothing_else() -> None:
    def states(**effects: float) -> list[str]:
        return [q.name for q in trace_augmented(augmented_car(effects)).states[6:]]

    assert states(steering_drag__k=20.0) == ["delta"]
    assert states(motor_lag__tau=0.1) == ["F_mf", "delta"]
    assert states(steering_backlash__b=0.02) == ["delta", "delta_behind"]
    assert states(motor_sag__s=0.2) == ["delta", "t"]
    assert states(steering_delay__tau=0.031) == ["delta", "u_s_ago_1", "u_s_ago_2"]
    assert states(motor_delay__tau=0.04) == ["delta", "u_m_ago_1", "u_m_ago_2"]


def test_effects_of_the_recordings_time_stand_where_they_are_told_to() -> None:
    model = augmented_car({"motor_sag__s": 0.4, "clock_drift__rho": 5e-4, "steering_delay__tau": 0.03})
    at = {time_s: trace_augmented(model, time_s) for time_s in (0.0, 300.0)}
    for time_s, formulas in at.items():
        assert "t" not in [q.name for q in formulas.states]
        assert worst_error(formulas, model, time_s) < EXACT
    assert worst_error(at[0.0], model, 300.0) > 1e-4
    with pytest.raises(UsageError, match="a clock that drifts"):
        trace_augmented(model)


def test_the_vehicle_alone_has_no_effects_of_how_it_was_measured() -> None:
    effects = {"steering_drag__k": 20.0, "marker_offset__d_x": 0.2, "pose_scale__kappa": 0.1, "clock_drift__rho": 5e-4}
    model = augmented_car(effects)
    e = export_model(model, "0" * 64, None, of_vehicle=True)
    alone = augmented_car({"steering_drag__k": 20.0})
    assert worst_error(e.formulas, alone) < EXACT
    assert np.abs(e.vectors.twists - drive_for_reference(model, e.formulas, None).twists).max() > 1e-3


@every_model
def test_the_first_state_is_that_of_a_car_whose_past_is_not_known(name: str) -> None:
    """Each kind of model is driven from its own first state by the reference; here that moves with the start."""
    e = make_export(name)
    begin = {f"{q}_0": x for q, x in zip(("p_x", "p_y", "theta"), (3.0, -1.0, 0.4), strict=True)}
    begin |= {"v_x_0": 0.8, "v_y_0": 0.1, "yaw_rate_0": -0.2, "delta_0": 0.15}
    x = dict(zip([q.name for q in e.formulas.states], evaluate(e.formulas.first_states, begin), strict=True))
    assert x["delta"] == 0.15 if "delta" in x else x["v_x"] == 0.8
    if name == "newton-euler-augmented":
        assert (x["p_x"], x["p_y"]) != (3.0, -1.0)  # the tracked point is not the CoG
        assert x["u_s_ago_1"] == 0.15


@needs_compiler
@every_model
def test_programs_of_every_model_do_what_the_model_does(name: str, tmp_path: Path) -> None:
    """Each is compiled with all warnings as errors, or run, as its user would."""
    formats = [f for f in ("c", "python", "casadi", "acados") if f in ("c", "python") or needs_casadi.args[0] is False]
    document = written(make_export(name), formats, tmp_path)
    for made in document.formats:
        assert made.error is not None, made
        assert made.error <= document.vectors.tolerance
        assert all((tmp_path / file).is_file() for file in made.files)
    assert ExportDocument.read(tmp_path / f"{document.name}.json") == document
    assert not (tmp_path / f"{document.name}_test").exists()  # the compiled test does not stay


@needs_compiler
@pytest.mark.parametrize(("format", "said"), [("c", "C"), ("python", "Python")])
def test_an_export_that_does_not_do_what_the_model_does_is_refused_and_not_written(
    format: str,  # noqa: A002
    said: str,
    tmp_path: Path,
) -> None:
    e = make_export("newton-euler")
    other = NewtonEuler(CAR._replace(m=CAR.m * (1.0 + 1e-6)), PERIOD_S, {})
    wrong = replace(e, formulas=TRACED["newton-euler"](other))
    with pytest.raises(InputRefused, match=f"export to {said}.*does not do what the model does"):
        written(wrong, [format], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_poses_are_moved_by_the_rule_by_which_predictions_are_scored(tmp_path: Path) -> None:
    from bcid.evaluation.closed_loop import integrate_poses

    e = make_export("newton-euler")
    written(e, ["python"], tmp_path)
    module, pose, twists = load_module(tmp_path / "newton_euler.py"), [1.0, 2.0, 0.5], e.vectors.twists
    for before, after in itertools.pairwise(twists):
        pose = module.move(pose, list(before), list(after))
    wanted = integrate_poses(np.array([1.0, 2.0, 0.5]), twists, PERIOD_S)[-1]
    assert np.abs(np.array(pose) - wanted).max() < 1e-12


def test_the_node_of_ros_drives_the_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    e = make_export("newton-euler")
    written(e, ["ros2"], tmp_path)
    published = stand_in_for_ros(monkeypatch)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "newton_euler", raising=False)
    node = load_module(tmp_path / "newton_euler_node.py").VehicleNode()
    node.take_command(types.SimpleNamespace(data=[0.1, 0.9]))
    node.take_command(types.SimpleNamespace(data=[float("nan"), 0.9]))
    model, carry = MODELS["newton-euler"], MODELS["newton-euler"].init(at_rest())
    for _ in range(50):
        node.advance()
        carry, twist = model.step(carry, np.array([0.1, 0.9]))
    last = published[-1].twist.twist
    assert [last.linear.x, last.linear.y, last.angular.z] == pytest.approx(list(twist), abs=1e-12)
    assert len(published) == 50
    assert published[-1].pose.pose.position.x > 0.05


def at_rest() -> History:
    return History(np.zeros((1, 3)), np.zeros((1, 4)), np.zeros((0, 1, 4)), np.zeros((1, 3)), np.zeros(1))


class Anything(types.SimpleNamespace):
    """A message: every field that is asked for is there."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        setattr(self, name, Anything())
        return self.__dict__[name]


def stand_in_for_ros(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Modules that stand for those of ROS 2; returns the list of what is published."""
    published: list[Any] = []

    class Node:
        def __init__(self, name: str) -> None:
            self.name = name

        def declare_parameter(self, name: str, value: Any) -> Any:
            return types.SimpleNamespace(value=value)

        def create_publisher(self, kind: Any, topic: str, depth: int) -> Any:
            return types.SimpleNamespace(publish=published.append)

        def create_subscription(self, *arguments: Any) -> None: ...

        def create_timer(self, *arguments: Any) -> None: ...

        def get_clock(self) -> Any:
            return types.SimpleNamespace(now=lambda: types.SimpleNamespace(to_msg=lambda: 0))

    for name, content in {
        "rclpy": {}, "rclpy.executors": {"ExternalShutdownException": KeyError}, "rclpy.node": {"Node": Node},
        "nav_msgs": {}, "nav_msgs.msg": {"Odometry": Anything}, "std_msgs": {},
        "std_msgs.msg": {"Float64MultiArray": Anything},
    }.items():  # fmt: skip
        module = types.ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
    return published


def test_a_graph_keeps_each_formula_once_and_leaves_out_what_changes_nothing() -> None:
    graph = Graph()
    x, k = graph.input("x"), graph.parameter("k", 3.0)
    assert (x + 1.0) * k is (x + 1.0) * k
    assert x + 0.0 is x
    assert 0.0 + x is x
    assert 1.0 * x is x
    assert x / 1.0 is x
    assert graph.operate("neg", -x) is x
    assert (0.0 * x).value == 0.0
    assert (k > 2.0) is True
    assert graph.operate("select", k > 2.0, x, 5.0) is x
    assert graph.operate("min", x, float("inf")) is x
    assert isinstance(k * 2.0, Node)  # a named constant stays one
    assert (k * 2.0).value == 6.0


def branching(x: float, y: float) -> tuple[float, float]:
    if x > y:
        return (x, 1.0) if y > 0.0 else (y, 2.0)
    return (x * y, 3.0)


def test_a_branch_on_an_input_is_taken_both_ways() -> None:
    graph = Graph()
    traced = Tracer(graph)
    results = traced._copy(branching)(graph.input("x"), graph.input("y"))  # type: ignore[arg-type]
    for x, y in [(2.0, 1.0), (2.0, -1.0), (1.0, 2.0)]:
        assert tuple(evaluate(tuple(results), {"x": x, "y": y})) == branching(x, y)


def test_a_condition_outside_of_a_traced_function_is_not_guessed() -> None:
    x = Graph().input("x")
    with pytest.raises(Exception, match="branch on a number that is not known"):
        bool(x > 0.0)


def test_a_car_of_flags_has_numbers_for_them_and_names_for_the_rest() -> None:
    formulas = TRACED["newton-euler"](MODELS["newton-euler"])
    names = {n.name for n in formulas.graph.nodes_for(formulas.results) if n.operation == "parameter"}
    assert {"m", "I_z", "C_f", "F_r_max"} <= names <= set(Car._fields) - {"front_share", "reverses"}
