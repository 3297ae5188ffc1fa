"""Formulas with some of their numbers replaced by others, such as a named constant by an input."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bcid.export.graph import Node


def substitute(results: Sequence[Node], pairs: Sequence[tuple[Node, Node]]) -> list[Node]:
    """The `results` with the first node of each of `pairs` replaced by the second, as nodes of the same graph.

    What a trace decided by the value of a named constant stays decided.
    """
    graph = results[0].graph
    anew: dict[int, Any] = {old.place: new for old, new in pairs}
    for node in graph.nodes_for(results):
        if node.place in anew:
            continue
        changed = any(anew[argument.place] is not argument for argument in node.arguments)
        arguments = tuple(anew[argument.place] for argument in node.arguments)
        if not changed:
            anew[node.place] = node
        elif node.operation == "network":
            network, _, output = node.name.partition("[")
            inputs = tuple(graph.as_node(argument) for argument in arguments)
            anew[node.place] = graph.network_output(network, inputs, int(output.rstrip("]")))
        else:
            anew[node.place] = graph.operate(node.operation, *arguments)
    return [graph.as_node(anew[result.place]) for result in results]
