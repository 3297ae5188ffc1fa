"""Tapes give what their formulas say, and named constants can be made inputs."""

from __future__ import annotations

import numpy as np
import pytest

from bcid.export.graph import OPERATIONS, Graph, Node
from bcid.export.substitution import substitute
from bcid.export.tape import CODES, record_tape, run_tape

PAIRS = [(0.3, 0.7), (-1.4, 0.2), (1.2, -0.8), (0.9, 0.9), (0.0, -2.0)]


def run(results: list[Node], **inputs: float) -> np.ndarray:
    """The results at some inputs."""
    tape, out = record_tape(results, list(inputs)), np.empty(len(results))
    run_tape(tape, np.array(list(inputs.values())), tape.start.copy(), out)
    return out


def test_every_operation_has_a_code() -> None:
    assert set(CODES) == set(OPERATIONS)


@pytest.mark.parametrize("operation", sorted(set(OPERATIONS) - {"select", "and", "or"}))
@pytest.mark.parametrize(("x", "y"), PAIRS)
def test_an_operation_is_that_of_numbers(operation: str, x: float, y: float) -> None:
    one = operation in ("neg", "abs", "floor", "sqrt", "exp", "sin", "cos", "atan", "tanh")
    x = abs(x) if operation == "sqrt" else x
    graph = Graph()
    a, b = graph.input("a"), graph.input("b")
    result = graph.operate(operation, *(a, b)[: 1 if one else 2])
    assert isinstance(result, Node)
    expected = float(OPERATIONS[operation](*(x, y)[: 1 if one else 2]))
    assert run([result], a=x, b=y)[0] == pytest.approx(expected, rel=1e-15, abs=0.0)


@pytest.mark.parametrize(("x", "y"), [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)])
def test_conditions_are_joined_and_select(x: float, y: float) -> None:
    graph = Graph()
    a, b = graph.input("a"), graph.input("b")
    is_a, is_b = a > 0.0, b > 0.0
    both, either = (graph.operate("select", c, 10.0, 20.0) for c in (is_a & is_b, is_a | is_b))
    out = run([both, either], a=x, b=y)  # type: ignore[list-item]  # nodes
    assert out.tolist() == [10.0 if x > 0 and y > 0 else 20.0, 10.0 if x > 0 or y > 0 else 20.0]


def test_results_may_be_inputs_and_constants_and_inputs_idle() -> None:
    graph = Graph()
    a = graph.input("a")
    assert run([a, graph.constant(4.0), a + 1.0], a=2.0, idle=7.0).tolist() == [2.0, 4.0, 3.0]


def test_an_unknown_input_is_refused() -> None:
    with pytest.raises(ValueError, match="no input is called b"):
        record_tape([Graph().input("b")], ["a"])


def test_a_named_constant_becomes_an_input() -> None:
    graph = Graph()
    a, m = graph.input("a"), graph.parameter("m", 4.0)
    y = graph.as_node(a / m + m * m)
    (anew,) = substitute([y], [(m, graph.as_node(graph.input("share") * 4.0))])
    assert run([anew], a=2.0, share=0.5)[0] == 2.0 / 2.0 + 4.0
    assert substitute([y], [])[0] is y
