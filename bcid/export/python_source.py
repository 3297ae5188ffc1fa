"""A model in Python: one file of plain numbers, `math` and lists, that needs nothing else."""

from __future__ import annotations

import math

from bcid.export.exported import Exported
from bcid.export.formulas import COMMANDS, POSE, START, STEERED, TWIST
from bcid.export.pose_formulas import trace_pose
from bcid.export.python_text import body_text, constants_text, quantities_text, tables_text, tuple_text, unpack_text
from bcid.export.statements import NETWORK_FORMULA, Language, write_program

PYTHON = Language(
    {
        "abs": "abs({0})", "min": "min({0}, {1})", "max": "max({0}, {1})", "floor": "math.floor({0})",
        "sqrt": "math.sqrt({0})", "exp": "math.exp({0})", "sin": "math.sin({0})", "cos": "math.cos({0})",
        "atan": "math.atan({0})", "atan2": "math.atan2({0}, {1})", "tanh": "math.tanh({0})",
        "hypot": "math.hypot({0}, {1})", "copysign": "math.copysign({0}, {1})", "select": "{1} if {0} else {2}",
    },
    {}, lambda value: repr(value) if math.isfinite(value) else ("-" if value < 0.0 else "") + "math.inf", selection=1,
)  # fmt: skip

_NETWORK = '''

def {name}(x):
    """{formula}."""
    z = [(a - mean) / sd for a, mean, sd in zip(x, {name}_x_mean, {name}_x_sd)]
    h = [max(b + sum(a * w for a, w in zip(z, row)), 0.0) for b, row in zip({name}_b1, {name}_W1)]
    h = [max(b + sum(a * w for a, w in zip(h, row)), 0.0) for b, row in zip({name}_b2, {name}_W2)]
    y = [b + sum(a * w for a, w in zip(h, row)) for b, row in zip({name}_b3, {name}_W3)]
    return [mean + sd * a for a, mean, sd in zip(y, {name}_y_mean, {name}_y_sd)]
'''


def write_python_source(e: Exported) -> str:
    """The text of NAME.py, with `init(pose, twist, delta)`, `step(x, u)` and `move(pose, twist, twist_next)`."""
    formulas = e.formulas
    step = write_program(formulas.results, PYTHON)
    init = write_program(formulas.first_states, PYTHON)
    moved = write_program(trace_pose(formulas.period_s), PYTHON)
    n = len(formulas.states)
    networks = "".join(
        tables_text(k, w) + _NETWORK.format(name=k, formula=NETWORK_FORMULA) for k, w in formulas.networks.items()
    )
    next_states = "".join(f"        {text},\n" for text in step.results[:n])
    return f'''\
"""{e.about}

All are lists of floats: a state `x`, see STATES; a command `u`, see COMMANDS, held for PERIOD_S seconds; a pose
[p_x, p_y (m), theta (rad)] in the world; a twist [v_x, v_y (m/s), yaw rate (rad/s)], x ahead, y left.
Poses and twists are of the {e.point}.

{quantities_text(formulas.states, e.commands)}"""

import math  # noqa: F401

PERIOD_S = {formulas.period_s!r}
STATES = {tuple_text([q.name for q in formulas.states])}
COMMANDS = {tuple_text([q.name for q in COMMANDS])}

{constants_text(step, init)}{networks}

def init(pose, twist, delta):
    """The state of a vehicle whose past is not known: it coasts, its wheel held at delta (rad)."""
{unpack_text(START[:3], "pose")}{unpack_text(START[3:6], "twist")}    {STEERED.name}_0 = delta
{body_text(init)}    return [{", ".join(init.results)}]


def step(x, u):
    """One period: the state after it, and the twist there."""
{unpack_text(formulas.states, "x")}{unpack_text(COMMANDS, "u")}{body_text(step)}    x_next = [
{next_states}    ]
    return x_next, [{", ".join(step.results[n:])}]


def move(pose, twist, twist_next):
    """The pose one period later, from the twists before and after it, by the trapezoidal rule."""
{unpack_text(POSE, "pose")}{unpack_text(TWIST, "twist")}{unpack_text(TWIST, "twist_next", "_next")}{body_text(moved)}\
    return [{", ".join(moved.results)}]
'''
