"""Formulas as graphs: numbers that remember how they were computed, for printers to write in another language.

A node is an input, a named constant, a number, or an operation on other nodes.  Two nodes of the same operation on the
same arguments are one, so that what equations have in common is computed once.  Operations on numbers are carried out,
and those that change nothing are left out: x + 0, x - 0, 1 x, 0 x.  These are exact for finite numbers, but for the
sign of a zero.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

OPERATIONS: dict[str, Callable[..., Any]] = {
    "add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv, "neg": operator.neg,
    "abs": abs, "min": min, "max": max, "floor": math.floor, "sqrt": math.sqrt, "exp": math.exp, "sin": math.sin,
    "cos": math.cos, "atan": math.atan, "atan2": math.atan2, "tanh": math.tanh, "hypot": math.hypot,
    "copysign": math.copysign,
    "lt": operator.lt, "le": operator.le, "gt": operator.gt, "ge": operator.ge, "eq": operator.eq, "ne": operator.ne,
    "and": operator.and_, "or": operator.or_, "select": lambda condition, a, b: a if condition else b,
}  # fmt: skip
"""What a node may be computed by, on numbers; truth values come from the comparisons, `and` and `or`."""

TRUTHS = frozenset({"lt", "le", "gt", "ge", "eq", "ne", "and", "or"})
"""Operations whose result is a truth value."""


class UndecidedBranch(Exception):
    """A function asks whether a condition holds that depends on inputs; whoever runs it must try both answers."""

    def __init__(self, condition: Node) -> None:
        super().__init__("a branch on a number that is not known")
        self.condition = condition


@dataclass(eq=False, repr=False)
class Graph:
    """The nodes of some formulas, each once, in the order in which they were made: arguments come first."""

    nodes: list[Node] = field(default_factory=list)
    kept: dict[tuple[Any, ...], Node] = field(default_factory=dict)
    answers: list[bool] | None = None  # to conditions that a function will ask for, in order; None where none may

    def input(self, name: str) -> Node:
        """The input `name`, whose value is not known."""
        return self._keep(("input", name), "input", (), None, name)

    def parameter(self, name: str, value: float) -> Node:
        """The named constant `name`: conditions on it are decided by its `value`, and it is printed by its name."""
        return self._keep(("parameter", name), "parameter", (), float(value), name)

    def constant(self, value: float) -> Node:
        """The number `value`; zeros of either sign are one."""
        value = float(value) + 0.0
        return self._keep(("constant", repr(value)), "constant", (), value, "")

    def network_output(self, network: str, inputs: tuple[Node, ...], output: int) -> Node:
        """Output number `output` of the perceptron `network` at `inputs`."""
        name = f"{network}[{output}]"
        return self._keep(("network", name, *map(id, inputs)), "network", inputs, None, name)

    def as_node(self, number: Node | float) -> Node:
        """`number` as a node of this graph."""
        return number if isinstance(number, Node) else self.constant(number)

    def operate(self, operation: str, *operands: Node | float) -> Node | float | bool:
        """The `operation` on `operands`: a number where all are numbers, a truth value where it can be decided."""
        if not any(isinstance(operand, Node) for operand in operands):
            result: float | bool = OPERATIONS[operation](*operands)
            return result
        if operation in ("and", "or"):
            return self._combine_conditions(operation, *operands)
        if operation == "select":
            condition, a, b = operands
            if not isinstance(condition, Node) or condition.value is not None:
                return a if condition else b
            return a if a is b else self._make(operation, condition, self.as_node(a), self.as_node(b))
        nodes = tuple(self.as_node(operand) for operand in operands)
        values = [node.value for node in nodes]
        if operation in TRUTHS and None not in values:
            return bool(OPERATIONS[operation](*values))
        if all(node.operation == "constant" for node in nodes):
            return self.constant(OPERATIONS[operation](*values))
        simpler = _leave_out(operation, nodes)
        return self._make(operation, *nodes) if simpler is None else simpler

    def _combine_conditions(self, operation: str, a: Node | float, b: Node | float) -> Node | float | bool:
        """`a` and `b`, or `a` or `b`, of which one at least is a node."""
        known, other = (a, b) if not isinstance(a, Node) else (b, a)
        if isinstance(known, Node):
            return self._make(operation, self.as_node(a), self.as_node(b))
        return other if bool(known) == (operation == "and") else bool(known)

    def _make(self, operation: str, *nodes: Node) -> Node:
        """The node of an operation on nodes, made once."""
        values = [node.value for node in nodes]
        value = None if None in values else OPERATIONS[operation](*values)
        return self._keep((operation, *map(id, nodes)), operation, nodes, value, "")

    def _keep(
        self, key: tuple[Any, ...], operation: str, arguments: tuple[Node, ...], value: float | None, name: str
    ) -> Node:
        """The node under `key`, made where it is asked for first."""
        if key not in self.kept:
            self.kept[key] = Node(self, len(self.nodes), operation, arguments, value, name)
            self.nodes.append(self.kept[key])
        return self.kept[key]

    def nodes_for(self, results: Iterable[Node]) -> list[Node]:
        """The nodes that `results` are computed from, themselves among them; arguments come first."""
        found: set[int] = set()
        ahead = list(results)
        while ahead:
            node = ahead.pop()
            if node.place not in found:
                found.add(node.place)
                ahead.extend(node.arguments)
        return [self.nodes[place] for place in sorted(found)]


@dataclass(frozen=True, eq=False, repr=False, slots=True)
class Node:
    """A number, or a truth value, in formulas: what it is computed by, and from what."""

    graph: Graph
    place: int  # among the graph's nodes
    operation: str  # of OPERATIONS, or "input", "parameter", "constant", "network"
    arguments: tuple[Node, ...]
    value: float | None  # where it depends on no input
    name: str  # of an input, a named constant, or an output of a network

    __array_priority__ = 1000.0  # numbers of numpy leave an operation to us

    def __repr__(self) -> str:
        """What computes the node, and from which nodes, but not what computes those."""
        return f"<{self.place}: {self.operation} {self.name or [a.place for a in self.arguments]}>"

    def __bool__(self) -> bool:
        """The truth of a condition: known, or the next of the answers that are to be tried.

        Raises:
            UndecidedBranch: it depends on inputs, and no answer is left.
        """
        if self.value is not None:
            return bool(self.value)
        if not self.graph.answers:
            raise UndecidedBranch(self)
        return self.graph.answers.pop(0)

    def __float__(self) -> float:
        """The value of a node that depends on no input.

        Raises:
            TypeError: it depends on inputs.
        """
        if self.value is None:
            raise TypeError("a number that depends on inputs is not known yet")
        return float(self.value)

    def __neg__(self) -> Any:
        return self.graph.operate("neg", self)

    def __abs__(self) -> Any:
        return self.graph.operate("abs", self)

    def __eq__(self, other: object) -> Any:
        return self.graph.operate("eq", self, other)  # type: ignore[arg-type]  # numbers and nodes

    def __ne__(self, other: object) -> Any:
        return self.graph.operate("ne", self, other)  # type: ignore[arg-type]

    def sin(self) -> Any:
        """The sine, by the name under which numpy asks the elements of an array for it."""
        return self.graph.operate("sin", self)

    def cos(self) -> Any:
        """The cosine, by the name under which numpy asks the elements of an array for it."""
        return self.graph.operate("cos", self)

    def __mod__(self, other: Any) -> Any:
        """The remainder of a division, of the sign of `other`, as Python has it."""
        return self - self.graph.operate("floor", self / other) * other

    __hash__ = object.__hash__


def _install_operators() -> None:
    """Give `Node` Python's operators on two numbers."""
    for operation in ("add", "sub", "mul", "truediv", "lt", "le", "gt", "ge", "and", "or"):
        name = {"truediv": "div"}.get(operation, operation)
        setattr(Node, f"__{operation}__", lambda a, b, name=name: a.graph.operate(name, a, b))
        if name not in TRUTHS or name in ("and", "or"):
            setattr(Node, f"__r{operation}__", lambda a, b, name=name: a.graph.operate(name, b, a))


_install_operators()


def _leave_out(operation: str, nodes: tuple[Node, ...]) -> Node | float | None:
    """What `operation` on `nodes` comes to where it changes nothing; None where it must be carried out."""
    a, b = nodes[0], nodes[-1]
    x, y = (node.value if node.operation == "constant" else None for node in (a, b))
    graph = a.graph
    match operation:
        case "neg" if a.operation == "neg":
            return a.arguments[0]
        case "add" if y == 0.0:
            return a
        case "add" if x == 0.0:
            return b
        case "sub" if y == 0.0:
            return a
        case "sub" if x == 0.0:
            return graph.operate("neg", b)
        case "mul" if 0.0 in (x, y):
            return graph.constant(0.0)
        case "mul" | "div" if y == 1.0:
            return a
        case "mul" if x == 1.0:
            return b
        case "div" if x == 0.0:
            return graph.constant(0.0)
        case "min" | "max" if a is b:
            return a
        case "min" | "max" if y == {"min": math.inf, "max": -math.inf}[operation]:
            return a
    return None
