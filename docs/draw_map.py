"""`python docs/draw_map.py`: docs/map.svg, the packages of bcid and what each imports, drawn from the imports.

A package stands above all that it imports; an arrow that follows from others is left out (transitive reduction).
"""

from __future__ import annotations

import ast
from html import escape
from pathlib import Path

import grimp

ROOT = Path(__file__).parent.parent
BOX_WIDTH, BOX_HEIGHT, GAP = 268, 62, 34
SHIFTS = (-60, 20, -20, 60)  # of the floors, so that few arrows run straight down through boxes


def packages() -> dict[str, Path]:
    """The parts of bcid by name: its packages and its single modules."""
    folder = ROOT / "bcid"
    parts = [p for p in folder.iterdir() if (p / "__init__.py").is_file() or (p.suffix == ".py" and p.stem[0] != "_")]
    return {p.stem: p for p in sorted(parts)}


def imports(names: set[str]) -> dict[str, set[str]]:
    """The parts that each part imports, less those that it reaches through others."""
    graph = grimp.build_graph("bcid")
    direct: dict[str, set[str]] = {name: set() for name in sorted(names)}
    for module in graph.modules:
        above = module.split(".")[1] if "." in module else ""
        for imported in graph.find_modules_directly_imported_by(module):
            below = imported.split(".")[1] if "." in imported else ""
            if above in names and below in names and above != below:
                direct[above].add(below)

    def reached(name: str) -> set[str]:
        return direct[name].union(*(reached(below) for below in direct[name]))

    return {n: {b for b in below if not any(b in reached(o) for o in below)} for n, below in direct.items()}


def floors(below: dict[str, set[str]]) -> dict[str, int]:
    """How high each part stands: 0 where it imports nothing, else one above the highest that it imports."""

    def height(name: str) -> int:
        return 1 + max((height(b) for b in below[name]), default=-1)

    return {name: height(name) for name in below}


def summary(part: Path) -> str:
    """The first sentence of a part's docstring."""
    doc = ast.get_docstring(ast.parse((part / "__init__.py" if part.is_dir() else part).read_text(encoding="utf-8")))
    return (doc or "").split("\n\n")[0].replace("\n", " ")


def svg() -> str:
    """The picture."""
    parts = packages()
    below = imports(set(parts))
    floor = floors(below)
    top = max(floor.values())
    most = max(sum(floor[name] == height for name in parts) for height in range(top + 1))
    # the widest floor, and room for a shift to either side
    width = round(most * (BOX_WIDTH + GAP / 2) + 2 * max(abs(shift) for shift in SHIFTS))
    place: dict[str, tuple[float, float]] = {}
    for height in range(top + 1):
        row = [name for name in parts if floor[name] == height]
        for i, name in enumerate(row):
            x = (
                width / 2
                + (i - (len(row) - 1) / 2) * (BOX_WIDTH + GAP / 2)
                - BOX_WIDTH / 2
                + SHIFTS[height % len(SHIFTS)]
            )
            place[name] = x, (top - height) * (BOX_HEIGHT + GAP) + 10
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {(top + 1) * (BOX_HEIGHT + GAP)}" '
        'font-family="sans-serif" font-size="11">',
        "<style>path{fill:none;stroke:#c0504d;stroke-opacity:.55;stroke-width:1.2;marker-end:url(#tip)}"
        "rect{fill:#f4f7fa;stroke:#46627f}</style>",
        '<marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<polygon points="0 0 8 4 0 8" fill="#c0504d"/></marker>',
    ]
    for name, (x, y) in place.items():
        words, rows = summary(parts[name]).rstrip(".").split(), [""]
        for word in words:
            if len(rows[-1]) + len(word) > 42:
                rows.append("")
            rows[-1] = f"{rows[-1]} {word}".strip()
        shown = [*rows[:2], f"{rows[2]} …"] if len(rows) > 3 else rows
        out.append(f'<rect x="{x:.0f}" y="{y:.0f}" width="{BOX_WIDTH}" height="{BOX_HEIGHT}" rx="4"/>')
        out.append(f'<text x="{x + 8:.0f}" y="{y + 15:.0f}" font-size="13" font-weight="bold">{name}</text>')
        for i, text in enumerate(shown):
            out.append(f'<text x="{x + 8:.0f}" y="{y + 29 + 13 * i:.0f}">{escape(text)}</text>')
    # over the boxes, so that an arrow that passes one by is not taken for its own
    for name, imported in below.items():
        for other in sorted(imported):
            (x_a, y_a), (x_b, y_b) = place[name], place[other]
            x_a, x_b, y_a = x_a + BOX_WIDTH / 2, x_b + BOX_WIDTH / 2, y_a + BOX_HEIGHT
            bend = f"C{x_a:.0f} {y_a + GAP:.0f} {x_b:.0f} {y_b - GAP:.0f} {x_b:.0f} {y_b:.0f}"
            out.append(f'<path d="M{x_a:.0f} {y_a:.0f}{bend}"/>')
    return "\n".join([*out, "</svg>", ""])


if __name__ == "__main__":
    (ROOT / "docs" / "map.svg").write_text(svg(), encoding="utf-8")
