"""A model as a module of Python, whatever library it computes with: the functions `init`, `step` and `move`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from bcid.export.exported import Exported
from bcid.export.formulas import COMMANDS, POSE, START, STEERED, TWIST, Variable
from bcid.export.pose_formulas import trace_pose
from bcid.export.statements import NETWORK_FORMULA, Language, Line, Program, wrap_texts, write_program
from bcid.models.network.mlp import MlpWeights

WIDTH = 110

# The rows of these are inputs; in a product of a table and a vector they are outputs.
_TRANSPOSED = ("W1", "W2", "W3")

_COLUMNS = {
    "init": "    pose, twist, delta = column(pose), column(twist), ca.vertcat(delta)\n",
    "step": "    x, u = column(x), column(u)\n",
    "move": "    pose, twist, twist_next = column(pose), column(twist), column(twist_next)\n",
}
"""How each function makes columns of CasADi of its arguments."""


@dataclass(frozen=True)
class PythonDialect:
    """How a module of Python computes: with which library, on what it calls arrays of numbers."""

    language: Language
    arrays: str  # what the functions take, as the docstring begins
    imports: str
    helpers: str  # functions that the others call
    network: str  # the function of a perceptron, of its {name} and {formula}
    table: str  # of a network; {} is a list of numbers
    result: tuple[str, str]  # what stands before and after the numbers of an array
    columns: bool  # whether arguments are made columns first, by the helper `column`


def write_python_module(e: Exported, dialect: PythonDialect) -> str:
    """The text of a module with `init(pose, twist, delta)`, `step(x, u)` and `move(pose, twist, twist_next)`."""
    formulas, (begin, end) = e.formulas, dialect.result
    step, init, moved = (
        write_program(results, dialect.language)
        for results in (formulas.results, formulas.first_states, trace_pose(formulas.period_s))
    )
    n = len(formulas.states)
    networks = "".join(
        _tables_text(k, w, dialect.table) + dialect.network.format(name=k, formula=NETWORK_FORMULA)
        for k, w in formulas.networks.items()
    )
    next_states = "".join(f"        {text},\n" for text in step.results[:n])
    made_columns = _COLUMNS if dialect.columns else dict.fromkeys(_COLUMNS, "")
    return f'''\
"""{e.about}

{dialect.arrays} a state `x`, see STATES; a command `u`, see COMMANDS, held for PERIOD_S seconds; a pose
[p_x, p_y (m), theta (rad)] in the world; a twist [v_x, v_y (m/s), yaw rate (rad/s)], x ahead, y left.
Poses and twists are of the {e.point}.

{_variables_text(formulas.states, e.commands)}"""

{dialect.imports}

PERIOD_S = {formulas.period_s!r}
STATES = {_tuple_text([q.name for q in formulas.states])}
COMMANDS = {_tuple_text([q.name for q in COMMANDS])}

{_constants_text(step, init)}{dialect.helpers}{networks}

def init(pose, twist, delta):
    """The state of a vehicle whose past is not known: it coasts, its wheel held at delta (rad)."""
{made_columns["init"]}{_unpack_text(START[:3], "pose")}{_unpack_text(START[3:6], "twist")}    {STEERED.name}_0 = delta
{body_text(init)}    return {begin}{", ".join(init.results)}{end}


def step(x, u):
    """One period: the state after it, and the twist there."""
{made_columns["step"]}{_unpack_text(formulas.states, "x")}{_unpack_text(COMMANDS, "u")}{body_text(step)}\
    x_next = {begin}
{next_states}    {end}
    return x_next, {begin}{", ".join(step.results[n:])}{end}


def move(pose, twist, twist_next):
    """The pose one period later, from the twists before and after it, by the trapezoidal rule."""
{made_columns["move"]}{_unpack_text(POSE, "pose")}{_unpack_text(TWIST, "twist")}\
{_unpack_text(TWIST, "twist_next", "_next")}{body_text(moved)}    return {begin}{", ".join(moved.results)}{end}
'''


def body_text(program: Program) -> str:
    """The lines of a program as a function's body."""
    return "".join(
        f"    {line.name} = "
        + (line.text if isinstance(line, Line) else f"{line.network}([{', '.join(line.inputs)}])")
        + "\n"
        for line in program.lines
    )


def _unpack_text(quantities: Sequence[Variable], array: str, after: str = "") -> str:
    """An assignment of the numbers of `array` to the names of the `quantities`, each followed by `after`."""
    places = ", ".join(f"{array}[{i}]" for i in range(len(quantities)))
    return f"    {', '.join(q.name + after for q in quantities)} = {places}\n"


def _variables_text(*arrays: Sequence[Variable]) -> str:
    """Lines of a docstring that describe each variable of some arrays."""
    return "".join(f"    {variable.describe()}\n" for variables in arrays for variable in variables)


def _tuple_text(names: Sequence[str]) -> str:
    """A tuple of strings."""
    return "(" + ", ".join(f'"{name}"' for name in names) + ("," if len(names) == 1 else "") + ")"


def _constants_text(*programs: Program) -> str:
    """Assignments of the named constants of some programs."""
    values = {name: value for program in programs for name, value in program.parameters.items()}
    return "".join(f"{name} = {value!r}\n" for name, value in values.items())


def _tables_text(name: str, w: MlpWeights, make: str) -> str:
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
    return wrap_texts([repr(number) for number in row], WIDTH)
