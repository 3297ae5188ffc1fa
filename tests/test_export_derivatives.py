"""Derivatives of formulas: of every operation against differences, and of whole models."""

from __future__ import annotations

import numpy as np
import pytest

from bcid.export.derivatives import FLAT, PARTIALS, differentiate
from bcid.export.graph import OPERATIONS, Graph, Node

POINTS = [(0.3, 0.7), (-0.4, 0.2), (1.2, -0.8), (0.9, 0.1)]


def evaluate(node: Node, values: dict[str, float]) -> float:
    """The value of a node where the inputs have `values`."""
    known: dict[int, float] = {}
    for each in node.graph.nodes_for([node]):
        if each.operation == "input":
            known[each.place] = values[each.name]
        elif each.operation in ("constant", "parameter"):
            known[each.place] = values.get(each.name, each.value or 0.0)
        else:
            known[each.place] = OPERATIONS[each.operation](*(known[a.place] for a in each.arguments))
    return float(known[node.place])


def test_every_operation_has_its_partial_derivatives() -> None:
    assert set(PARTIALS) | set(FLAT) | {"select", "network"} >= set(OPERATIONS)


@pytest.mark.parametrize("operation", sorted(PARTIALS))
@pytest.mark.parametrize("point", POINTS)
def test_partial_derivatives_are_those_of_differences(operation: str, point: tuple[float, float]) -> None:
    graph = Graph()
    a, b = graph.input("a"), graph.input("b")
    count = PARTIALS[operation].__code__.co_argcount - 2
    first = a * a + 0.5 if operation == "sqrt" else a
    y = graph.operate(operation, *(first, b)[:count])
    assert isinstance(y, Node)
    slopes = differentiate([y], [a, b])[0]
    at, h = dict(zip("ab", point, strict=True)), 1e-6
    for name, slope in zip("ab", slopes, strict=True):
        ahead, behind = (evaluate(y, at | {name: at[name] + step}) for step in (h, -h))
        assert evaluate(slope, at) == pytest.approx((ahead - behind) / (2.0 * h), abs=1e-8)


def test_a_selection_has_the_slope_of_the_side_it_takes() -> None:
    graph = Graph()
    a = graph.input("a")
    y = graph.operate("select", graph.operate("gt", a, 0.0), a * a, -a)
    slope = differentiate([y], [a])[0][0]  # type: ignore[list-item]  # a node
    assert evaluate(slope, {"a": 3.0}) == 6.0
    assert evaluate(slope, {"a": -3.0}) == -1.0


def test_singular_points_have_no_slope_and_no_division_by_zero() -> None:
    graph = Graph()
    a, b = graph.input("a"), graph.input("b")
    for operation, operands in (("sqrt", (a * a,)), ("hypot", (a, b)), ("atan2", (a, b))):
        y = graph.operate(operation, *operands)
        assert isinstance(y, Node)
        for slope in differentiate([y], [a, b])[0]:
            assert np.isfinite(evaluate(slope, {"a": 0.0, "b": 0.0}))


def test_what_does_not_depend_on_an_input_has_no_slope() -> None:
    graph = Graph()
    a, b = graph.input("a"), graph.input("b")
    slope = differentiate([graph.as_node(a * 2.0)], [b])[0][0]
    assert slope.operation == "constant"
    assert slope.value == 0.0


def test_named_constants_can_be_varied_too() -> None:
    graph = Graph()
    a, k = graph.input("a"), graph.parameter("k", 3.0)
    slope = differentiate([graph.as_node(a * a * k)], [k])[0][0]
    assert evaluate(slope, {"a": 2.0}) == 4.0
