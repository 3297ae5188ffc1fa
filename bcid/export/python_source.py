"""A model in Python: one file of plain numbers, `math` and lists, that needs nothing else."""

from __future__ import annotations

from bcid.export.exported import Exported
from bcid.export.python_text import PythonDialect, write_python_module
from bcid.export.statements import Language

PYTHON = Language(
    {
        "abs": "abs({0})", "min": "min({0}, {1})", "max": "max({0}, {1})", "floor": "math.floor({0})",
        "sqrt": "math.sqrt({0})", "exp": "math.exp({0})", "sin": "math.sin({0})", "cos": "math.cos({0})",
        "atan": "math.atan({0})", "atan2": "math.atan2({0}, {1})", "tanh": "math.tanh({0})",
        "hypot": "math.hypot({0}, {1})", "copysign": "math.copysign({0}, {1})", "select": "{1} if {0} else {2}",
    },
    {}, "math.inf", selection=1,
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


DIALECT = PythonDialect(
    PYTHON, "All are lists of floats:", "import math  # noqa: F401", "", _NETWORK, table="{}", result=("[", "]"),
    columns=False,
)  # fmt: skip


def write_python_source(e: Exported) -> str:
    """The text of NAME.py, with `init(pose, twist, delta)`, `step(x, u)` and `move(pose, twist, twist_next)`."""
    return write_python_module(e, DIALECT)
