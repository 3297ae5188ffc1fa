"""What keeps the code readable: names that stand for one thing, imports without circles, limits with reasons."""

from __future__ import annotations

import ast
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


@pytest.mark.parametrize("path", LIMITS, ids=lambda path: path.parent.name)
def test_every_limit_gives_its_reason_and_is_used(path: Path) -> None:
    """A limit is a field of a frozen dataclass with a reason (a string or a comment above it), read by some module."""
    lines = path.read_text(encoding="utf-8").splitlines()
    used = {
        node.attr
        for other, tree in MODULES.items()
        if other not in LIMITS
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
    }
    for kind in (n for n in MODULES[path].body if isinstance(n, ast.ClassDef)):
        assert "frozen=True" in ast.unparse(kind.decorator_list[0]), kind.name
        for i, field in enumerate(kind.body):
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                name, after = f"{kind.name}.{field.target.id}", kind.body[i + 1 : i + 2]
                above = next(line for line in lines[field.lineno - 2 :: -1] if ": " not in line or "#" in line)
                told = after and isinstance(after[0], ast.Expr) and isinstance(after[0].value, ast.Constant)
                assert told or above.lstrip().startswith("#") or " #" in lines[field.lineno - 1], name
                assert field.target.id in used, f"{name} is not used"


def test_the_map_is_drawn_from_the_imports_as_they_are() -> None:
    """`python docs/draw_map.py` renews it."""
    spec = importlib.util.spec_from_file_location("draw_map", ROOT / "docs" / "draw_map.py")
    assert spec
    assert spec.loader
    draw_map = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(draw_map)
    assert draw_map.svg() == (ROOT / "docs" / "map.svg").read_text(encoding="utf-8")
