"""Formulas as the lines of a program: which numbers get a name, and how expressions are written in a language."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from bcid.export.graph import TRUTHS, Node

LONGEST_EXPRESSION = 76
"""Characters up to which what is used once is written where it is used."""

ATOM = 9
INFIX = {
    "or": ("or", 2), "and": ("and", 3), "lt": ("<", 4), "le": ("<=", 4), "gt": (">", 4), "ge": (">=", 4),
    "eq": ("==", 4), "ne": ("!=", 4), "add": ("+", 5), "sub": ("-", 5), "mul": ("*", 6), "div": ("/", 6),
}  # fmt: skip
"""Signs between two operands, and how tightly they bind: as in C and in Python."""
NEGATION = 7

NETWORK_FORMULA = "y = y_mean + y_sd (W3 relu(W2 relu(W1 z + b1) + b2) + b3), z = (x - x_mean) / x_sd"
"""What a network computes, for the comments of every language."""


@dataclass(frozen=True)
class Language:
    """How a language writes operations."""

    calls: Mapping[str, str]  # by operation, with {0}, {1}, {2} for the operands: all but signs between two operands
    signs: Mapping[str, str]  # in place of those of INFIX
    infinity: str
    selection: int = ATOM  # how tightly a selection binds; its operands are written without brackets if it is a call

    def number(self, value: float) -> str:
        """A number as it is written."""
        return repr(value) if math.isfinite(value) else ("-" if value < 0.0 else "") + self.infinity


class Line(NamedTuple):
    """`name` = `text`, a number or, if `is_truth`, a truth value."""

    name: str
    text: str
    is_truth: bool = False


class NetworkLine(NamedTuple):
    """The outputs of a network, `name`[0] and so on, from the texts of its inputs."""

    name: str
    network: str
    inputs: tuple[str, ...]


class Program(NamedTuple):
    """The lines that compute some results, the texts of these, and what the lines are computed from."""

    lines: list[Line | NetworkLine]
    results: list[str]
    inputs: list[str]
    parameters: dict[str, float]
    operations: frozenset[str]


def write_program(results: Sequence[Node], language: Language) -> Program:
    """The program, in `language`, that computes the `results`: whatever is used more than once has a name."""
    nodes = results[0].graph.nodes_for(results)
    uses = Counter(argument.place for node in nodes for argument in node.arguments)
    uses.update(node.place for node in results)
    texts, lines, networks = dict[int, tuple[str, int]](), list[Line | NetworkLine](), dict[tuple[int, ...], str]()
    for node in nodes:
        if node.operation == "network":
            key = tuple(argument.place for argument in node.arguments)
            network, _, output = node.name.partition("[")
            if key not in networks:
                networks[key] = f"y{len(networks) + 1}"
                lines.append(NetworkLine(networks[key], network, tuple(texts[place][0] for place in key)))
            texts[node.place] = (f"{networks[key]}[{output}", ATOM)
            continue
        text, binds = _write(node, texts, language)
        plain = node.operation == "neg" and not node.arguments[0].arguments
        if node.arguments and not plain and (uses[node.place] > 1 or len(text) > LONGEST_EXPRESSION):
            name = f"a{len(lines) + 1}"
            lines.append(Line(name, text, node.operation in TRUTHS))
            text, binds = name, ATOM
        texts[node.place] = (text, binds)
    return Program(
        lines, [texts[node.place][0] for node in results],
        [node.name for node in nodes if node.operation == "input"],
        {node.name: float(node.value or 0.0) for node in nodes if node.operation == "parameter"},
        frozenset(node.operation for node in nodes),
    )  # fmt: skip


def _write(node: Node, texts: Mapping[int, tuple[str, int]], language: Language) -> tuple[str, int]:
    """The expression of one node, and how tightly it binds."""
    if node.operation in ("input", "parameter"):
        return node.name, ATOM
    if node.operation == "constant":
        text = language.number(node.value or 0.0)
        return text, ATOM if text[0] != "-" else NEGATION
    operands = [texts[argument.place] for argument in node.arguments]
    if node.operation in language.calls:
        binds = language.selection if node.operation == "select" else ATOM
        bare = [_bracket(operand, binds + 1) if binds < ATOM else operand[0] for operand in operands]
        return language.calls[node.operation].format(*bare), binds
    if node.operation == "neg":
        return f"-{_bracket(operands[0], NEGATION + 1)}", NEGATION
    sign, binds = INFIX[node.operation]
    left, right = _bracket(operands[0], binds), _bracket(operands[1], binds + 1)
    return f"{left} {language.signs.get(node.operation, sign)} {right}", binds


def _bracket(operand: tuple[str, int], least: int) -> str:
    """The text of an operand, in brackets where it binds less tightly than `least`."""
    text, binds = operand
    return text if binds >= least else f"({text})"


def wrap_texts(texts: Sequence[str], width: int) -> Iterator[str]:
    """Lines of at most `width` characters that hold `texts` with commas between them."""
    line = ""
    for text in texts:
        if line and len(line) + len(text) + 2 > width:
            yield line + ","
            line = ""
        line += (", " if line else "") + text
    if line:
        yield line
