"""A digest of the code that a stage runs: its module and, through its imports, everything that it calls."""

import ast
import contextlib
import hashlib
import importlib.metadata
import json
import os
import platform
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

PACKAGE = Path(__file__).parent.parent
_ROOT = PACKAGE.parent
_PACKAGE = PACKAGE.name
_MAX_KEPT_FILES = 2000
_DISTRIBUTION = {"mcap_ros2": "mcap-ros2-support", "mcap_protobuf": "mcap-protobuf-support"}


class StageCode(NamedTuple):
    """What code a pipeline stage runs: a digest of its sources, and the versions of libraries."""

    digest: str
    packages: dict[str, str]  # version by name of the libraries that it imports


class _ModuleCode(NamedTuple):
    """Digest and imports of one module."""

    digest: str
    inside: frozenset[str]  # imported modules of this package
    outside: frozenset[str]  # imported top-level names of others


@cache
def _module_path(module: str) -> Path | None:
    """The file of this package's `module`, such as "bcid.effects.table"; None where there is none."""
    base = _ROOT.joinpath(*module.split("."))
    return next((p for p in (base.with_suffix(".py"), base / "__init__.py") if p.exists()), None)


@cache
def _read_module(name: str) -> _ModuleCode:
    """Digest of the module `name`, and the modules that it imports anywhere in its file.

    For an `__init__`, the page templates (*.j2) in its folder are included in the digest.
    """
    path = _module_path(name)
    if path is None:
        raise ModuleNotFoundError(name)
    syntax = _PARSED_FILES.parse(path.read_bytes())
    known = {imported for imported in syntax.imports if imported.split(".")[0] == _PACKAGE}
    inside = {imported for imported in known if _module_path(imported) is not None}
    outside = {imported.split(".")[0] for imported in set(syntax.imports) - known}
    digest, templates = syntax.digest, sorted(path.parent.glob("*.j2")) if path.name == "__init__.py" else []
    if templates:
        digest = hashlib.sha256(b"".join([digest.encode(), *(t.read_bytes() for t in templates)])).hexdigest()
    parents = {name.rpartition(".")[0]} - {""}
    return _ModuleCode(digest, frozenset(inside | parents), frozenset(outside))


class _Syntax(NamedTuple):
    """What a source file says: the SHA-256 of its syntax without docstrings, and all that it may import, sorted."""

    digest: str
    imports: list[str]


def _parse_source(source: bytes) -> _Syntax:
    """The syntax of the Python file with the content `source`."""
    tree, imports = ast.parse(source), set[str]()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imports.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            imports.update([node.module, *(f"{node.module}.{alias.name}" for alias in node.names)])
        elif isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body[0] = ast.Pass()
    return _Syntax(hashlib.sha256(ast.dump(tree).encode()).hexdigest(), sorted(imports))


class _ParsedFiles:
    """The syntax of source files by their content, kept beside Python's own caches: parsing them takes a second.

    Where the file cannot be read or written, everything is parsed anew.
    """

    def __init__(self, path: Path) -> None:
        """Nothing is read before it is needed."""
        self._path = path
        self._known: dict[str, list[Any]] | None = None
        self._used: dict[str, list[Any]] = {}
        self._grown = False

    def parse(self, source: bytes) -> _Syntax:
        """The syntax of the file with the content `source`."""
        if self._known is None:
            self._known = self._read()
        key = hashlib.sha256(source).hexdigest()
        if key not in self._known:
            self._known[key], self._grown = list(_parse_source(source)), True
        self._used[key] = self._known[key]
        return _Syntax(*self._known[key])

    def _read(self) -> dict[str, list[Any]]:
        """What is kept; nothing where that is not as it was written."""
        try:
            digest, _, text = self._path.read_text(encoding="utf-8").partition("\n")
            return dict(json.loads(text)) if hashlib.sha256(text.encode()).hexdigest() == digest else {}
        except (OSError, ValueError):
            return {}

    def save(self) -> None:
        """Write what has been added; files that this process did not read are forgotten where they are many."""
        if not self._grown:
            return
        self._grown, known = False, self._known or {}
        text = json.dumps(known if len(known) < _MAX_KEPT_FILES else self._used)
        name = f"{self._path}.{os.getpid()}"
        with contextlib.suppress(OSError):
            self._path.parent.mkdir(exist_ok=True)
            Path(name).write_text(f"{hashlib.sha256(text.encode()).hexdigest()}\n{text}", encoding="utf-8")
            os.replace(name, self._path)


_PARSED_FILES = _ParsedFiles(PACKAGE / "__pycache__" / f"syntax.{sys.implementation.cache_tag}.json")


def import_closure(roots: Iterable[str]) -> set[str]:
    """Names of the modules `roots`, and of all modules of this package that they import, directly or through others."""
    seen: set[str] = set()
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen.add(name)
            waiting.extend(_read_module(name).inside)
    _PARSED_FILES.save()
    return seen


@cache
def digest_with_imports(*roots: str) -> str:
    """SHA-256 of the code of the modules `roots` and of all that they import in this package, directly or not.

    Docstrings and comments do not count.
    """
    lines = "".join(f"{name} {_read_module(name).digest}\n" for name in sorted(import_closure(roots)))
    return hashlib.sha256(lines.encode()).hexdigest()


@cache
def _library_version(name: str) -> str | None:
    """The version of the installed library that is imported as `name`; None for one of the standard library."""
    try:
        return importlib.metadata.version(_DISTRIBUTION.get(name, name))
    except importlib.metadata.PackageNotFoundError:
        return None


@cache
def stage_code(*roots: str) -> StageCode:
    """Digest of the modules `roots` with all their imports, and the versions of Python and the imported libraries.

    It tells a pipeline stage whether its results are still those of the present code.
    """
    modules = import_closure(roots)
    outside = sorted(set().union(*(_read_module(name).outside for name in modules)))
    versions = {name: _library_version(name) for name in outside}
    packages = {"python": platform.python_version()} | {name: v for name, v in versions.items() if v is not None}
    return StageCode(digest_with_imports(*roots), packages)
