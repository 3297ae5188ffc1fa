"""Compiled functions run over nodes in place of numbers, so that what they compute can be printed elsewhere.

The plain Python of a compiled function is made anew with the mathematics it names replaced: `math`, `min`, `where` and
the like by operations on nodes, numpy's arrays by such as hold nodes, and every function that it calls by one that is
traced in turn.  No equation is written a second time.  A branch on a number that depends on inputs is taken both ways,
and the two results are joined by a selection.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from types import FunctionType, ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from bcid.compiled import lanes
from bcid.export.graph import Graph, Node, UndecidedBranch
from bcid.physics import elementary

PACKAGE = "bcid"
"""Functions of other packages are called as they are."""


_OF_MATH = ("sqrt", "exp", "sin", "cos", "atan", "atan2", "tanh", "hypot", "copysign")
"""Functions of `math` that compiled functions name."""


class Tracer:
    """Traced copies of compiled functions, for one graph."""

    def __init__(
        self, graph: Graph, replaced: Mapping[Any, Any] | None = None, values: Mapping[str, Any] | None = None
    ) -> None:
        """`replaced` maps further compiled functions to what is called in their place, `values` names to numbers."""
        self.graph = graph
        self.copies: dict[int, Callable[..., Any]] = {}
        self.kept_alive: list[Any] = []
        self.names = _mathematics(graph) | dict(values or {})
        for function, stand_in in (_functions_by_nodes(graph) | dict(replaced or {})).items():
            self.copies[id(_plain(function))] = stand_in

    def trace(self, function: Any) -> Callable[..., Any]:
        """The compiled `function`, or a plain one of this package, as one that takes and returns nodes and numbers."""
        plain = _plain(function)
        if id(plain) not in self.copies:
            self.kept_alive.append(plain)  # an id is another object's once its own is gone
            self.copies[id(plain)] = self._copy(plain)
        return self.copies[id(plain)]

    def _copy(self, plain: FunctionType) -> Callable[..., Any]:
        """A copy of `plain` that sees traced functions and the mathematics of nodes under the names it uses."""
        code, globals_ = plain.__code__, plain.__globals__
        seen = {
            **globals_,
            **{name: self._seen_by(x) for name in code.co_names if (x := globals_.get(name)) is not None},
        }
        copy = FunctionType(code, seen | self.names, plain.__name__, plain.__defaults__, plain.__closure__)
        copy.__kwdefaults__ = plain.__kwdefaults__
        return lambda *arguments, **named: self._take_both_ways(copy, arguments, named, [])

    def _seen_by(self, thing: Any) -> Any:
        """What a traced function finds in place of `thing`, a global of its module."""
        if isinstance(thing, ModuleType) and thing.__name__.startswith(PACKAGE):
            return _TracedModule(self, thing)
        return self.trace(thing) if _is_traceable(thing) else thing

    def _take_both_ways(
        self, function: Callable[..., Any], arguments: tuple[Any, ...], named: Mapping[str, Any], answers: list[bool]
    ) -> Any:
        """What `function` returns after the `answers` to its first conditions, of all that come after both ways."""
        outer, self.graph.answers = self.graph.answers, list(answers)
        try:
            return function(*arguments, **named)
        except UndecidedBranch as branch:
            condition = branch.condition
        finally:
            self.graph.answers = outer
        holds, fails = (self._take_both_ways(function, arguments, named, [*answers, x]) for x in (True, False))
        return _select(condition, holds, fails)


class _TracedModule:
    """A module of this package as traced functions see it."""

    def __init__(self, tracer: Tracer, module: ModuleType) -> None:
        self._tracer, self._module = tracer, module

    def __getattr__(self, name: str) -> Any:
        return self._tracer._seen_by(getattr(self._module, name))


def _plain(function: Any) -> Any:
    """The plain Python of a compiled function; any other one as it is."""
    return getattr(function, "py_func", function)


def _is_traceable(thing: Any) -> bool:
    """Whether `thing` is a compiled function, or a plain one of this package."""
    return hasattr(thing, "py_func") or (isinstance(thing, FunctionType) and thing.__module__.startswith(PACKAGE))


def _select(condition: Node, a: Any, b: Any) -> Any:
    """`a` where the condition holds, else `b`: of numbers and nodes, and of tuples and arrays of them one by one."""
    if isinstance(a, tuple):
        parts = [_select(condition, x, y) for x, y in zip(a, b, strict=True)]
        return type(a)(*parts) if hasattr(a, "_fields") else tuple(parts)
    if isinstance(a, np.ndarray):
        return np.array([_select(condition, x, y) for x, y in zip(a.flat, b.flat, strict=True)], object).reshape(
            a.shape
        )
    return condition.graph.operate("select", condition, a, b)


def _functions_by_nodes(graph: Graph) -> dict[Any, Callable[..., Any]]:
    """What stands for the helpers of compiled functions, and for polynomials of functions that every language has."""
    operate = graph.operate

    def arctan_ratio(y: Any, x: Any) -> Any:
        return operate("atan", y / x)

    return {
        lanes.where: lambda condition, a, b: operate("select", condition, a, b),
        lanes.any_lane: lambda condition: isinstance(condition, Node) or condition,
        lanes.floor: lambda x: operate("floor", x),
        lanes.multiply_add: lambda a, b, c: a * b + c,
        elementary.sincos: lambda x: (operate("sin", x), operate("cos", x)),
        elementary.arctan_ratio: arctan_ratio,
        elementary.arctan_ratio_by_jumps: arctan_ratio,
        elementary.arctan: lambda x: operate("atan", x),
        elementary.clip: lambda x, low, high: operate("min", operate("max", x, low), high),
    }


def _mathematics(graph: Graph) -> dict[str, Any]:
    """What stands for modules and built-in functions of Python that compiled functions name."""

    def by_node(operation: str) -> Callable[..., Any]:
        return lambda *operands: graph.operate(operation, *operands)

    of_math = {name: by_node(name) for name in _OF_MATH}
    constants = {name: getattr(math, name) for name in ("pi", "inf", "ceil", "floor")}
    return {
        "math": SimpleNamespace(**of_math, **constants), "np": _NodeArrays(graph),
        "min": by_node("min"), "max": by_node("max"),
        "float": lambda x: x if isinstance(x, Node) else float(x),
    }  # fmt: skip


class _NodeArrays:
    """The functions of numpy that compiled functions name, for arrays that may hold nodes."""

    def __init__(self, graph: Graph) -> None:
        self._graph = graph

    def __getattr__(self, name: str) -> Any:
        return getattr(np, name)

    def empty(self, shape: Any, dtype: Any = None) -> Any:
        """An array to be filled: of nodes, unless it is to be of some other type."""
        return np.empty(shape, object) if dtype is None else np.empty(shape, dtype)

    def zeros(self, shape: Any, dtype: Any = None) -> Any:
        """An array of zeros, to be filled: of nodes, unless it is to be of some other type."""
        return np.full(shape, 0.0, object) if dtype is None else np.zeros(shape, dtype)

    def clip(self, values: Sequence[Any], low: Any, high: Any) -> Any:
        """`values` within [low, high], one by one."""
        operate = self._graph.operate
        return np.array([operate("min", operate("max", x, low), high) for x in values], object)
