"""Derivatives of formulas by the chain rule, as formulas of the same graph.

For each operation y = f(a, b, ...) stand its partial derivatives; a node's derivative is their sum, each times the
derivative of its argument (forward mode: Griewank and Walther, Evaluating Derivatives, 2008, chapter 3).  Where a
formula has a kink, `min`, `max`, `abs` or a selection, the derivative is that of the side on which the formula is
evaluated; of steps, `floor` and comparisons, it is 0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bcid.export.graph import TRUTHS, Graph, Node

Number = Any
"""A node, or a number where all that it depends on is known."""

FLAT = TRUTHS | {"input", "parameter", "constant", "floor"}
"""Operations whose result does not vary with their arguments, or that have none."""


def differentiate(results: Sequence[Node], by: Sequence[Node]) -> list[list[Node]]:
    """The derivatives (m, n) of m `results` by n inputs or named constants, as nodes of their graph.

    Raises:
        ValueError: a result is computed by a network, which has no formula to differentiate.
    """
    graph = results[0].graph
    nodes = graph.nodes_for(results)
    columns = [_derivatives_by(nodes, graph, one) for one in by]
    zero = graph.constant(0.0)
    return [[graph.as_node(column.get(result.place, zero)) for column in columns] for result in results]


def _derivatives_by(nodes: Sequence[Node], graph: Graph, one: Node) -> dict[int, Number]:
    """The derivatives of `nodes`, arguments first, by the node `one`, by their places; 0 where a place is missing."""
    slopes: dict[int, Number] = {one.place: 1.0}
    for node in nodes:
        moving = [i for i, argument in enumerate(node.arguments) if argument.place in slopes]
        if not moving or node.operation in FLAT:
            continue
        if node.operation == "network":
            raise ValueError("a network has no formula to differentiate")
        slope = _slope_of(graph, node, slopes)
        if not _is_zero(slope):
            slopes[node.place] = slope
    return slopes


def _slope_of(graph: Graph, node: Node, slopes: Mapping[int, Number]) -> Number:
    """The derivative of a node from those of its arguments."""
    if node.operation == "select":
        condition, *sides = node.arguments
        holds, fails = (slopes.get(side.place, 0.0) for side in sides)
        return graph.operate("select", condition, holds, fails)
    total: Number = 0.0
    for i, argument in enumerate(node.arguments):
        if argument.place in slopes:
            total = total + PARTIALS[node.operation](graph, node, *node.arguments)[i] * slopes[argument.place]
    return total


def _is_zero(number: Number) -> bool:
    """Whether a number is known to be 0, whatever the inputs are."""
    return number == 0.0 if not isinstance(number, Node) else number.operation == "constant" and number.value == 0.0


def _of_smaller(graph: Graph, y: Number, a: Number, b: Number) -> tuple[Number, Number]:
    """The partial derivatives of the smaller of two numbers; of equal ones the first, as Python's `min` has it."""
    first: Number = graph.operate("select", graph.operate("le", a, b), 1.0, 0.0)
    return first, 1.0 - first


def _of_larger(graph: Graph, y: Number, a: Number, b: Number) -> tuple[Number, Number]:
    """The partial derivatives of the larger of two numbers; of equal ones the first, as Python's `max` has it."""
    first: Number = graph.operate("select", graph.operate("ge", a, b), 1.0, 0.0)
    return first, 1.0 - first


def _of_root(graph: Graph, y: Number, a: Number) -> tuple[Number]:
    """The derivative of a square root, 0 at zero, where it has none."""
    return (graph.operate("select", graph.operate("gt", y, 0.0), 0.5, 0.0) / _nonzero(graph, y),)


def _of_hypotenuse(graph: Graph, y: Number, a: Number, b: Number) -> tuple[Number, Number]:
    """The partial derivatives of sqrt(a^2 + b^2), 0 at its tip, where it has none."""
    length = _nonzero(graph, y)
    return a / length, b / length


def _of_direction(graph: Graph, y: Number, a: Number, b: Number) -> tuple[Number, Number]:
    """The partial derivatives of atan2(a, b), 0 at the origin, where it has none."""
    square = _nonzero(graph, a * a + b * b)
    return b / square, -a / square


def _nonzero(graph: Graph, length: Number) -> Number:
    """A length as a divisor: 1 in place of 0."""
    return graph.operate("select", graph.operate("gt", length, 0.0), length, 1.0)


def _sign(graph: Graph, a: Number) -> Number:
    """The sign of a number, 1 or -1."""
    return graph.operate("copysign", 1.0, a)


PARTIALS: dict[str, Callable[..., tuple[Number, ...]]] = {
    "add": lambda graph, y, a, b: (1.0, 1.0),
    "sub": lambda graph, y, a, b: (1.0, -1.0),
    "mul": lambda graph, y, a, b: (b, a),
    "div": lambda graph, y, a, b: (1.0 / b, -y / b),
    "neg": lambda graph, y, a: (-1.0,),
    "abs": lambda graph, y, a: (_sign(graph, a),),
    "min": _of_smaller,
    "max": _of_larger,
    "sqrt": _of_root,
    "exp": lambda graph, y, a: (y,),
    "sin": lambda graph, y, a: (graph.operate("cos", a),),
    "cos": lambda graph, y, a: (-graph.operate("sin", a),),
    "atan": lambda graph, y, a: (1.0 / (1.0 + a * a),),
    "atan2": _of_direction,
    "tanh": lambda graph, y, a: (1.0 - y * y,),
    "hypot": _of_hypotenuse,
    "copysign": lambda graph, y, a, b: (_sign(graph, a) * _sign(graph, b), 0.0),
}
"""The partial derivatives of y by its arguments a and b, by operation, from the graph, y, a and b."""
