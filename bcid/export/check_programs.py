"""Programs that drive an exported model and compare it with what the model itself made of the same commands.

Each prints the largest error and fails where that is more than the tolerance: the check of every export here, and a
first test for its user.
"""

from __future__ import annotations

from collections.abc import Sequence

from bcid.aliases import Floats
from bcid.export.reference_drive import ReferenceDrive
from bcid.export.statements import wrapped

WIDTH = 110

_C = """\
/* Drives {name} by {steps} commands, and compares its twists with those of the model that it was made of.
 *
 *   cc -std=c99 -O2 {name}.c {name}_test.c -lm -o {name}_test && ./{name}_test
 */
#include <math.h>
#include <stdio.h>

#include "{name}.h"

#define STEPS {steps}

{tables}
int main(void)
{{
    double x[{N}_STATES], twist[3], worst = 0.0;
    int i, k;
    {name}_init(first_pose, first_twist, {delta}, x);
    for (k = 0; k < STEPS; ++k) {{
{restart}        {name}_step(x, commands[k], x, twist);
        for (i = 0; i < 3; ++i) {{
            const double error = fabs(twist[i] - twists[k][i]);
            if (!(error <= worst)) worst = error;
        }}
    }}
    printf("%.3e\\n", worst);
    return worst <= {tolerance!r} ? 0 : 1;
}}
"""

_C_RESTART = "        for (i = 0; i < {N}_STATES; ++i) x[i] = states[k][i];\n"

_PYTHON = '''\
"""Drives {module} by {steps} commands, and compares its twists with those of the model that it was made of."""

import sys

from {module} import init, step

FIRST_POSE, FIRST_TWIST, FIRST_STEERING = {pose}, {twist}, {delta!r}
COMMANDS = {commands}
TWISTS = {twists}
{states}

def main():
    """Print the largest error; 1 where it is more than {tolerance!r}."""
    x, worst = init(FIRST_POSE, FIRST_TWIST, FIRST_STEERING), 0.0
    for k, (command, expected) in enumerate(zip(COMMANDS, TWISTS)):
{restart}        x, twist = step(x, command)
        worst = max([worst, *(abs({number} - b) for a, b in zip({sequence}, expected))])
    print(f"{{worst:.3e}}")
    return 0 if worst <= {tolerance!r} else 1


if __name__ == "__main__":
    sys.exit(main())
'''


def write_c_test(name: str, v: ReferenceDrive) -> str:
    """The text of NAME_test.c."""
    states = f"{name.upper()}_STATES"
    tables = "".join(
        f"static const double {key}{shape} = {_braced(table.tolist())};\n"
        for key, shape, table in (
            ("first_pose", "[3]", v.pose), ("first_twist", "[3]", v.twist), ("commands", "[STEPS][2]", v.commands),
            ("twists", "[STEPS][3]", v.twists), ("states", f"[STEPS][{states}]", v.states),
        )
        if table is not None
    )  # fmt: skip
    restart = "" if v.states is None else _C_RESTART.format(N=name.upper())
    return _C.format(
        name=name, N=name.upper(), steps=len(v.commands), tables=tables, delta=repr(v.delta), restart=restart,
        tolerance=v.tolerance,
    )  # fmt: skip


def write_python_test(module: str, v: ReferenceDrive, in_casadi: bool = False) -> str:
    """The text of a test of the Python `module`, whose numbers are CasADi's if `in_casadi`."""
    return _PYTHON.format(
        module=module, steps=len(v.commands), pose=v.pose.tolist(), twist=v.twist.tolist(), delta=v.delta,
        commands=_bracketed(v.commands), twists=_bracketed(v.twists), tolerance=v.tolerance,
        states="" if v.states is None else f"STATES = {_bracketed(v.states)}\n",
        restart="" if v.states is None else "        x = STATES[k]\n",
        number="float(a)" if in_casadi else "a", sequence="twist.nz" if in_casadi else "twist",
    )  # fmt: skip


def _braced(rows: Sequence[float] | Sequence[Sequence[float]]) -> str:
    """A table in C."""
    if isinstance(rows[0], list):
        return "{\n" + "".join(f"    {_braced(row)},\n" for row in rows) + "}"  # type: ignore[arg-type]
    return "{" + "\n     ".join(wrapped([repr(number) for number in rows], WIDTH)) + "}"


def _bracketed(table: Floats) -> str:
    """A table in Python, a row in lines of its own."""
    return (
        "[\n"
        + "".join(
            "    [" + "\n     ".join(wrapped([repr(number) for number in row], WIDTH)) + "],\n"
            for row in table.tolist()
        )
        + "]"
    )
