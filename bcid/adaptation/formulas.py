"""What a filter that adapts a car needs of it, as formulas: its step, the pose that is seen, and both their slopes.

The filter's state z holds the car's states and, after these, the adapted quantities:

    z = [x, q],   x_(k+1) = f(x_k, u_k, q),   y_k = h(x_k, q)

with the slopes F = df/dz and H = dh/dz by the chain rule.  What the model lacks may last: three states d more are
accelerations that fade with the time tau_d, and drive the twist beside the model,

    v_(k+1) = f_v(x_k, u_k, q) + T d_k,   d_(k+1) = exp(-T/tau_d) d_k.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from bcid.adaptation.quantities import AdaptedQuantity
from bcid.effects.measurement import tracked_pose
from bcid.errors import UsageError
from bcid.export.augmented_formulas import BODY, name_model, trace_named_model
from bcid.export.derivatives import differentiate
from bcid.export.formulas import StepFormulas, Variable, as_nodes
from bcid.export.graph import Graph, Node
from bcid.export.substitution import substitute
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler

PUSHED = ("v_x", "v_y", "yaw_rate")
"""States that what the model lacks pushes."""
LASTING = (
    Variable("lasting_x", "m/s^2", "acceleration ahead that the model lacks"),
    Variable("lasting_y", "m/s^2", "acceleration to the left that the model lacks"),
    Variable("lasting_turn", "rad/s^2", "yaw acceleration that the model lacks"),
)
"""The states d, for each of PUSHED."""
LASTS_S = 1.0
"""tau_d (s).  On simulated drives with a real car's extras 0.5, 1 and 2 s are alike: 553, 569 and 558 nats beside
pushes that do not last, over the first minutes of ten drives."""


class AdaptiveFormulas(NamedTuple):
    """The formulas of an adapted car; inputs are called as the states, the commands and the adapted quantities."""

    period_s: float
    wheelbase_m: float
    states: tuple[Variable, ...]
    quantities: tuple[AdaptedQuantity, ...]
    next_states: tuple[Node, ...]  # f
    slopes: tuple[tuple[Node, ...], ...]  # F (n, n + k), a row for each state
    pose: tuple[Node, ...]  # h, the tracked pose
    pose_slopes: tuple[tuple[Node, ...], ...]  # H (3, n + k)
    first_states: tuple[Node, ...]  # from pose, twist and steering angle
    first_slopes: tuple[tuple[Node, ...], ...]  # G (n, k), of the first states by the quantities


def trace_adaptive(model: AugmentedNewtonEuler, quantities: Sequence[AdaptedQuantity]) -> AdaptiveFormulas:
    """The formulas of a car whose `quantities` are adapted; effects among these are switched on in it.

    Raises:
        UsageError: a quantity changes nothing of the car, or its poses' clock drifts.
    """
    named = name_model(model)
    graph, tracer = named.tracer.graph, named.tracer
    step = trace_named_model(named, model)
    body = [graph.input(quantity.name) for quantity in BODY]
    seen = as_nodes(graph, tracer.trace(tracked_pose)(*body[:3], named.switches))
    inputs = _quantity_inputs(step, seen, quantities)
    replaced = substitute([*step.next_states, *seen, *step.first_states], inputs)
    n = len(step.states)
    after, seen, first = tuple(replaced[:n]), tuple(replaced[n : n + 3]), tuple(replaced[n + 3 :])
    after = _add_lasting(graph, step.states, after, model.period_s)
    states, first = (*step.states, *LASTING), (*first, *(graph.as_node(0.0) for _ in LASTING))
    followed = [graph.input(quantity.symbol) for quantity in quantities]
    by = [*(graph.input(state.name) for state in states), *followed]
    return AdaptiveFormulas(
        model.period_s, model.car.l_f + model.car.l_r, states, tuple(quantities), after,
        tuple(map(tuple, differentiate(after, by))), seen, tuple(map(tuple, differentiate(seen, by))), first,
        tuple(map(tuple, differentiate(first, followed))),
    )  # fmt: skip


def _add_lasting(
    graph: Graph, states: Sequence[Variable], after: Sequence[Node], period_s: float
) -> tuple[Node, ...]:  # fmt: skip
    """The states after a period, driven by what lasts, and after them the states d."""
    d: dict[str, Any] = {pushed: graph.input(lasting.name) for pushed, lasting in zip(PUSHED, LASTING, strict=True)}
    driven = [
        graph.as_node(x + period_s * d[state.name]) if state.name in d else x
        for state, x in zip(states, after, strict=True)
    ]
    return (*driven, *(graph.as_node(math.exp(-period_s / LASTS_S) * each) for each in d.values()))


def _quantity_inputs(
    step: StepFormulas, seen: Sequence[Node], quantities: Sequence[AdaptedQuantity]
) -> list[tuple[Node, Node]]:
    """Each named constant that a quantity changes, with what stands for it: an input, or its product with the constant.

    Raises:
        UsageError: no formula depends on a constant that is to be adapted.
    """
    graph = step.graph
    constants = {
        node.name: node for node in graph.nodes_for([*step.next_states, *seen]) if node.operation == "parameter"
    }
    inputs = []
    for quantity in quantities:
        known = [constants[c] for c in quantity.constants if c in constants]
        if not known:
            raise UsageError(f"{quantity.name}: no motion of this car depends on it\n  next: adapt something else")
        value: Any = graph.input(quantity.symbol)
        for node in known:
            inputs.append((node, graph.as_node(value * float(node)) if quantity.is_factor else value))
    return inputs
