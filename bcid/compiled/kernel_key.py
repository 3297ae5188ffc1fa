"""What a compiled function is made of, as a digest: its own code, and all that the names in it stand for.

Compiled functions that it calls are part of it, with what they name in turn; so are the values of the constants that
it reads, and the fields of the tuples that it is given.  What it does not name is not, though it stand in the same
module: an edit there, or of a docstring or comment, leaves the digest as it is.
"""

import builtins
import hashlib
import re
import sys
from collections.abc import Iterator
from functools import cache
from types import CodeType, FunctionType, ModuleType
from typing import Any, get_args

import numpy as np
from numba.core.dispatcher import Dispatcher

from bcid.files.source_code import PACKAGE, digest_with_imports

KERNEL_OPTIONS = "kernel_options"
"""Name of the attribute of a Python function that tells with which options it is compiled."""

# they make machine code of every kernel: by operators too, which no kernel names
_COMPILER = ("bcid.compiled.njit", "bcid.compiled.lanes", "bcid.compiled.lane_access")


def kernel_digest(kernel: FunctionType) -> str:
    """SHA-256, in hex digits, of all that the machine code of the Python function `kernel` is made of.

    For a function that is not compiled, an intrinsic or an object of a class of this package, it holds the code of the
    whole module that defines it, with all modules that this one imports.
    """
    digest = hashlib.sha256(_compiler_digest().encode())
    for line in _function_lines(kernel, set()):
        digest.update(f"{line}\n".encode())
    return digest.hexdigest()


@cache
def _compiler_digest() -> str:
    """SHA-256 of the modules of this package that take part in making machine code of any function."""
    return digest_with_imports(*_COMPILER)


def _function_lines(function: FunctionType, seen: set[Any]) -> Iterator[str]:
    """Lines that describe the Python function `function`, and what it names, unless it is one of those `seen`."""
    options = getattr(function, KERNEL_OPTIONS, "")
    yield f"function {function.__module__}.{function.__qualname__} {function.__defaults__!r} {options}"
    if function in seen:
        return
    seen.add(function)
    yield from _code_lines(function.__code__, function.__doc__)
    for name, value in _named_values(function):
        yield f"name {name}"
        yield from _value_lines(value, seen)
    for hint in function.__annotations__.values():
        yield from _hint_lines(hint, function.__globals__, seen)


def _code_lines(code: CodeType, docstring: str | None = None) -> Iterator[str]:
    """Lines that describe Python's bytecode `code` without its `docstring` and the numbers of its lines."""
    yield f"code {code.co_code.hex()} {code.co_names} {code.co_varnames} {code.co_freevars} {code.co_cellvars}"
    constants = list(code.co_consts)
    if docstring is not None and constants and constants[0] == docstring:
        constants[0] = None
    for constant in constants:
        if isinstance(constant, CodeType):
            yield from _code_lines(constant)
        else:
            yield f"constant {_text(constant)}"


def _text(value: Any) -> str:
    """The text that Python prints for `value`; of a set, which has no order of its own, in alphabetical order."""
    return str(sorted(map(repr, value))) if isinstance(value, set | frozenset) else repr(value)


def _all_names(code: CodeType) -> set[str]:
    """Names of globals and of attributes in the bytecode `code` and in functions within it."""
    inner = (_all_names(constant) for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*inner)


def _named_values(function: FunctionType) -> Iterator[tuple[str, Any]]:
    """What the global names in a function stand for, with these names in order, then the variables it encloses.

    A module of this package stands for those of its attributes that the function names.
    """
    names = sorted(_all_names(function.__code__))
    for name in names:
        value = function.__globals__.get(name)
        if isinstance(value, ModuleType):
            if _is_ours(value.__name__):
                yield from ((f"{name}.{further}", getattr(value, further, None)) for further in names)
            else:
                yield name, value.__name__
        elif value is not None:
            yield name, value
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        yield name, cell.cell_contents


def _value_lines(value: Any, seen: set[Any]) -> Iterator[str]:
    """Lines that tell what a kernel takes from `value`, a global that it names, from what it takes from any other."""
    if isinstance(value, Dispatcher):
        yield f"compiled {[(name, _text(option)) for name, option in sorted(value.targetoptions.items())]}"
        yield from _function_lines(value.py_func, seen)
    elif isinstance(value, type) and hasattr(value, "_fields"):
        yield from _tuple_lines(value, seen)
    elif isinstance(value, tuple):
        if hasattr(value, "_fields"):
            yield from _tuple_lines(type(value), seen)
        yield f"values {type(value).__qualname__} {len(value)}"
        for item in value:
            yield from _value_lines(item, seen)
    elif isinstance(value, np.ndarray):
        yield f"array {value.dtype} {value.shape} {value.tobytes().hex()}"
    elif _is_ours(module := _module_of(value)):
        yield f"module {module} {digest_with_imports(module)}"
    else:
        named = hasattr(value, "__qualname__")
        yield f"value {value.__module__}.{value.__qualname__}" if named else f"value {type(value)} {value!r}"


def _tuple_lines(kind: Any, seen: set[Any]) -> Iterator[str]:
    """Lines that describe a class of tuples with names: its fields in order, and those of the tuples within it."""
    yield f"tuple {kind.__module__}.{kind.__qualname__} {kind._fields}"
    if kind not in seen:
        seen.add(kind)
        names = vars(sys.modules.get(kind.__module__, builtins))
        for hint in kind.__annotations__.values():
            yield from _hint_lines(hint, names, seen)


def _hint_lines(hint: Any, names: dict[str, Any], seen: set[Any]) -> Iterator[str]:
    """Lines that describe the classes of tuples in the annotation `hint`, which may be a text with global `names`."""
    if isinstance(hint, type) and hasattr(hint, "_fields"):
        yield from _tuple_lines(hint, seen)
        return
    for part in (names.get(word) for word in re.findall(r"\w+", hint)) if isinstance(hint, str) else get_args(hint):
        if not isinstance(part, str):
            yield from _hint_lines(part, names, seen)


def _module_of(value: Any) -> str:
    """Name of the module that defines `value` or, of an object without one, its class; of a module, its own."""
    if isinstance(value, ModuleType):
        return value.__name__
    return getattr(value, "__module__", None) or type(value).__module__


def _is_ours(module: str) -> bool:
    """Whether `module` is this package or a module in it."""
    return module.split(".", maxsplit=1)[0] == PACKAGE.name
