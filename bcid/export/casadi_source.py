"""A model in CasADi: one file whose functions take numbers, SX or MX, to be differentiated and optimised."""

from __future__ import annotations

from bcid.export.exported import Exported
from bcid.export.python_text import PythonDialect, write_python_module
from bcid.export.statements import Language

CASADI = Language(
    {
        "abs": "ca.fabs({0})", "min": "ca.fmin({0}, {1})", "max": "ca.fmax({0}, {1})", "floor": "ca.floor({0})",
        "sqrt": "root({0})", "exp": "ca.exp({0})", "sin": "ca.sin({0})", "cos": "ca.cos({0})",
        "atan": "ca.atan({0})", "atan2": "ca.atan2({0}, {1})", "tanh": "ca.tanh({0})", "hypot": "hypot({0}, {1})",
        "copysign": "ca.copysign({0}, {1})", "select": "ca.if_else({0}, {1}, {2})",
        "and": "ca.logic_and({0}, {1})", "or": "ca.logic_or({0}, {1})",
    },
    {}, "ca.inf",
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


_FUNCTION = '''

def step_function(symbol=ca.{symbol}.sym):
    """The step as a CasADi Function of (x, u), which gives (x_next, twist)."""
    x, u = symbol("x", len(STATES)), symbol("u", len(COMMANDS))
    return ca.Function("{name}_step", [x, u], list(step(x, u)), ["x", "u"], ["x_next", "twist"])
'''

DIALECT = PythonDialect(
    CASADI, "Columns of CasADi, or lists:", "import casadi as ca", f"\n\n{_HELPERS}", _NETWORK, table="ca.DM({})",
    result=("ca.vertcat(", ")"), columns=True,
)  # fmt: skip


def write_casadi_source(e: Exported) -> str:
    """The text of NAME_casadi.py, with `init`, `step` and `move` as in Python, and `step_function()`, a Function."""
    symbol = "MX" if e.formulas.networks else "SX"
    return write_python_module(e, DIALECT) + _FUNCTION.format(symbol=symbol, name=e.name)
