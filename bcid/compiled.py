"""`njit` for the whole package: numba's, cached on disk under a key that covers every source file.

Numba's own cache looks only at the file that holds the compiled function, so a kernel that has inlined
`bcid.physics.tyres` would go on running the old tyre after an edit there.  The cache folder therefore
carries a digest of all of bcid's sources in its name.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])

_PACKAGE = Path(__file__).parent


def _sources_digest() -> str:
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        digest.update(str(path.relative_to(_PACKAGE)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


_base = os.environ.get("NUMBA_CACHE_DIR") or str(_PACKAGE / "__pycache__" / "numba")
setattr(numba.config, "CACHE_DIR", str(Path(_base) / _sources_digest()))  # noqa: B010  # mypy does not see it


def njit(function: F) -> F:
    """Compile `function` to machine code; `function.py_func` stays the plain Python reference."""
    return cast(F, numba.njit(cache=True, error_model="numpy")(function))


def njit_inline(function: F) -> F:
    """The same, always inlined: for functions that are handed a whole car and called several times a step."""
    return cast(F, numba.njit(cache=True, error_model="numpy", forceinline=True)(function))


def njit_sums(function: F) -> F:
    """The same, always inlined, for loops that add up.

    Sums may be taken in any order and products added without rounding first, so that they too become vector code.
    """
    fastmath = {"reassoc", "nsz", "contract"}
    return cast(F, numba.njit(cache=True, error_model="numpy", fastmath=fastmath, forceinline=True)(function))


def njit_parallel(function: F) -> F:
    """The same with `prange` loops spread over the cores."""
    return cast(F, numba.njit(cache=True, error_model="numpy", parallel=True)(function))
