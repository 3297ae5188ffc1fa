"""The formulas of each kind of model: its own compiled step, traced over its states and commands."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from bcid.export.formulas import STEERED, TWIST, StepFormulas, Variable, name_constants, periods_ago, trace_scan
from bcid.export.graph import Graph, Node
from bcid.export.start import slips_at_start
from bcid.export.trace import Tracer
from bcid.models.kinematic.state import KinematicCar
from bcid.models.network import mlp
from bcid.models.network.mlp import MlpBuffers, MlpWeights
from bcid.physics.car import Car

FLAGS = ("front_share", "sets_force", "reverses", "follows_wheel", "follow")
"""Constants of a car that choose among laws."""

BODY_STATES = (*TWIST, STEERED)
KINEMATIC_STATES = (
    Variable("v_f", "m/s", "speed of the front wheel"),
    Variable("alpha_f", "rad", "slip angle of the front wheel"),
    Variable("alpha_r", "rad", "slip angle of the rear wheels"),
    STEERED,
)


def trace_newton_euler(model: Any) -> StepFormulas:
    """The formulas of a Newton-Euler car, its state [v_x, v_y, yaw rate, delta]."""
    tracer = Tracer(Graph())
    car, longest = model.kernel_arguments
    named = Car(**name_constants(tracer.graph, car._asdict(), FLAGS))
    return trace_scan(model, tracer, BODY_STATES, _begin_body, (named, longest), {})


def trace_linear(model: Any) -> StepFormulas:
    """The formulas of a linearised car, its state [v_x, v_y, yaw rate, delta]."""
    return trace_scan(model, Tracer(Graph()), BODY_STATES, _begin_body, model.kernel_arguments, {})


def trace_k_sindy(model: Any) -> StepFormulas:
    """The formulas of a K-SINDy, its state [v_f, alpha_f, alpha_r, delta]."""
    tracer = Tracer(Graph())
    sparse, car = model.kernel_arguments
    return trace_scan(model, tracer, KINEMATIC_STATES, _begin_kinematic(tracer, car), (sparse, car), {})


def trace_k_mlp(model: Any) -> StepFormulas:
    """The formulas of a K-MLP or a K-SINDy-MLP, its state [v_f, alpha_f, alpha_r, delta]."""
    tracer, networks = _with_network(model.weights)
    return trace_scan(
        model, tracer, KINEMATIC_STATES, _begin_kinematic(tracer, model.car), model.kernel_arguments, networks
    )


def trace_narx_mlp(model: Any) -> StepFormulas:
    """The formulas of a NARX-MLP, its state the last three twists, newest first, and the two commands before."""
    tracer, networks = _with_network(model.weights)
    twists = [
        Variable(f"{q.name}{_ago(k)}", q.unit, q.meaning + (f", {periods_ago(k)}" if k else ""))
        for k in range(3)
        for q in TWIST
    ]
    commands = [
        Variable(f"{name}{_ago(k)}", unit, f"command {periods_ago(k)}")
        for k in (1, 2)
        for name, unit in (("u_s", "rad"), ("u_m", ""))
    ]

    def begin(start: dict[str, Node]) -> list[Any]:
        return [*3 * [start[f"{q.name}_0"] for q in TWIST], *2 * [start[f"{STEERED.name}_0"], 0.0]]

    return trace_scan(model, tracer, (*twists, *commands), begin, model.kernel_arguments, networks)


def _ago(k: int) -> str:
    """What is appended to the name of a quantity `k` periods ago."""
    return f"_ago_{k}" if k else ""


def _begin_body(start: dict[str, Node]) -> list[Node]:
    """The first state [v_x, v_y, yaw rate, delta]."""
    return [start[f"{quantity.name}_0"] for quantity in BODY_STATES]


def _begin_kinematic(tracer: Tracer, car: KinematicCar) -> Callable[[dict[str, Node]], list[Any]]:
    """What gives the first state [v_f, alpha_f, alpha_r, delta] of a kinematic model of `car`."""

    def begin(start: dict[str, Node]) -> list[Any]:
        v_x, v_y, yaw_rate, delta = _begin_body(start)
        return [*tracer.trace(slips_at_start)(v_x, v_y, yaw_rate, delta, car.l_f, car.l_r), delta]

    return begin


def _with_network(weights: MlpWeights) -> tuple[Tracer, dict[str, MlpWeights]]:
    """A tracer for which a perceptron is one operation, and its weights by the name of that."""
    graph = Graph()

    def evaluate(buffers: MlpBuffers, _weights: MlpWeights) -> None:
        inputs = tuple(graph.as_node(x) for x in buffers.x)
        for i in range(len(buffers.y)):
            buffers.y[i] = graph.network_output("network", inputs, i)

    return Tracer(graph, {mlp.evaluate_mlp: evaluate}), {"network": weights}


TRACED: dict[str, Callable[[Any], StepFormulas]] = {
    "newton-euler": trace_newton_euler,
    "newton-euler-linear": trace_linear,
    "narx-mlp": trace_narx_mlp,
    "k-mlp": trace_k_mlp,
    "k-sindy": trace_k_sindy,
    "k-sindy-mlp": trace_k_mlp,
}
"""How the formulas of a model are found, by its name."""
