"""`njit` for the whole package: numba's, cached on disk under the content of a kernel's module and of its imports.

Numba's own cache looks only at the file that holds the compiled function, so that a kernel which has inlined
`bcid.physics.tyres` would go on running the old tyre after an edit there.  Here the key of a cached kernel is the
digest of its module and of all modules of this package that it imports, directly or not: an edit elsewhere, or of a
docstring, costs nothing.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self, TypeVar, cast

import numba
from numba.core.caching import CacheImpl, UserProvidedCacheLocator

from bcid.files.source_code import PACKAGE, digest_with_imports

F = TypeVar("F", bound=Callable[..., Any])


class _ImportsLocator(UserProvidedCacheLocator):
    """Where the kernels of one module are cached: a folder named after the digest of its source and imports."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        super().__init__(function, file)  # type: ignore[no-untyped-call]  # numba is not typed
        base = os.environ.get("NUMBA_CACHE_DIR") or str(PACKAGE / "__pycache__" / "numba")
        # a function made of another module's code depends on both
        written_in = ".".join(Path(file).relative_to(PACKAGE.parent).with_suffix("").parts)
        self._stamp = digest_with_imports(function.__module__, written_in)
        self._cache_path = str(Path(base) / f"{function.__module__}-{self._stamp[:16]}")

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> Self | None:
        """The locator for a function of this package; None for any other, whose imports are not known."""
        if not Path(py_file).is_relative_to(PACKAGE):
            return None
        locator = cls(py_func, py_file)
        try:
            locator.ensure_cache_path()  # type: ignore[no-untyped-call]
        except OSError:
            return None
        return locator

    def get_source_stamp(self) -> str:
        """The digest of source and imports, where numba would look at the file alone."""
        return self._stamp

    def get_disambiguator(self) -> str:
        """A constant: within a module a kernel is known by its qualified name, whatever line it stands on."""
        return "kernel"


CacheImpl._locator_classes.insert(0, _ImportsLocator)


def _cached_compiler(**options: Any) -> Callable[[F], F]:
    """Decorator that compiles a function with numba's `options` and caches the machine code on disk.

    The cache holds until the function's module, or one that it imports, changes; `.py_func` stays plain Python.
    """
    return cast(Callable[[F], F], numba.njit(cache=True, error_model="numpy", **options))


njit = _cached_compiler()
njit_inline = _cached_compiler(forceinline=True)
"""For what is handed a whole car several times a step: such arguments are not copied where it is inlined."""
njit_sums = _cached_compiler(forceinline=True, fastmath={"reassoc", "nsz", "contract"})
"""For loops that add up: sums are taken in any order and products added unrounded, so that they become vector code."""
njit_parallel = _cached_compiler(parallel=True)
"""For `prange` loops, which are spread over the cores."""
