"""What the pictures of pages are drawn on: panels of one width, colours that the page's theme sets, inline SVG.

A picture is one or more panels, each an SVG image of its own, so that a page can set them side by side or, where it is
narrow, one below the other, and their words stay as large as the text around them.  Colours stand in the SVG as
variables of the page's stylesheet (page.css.j2), which has a light and a dark value of each.
"""

import hashlib
import io
import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from markupsafe import Markup, escape
from matplotlib import rc_context
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from bcid.aliases import Floats

Columns = Mapping[str, Floats]

INK, MUTED, RULE = "#1c1c1c", "#5a5a5a", "#c8c8c8"
BEFORE, AFTER = "#b84500", "#0067a3"
MODEL_COLOURS = ("#0068a4", "#00735a", "#b84600", "#a3437a", "#8f5f00", "#6b6b6b")
"""Colours of models, told apart also by those who see no red or no green; each has its own dash and marker beside."""

VARIABLES = {INK: "ink", MUTED: "muted", RULE: "rule", BEFORE: "before", AFTER: "after"} | {
    colour: f"model-{i}" for i, colour in enumerate(MODEL_COLOURS, start=1)
}
"""Names of the stylesheet's variables, by the colour that stands for each in a drawing."""

# Neither light nor dark: for what is drawn into pixels, which no stylesheet recolours.
DOT_COLOUR, UNDRIVEN_COLOUR = "#808080", "#80808040"
WIDTH = 5.0  # of a panel (inches): its words have the size of the page's where a page is 360 px wide
LONGEST_LABEL = 25
"""Characters of a name beside a line, which leave the line most of the picture."""
TEXT_SIZE = 10.0  # points
DOTS_PER_INCH = 160  # of what is drawn into pixels
UNCHANGED = "base model"  # the only stage where nothing was changed

SIGNED_COLOURS = LinearSegmentedColormap.from_list(
    "signed", [(0.1, 0.48, 0.85, 1.0), (0.1, 0.48, 0.85, 0.0), (0.85, 0.35, 0.0, 0.0), (0.85, 0.35, 0.0, 1.0)]
)
"""Blue below zero, orange above, and clear at zero, where the page shows through whether it is light or dark."""
SIZE_COLOURS = LinearSegmentedColormap.from_list("size", [(0.85, 0.35, 0.0, 0.0), (0.85, 0.35, 0.0, 1.0)])
"""From clear to orange, the larger the deeper."""


class Picture(NamedTuple):
    """One picture of a page, with title and caption."""

    title: str
    caption: str
    panels: tuple[Markup, ...]  # SVG elements


def create_panel(height: float, title: str = "") -> tuple[Figure, Any]:
    """A figure one panel wide and `height` inches high, and its axes, without frame above and at the right."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    ax = figure.subplots()
    style_axes(ax)
    ax.set_title(title, fontsize=TEXT_SIZE + 0.5, loc="left", color=INK, parse_math=False)
    return figure, ax


def style_axes(ax: Any) -> None:
    """Give axes the pictures' text size and ink, and frame them at the left and below only."""
    ax.spines[["top", "right"]].set_visible(False)
    ax.spines[["left", "bottom"]].set_color(MUTED)
    ax.tick_params(labelsize=TEXT_SIZE - 0.5, color=MUTED, labelcolor=INK)
    ax.xaxis.label.set(size=TEXT_SIZE, color=INK)
    ax.yaxis.label.set(size=TEXT_SIZE, color=INK)
    ax.patch.set_visible(False)


def create_floor_panel(width: float, height: float, title: str, below: float = 0.0) -> tuple[Figure, Any]:
    """A panel of equal scales for a floor of `width` by `height` m, with `below` inches kept for a colour bar."""
    inner = WIDTH - 0.7
    figure, ax = create_panel(float(np.clip(inner * height / max(width, 1e-6), 1.6, 4.6)) + 0.75 + below, title)
    ax.set_aspect("equal")
    ax.set_xlabel("x (m)")
    ax.set_ylabel("y (m)")
    return figure, ax


LEGEND = {
    "fontsize": TEXT_SIZE - 0.5, "frameon": False, "labelcolor": INK, "borderaxespad": 0.2, "handlelength": 2.2,
    "columnspacing": 1.4,
}  # fmt: skip
"""How legends look, wherever they stand."""


