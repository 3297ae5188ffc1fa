"""What keeps the code readable: names that stand for one thing, imports without circles, limits with reasons."""

from __future__ import annotations

import ast
import importlib
import importlib.util
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import grimp
import pytest

ROOT = Path(__file__).parent.parent
MODULES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted((ROOT / "bcid").rglob("*.py"))}
LIMITS = [path for path in MODULES if path.name == "limits.py"]


def test_no_two_classes_share_a_name() -> None:
    names = Counter(n.name for tree in MODULES.values() for n in ast.walk(tree) if isinstance(n, ast.ClassDef))
    assert {name: count for name, count in names.items() if count > 1} == {}


def test_no_module_imports_itself_through_others() -> None:
    graph = grimp.build_graph("bcid")
    below = {m: graph.find_modules_directly_imported_by(m) for m in graph.modules}
    while ends := [m for m, imported in below.items() if not imported & below.keys()]:
        for m in ends:
            del below[m]
    assert sorted(below) == []


PACKAGES = [p for p in MODULES if p.name == "__init__.py" and p.parent.name not in ("bcid", "stages")]


@pytest.mark.parametrize("path", PACKAGES, ids=lambda path: path.parent.relative_to(ROOT).as_posix())
def test_a_package_s_docstring_names_all_that_is_in_it(path: Path) -> None:
    parts = [p for p in path.parent.iterdir() if p.suffix == ".py" or (p / "__init__.py").is_file()]
    doc = ast.get_docstring(MODULES[path]) or ""
    assert [p.stem for p in sorted(parts) if p.stem[0] != "_" and f"`{p.stem}`" not in doc] == []


def functions(tree: ast.Module) -> Iterator[ast.FunctionDef]:
    """All functions and methods of a module."""
    yield from (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef))


def test_no_parameter_is_a_mere_preposition_or_participle() -> None:
    parameters = [
        f"{path.relative_to(ROOT)}: {f.name}({a.arg})"
        for path, tree in MODULES.items()
        for f in functions(tree)
        for a in [*f.args.posonlyargs, *f.args.args, *f.args.kwonlyargs]
        if a.arg in ("of", "found") and not f.name.startswith("_")
    ]
    assert parameters == []


def test_every_function_says_what_it_does() -> None:
    silent = [
        f"{path.relative_to(ROOT)}: {f.name}"
        for path, tree in MODULES.items()
        for f in tree.body
        if isinstance(f, ast.FunctionDef) and ast.get_docstring(f) is None
    ]
    assert silent == []


def test_docstrings_stand_alone() -> None:
    leaning = [
        f"{path.relative_to(ROOT)}: {node.name}: {doc.splitlines()[0]}"
        for path, tree in MODULES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and (doc := ast.get_docstring(node))
        if doc.startswith(("The same", "Of ", "See ", "As "))
    ]
    assert leaning == []


def used_limits() -> set[tuple[str, str, str]]:
    """Module and name of a dataclass in a limits.py, and a field that another module reads from an instance of it."""
    used = set()
    for path, tree in MODULES.items():
        nodes = [] if path in LIMITS else list(ast.walk(tree))
        kinds = {
            alias.asname or alias.name: type(getattr(importlib.import_module(node.module), alias.name))
            for node in nodes
            if isinstance(node, ast.ImportFrom) and node.module and node.module.endswith(".limits")
            for alias in node.names
        }
        used |= {
            (kinds[node.value.id].__module__, kinds[node.value.id].__name__, node.attr)
            for node in nodes
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in kinds
        }
    return used


USED_LIMITS = used_limits()


@pytest.mark.parametrize("path", LIMITS, ids=lambda path: ".".join(path.relative_to(ROOT).parts[1:-1]))
def test_every_limit_gives_its_reason_and_is_used(path: Path) -> None:
    """A limit is a field of a frozen dataclass, read by some module, with its own reason: a comment or a string."""
    lines = path.read_text(encoding="utf-8").splitlines()
    module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for kind in (n for n in MODULES[path].body if isinstance(n, ast.ClassDef)):
        assert "frozen=True" in ast.unparse(kind.decorator_list[0]), kind.name
        for i, field in enumerate(kind.body):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                name, after = f"{kind.name}.{field.target.id}", kind.body[i + 1 : i + 2]
                below = after and isinstance(after[0], ast.Expr) and isinstance(after[0].value, ast.Constant)
                above = lines[field.lineno - 2].lstrip().startswith("#")
                assert above or below or " #" in lines[field.lineno - 1], f"{name} has no reason of its own"
                assert (module, kind.name, field.target.id) in USED_LIMITS, f"{name} is not used"


def test_the_map_is_drawn_from_the_imports_as_they_are() -> None:
    """`python docs/draw_map.py` renews it."""
    spec = importlib.util.spec_from_file_location("draw_map", ROOT / "docs" / "draw_map.py")
    assert spec
    assert spec.loader
    draw_map = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(draw_map)
    assert draw_map.svg() == (ROOT / "docs" / "map.svg").read_text(encoding="utf-8")
