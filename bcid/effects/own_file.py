"""A user's file of effects: read, checked, and put into use beside the vocabulary.

The file is code, and it is the user's: nothing runs it but the option or setting that names it.  A model that holds
such effects is saved with a copy of the file and its digest, and read again only where that file was named, too.
"""

from __future__ import annotations

import ast
import hashlib
import importlib.abc
import traceback
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import CodeType, ModuleType

from bcid.effects.own import OwnEffect
from bcid.effects.own_checks import NEXT_STEP, find_problems
from bcid.effects.own_laws import LAWS, mark_of
from bcid.effects.table import further_effects
from bcid.errors import InputRefused, Problems
from bcid.files.regular import read_regular_file

MAX_FILE_BYTES = 1_000_000
"""A file of effects is a page or two of text."""

MODULES = ("__future__", "math", "numpy", "typing", "bcid")
"""What a file may import: the digest of its text must say all that its laws do."""


@dataclass(frozen=True)
class OwnFile:
    """A user's file of effects that was read and found right."""

    name: str
    text: str
    sha256: str
    effects: tuple[OwnEffect, ...]


IN_USE: list[OwnFile] = []
"""The file whose effects are in use in this process; none, or one."""


class _TextLoader(importlib.abc.InspectLoader):
    """Makes a module of a text that was read already, and writes nothing beside the file."""

    def __init__(self, path: Path, text: str) -> None:
        self._path, self._text = path, text

    def get_source(self, fullname: str) -> str:
        """The text of the module, whatever it is called."""
        return self._text

    def get_code(self, fullname: str) -> CodeType:
        """The text compiled, under the name of its file."""
        return self.source_to_code(self._text, str(self._path))


def read_own_effects(path: Path) -> OwnFile:
    """The effects that the Python file at `path` declares, after the file was run and each effect checked.

    Raises:
        InputRefused: there is no such file, it cannot be run, imports more than MODULES, declares no effect, or one
            that is wrong; all that is wrong is told at once.
    """
    try:
        content = read_regular_file(path, MAX_FILE_BYTES)
        text = content.decode("utf-8")
    except (OSError, ValueError) as error:
        raise InputRefused(path, "file of effects", f"cannot be read: {error}", "name a Python file") from None
    digest = hashlib.sha256(content).hexdigest()
    _refuse_imports(path, text)
    effects = _run(path, text, digest)
    if not effects:
        raise InputRefused(path, "file of effects", "declares no effect", f"put @effect(…) over a law; {NEXT_STEP}")
    problems = Problems()
    for effect in effects:
        problems.extend(find_problems(effect, digest))
    problems.raise_if_any(path)
    return OwnFile(path.name, text, digest, effects)


def _refuse_imports(path: Path, text: str) -> None:
    """Refuse (InputRefused) a text that is no Python, or imports other modules than MODULES."""
    try:
        tree = ast.parse(text, str(path))
    except (SyntaxError, ValueError) as error:
        line = getattr(error, "lineno", None)
        place = f"line {line}" if line else "file of effects"
        raise InputRefused(path, place, f"is no Python: {getattr(error, 'msg', error)}", "mend it") from None
    for node in ast.walk(tree):
        names = (
            [alias.name for alias in node.names] if isinstance(node, ast.Import)
            else ["." * node.level + (node.module or "")] if isinstance(node, ast.ImportFrom)
            else []
        )  # fmt: skip
        for name in names:
            if name.partition(".")[0] not in MODULES:
                cause = f"imports {name}; a file of effects has all that its laws compute in itself"
                raise InputRefused(path, f"line {node.lineno}", cause, f"import {', '.join(MODULES[1:])} alone")  # type: ignore[attr-defined]  # one of the two imports


def _run(path: Path, text: str, digest: str) -> tuple[OwnEffect, ...]:
    """The effects that a text declares, in their order, by running it.

    Raises:
        InputRefused: it raises an error, of which the line is told.
    """
    module, loader = ModuleType(f"own_effects_{digest[:16]}"), _TextLoader(path, text)
    try:
        loader.exec_module(module)
    # whatever the user's own code raises is the user's to read
    except Exception as error:
        lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
        place = f"line {lines[-1]}" if lines else "file of effects"
        raise InputRefused(path, place, f"{type(error).__name__}: {error}", f"mend it; {NEXT_STEP}") from None
    return tuple(value for value in vars(module).values() if isinstance(value, OwnEffect))


@contextmanager
def own_effects_in_use(file: OwnFile | None) -> Iterator[None]:
    """Context in which the effects of a user's `file`, if there is one, belong to the vocabulary of this process.

    Where the same file is in use already, nothing changes.

    Raises:
        UsageError: the effects of another file are in use.
    """
    if file is None or [other.sha256 for other in IN_USE] == [file.sha256]:
        yield
        return
    mark = mark_of(file.sha256)
    LAWS[mark] = tuple(effect.as_own_law() for effect in file.effects)
    with further_effects(file.effects, mark):
        IN_USE.append(file)
        try:
            yield
        finally:
            IN_USE.remove(file)


def file_of_effects(fields: Iterable[str]) -> OwnFile | None:
    """The file in use that declares one of the parameters `fields`, such as "my_effect__a"; None where none is one."""
    wanted = set(fields)
    return next((f for f in IN_USE if wanted & {field for e in f.effects for field in e.fields}), None)
