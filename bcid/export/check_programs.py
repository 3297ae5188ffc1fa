"""Programs that run an exported model and compare it with what the model itself made of the same.

Each drives the commands of the reference drive, and goes through its first states and single periods.  It prints the
largest error of a twist over the drive, and fails where anything is off by more than its tolerance: the check of every
export here, and a first test for its user.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.export.reference_drive import EXACT, EXACT_STEP, ReferenceDrive
from bcid.export.statements import wrap_texts

WIDTH = 110

_C = """\
/* Drives {name} by {steps} commands, and compares it with the model that it was made of; then first states and single
 * periods, from which a drive would never come to all that the model does.
 *
 *   cc -std=c99 -O2 {name}.c {name}_test.c -lm -o {name}_test && ./{name}_test
 */
#include <math.h>
#include <stdio.h>

#include "{name}.h"

#define STEPS {steps}
#define SINGLE_STEPS {single_steps}
#define STARTS {starts}

{tables}
/* The larger of two errors; one that is no number is the largest. */
static double larger(double worst, double error)
{{
    if (error <= worst) return worst;
    return error == error ? error : HUGE_VAL;
}}

/* The largest error of `n` numbers, relative for those beyond their scale, or `worst` if that is more. */
static double compare(const double *is, const double *wanted, const double *scale, int n, double worst)
{{
    int i;
    for (i = 0; i < n; ++i) worst = larger(worst, fabs(is[i] - wanted[i]) / fmax(scale[i], fabs(wanted[i])));
    return worst;
}}

/* 1, with a message, where what is checked is off by more than it may. */
static int is_off(const char *what, double worst, double tolerance)
{{
    if (worst <= tolerance) return 0;
    fprintf(stderr, "%s: off by %.3e, which may be %.0e\\n", what, worst, tolerance);
    return 1;
}}

int main(void)
{{
    double x[{N}_STATES], twist[3], pose[3], worst = 0.0, first = 0.0, single = 0.0;
    int i, k, failed;
    for (k = 0; k < STARTS; ++k) {{
        {name}_init(start_poses[k], start_twists[k], start_angles[k], x);
        first = compare(x, start_states[k], scales, {N}_STATES, first);
    }}
    for (k = 0; k < SINGLE_STEPS; ++k) {{
        {name}_step(single_states[k], single_commands[k], x, twist);
        single = compare(x, single_next_states[k], scales, {N}_STATES, single);
        single = compare(twist, single_twists[k], ones, 3, single);
    }}
    {name}_init(start_poses[0], start_twists[0], start_angles[0], x);
    for (i = 0; i < 3; ++i) pose[i] = start_poses[0][i];
    for (k = 0; k < STEPS; ++k) {{
{restart}        {name}_step(x, commands[k], x, twist);
        for (i = 0; i < 3; ++i) worst = larger(worst, fabs(twist[i] - twists[k][i]));
        {name}_pose(pose, k == 0 ? start_twists[0] : twists[k - 1], twists[k], pose);
    }}
    printf("%.3e\\n", worst);
    failed = is_off("twists of the drive", worst, {tolerance!r});
    failed += is_off("pose after the drive", compare(pose, end_pose, ones, 3, 0.0), {pose_tolerance!r});
    failed += is_off("first states", first, {first_tolerance!r});
    failed += is_off("single periods", single, {step_tolerance!r});
    return failed ? 1 : 0;
}}
"""

_C_RESTART = "        for (i = 0; i < {N}_STATES; ++i) x[i] = states[k][i];\n"

_PYTHON = '''\
"""Drives {module} by {steps} commands, and compares it with the model that it was made of.

