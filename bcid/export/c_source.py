"""A model in C99: NAME.h and NAME.c, of doubles and `math.h` alone, without memory of its own."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np

from bcid.export.exported import Exported
from bcid.export.formulas import COMMANDS, POSE, START, TWIST, Variable
from bcid.export.pose_formulas import trace_pose
from bcid.export.statements import NETWORK_FORMULA, Language, Line, NetworkLine, Program, wrap_texts, write_program
from bcid.models.network.mlp import MlpWeights

WIDTH = 100


C = Language(
    {
        "abs": "fabs({0})", "min": "least({0}, {1})", "max": "largest({0}, {1})", "floor": "floor({0})",
        "sqrt": "sqrt({0})", "exp": "exp({0})", "sin": "sin({0})", "cos": "cos({0})", "atan": "atan({0})",
        "atan2": "atan2({0}, {1})", "tanh": "tanh({0})", "hypot": "hypot({0}, {1})", "copysign": "copysign({0}, {1})",
        "select": "{0} ? {1} : {2}",
    },
    {"and": "&&", "or": "||"}, "INFINITY", selection=1,
)  # fmt: skip

HELPERS = {
    "min": "static double least(double a, double b) { return b < a ? b : a; }",
    "max": "static double largest(double a, double b) { return b > a ? b : a; }",
}
"""Functions that stand for operations which C does not have as Python does, by the operation."""

_NETWORK = """\
/* {formula}; a row for each input */
static void {name}(const double x[{n}], double y[{m}])
{{
    float h1[{a}], h2[{b}], h3[{m}];
    int i, j;
    for (j = 0; j < {a}; ++j) h1[j] = {name}_b1[j];
    for (i = 0; i < {n}; ++i) {{
        const float z = (float)((x[i] - {name}_x_mean[i]) / {name}_x_sd[i]);
        for (j = 0; j < {a}; ++j) h1[j] += z * {name}_W1[i][j];
    }}
    for (j = 0; j < {b}; ++j) h2[j] = {name}_b2[j];
    for (i = 0; i < {a}; ++i) {{
        if (h1[i] > 0.0f) {{
            for (j = 0; j < {b}; ++j) h2[j] += h1[i] * {name}_W2[i][j];
        }}
    }}
    for (j = 0; j < {m}; ++j) h3[j] = {name}_b3[j];
    for (i = 0; i < {b}; ++i) {{
        if (h2[i] > 0.0f) {{
            for (j = 0; j < {m}; ++j) h3[j] += h2[i] * {name}_W3[i][j];
        }}
    }}
    for (j = 0; j < {m}; ++j) y[j] = {name}_y_mean[j] + {name}_y_sd[j] * (double)h3[j];
}}
"""


def write_c_header(e: Exported) -> str:
    """The text of NAME.h."""
    name, formulas = e.name, e.formulas
    guard = f"{name.upper()}_H"
    states, commands = describe_all("x", formulas.states), describe_all("u", e.commands)
    return f"""\
/* {e.about}
 *
 * State:
{states}
 * Command, held for one period:
{commands}
 * Pose [p_x, p_y (m), theta (rad)] in the world, x to y counter-clockwise; twist [v_x, v_y (m/s), yaw rate (rad/s)] in
 * the vehicle's axes, x ahead, y left.  Both are of the {e.point}.
 */
#ifndef {guard}
#define {guard}

#ifdef __cplusplus
extern "C" {{
#endif

#define {name.upper()}_STATES {len(formulas.states)}
#define {name.upper()}_COMMANDS {len(COMMANDS)}
#define {name.upper()}_PERIOD_S {formulas.period_s!r}

/* The state of a vehicle whose past is not known: it coasts, its wheel held at delta (rad). */
void {name}_init(const double pose[3], const double twist[3], double delta, double x[{len(formulas.states)}]);

/* One period: the state after it and the twist there.  x_next may be x. */
void {name}_step(const double x[{len(formulas.states)}], const double u[{len(COMMANDS)}],
                 double x_next[{len(formulas.states)}], double twist[3]);

/* The pose one period later, from the twists before and after it, by the trapezoidal rule.  pose_next may be pose. */
void {name}_pose(const double pose[3], const double twist[3], const double twist_next[3], double pose_next[3]);

#ifdef __cplusplus
}}
#endif

