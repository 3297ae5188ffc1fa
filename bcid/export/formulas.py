"""One period of a fitted model as formulas: the state after it and the twist there, from a state and a command."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from bcid.export.graph import Graph, Node
from bcid.export.trace import Tracer
from bcid.models.network.mlp import MlpWeights


class Variable(NamedTuple):
    """A number that a formula takes or gives."""

    name: str
    unit: str
    meaning: str

    def describe(self) -> str:
        """Name, unit in brackets and meaning, for a line of a comment."""
        return f"{self.name:14} {self.unit and f'({self.unit}) '}{self.meaning}"


COMMANDS = (
    Variable("u_s", "rad", "steering command, left positive"),
    Variable(
        "u_m", "", "throttle: a reference speed in m/s, or a share of full force; below zero it brakes or reverses"
    ),
)
CENTRE_OF_GRAVITY = "centre of gravity"
"""The point that quantities are of where their meaning says so."""
TWIST = (
    Variable("v_x", "m/s", "velocity ahead"),
    Variable("v_y", "m/s", "velocity to the left"),
    Variable("yaw_rate", "rad/s", "yaw rate, counter-clockwise"),
)
POSE = (
    Variable("p_x", "m", "position in the world"),
    Variable("p_y", "m", "position in the world"),
    Variable("theta", "rad", "yaw, counter-clockwise"),
)
STEERED = Variable("delta", "rad", "steering angle, left positive")

START = tuple(q._replace(name=f"{q.name}_0") for q in (*POSE, *TWIST, STEERED))
"""Pose, twist and steering angle, from which a first state is made where the past is not known."""


@dataclass(frozen=True)
class StepFormulas:
    """The formulas of one model.  Nodes are of `graph`, whose inputs are called as the states, commands and `START`."""

    graph: Graph
    period_s: float
    states: tuple[Variable, ...]
    next_states: tuple[Node, ...]
    twist: tuple[Node, ...]  # after the period
    first_states: tuple[Node, ...]  # from pose, twist and steering angle: a car that coasts, its wheel held
    networks: Mapping[str, MlpWeights]

    @property
    def results(self) -> tuple[Node, ...]:
        """All nodes of a step."""
        return (*self.next_states, *self.twist)

    def without_idle_states(self, wanted: Sequence[str] = ()) -> StepFormulas:
        """The formulas without the states on which neither the twist nor a state of those `wanted` ever depends."""
        names = [state.name for state in self.states]
        kept, ahead = set(wanted), [*self.twist, *(self.next_states[names.index(name)] for name in wanted)]
        while ahead:
            asked = {n.name for n in self.graph.nodes_for(ahead) if n.operation == "input"} & set(names) - kept
            kept |= asked
            ahead = [self.next_states[names.index(name)] for name in asked]
        places = [i for i, name in enumerate(names) if name in kept]
        return replace(
            self,
            states=tuple(self.states[i] for i in places),
            next_states=tuple(self.next_states[i] for i in places),
            first_states=tuple(self.first_states[i] for i in places),
        )


def periods_ago(k: int) -> str:
    """`k` periods ago, in words."""
    return f"{k} period{'' if k == 1 else 's'} ago"


def name_constants(graph: Graph, values: Mapping[str, float], plain: Sequence[str] = ()) -> dict[str, Any]:
    """`values` as named constants of `graph`; those called `plain`, and zeros, on which the structure hangs, stay."""
    return {
        name: value if name in plain or value == 0.0 else graph.parameter(name, value) for name, value in values.items()
    }


def trace_scan(
    model: Any,
    tracer: Tracer,
    states: Sequence[Variable],
    begin: Callable[[dict[str, Node]], Sequence[Any]],
    arguments: Sequence[Any],
    networks: Mapping[str, MlpWeights],
) -> StepFormulas:
    """The formulas of one period of `model`, by the compiled scan of its class, which keeps the `states` in its carry.

    The scan takes `arguments` beside carry and commands.  `begin` gives the first state from the nodes of `START` by
    name.
    """
    graph = tracer.graph
    carry = np.array([graph.input(state.name) for state in states], object)
    parts = np.array([[[model.period_s, *(graph.input(command.name) for command in COMMANDS), 0.0]]], object)
    twists = tracer.trace(model.kernels.scan)(carry, parts, *arguments)
    first = begin({quantity.name: graph.input(quantity.name) for quantity in START})
    return StepFormulas(
        graph, model.period_s, tuple(states), as_nodes(graph, carry), as_nodes(graph, twists[0]),
        as_nodes(graph, first), networks,
    )  # fmt: skip


def as_nodes(graph: Graph, numbers: Iterable[Any]) -> tuple[Node, ...]:
    """`numbers`, some of them nodes already, as nodes of `graph`."""
    return tuple(graph.as_node(number) for number in numbers)
