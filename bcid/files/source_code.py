"""A digest of the code that a stage runs: its module and, through its imports, everything that it calls."""

import ast
import hashlib
import importlib.metadata
import platform
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import NamedTuple

PACKAGE = Path(__file__).parent.parent
_ROOT = PACKAGE.parent
_PACKAGE = PACKAGE.name
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


def _module_path(module: str) -> Path | None:
    """The file of this package's `module`, such as "bcid.effects.table"; None where there is none."""
    base = _ROOT.joinpath(*module.split("."))
    return next((p for p in (base.with_suffix(".py"), base / "__init__.py") if p.exists()), None)


@cache
def _read_module(name: str) -> _ModuleCode:
    """Digest of the module `name`, and the modules that it imports anywhere in its file."""
    path = _module_path(name)
    if path is None:
        raise ModuleNotFoundError(name)
    tree = ast.parse(path.read_bytes())
    inside, outside = set(), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        for imported in names:
            if imported.split(".")[0] != _PACKAGE:
                outside.add(imported.split(".")[0])
            elif _module_path(imported) is not None:
                inside.add(imported)
    parents = {name.rpartition(".")[0]} - {""}
    return _ModuleCode(_syntax_digest(tree, path), frozenset(inside | parents), frozenset(outside))


def _syntax_digest(tree: ast.Module, path: Path) -> str:
    """SHA-256 of a module's syntax `tree` without docstrings, in hex digits.

    For an `__init__` at `path`, the page templates (*.j2) in its folder are included.
    """
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body[0] = ast.Pass()
    digest = hashlib.sha256(ast.dump(tree).encode())
    if path.name == "__init__.py":
        for template in sorted(path.parent.glob("*.j2")):
            digest.update(template.read_bytes())
    return digest.hexdigest()


def import_closure(roots: Iterable[str]) -> set[str]:
    """Names of the modules `roots`, and of all modules of this package that they import, directly or through others."""
    seen: set[str] = set()
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen.add(name)
            waiting.extend(_read_module(name).inside)
    return seen


@cache
def digest_with_imports(*roots: str) -> str:
    """SHA-256 of the code of the modules `roots` and of all that they import in this package, directly or not.

    Docstrings and comments do not count.
    """
    lines = "".join(f"{name} {_read_module(name).digest}\n" for name in sorted(import_closure(roots)))
    return hashlib.sha256(lines.encode()).hexdigest()


@cache
def stage_code(*roots: str) -> StageCode:
    """Digest of the modules `roots` with all their imports, and the versions of Python and the imported libraries.

    It tells a pipeline stage whether its results are still those of the present code.
    """
    modules = import_closure(roots)
    outside = sorted(set().union(*(_read_module(name).outside for name in modules)))
    packages = {"python": platform.python_version()}
    for name in outside:
        try:
            packages[name] = importlib.metadata.version(_DISTRIBUTION.get(name, name))
        except importlib.metadata.PackageNotFoundError:
            continue  # the standard library
    return StageCode(digest_with_imports(*roots), packages)
