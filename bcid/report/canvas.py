"""What the pictures of a diagnosis are drawn on: sizes, colours, panels of the floor, PNG data."""

import base64
import io
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from bcid.aliases import Floats

Columns = Mapping[str, Floats]

BEFORE, AFTER, DOT_COLOUR, UNDRIVEN_COLOUR = "#d55e00", "#0072b2", "#808080", "#e3e3e3"
PIXELS_PER_INCH = 110
WIDTH = 9.0  # of the widest picture (inches)
UNCHANGED = "base model"  # the only stage where nothing was changed


class Picture(NamedTuple):
    """One picture of a page, with title and caption."""

    title: str
    caption: str
    image: str  # a data URI


def render_data_uri(figure: Figure) -> str:
    """A figure as the data URI of a PNG image, without metadata: the same figure gives the same bytes."""
    data, canvas = io.BytesIO(), FigureCanvasAgg(figure)
    figure.dpi = PIXELS_PER_INCH
    # laid out here, and drawn once: `savefig` would draw everything once more to lay it out
    layout = figure.get_layout_engine()
    if layout is not None:
        layout.execute(figure)
        figure.set_layout_engine("none")
    canvas.print_png(data, metadata={"Software": None})  # type: ignore[no-untyped-call]  # matplotlib has no types for it
    return "data:image/png;base64," + base64.b64encode(data.getvalue()).decode()


def insert_gaps(points: Floats, starts: npt.NDArray[np.intp]) -> Floats:
    """The path `points` (N, n) with a row of NaN before each row in `starts`, which breaks its line there."""
    return np.insert(points, starts[starts > 0], np.nan, axis=0)


def create_floor_panels(count: int, width: float, height: float) -> tuple[Figure, Sequence[Any]]:
    """A figure with `count` panels side by side, all of the same scale, for a floor of `width` by `height` m."""
    wide = min((WIDTH - 1.7) / count, 4.4)
    tall = float(np.clip(wide * height / max(width, 1e-6), 1.6, 4.2))
    wide = float(np.clip(tall * width / max(height, 1e-6), 1.8, wide))
    figure = Figure(figsize=(max(count * wide + 1.7, 4.6), tall + 0.8), layout="constrained")
    axes = figure.subplots(1, count, sharex=True, sharey=True, squeeze=False)[0]
    for ax in axes:
        ax.set_aspect("equal")
        ax.set_xlabel("x (m)")
    axes[0].set_ylabel("y (m)")
    return figure, axes
