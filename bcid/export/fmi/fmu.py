"""A model as FMUs for co-simulation: its C and a wrapper for each version, compiled where there is a C compiler.

An FMU needs nothing at run time but the C library.  It holds its sources, from which importers compile it for
computers of other kinds.
"""

from __future__ import annotations

import hashlib
import io
import platform
import sys
import tempfile
import uuid
import zipfile
from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path

from bcid.export.c_source import write_c_header, write_c_source
from bcid.export.check import compile_c, find_compiler
from bcid.export.exported import Exported
from bcid.export.fmi.description import describe_build, describe_fmi2, describe_fmi3

SYSTEM, LIBRARY = {"win32": ("windows", ".dll"), "darwin": ("darwin", ".dylib")}.get(sys.platform, ("linux", ".so"))
"""This operating system as FMI 3.0 calls it, and how names of its shared libraries end."""

PROCESSORS = {"amd64": "x86_64", "arm64": "aarch64"}
"""Kinds of processors that FMI 3.0 calls otherwise than `platform.machine` does."""

SHARED = ("-shared", "-fvisibility=hidden", *(() if SYSTEM == "windows" else ("-fPIC",)))
"""Flags for a shared library that shows no function but the interface's."""

ZIP_EPOCH = (1980, 1, 1, 0, 0, 0)
"""Date of all files in an FMU, so that the same model gives the same bytes."""
UNIX, TEXT_RIGHTS, LIBRARY_RIGHTS = 3, 0o100644, 0o100755

_MODEL_HEADER = """\
/* The model in this FMU, under names of mixed case, which none of its own has. */
#include "{name}.h"

#define Model_TOKEN "{token}"
#define Model_STATES {N}_STATES
#define Model_PERIOD_S {N}_PERIOD_S
#define Model_init {name}_init
#define Model_step {name}_step
#define Model_pose {name}_pose
"""


def write_fmus(e: Exported) -> dict[str, bytes]:
    """The bytes of NAME.fmu, of FMI 3.0, and of NAME_fmi2.fmu, of FMI 2.0.

    Each holds a shared library for this computer where a C compiler is found, and otherwise only sources.

    Raises:
        InputRefused: the sources do not compile, or not in time.
    """
    return {f"{e.name}.fmu": _write_fmu(e, 3), f"{e.name}_fmi2.fmu": _write_fmu(e, 2)}


def platform_folder(version: int) -> str:
    """The folder of an FMU, of version 2 or 3, in which shared libraries for this computer lie."""
    if version == 2:
        return f"binaries/{'win' if SYSTEM == 'windows' else SYSTEM}{64 if sys.maxsize > 2**32 else 32}"
    processor = platform.machine().lower()
    return f"binaries/{PROCESSORS.get(processor, processor)}-{SYSTEM}"


def write_texts(e: Exported, version: int) -> dict[str, str]:
    """The texts in an FMU of version 2 or 3 by their paths: its descriptions and its sources.

    They are told apart from all others by the token in them, which is a digest of the rest of them.
    """
    own = (f"fmu-fmi{version}.c", f"fmi{version}-interface.h", "fmu-vehicle.h")
    sources = {
        f"{e.name}.c": write_c_source(e),
        f"{e.name}.h": write_c_header(e),
        **{name: files("bcid.export.fmi").joinpath(name).read_text(encoding="utf-8") for name in own},
    }

    def with_token(token: str) -> dict[str, str]:
        header = _MODEL_HEADER.format(name=e.name, N=e.name.upper(), token=token)
        all_sources = sources | {"fmu-model.h": header}
        return _describe(e, version, token, sources) | {f"sources/{name}": all_sources[name] for name in all_sources}

    return with_token(_digest(with_token("")))


def _describe(e: Exported, version: int, token: str, sources: Mapping[str, str]) -> dict[str, str]:
    """The descriptions in an FMU of version 2 or 3 by their paths."""
    compiled = [name for name in sources if name.endswith(".c")]
    if version == 2:
        return {"modelDescription.xml": describe_fmi2(e, token, compiled)}
    return {
        "modelDescription.xml": describe_fmi3(e, token),
        "sources/buildDescription.xml": describe_build(e, compiled),
    }


def _digest(texts: Mapping[str, str]) -> str:
    """A digest of named texts, in the form of a UUID."""
    digest = hashlib.sha256("\0".join(f"{name}\0{text}" for name, text in texts.items()).encode())
    return str(uuid.UUID(bytes=digest.digest()[:16], version=5))


def _write_fmu(e: Exported, version: int) -> bytes:
    """The bytes of an FMU of version 2 or 3."""
    texts, compiler = write_texts(e, version), find_compiler()
    members = {path: text.encode() for path, text in texts.items()}
    if compiler is not None:
        members[f"{platform_folder(version)}/{e.name}{LIBRARY}"] = _compile(compiler, e.name, texts)
    return _zip(members)


def _compile(compiler: str, name: str, texts: Mapping[str, str]) -> bytes:
    """The shared library of the sources among `texts`.

    Raises:
        InputRefused: they do not compile, or not in time.
    """
    with tempfile.TemporaryDirectory() as folder:
        sources = {Path(path).name: text for path, text in texts.items() if path.startswith("sources/")}
        for file, text in sources.items():
            (Path(folder) / file).write_text(text, encoding="utf-8", newline="\n")
        library, compiled = f"{name}{LIBRARY}", [file for file in sources if file.endswith(".c")]
        compile_c(compiler, compiled, Path(folder).resolve() / library, "FMI", SHARED)
        return (Path(folder) / library).read_bytes()


def _zip(members: Mapping[str, bytes]) -> bytes:
    """A zip archive of `members` by their paths: the same bytes whenever it is made."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as fmu:
        for path, content in members.items():
            entry = zipfile.ZipInfo(path, ZIP_EPOCH)
            entry.compress_type, entry.create_system = zipfile.ZIP_DEFLATED, UNIX
            entry.external_attr = (LIBRARY_RIGHTS if path.endswith(LIBRARY) else TEXT_RIGHTS) << 16
            fmu.writestr(entry, content)
    return archive.getvalue()
