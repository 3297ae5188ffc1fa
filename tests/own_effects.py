"""Files of effects of a user's own, for tests: some that are right, and many that are not."""

from __future__ import annotations

from pathlib import Path

from bcid.effects.own_file import OwnFile, read_own_effects

_PAGE = Path(__file__).parents[1] / "docs/own_effects.md"
MAGNET = _PAGE.read_text(encoding="utf-8").partition("```python\n")[2].partition("```")[0]
"""The complete file of docs/own_effects.md: magnets that pull the car to the line x = 1 m."""

ACTUATORS = '''\
"""A worn servo horn, and a motor that grows warm."""

from bcid.effects.own import Parameter, compiled, effect, where


@compiled
def share_of_time(t, T):
    return min(t / T, 1.0)


@effect("δ_w = (1 + a·[δ > 0])·δ", channel="steering", parameters=(Parameter("a", "1", -0.5, 0.5, 0.1, "excess"),))
def worn_horn(delta, a):
    return where(delta > 0.0, (1.0 + a) * delta, delta)


@effect("F_m·(1 − s·(t/T)²)", channel="motor", parameters=(Parameter("s", "1", 0.0, 0.9, 0.2, "share lost"),))
def warm_motor(F_m, t, T, s):
    x = share_of_time(t, T)
    return F_m * (1.0 - s * x * x)


@effect("F_x −= b·v_x·|v_y|", channel="fx", parameters=(Parameter("b", "kg m^-1", 0.0, 90.0, 5.0, "drag"),))
def oblique_drag(v_x, v_y, b):
    return -b * v_x * abs(v_y)
'''

_HEAD = "import math\nfrom bcid.effects.own import Constant, Parameter, effect, where\n"
_C = 'Parameter("c", "kg s^-1", 0.0, 90.0, 5.0, "drag")'


def _place(symbol: str) -> str:
    """The declaration of a place (m)."""
    return f', Parameter("{symbol}", "m", 0.5, 9.0, 1.0, "where", is_place=True)'


def file_with(law: str, arguments: str = "v_x, c", parameters: str = _C, **more: str) -> str:
    """The text of a file with one effect of a `law`, the expression that it returns, on the channel "fx"."""
    given = {"channel": '"fx"'} | more
    options = ", ".join(f"{name}={value}" for name, value in given.items())
    declared = f'@effect("F_x", parameters=({parameters},), {options})'
    return f"{_HEAD}{declared}\ndef own_drag({arguments}):\n    return {law}\n"


DRAG = file_with("-c * v_x")
REFUSED = {
    "no Python": ("def f(:\n    pass\n", "line 1: is no Python"),
    "raises": (_HEAD + "x = 1\nx = 1 / 0\n", "line 4: ZeroDivisionError"),
    "imports": ("import os\n" + DRAG, "line 1: imports os"),
    "imports inside": (DRAG.replace("    return", "    import socket\n    return"), "imports socket"),
    "no effect": ("x = 1\n", "declares no effect"),
    "lacks channel": (DRAG.replace(', channel="fx"', ""), "missing 1 required keyword-only argument: 'channel'"),
    "name taken": (DRAG.replace("own_drag", "yaw_scrub"), "the vocabulary has an effect of this name"),
    "name that parts": (DRAG.replace("own_drag", "own__drag"), "two in a row"),
    "channel": (DRAG.replace('"fx"', '"pose"'), "its channel 'pose' is none of"),
    "look-alike": (file_with("-c * v_x", looks_like='("windmill",)'), "windmill, which the vocabulary does not have"),
    "unknown argument": (file_with("-c * vx", "vx, c"), "its law takes vx"),
    "unused parameter": (file_with("-v_x", "v_x"), "its law takes no c"),
    "quantity as symbol": (DRAG.replace('"c"', '"m"').replace("v_x, c", "v_x, m").replace("-c", "-m"), "m stands for"),
    "quantity of another channel": (file_with("-c * v_w", "v_w, c"), "v_w, which is no parameter"),
    "bounds without zero": (DRAG.replace("0.0, 90.0", "1.0, 90.0"), "must be off at zero"),
    "bounds in turn": (DRAG.replace("0.0, 90.0", "90.0, 0.0"), "is bound by 90 and 0"),
    "size outside": (DRAG.replace("90.0, 5.0", "90.0, 95.0"), "has the size 95"),
    "unit": (DRAG.replace("kg s^-1", "N s/m"), "has the unit 'N s/m'"),
    "wrong unit": (DRAG.replace("kg s^-1", "kg m^-1"), "its units do not fit"),
    "number with a unit": (file_with("-c * math.tanh(v_x / 0.05)"), "its units do not fit"),
    "not finite": (file_with("-c * v_x / (v_x - v_x)"), "ZeroDivisionError"),
    "infinite": (file_with("-c * v_x * math.inf"), "not finite"),
    "not zero where off": (file_with("-c * v_x - m * v_x * v_x / 1e9", "v_x, m, c"), "to the last bit"),
    "jumps": (file_with("where(c > 0.0, -5.0 * m * v_x / T, 0.0)", "v_x, m, T, c"), "it jumps"),
    "shape alone": (
        file_with("-c * v_x * s", "v_x, c, s", _C + ', Parameter("s", "1", -9.0, 9.0, 1.0, "shape")'),
        "parameter c alone, at its size, changes nothing",
    ),
    "unknown place": (
        file_with("-c * v_x * (p_x > x)", "p_x, v_x, c, x", _C + _place("x")),
        "none that a diagnosis can search for",
    ),
    "beyond its circle": (
        file_with(
            "-c * v_x + 0.0 * (x + y + radius)", "v_x, c, x, y, radius",
            _C + _place("x") + _place("y") + _place("radius"),
        ),
        "it acts outside of its circle",
    ),
    "three numbers": (file_with("(c * v_x, 0.0, 0.0)"), "returns a number, not tuple"),
    "one number": (DRAG.replace('"fx"', '"any"'), "returns three numbers"),
    "branches": (file_with("-c * v_x if v_x > 0.0 else 0.0"), "it branches on a quantity; write where"),
    "unknown function": (file_with("-c * v_x * math.cos(delta)", "v_x, delta, c"), "cos is not known there"),
    "power": (file_with("-c * v_x ** 1", "v_x, c"), "pow is not known there"),
    "mixed": (
        file_with("-c * v_x + helper()").replace("@effect", "def helper():\n    return 0.0\n\n@effect"),
        "it names helper, which is not compiled",
    ),
}  # fmt: skip
"""Texts of files that are refused, and what is said of each."""


def own_file(folder: Path, text: str | bytes) -> OwnFile:
    """The effects that effects.py in `folder` declares, after this text is written to it if there is a folder."""
    path = folder / "effects.py"
    if folder.is_dir():
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_own_effects(path)
