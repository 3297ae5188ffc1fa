"""One text of an equation, compiled more than once: with other functions beneath it, or in single precision."""

from collections.abc import Mapping
from types import FunctionType
from typing import Any, TypeVar

import numpy as np

from bcid.compiled.njit import recompile

F = TypeVar("F")


def rebuild(function: F, exchanged: Mapping[Any, Any], module: str, single: bool = False) -> F:
    """The compiled `function` anew: wherever it or what it calls calls a key of `exchanged`, it calls the value.

    All compiled functions on the way are rebuilt with the options they have.  If `single`, the numbers in the texts of
    all of them are of single precision, so that arguments of single precision give results of it.  `module` is the name
    of the caller's module, under whose key the machine code is cached.
    """
    copies = Copies({}, module, single)
    for old, new in exchanged.items():
        copies.made[old] = copies.copy(new) or new
    rebuilt: F = copies.copy(function) or function
    return rebuilt


class Copies:
    """Copies of compiled functions, by the function they stand for; None where that stays as it is."""

    def __init__(self, made: dict[Any, Any], module: str, single: bool) -> None:
        self.made, self.module, self.single = made, module, single

    def copy(self, function: Any) -> Any:
        """A copy of the compiled `function` that calls copies, made on demand; None where nothing in it changes."""
        if function not in self.made:
            plain = function.py_func
            code, globals_ = plain.__code__, plain.__globals__
            used = {n: globals_[n] for n in code.co_names if n in globals_}
            others = {n: self.copy(f) for n, f in used.items() if hasattr(f, "py_func")}
            others = {n: f for n, f in others.items() if f is not None}
            if self.single:
                others |= {n: np.float32(x) for n, x in used.items() if isinstance(x, float)}
            numbers = self.single and any(isinstance(x, float) for x in code.co_consts)
            self.made[function] = None
            if others or numbers:
                constants = tuple(np.float32(x) if numbers and isinstance(x, float) else x for x in code.co_consts)
                copy = FunctionType(code.replace(co_consts=constants), {**globals_, **others, "__name__": self.module})
                copy.__annotations__, copy.__defaults__ = plain.__annotations__, plain.__defaults__
                # under which it is cached
                copy.__qualname__ = (
                    f"{plain.__module__}.{plain.__qualname__}_{'single' if self.single else 'exchanged'}"
                )
                self.made[function] = recompile(function, copy)
        return self.made[function]