def add_legend(ax: Any, columns: int = 3) -> None:
    """A legend of `ax` in one or more rows above its frame."""
    ax.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=columns, **LEGEND)


def add_legend_above(figure: Figure) -> None:
    """A legend of all that a figure of one panel shows, above it, from its left edge on: as wide as the figure."""
    figure.legend(loc="outside upper left", ncols=3, **LEGEND)


def render_svg(figure: Figure, label: str) -> Markup:
    """A figure as an SVG element to stand in a page, called `label` for those who hear the page.

    The same figure gives the same bytes.  Words are text, which can be searched and selected; colours named in
    VARIABLES are variables of the page's stylesheet.
    """
    figure.dpi = DOTS_PER_INCH
    figure.patch.set_visible(False)
    text = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "bcid"}):
        FigureCanvasSVG(figure).print_svg(text)  # type: ignore[no-untyped-call]  # matplotlib has no types for it
    return Markup(_fit_into_page(text.getvalue(), label))  # noqa: S704  # matplotlib escapes all text


def _fit_into_page(text: str, label: str) -> str:
    """The SVG document `text` as an element: no prologue, metadata or own styles, and names that no other one uses."""
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->", "", text, flags=re.DOTALL)
    used = set(re.findall(r'(?:url\(#|href="#)([^")]+)', text))
    prefix = hashlib.sha256((label + text).encode()).hexdigest()[:8]
    text = re.sub(r' id="([^"]+)"', lambda m: f' id="{prefix}-{m[1]}"' if m[1] in used else "", text)
    text = re.sub(r'(url\(#|href="#)', rf"\g<1>{prefix}-", text)
    # hundredths of a point are finer than any screen, and half as long
    text = re.sub(r' d="[^"]+"', lambda m: re.sub(r"(\.\d\d)\d+", r"\1", m[0]), text)
    for colour, variable in VARIABLES.items():
        text = text.replace(colour, f"var(--{variable}, {colour})")
    view_box = re.search(r'viewBox="[^"]+"', text)
    head = f'<svg {view_box[0] if view_box else ""} role="img" aria-label="{escape(label)}">'
    return re.sub(r"\s*\n\s*", "\n", head + text[text.index(">") + 1 :]).strip()


def insert_gaps(points: Floats, starts: npt.NDArray[np.intp]) -> Floats:
    """The path `points` (N, n) with a row of NaN before each row in `starts`, which breaks its line there."""
    return np.insert(points, starts[starts > 0], np.nan, axis=0)


def _shorten_middle(name: str) -> str:
    """A name of at most LONGEST_LABEL characters: of longer ones beginning and end, by which models are told apart.

    >>> _shorten_middle("newton-euler (a_folder_with_a_long_name/base)")
    'newton-euler (…name/base)'
    """
    half = LONGEST_LABEL // 2
    return name if len(name) <= LONGEST_LABEL else f"{name[: half + 2]}…{name[2 - half :]}"


def label_line_ends(ax: Any, ends: Sequence[tuple[float, float, str, str]], log: bool = False) -> None:
    """Write names beside the right ends (x, y, name, colour) of lines, moved apart where they would overlap."""
    figure_height = ax.figure.get_figheight()
    low, high = np.log(ax.get_ylim()) if log else ax.get_ylim()
    step = (high - low) * 1.35 * TEXT_SIZE / 72.0 / max(0.72 * figure_height, 0.5)
    ordered = sorted(ends, key=lambda end: end[1])
    heights = [float(np.log(y) if log else y) for _, y, _, _ in ordered]
    for _ in range(200):
        for i in range(len(heights) - 1):
            lack = step - (heights[i + 1] - heights[i])
            if lack > 0.0:
                heights[i] -= lack / 2
                heights[i + 1] += lack / 2
    for (x, y, name, colour), height in zip(ordered, heights, strict=True):
        at = float(np.exp(height)) if log else height
        ax.annotate(
            _shorten_middle(name), (x, y), xytext=(1.03, at), textcoords=ax.get_yaxis_transform(), color=colour,
            va="center", fontsize=TEXT_SIZE - 0.5, parse_math=False, annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": colour, "lw": 0.6, "shrinkA": 1, "shrinkB": 3},
        )  # fmt: skip
