"""`njit` for the whole package: numba's, cached on disk under the content of a kernel's module and of its imports.

Numba's own cache looks only at the file that holds the compiled function, so that a kernel which has inlined
`bcid.physics.tyres` would go on running the old tyre after an edit there.  Here the key of a cached kernel is the
digest of its module and of all modules of this package that it imports, directly or not: an edit elsewhere, or of a
docstring, costs nothing.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self, TypeVar, cast

import numba
from numba.core.caching import CacheImpl, UserProvidedCacheLocator

from bcid.files.source_code import PACKAGE, digest_with_imports

F = TypeVar("F", bound=Callable[..., Any])


class _ImportsLocator(UserProvidedCacheLocator):
    """Where the kernels of one module of this package lie: a folder named after its source and its imports'."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        super().__init__(function, file)  # type: ignore[no-untyped-call]  # numba is not typed
        base = os.environ.get("NUMBA_CACHE_DIR") or str(PACKAGE / "__pycache__" / "numba")
        self._stamp = digest_with_imports(function.__module__)
        self._cache_path = str(Path(base) / f"{function.__module__}-{self._stamp[:16]}")

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> Self | None:
        """The locator of a function of this package; none of any other, whose imports are not known."""
        if not Path(py_file).is_relative_to(PACKAGE):
            return None
        locator = cls(py_func, py_file)
        try:
            locator.ensure_cache_path()  # type: ignore[no-untyped-call]
        except OSError:
            return None
        return locator

    def get_source_stamp(self) -> str:
        """The digest, in the place of that of the file alone."""
        return self._stamp

    def get_disambiguator(self) -> str:
        """Nothing: within a module a kernel is known by its qualified name, whatever line it stands on."""
        return "kernel"


CacheImpl._locator_classes.insert(0, _ImportsLocator)


def njit(function: F) -> F:
    """Compile `function` to machine code; `function.py_func` stays the plain Python reference."""
    return cast(F, numba.njit(cache=True, error_model="numpy")(function))


def njit_inline(function: F) -> F:
    """Compile `function` as `njit` does, always inlined: for what is handed a whole car several times a step."""
    return cast(F, numba.njit(cache=True, error_model="numpy", forceinline=True)(function))


def njit_sums(function: F) -> F:
    """Compile `function` as `njit_inline` does, for loops that add up.

    Sums may be taken in any order and products added without rounding first, so that they too become vector code.
    """
    fastmath = {"reassoc", "nsz", "contract"}
    return cast(F, numba.njit(cache=True, error_model="numpy", fastmath=fastmath, forceinline=True)(function))


def njit_parallel(function: F) -> F:
    """Compile `function` as `njit` does, with its `prange` loops spread over the cores."""
    return cast(F, numba.njit(cache=True, error_model="numpy", parallel=True)(function))
