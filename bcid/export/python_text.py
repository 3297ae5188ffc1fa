"""What texts in Python have in common, whatever library they compute with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from bcid.export.formulas import Variable
from bcid.export.statements import Line, Program, wrapped
from bcid.models.network.mlp import MlpWeights

WIDTH = 110

# The rows of these are inputs; in a product of a table and a vector they are outputs.
_TRANSPOSED = ("W1", "W2", "W3")


def body_text(program: Program) -> str:
    """The lines of a program as a function's body."""
    return "".join(
        f"    {line.name} = "
        + (line.text if isinstance(line, Line) else f"{line.network}([{', '.join(line.inputs)}])")
        + "\n"
        for line in program.lines
    )


def unpack_text(quantities: Sequence[Variable], array: str, after: str = "") -> str:
    """An assignment of the numbers of `array` to the names of the `quantities`, each followed by `after`."""
    places = ", ".join(f"{array}[{i}]" for i in range(len(quantities)))
    return f"    {', '.join(q.name + after for q in quantities)} = {places}\n"


def quantities_text(*arrays: Sequence[Variable]) -> str:
    """Lines of a docstring: name, unit and meaning of each quantity in some arrays."""
    return "".join(
        f"    {q.name:14} {q.unit and f'({q.unit}) '}{q.meaning}\n" for quantities in arrays for q in quantities
    )


def tuple_text(names: Sequence[str]) -> str:
    """A tuple of strings."""
    return "(" + ", ".join(f'"{name}"' for name in names) + ("," if len(names) == 1 else "") + ")"


def constants_text(*programs: Program) -> str:
    """Assignments of the named constants of some programs."""
    values = {name: value for program in programs for name, value in program.parameters.items()}
    return "".join(f"{name} = {value!r}\n" for name, value in values.items())


def tables_text(name: str, w: MlpWeights, make: str = "{}") -> str:
    """Assignments of the tables of a perceptron, a row for each output of a layer, each written as `make` of a list."""
    text = ""
    for key, table in w._asdict().items():
        rows = (table.T if key in _TRANSPOSED else table).tolist()
        text += f"{name}_{key} = {make.format(_list_text(rows))}\n"
    return text


def _list_text(rows: Sequence[float] | Sequence[Sequence[float]]) -> str:
    """A list of numbers, or of rows of them, a row in lines of its own."""
    if isinstance(rows[0], list):
        return "[\n" + "".join(f"    {_list_text(row)},\n" for row in rows) + "]"  # type: ignore[arg-type]
    return "[" + "\n    ".join(_number_lines(rows)) + "]"  # type: ignore[arg-type]


def _number_lines(row: Sequence[float]) -> Iterator[str]:
    """The numbers of a row, with commas between, in lines."""
    return wrapped([repr(number) for number in row], WIDTH)
