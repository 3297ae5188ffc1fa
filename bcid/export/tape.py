"""Formulas as a tape: a list of operations on numbered places, which one compiled loop runs for any formulas.

Nothing is compiled anew for another model.  A place holds a number; truth values are 1 and 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.compiled.njit import njit
from bcid.export.graph import Node

CODES = {
    name: code
    for code, name in enumerate(
        ("mul", "add", "sub", "div", "neg", "select", "lt", "le", "gt", "ge", "and", "or", "eq", "ne", "min", "max",
         "abs", "sqrt", "sin", "cos", "atan", "tanh", "exp", "hypot", "copysign", "floor", "atan2")
    )
}  # fmt: skip
"""The number of each operation on a tape, frequent ones first, as they are looked for in this order."""


class Tape(NamedTuple):
    """The operations that compute some results from inputs, in order."""

    codes: Ints  # (n,) of CODES
    operands: Ints  # (n, 3) places of the operands, 0 where there is none
    targets: Ints  # (n,) place of each operation's result
    start: Floats  # (m,) what all places hold at first: constants, and 0 elsewhere
    inputs: Ints  # places of the inputs
    results: Ints  # places of the results


def record_tape(results: Sequence[Node], inputs: Sequence[str]) -> Tape:
    """The tape that computes `results` from inputs in the order of the names `inputs`, which may be more than are read.

    Raises:
        ValueError: a result is computed by a network, or from an input that is not among `inputs`.
    """
    nodes = results[0].graph.nodes_for(results)
    place = {node.place: i for i, node in enumerate(nodes)}
    named = {node.name: place[node.place] for node in nodes if node.operation == "input"}
    if unknown := named.keys() - set(inputs):
        raise ValueError(f"no input is called {', '.join(sorted(unknown))}")
    if any(node.operation == "network" for node in nodes):
        raise ValueError("a network is no operation of a tape")
    computed = [node for node in nodes if node.operation in CODES]
    operands = [[place[a.place] for a in node.arguments] + [0] * (3 - len(node.arguments)) for node in computed]
    start = [float(node.value or 0.0) if node.operation in ("constant", "parameter") else 0.0 for node in nodes]
    spare = len(start)  # where inputs go that no result depends on
    return Tape(
        np.array([CODES[node.operation] for node in computed], np.int64),
        np.array(operands, np.int64).reshape(-1, 3),
        np.array([place[node.place] for node in computed], np.int64),
        np.array([*start, 0.0]),
        np.array([named.get(name, spare) for name in inputs], np.int64),
        np.array([place[result.place] for result in results], np.int64),
    )


@njit
def run_tape(tape: Tape, inputs: Floats, places: Floats, results: Floats) -> None:
    """Fill in the `results` of a tape at `inputs`; `places` (m,), which begin as `tape.start`, are worked on."""
    for i in range(len(inputs)):
        places[tape.inputs[i]] = inputs[i]
    for i in range(len(tape.codes)):
        a, b = places[tape.operands[i, 0]], places[tape.operands[i, 1]]
        code = tape.codes[i]
        if code < 5:
            y = _combine(code, a, b)
        elif code == 5:
            y = b if a != 0.0 else places[tape.operands[i, 2]]
        elif code < 14:
            y = 1.0 if _holds(code, a, b) else 0.0
        else:
            y = _apply(code, a, b)
        places[tape.targets[i]] = y
    for i in range(len(results)):
        results[i] = places[tape.results[i]]


@njit
def _combine(code: int, a: float, b: float) -> float:
    """The result of an arithmetic operation."""
    if code == 0:
        return a * b
    if code == 1:
        return a + b
    if code == 2:
        return a - b
    return a / b if code == 3 else -a


@njit
def _holds(code: int, a: float, b: float) -> bool:
    """Whether a condition holds."""
    if code == 6:
        return a < b
    if code == 7:
        return a <= b
    if code == 8:
        return a > b
    if code == 9:
        return a >= b
    if code == 10:
        return a != 0.0 and b != 0.0
    if code == 11:
        return a != 0.0 or b != 0.0
    return a == b if code == 12 else a != b


@njit
def _apply(code: int, a: float, b: float) -> float:
    """The value of a function of one number or two."""
    if code == 14:
        return b if b < a else a
    if code == 15:
        return b if b > a else a
    if code == 16:
        return abs(a)
    if code == 17:
        return math.sqrt(a)
    if code == 18:
        return math.sin(a)
    if code == 19:
        return math.cos(a)
    if code == 20:
        return math.atan(a)
    if code == 21:
        return math.tanh(a)
    if code == 22:
        return math.exp(a)
    if code == 23:
        return math.hypot(a, b)
    if code == 24:
        return math.copysign(a, b)
    return float(math.floor(a)) if code == 25 else math.atan2(a, b)
