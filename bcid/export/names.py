"""What the files and functions of an export may be called."""

from __future__ import annotations

import keyword
import re
import sys

from bcid.errors import UsageError
from bcid.files.names import is_device_name
from bcid.libraries import EXTRAS

NAME = re.compile(r"[a-z][a-z0-9_]{0,62}")
"""What can be a name in all languages, and of files."""

KEYWORDS_OF_C = frozenset({
    "auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern", "float",
    "for", "goto", "if", "inline", "int", "long", "register", "restrict", "return", "short", "signed", "sizeof",
    "static", "struct", "switch", "typedef", "union", "unsigned", "void", "volatile", "while",
})  # fmt: skip
OTHER_LIBRARIES = frozenset({"numpy", "acados_template", "rclpy", "nav_msgs", "std_msgs", "bcid"})
"""What an exported file imports, or what imports it, besides the extras' libraries."""


def check_name(name: str) -> str:
    """`name`, if files, modules of Python and functions of C can be called so.

    Raises:
        UsageError: they cannot, or another module has that name, in whose place NAME.py would be imported.
    """
    if not NAME.fullmatch(name):
        raise UsageError(
            f"{name!r} cannot be a name in C, Python and of files\n"
            "  next: use small letters, digits and _, a letter first"
        )
    if is_device_name(name):
        raise UsageError(f"{name!r} cannot be a name: {name}.c is no file on Windows\n  next: choose another --name")
    if keyword.iskeyword(name) or name in KEYWORDS_OF_C:
        raise UsageError(f"{name!r} cannot be a name: it is a word of C or of Python\n  next: choose another --name")
    if name in sys.stdlib_module_names or name in EXTRAS or name in OTHER_LIBRARIES:
        raise UsageError(
            f"{name!r} cannot be a name: {name}.py would be imported in place of the module of that name\n"
            "  next: choose another --name"
        )
    return name