#endif
"""


def write_c_source(e: Exported) -> str:
    """The text of NAME.c."""
    name, formulas = e.name, e.formulas
    step = write_program(formulas.results, C)
    init = write_program(formulas.first_states, C)
    moved = write_program(trace_pose(formulas.period_s), C)
    n = len(formulas.states)
    parameters = step.parameters | init.parameters
    used = step.operations | init.operations
    blocks = [
        f'/* {e.about} */\n\n#include "{name}.h"\n\n#include <math.h>\n',
        "".join(f"static const double {key} = {C.number(value)};\n" for key, value in parameters.items()),
        "".join(f"{text}\n" for operation, text in HELPERS.items() if operation in used),
        *(_write_network(key, weights) for key, weights in formulas.networks.items()),
        write_function(
            f"void {name}_init(const double pose[3], const double twist[3], double delta, double x[{n}])", init,
            places_in(START[:3], "pose") | places_in(START[3:6], "twist") | {START[6].name: "delta"},
            element_texts("x", n), ["pose", "twist", "delta"],
        ),
        write_function(
            f"void {name}_step(const double x[{n}], const double u[{len(COMMANDS)}],\n"
            f"{' ' * (len(name) + 11)}double x_next[{n}], double twist[3])", step,
            places_in(formulas.states, "x") | places_in(COMMANDS, "u"),
            [*element_texts("x_next", n), *element_texts("twist", 3)], ["u"],
        ),
        write_function(
            f"void {name}_pose(const double pose[3], const double twist[3], const double twist_next[3],\n"
            f"{' ' * (len(name) + 11)}double pose_next[3])", moved,
            places_in(POSE, "pose") | places_in(TWIST, "twist") | places_in(TWIST, "twist_next", "_next"),
            element_texts("pose_next", 3), [],
        ),
    ]  # fmt: skip
    return "\n".join(block for block in blocks if block)


def write_function(head: str, program: Program, places: dict[str, str], results: list[str], may_idle: list[str]) -> str:
    """The definition of a function: what it reads from `places`, the program's lines, its `results`."""
    read = [f"{name} = {places[name]}" for name in program.inputs]
    lines = list(wrap_texts(read, WIDTH - 20))
    body = [("    const double " if i == 0 else "                 ") + line for i, line in enumerate(lines)]
    if body:
        body[-1] += ";"
    used = {places[name].partition("[")[0] for name in program.inputs}
    body += [f"    (void){argument};" for argument in may_idle if argument not in used]
    body += list(chain.from_iterable(_write_line(line) for line in program.lines))
    body += [f"    {place} = {text};" for place, text in zip(results, program.results, strict=True)]
    return f"{head}\n{{\n" + "\n".join(body) + "\n}\n"


def _write_line(line: Line | NetworkLine) -> list[str]:
    """A line of a program in C."""
    if isinstance(line, Line):
        return [f"    const {'int' if line.is_truth else 'double'} {line.name} = {line.text};"]
    return [
        f"    const double x_{line.name}[{len(line.inputs)}] = {{{', '.join(line.inputs)}}};",
        f"    double {line.name}[3];",
        f"    {line.network}(x_{line.name}, {line.name});",
    ]


def _write_network(name: str, w: MlpWeights) -> str:
    """The tables of a perceptron, and the function that evaluates it."""
    text = "".join(_write_table(f"{name}_{key}", table) for key, table in w._asdict().items())
    sizes = {"n": len(w.x_mean), "a": len(w.b1), "b": len(w.b2), "m": len(w.b3)}
    return text + "\n" + _NETWORK.format(name=name, formula=NETWORK_FORMULA, **sizes)


def _write_table(name: str, table: Any) -> str:
    """A constant table of numbers in C, in single precision where it is of it."""
    single = table.dtype == np.float32
    shape = "".join(f"[{n}]" for n in table.shape)
    rows = table if table.ndim == 2 else table[None]
    texts = [
        "{" + "\n     ".join(wrap_texts([f"{x!s}f" if single else repr(float(x)) for x in row], WIDTH)) + "}"
        for row in rows
    ]
    inner = texts[0] if table.ndim == 1 else "{\n    " + ",\n    ".join(texts) + "}"
    return f"static const {'float' if single else 'double'} {name}{shape} = {inner};\n"


def element_texts(array: str, n: int) -> list[str]:
    """The texts of the `n` elements of an array."""
    return [f"{array}[{i}]" for i in range(n)]


def places_in(quantities: Sequence[Variable], array: str, after: str = "") -> dict[str, str]:
    """Where each of the `quantities` stands in an `array`, by its name followed by `after`."""
    return {q.name + after: f"{array}[{i}]" for i, q in enumerate(quantities)}


def describe_all(array: str, quantities: Sequence[Variable]) -> str:
    """The elements of an array in a comment, a line each."""
    width = len(f"{array}[{len(quantities) - 1}]")
    return "\n".join(f" *   {f'{array}[{i}]':{width}}  {quantity.describe()}" for i, quantity in enumerate(quantities))
