"""`njit` for the whole package: numba's, with machine code made late (`late_code`) and kept on disk (`kernel_cache`).

A function is compiled in two ways: as an entry, which Python calls, with machine code of its own and all that it calls
in it; and as a part of other compiled functions.  Only entries are kept on disk, each under the digest of its own code
and of all that it calls and reads (`kernel_key`).
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core.dispatcher import Dispatcher

from bcid.compiled.kernel_cache import KernelCache
from bcid.compiled.kernel_key import KERNEL_OPTIONS
from bcid.compiled.late_code import install_late_code

F = TypeVar("F", bound=Callable[..., Any])

install_late_code()


def _cached_compiler(**options: Any) -> Callable[[F], F]:
    """Decorator that compiles a function with numba's `options` and keeps the machine code on disk.

    What is kept holds until the function changes, or something that it calls or reads; `.py_func` stays plain Python.
    """
    # these options are not in numba's declared ones
    numba_njit: Any = numba.njit
    compiled = numba_njit(error_model="numpy", no_cfunc_wrapper=True, **options)
    part = numba_njit(error_model="numpy", no_cfunc_wrapper=True, no_cpython_wrapper=True, **options)

    def compile_both_ways(function: F) -> F:
        """The entry of a function, in place of which other compiled functions are given the part."""
        # a set prints in any order
        told = sorted((name, str(sorted(x) if isinstance(x, set) else x)) for name, x in options.items())
        setattr(function, KERNEL_OPTIONS, str(told))
        entry, within = compiled(function), part(function)
        # a plain function where numba is told to compile nothing (NUMBA_DISABLE_JIT)
        if isinstance(entry, Dispatcher):
            _give_to_compiled_callers(entry, within)
        return cast(F, entry)

    return compile_both_ways


def _give_to_compiled_callers(entry: Any, within: Any) -> None:
    """Let compiled functions that name `entry` call `within` instead, and keep `entry` on disk alone."""
    entry.get_call_template, entry.get_overload = within.get_call_template, within.get_overload
    entry._cache = KernelCache(entry.py_func)


njit = _cached_compiler()
njit_inline = _cached_compiler(forceinline=True)
"""For what is handed a whole car several times a step: such arguments are not copied where it is inlined."""
njit_sums = _cached_compiler(forceinline=True, fastmath={"reassoc", "nsz", "contract"})
"""For loops that add up: sums are taken in any order and products added unrounded, so that they become vector code."""
njit_parallel = _cached_compiler(parallel=True)
"""For `prange` loops, which are spread over the cores."""


def recompile(function: Any, plain: F) -> F:
    """Compile the Python function `plain` with the options with which the compiled `function` was."""
    kept = ("forceinline", "fastmath", "parallel")
    return _cached_compiler(**{k: v for k, v in function.targetoptions.items() if k in kept})(plain)
