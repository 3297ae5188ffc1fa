"""C code for peers: compiled while the benchmark runs, as an expert would, and called through ctypes."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bcid.bench.timing import PeerMissing

FLAGS = ("-O3", "-march=native", "-ffast-math", "-fopenmp-simd", "-fPIC")
# The widest vector registers, which compilers do not use by themselves.
WIDE = ("-mprefer-vector-width=512",)
SOURCES = Path(__file__).parent


def load_c(source: str, options: Sequence[str] = ()) -> ctypes.CDLL:
    """Compile the C text `source` with FLAGS and `options`; return the library.

    Raises:
        PeerMissing: there is no compiler, or it cannot compile the text.
    """
    compiler = shutil.which("cc")
    if compiler is None:
        raise PeerMissing("no C compiler (cc) here")
    with tempfile.TemporaryDirectory() as folder:
        text, code, library = (Path(folder) / name for name in ("peer.c", "peer.o", "peer.so"))
        text.write_text(source, encoding="utf-8")
        # a compiler for other processors knows no width of registers
        for wide in (WIDE, ()):
            # linked by itself: with -ffast-math a library sets small numbers to zero in the whole process
            for command in (
                [compiler, *FLAGS, *wide, *options, "-c", str(text), "-o", str(code)],
                [compiler, "-shared", str(code), "-o", str(library), "-lm"],
            ):
                done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
                if done.returncode != 0:
                    break
            else:
                return ctypes.CDLL(str(library))
    raise PeerMissing(f"cc does not compile the peer: {done.stderr.strip().splitlines()[-1:]}")


def load_source(name: str, options: Sequence[str] = ()) -> ctypes.CDLL:
    """Compile the C file `name` beside this module; return the library."""
    return load_c((SOURCES / name).read_text(encoding="utf-8"), options)


def pointer(array: Any) -> ctypes.c_void_p:
    """The address of an array's numbers, which must lie together."""
    if not array.flags.c_contiguous:
        raise ValueError("only an array whose numbers lie together has an address")
    return ctypes.c_void_p(array.ctypes.data)


def numbers(values: Any) -> Any:
    """`values` as an array of doubles that lie together."""
    return np.ascontiguousarray(values, dtype=np.float64)