Then it does so with first states and single periods, from which a drive would never come to all that the model does.
"""

import sys

from {module} import init, move, {step}

COMMANDS = {commands}
TWISTS = {twists}
END_POSE = {end_pose}
# of the numbers of a state
SCALES = {scales}
# pose, twist and steering angle, and the state there
STARTS = {starts}
# state and command, and the state and twist one period later
SINGLE_STEPS = {single_steps}
{states}

{numbers}def compare(numbers, wanted, scales=(1.0, 1.0, 1.0)):
    """The largest error, relative for numbers beyond their scale; infinite where one is no number."""
    errors = [abs(a - b) / max(scale, abs(b)) for a, b, scale in zip(numbers, wanted, scales)]
    return max(error if error == error else float("inf") for error in errors)


def main():
    """Print the largest error of a twist over the drive; 1 where anything is off by more than it may be."""
{make_step}    first = max(compare({init}, x, SCALES) for pose, twist, delta, x in STARTS)
    single = 0.0
    for x, u, x_next, twist in SINGLE_STEPS:
        after, there = step(x, u)
        single = max(single, compare({after}, x_next, SCALES), compare({there}, twist))
    pose, before, delta, x = STARTS[0]
    worst = 0.0
    for k, (u, expected) in enumerate(zip(COMMANDS, TWISTS)):
{restart}        x, twist = step(x, u)
        errors = [abs(a - b) for a, b in zip({twist}, expected)]
        worst = max([worst, *(error if error == error else float("inf") for error in errors)])
        pose = move(pose, before, expected)
        before = expected
    print(f"{{worst:.3e}}")
    failed = False
    for what, error, tolerance in (
        ("twists of the drive", worst, {tolerance!r}),
        ("pose after the drive", compare({pose}, END_POSE), {pose_tolerance!r}),
        ("first states", first, {first_tolerance!r}),
        ("single periods", single, {step_tolerance!r}),
    ):
        if not error <= tolerance:
            print(f"{{what}}: off by {{error:.3e}}, which may be {{tolerance:.0e}}", file=sys.stderr)
            failed = True
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
'''

_NUMBERS = '''\
def numbers(column):
    """A column of CasADi as a list."""
    return [float(column[i]) for i in range(column.numel())]


'''


def write_c_test(name: str, v: ReferenceDrive) -> str:
    """The text of NAME_test.c.  No table ends as a function of NAME does, so that they never have a name in common."""
    states = f"{name.upper()}_STATES"
    tables = "".join(
        f"static const double {key}{shape} = {c_table(np.asarray(table).tolist())};\n"
        for key, shape, table in (
            ("scales", f"[{states}]", v.scales), ("ones", "[3]", np.ones(3)),
            ("start_poses", "[STARTS][3]", [start.pose for start in v.starts]),
            ("start_twists", "[STARTS][3]", [start.twist for start in v.starts]),
            ("start_angles", "[STARTS]", [start.delta for start in v.starts]),
            ("start_states", f"[STARTS][{states}]", [start.state for start in v.starts]),
            ("commands", "[STEPS][2]", v.commands), ("twists", "[STEPS][3]", v.twists),
            ("states", f"[STEPS][{states}]", v.states), ("end_pose", "[3]", v.end_pose),
            ("single_states", f"[SINGLE_STEPS][{states}]", v.steps.states),
            ("single_commands", "[SINGLE_STEPS][2]", v.steps.commands),
            ("single_next_states", f"[SINGLE_STEPS][{states}]", v.steps.next_states),
            ("single_twists", "[SINGLE_STEPS][3]", v.steps.twists),
        )
        if table is not None
    )  # fmt: skip
    restart = "" if v.states is None else _C_RESTART.format(N=name.upper())
    return _C.format(
        name=name, N=name.upper(), steps=len(v.commands), single_steps=len(v.steps.states), starts=len(v.starts),
        tables=tables, restart=restart, **_tolerances(v),
    )  # fmt: skip


def write_python_test(module: str, v: ReferenceDrive, in_casadi: bool = False) -> str:
    """The text of a test of the Python `module`, whose numbers are CasADi's if `in_casadi`."""
    shown = "numbers({})" if in_casadi else "{}"
    texts = {key: shown.format(key) for key in ("twist", "pose", "after", "there")}
    return _PYTHON.format(
        module=module, steps=len(v.commands), commands=_python_table(v.commands), twists=_python_table(v.twists),
        end_pose=_row(v.end_pose.tolist()), scales=_row(v.scales.tolist()), starts=_python_tuples(v.starts),
        single_steps=_python_tuples(zip(*v.steps, strict=True)),
        states="" if v.states is None else f"STATES = {_python_table(v.states)}\n",
        restart="" if v.states is None else "        x = STATES[k]\n",
        step="step_function" if in_casadi else "step", make_step="    step = step_function()\n" if in_casadi else "",
        numbers=_NUMBERS if in_casadi else "", init=shown.format("init(pose, twist, delta)"), **texts, **_tolerances(v),
    )  # fmt: skip


def _tolerances(v: ReferenceDrive) -> dict[str, float]:
    """Largest errors by what they are of; no first state and no pose is computed by a network."""
    return {
        "tolerance": v.tolerance, "pose_tolerance": EXACT, "first_tolerance": EXACT_STEP,
        "step_tolerance": v.step_tolerance,
    }  # fmt: skip


def c_table(rows: Sequence[float] | Sequence[Sequence[float]]) -> str:
    """A table in C."""
    if isinstance(rows[0], list):
        return "{\n" + "".join(f"    {c_table(row)},\n" for row in rows) + "}"  # type: ignore[arg-type]
    return "{" + "\n     ".join(wrap_texts([repr(number) for number in rows], WIDTH)) + "}"


def _python_table(table: Floats) -> str:
    """A table in Python, a row in lines of its own."""
    return "[\n" + "".join(f"    {_row(row)},\n" for row in table.tolist()) + "]"


def _python_tuples(rows: Iterable[Iterable[Any]]) -> str:
    """A list of tuples of numbers and lists of them in Python, each of these in lines of its own."""
    return (
        "[\n"
        + "".join(
            "    (\n" + "".join(f"        {_item(np.asarray(part).tolist())},\n" for part in row) + "    ),\n"
            for row in rows
        )
        + "]"
    )


def _item(number: float | list[float]) -> str:
    """A number or a list of numbers in Python."""
    return _row(number) if isinstance(number, list) else repr(number)


def _row(row: Sequence[float]) -> str:
    """A list of numbers in Python."""
    return "[" + "\n     ".join(wrap_texts([repr(number) for number in row], WIDTH - 8)) + "]"
