"""A digest of the code that a stage runs: its module and, through its imports, everything that it calls."""

from __future__ import annotations

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


class Code(NamedTuple):
    """What a stage runs."""

    digest: str
    packages: dict[str, str]  # version by name of the libraries that it imports


class _Module(NamedTuple):
    digest: str
    inside: frozenset[str]  # imported modules of this package
    outside: frozenset[str]  # imported top-level names of others


def _file_of(module: str) -> Path | None:
    base = _ROOT.joinpath(*module.split("."))
    return next((p for p in (base.with_suffix(".py"), base / "__init__.py") if p.exists()), None)


@cache
def _module(name: str) -> _Module:
    """Digest and imports of one module, wherever in the file they stand.

    Comments and docstrings do not count; the templates beside a package's `__init__` do.
    """
    path = _file_of(name)
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
            elif _file_of(imported) is not None:
                inside.add(imported)
    parents = {name.rpartition(".")[0]} - {""}
    return _Module(_digest(tree, path), frozenset(inside | parents), frozenset(outside))


def _digest(tree: ast.Module, path: Path) -> str:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body[0] = ast.Pass()
    digest = hashlib.sha256(ast.dump(tree).encode())
    if path.name == "__init__.py":
        for template in sorted(path.parent.glob("*.j2")):
            digest.update(template.read_bytes())
    return digest.hexdigest()


def closure(roots: Iterable[str]) -> set[str]:
    """All modules of this package that the roots import, directly or not, and the roots themselves."""
    seen: set[str] = set()
    waiting = list(roots)
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen.add(name)
            waiting.extend(_module(name).inside)
    return seen


@cache
def digest_with_imports(*roots: str) -> str:
    """The digest of the modules `roots` and of all modules of this package that they import."""
    lines = "".join(f"{name} {_module(name).digest}\n" for name in sorted(closure(roots)))
    return hashlib.sha256(lines.encode()).hexdigest()


@cache
def code_of(*roots: str) -> Code:
    """The code that the modules `roots` run."""
    modules = closure(roots)
    outside = sorted(set().union(*(_module(name).outside for name in modules)))
    packages = {"python": platform.python_version()}
    for name in outside:
        try:
            packages[name] = importlib.metadata.version(_DISTRIBUTION.get(name, name))
        except importlib.metadata.PackageNotFoundError:
            continue  # the standard library
    return Code(digest_with_imports(*roots), packages)


def forget() -> None:
    """Read the sources anew (for tests that edit them)."""
    _module.cache_clear()
    digest_with_imports.cache_clear()
    code_of.cache_clear()
