"""Machine code of kernels on disk, each under the digest of what it is made of (`kernel_key`).

Numba's own cache looks only at the file that holds the compiled function, so that a kernel which has inlined
`bcid.physics.tyres` would go on running the old tyre after an edit there.

The cache is in the folder NUMBA_CACHE_DIR, or else in the package, or where that is read-only in the user's folder for
caches.  Where none of them can be written to, kernels are compiled anew in every process, and one line says so; a file
that cannot be read, for it is damaged, is written anew.
"""

import os
import sys
import tempfile
from collections.abc import Iterator
from functools import cache, cached_property
from multiprocessing import parent_process
from pathlib import Path
from types import FunctionType
from typing import Any, Self

from numba.core.caching import CompileResultCacheImpl, FunctionCache, UserProvidedCacheLocator

from bcid.compiled.kernel_key import kernel_digest
from bcid.files.source_code import PACKAGE

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
    if folder is None:
        named = os.environ.get(CACHE_VARIABLE)
        _warn(f"{named!r} cannot be written to" if named else "the installation and the home are read-only")
    return folder


@cache
def _warn(cause: str) -> None:
    """Say once on stderr that kernels are not kept because of `cause`; processes that this one starts say nothing."""
    if parent_process() is None:
        text = f"{cause}: functions are compiled anew in every run; let {CACHE_VARIABLE} name a folder of your own"
        print(f"warning: {text}", file=sys.stderr)  # noqa: T201


class _KernelLocator(UserProvidedCacheLocator):
    """Where the machine code of one kernel is kept: a folder named after the digest of what it is made of."""

    def __init__(self, function: FunctionType, file: str) -> None:
        super().__init__(function, file)  # type: ignore[no-untyped-call]  # numba is not typed
        self._stamp = kernel_digest(function)
        folder = find_cache_folder() or PACKAGE
        self._cache_path = str(folder / f"{function.__module__}.{function.__qualname__}-{self._stamp[:16]}")

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Self:
        """The locator for the Python function of a kernel."""
        return cls(py_func, py_file)

    def get_source_stamp(self) -> str:
        """The digest of what the kernel is made of, where numba would look at the file alone."""
        return self._stamp

    def get_disambiguator(self) -> str:
        """A constant: a kernel is known by its qualified name, whatever line it stands on."""
        return "kernel"


class _KernelFilesRules(CompileResultCacheImpl):
    """How numba writes and reads machine code, and where."""

    _locator_classes = [_KernelLocator]  # noqa: RUF012  # as numba declares it


class _KernelFiles(FunctionCache):
    """The files of one kernel."""

    _impl_class = _KernelFilesRules


class KernelCache:
    """What numba asks for a kernel's machine code before it compiles, and gives it to afterwards.

    The files are looked for when the kernel is first called: only then is all defined that it names.
    """

    def __init__(self, function: FunctionType) -> None:
        self._function = function

    @cached_property
    def _files(self) -> Any:
        """Numba's cache in the kernel's folder; None where nothing can be written."""
        return _KernelFiles(self._function) if find_cache_folder() else None  # type: ignore[no-untyped-call]

    @property
    def cache_path(self) -> str | None:
        """The kernel's folder."""
        return self._files.cache_path if self._files else None

    def load_overload(self, signature: Any, context: Any) -> Any:
        """The kernel compiled for a numba `signature`, connected with numba's `context`; None where it is not kept."""
        if not self._files:
            return None
        try:
            return self._files.load_overload(signature, context)
        # whatever unpickling raises for a file that was cut off or overwritten
        except Exception:
            return None

    def save_overload(self, signature: Any, compiled: Any) -> None:
        """Keep the kernel `compiled` for a numba `signature`; say so on stderr where the disk does not take it."""
        if self._files:
            try:
                self._files.save_overload(signature, compiled)
            except OSError as error:
                _warn(str(error))

    def flush(self) -> None:
        """Forget what is kept of the kernel, for all signatures."""
        if self._files:
            self._files.flush()
