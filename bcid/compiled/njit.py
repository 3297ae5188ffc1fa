"""`njit` for the whole package: numba's, cached on disk under the content of a kernel's module and of its imports.

Numba's own cache looks only at the file that holds the compiled function, so that a kernel which has inlined
`bcid.physics.tyres` would go on running the old tyre after an edit there.  Here the key of a cached kernel is the
digest of its module and of all modules of this package that it imports, directly or not: an edit elsewhere, or of a
docstring, costs nothing.

The cache is in the folder NUMBA_CACHE_DIR, or else in the package, or where that is read-only in the user's folder for
caches.  Where none of them can be written to, kernels are compiled anew in every process, and one line says so.
"""

import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from multiprocessing import parent_process
from pathlib import Path
from typing import Any, Self, TypeVar, cast

import numba
from numba.core.caching import CacheImpl, UserProvidedCacheLocator

from bcid.files.source_code import PACKAGE, digest_with_imports

F = TypeVar("F", bound=Callable[..., Any])


CACHE_VARIABLE = "NUMBA_CACHE_DIR"


def _candidate_folders() -> Iterator[Path]:
    """Folders in which compiled kernels may be kept, in order; the only one is NUMBA_CACHE_DIR where that is set."""
    if os.environ.get(CACHE_VARIABLE):
        yield Path(os.environ[CACHE_VARIABLE])
        return
    yield PACKAGE / "__pycache__" / "numba"
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    if os.path.isabs(home):  # without a home "~" stands for itself
        yield Path(home) / "bcid" / "numba"


def _is_writable(folder: Path) -> bool:
    """Whether `folder` is there, or can be made, and files can be written into it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except (OSError, ValueError):
        return False


@cache
def find_cache_folder() -> Path | None:
    """The folder in which compiled kernels are kept; None where none can be written to, which is said on stderr once.

    Processes that this one starts say nothing.
    """
    folder = next((f for f in _candidate_folders() if _is_writable(f)), None)
    if folder is None and parent_process() is None:
        named = os.environ.get(CACHE_VARIABLE)
        cause = f"{named!r} cannot be written to" if named else "the installation and the home are read-only"
        text = f"{cause}: functions are compiled anew in every run; let {CACHE_VARIABLE} name a folder of your own"
        print(f"warning: {text}", file=sys.stderr)  # noqa: T201
    return folder


class _ImportsLocator(UserProvidedCacheLocator):
    """Where the kernels of one module are cached: a folder named after the digest of its source and imports."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        super().__init__(function, file)  # type: ignore[no-untyped-call]  # numba is not typed
        base = find_cache_folder() or PACKAGE
        # a function made of another module's code depends on both
        written_in = ".".join(Path(file).relative_to(PACKAGE.parent).with_suffix("").parts)
        self._stamp = digest_with_imports(function.__module__, written_in)
        self._cache_path = str(base / f"{function.__module__}-{self._stamp[:16]}")

    @classmethod
    def from_function(cls, py_func: Callable[..., Any], py_file: str) -> Self | None:
        """The locator for a function of this package; None for any other, whose imports are not known."""
        return cls(py_func, py_file) if Path(py_file).is_relative_to(PACKAGE) else None

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
    is_kept = find_cache_folder() is not None
    return cast(Callable[[F], F], numba.njit(cache=is_kept, error_model="numpy", **options))


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
