"""A model in CasADi: one file whose functions take numbers, SX or MX, to be differentiated and optimised."""

from __future__ import annotations

import math

from bcid.export.exported import Exported
from bcid.export.formulas import COMMANDS, POSE, START, STEERED, TWIST
from bcid.export.pose_formulas import trace_pose
from bcid.export.python_text import body_text, constants_text, quantities_text, tables_text, tuple_text, unpack_text
from bcid.export.statements import NETWORK_FORMULA, Language, write_program

CASADI = Language(
    {
        "abs": "ca.fabs({0})", "min": "ca.fmin({0}, {1})", "max": "ca.fmax({0}, {1})", "floor": "ca.floor({0})",
        "sqrt": "root({0})", "exp": "ca.exp({0})", "sin": "ca.sin({0})", "cos": "ca.cos({0})",
        "atan": "ca.atan({0})", "atan2": "ca.atan2({0}, {1})", "tanh": "ca.tanh({0})", "hypot": "hypot({0}, {1})",
        "copysign": "ca.copysign({0}, {1})", "select": "ca.if_else({0}, {1}, {2})",
        "and": "ca.logic_and({0}, {1})", "or": "ca.logic_or({0}, {1})",
    },
    {}, lambda value: repr(value) if math.isfinite(value) else ("-" if value < 0.0 else "") + "ca.inf",
)  # fmt: skip

_HELPERS = '''\
def column(x):
    """A list of numbers or symbols as a column of CasADi; what is one stays as it is."""
    return x if isinstance(x, (ca.DM, ca.SX, ca.MX)) else ca.vertcat(*x)


def root(x):
    """The square root, with the derivative 0 at 0."""
    return ca.if_else(x == 0.0, 0.0, ca.sqrt(ca.if_else(x == 0.0, 1.0, x)))


def hypot(a, b):
    """sqrt(a^2 + b^2), with the derivative 0 where both are 0."""
    return root(a * a + b * b)
'''

_NETWORK = '''

def {name}(x):
    """{formula}."""
    h = (column(x) - {name}_x_mean) / {name}_x_sd
    for W, b in (({name}_W1, {name}_b1), ({name}_W2, {name}_b2)):
        h = ca.fmax(ca.mtimes(W, h) + b, 0.0)
    return {name}_y_mean + {name}_y_sd * (ca.mtimes({name}_W3, h) + {name}_b3)
'''


def write_casadi_source(e: Exported) -> str:
    """The text of NAME_casadi.py, with `init`, `step` and `move` as in Python, and `step_function()`, a Function."""
    name, formulas = e.name, e.formulas
    step = write_program(formulas.results, CASADI)
    init = write_program(formulas.first_states, CASADI)
    moved = write_program(trace_pose(formulas.period_s), CASADI)
    n = len(formulas.states)
    networks = "".join(
        tables_text(k, w, "ca.DM({})") + _NETWORK.format(name=k, formula=NETWORK_FORMULA)
        for k, w in formulas.networks.items()
    )
    next_states = "".join(f"        {text},\n" for text in step.results[:n])
    return f'''\
"""{e.about}

Columns of CasADi, or lists: a state `x`, see STATES; a command `u`, see COMMANDS, held for PERIOD_S seconds; a pose
[p_x, p_y (m), theta (rad)] in the world; a twist [v_x, v_y (m/s), yaw rate (rad/s)], x ahead, y left.
Poses and twists are of the {e.point}.

{quantities_text(formulas.states, e.commands)}"""

import casadi as ca

PERIOD_S = {formulas.period_s!r}
STATES = {tuple_text([q.name for q in formulas.states])}
COMMANDS = {tuple_text([q.name for q in COMMANDS])}

{constants_text(step, init)}

{_HELPERS}{networks}

def init(pose, twist, delta):
    """The state of a vehicle whose past is not known: it coasts, its wheel held at delta (rad)."""
    pose, twist, delta = column(pose), column(twist), ca.vertcat(delta)
{unpack_text(START[:3], "pose")}{unpack_text(START[3:6], "twist")}    {STEERED.name}_0 = delta
{body_text(init)}    return ca.vertcat({", ".join(init.results)})


def step(x, u):
    """One period: the state after it, and the twist there."""
    x, u = column(x), column(u)
{unpack_text(formulas.states, "x")}{unpack_text(COMMANDS, "u")}{body_text(step)}    x_next = ca.vertcat(
{next_states}    )
    return x_next, ca.vertcat({", ".join(step.results[n:])})


def move(pose, twist, twist_next):
    """The pose one period later, from the twists before and after it, by the trapezoidal rule."""
    pose, twist, twist_next = column(pose), column(twist), column(twist_next)
{unpack_text(POSE, "pose")}{unpack_text(TWIST, "twist")}{unpack_text(TWIST, "twist_next", "_next")}{body_text(moved)}\
    return ca.vertcat({", ".join(moved.results)})


def step_function(symbol=ca.{"MX" if formulas.networks else "SX"}.sym):
    """The step as a CasADi Function of (x, u), which gives (x_next, twist)."""
    x, u = symbol("x", len(STATES)), symbol("u", len(COMMANDS))
    return ca.Function("{name}_step", [x, u], list(step(x, u)), ["x", "u"], ["x_next", "twist"])
'''
