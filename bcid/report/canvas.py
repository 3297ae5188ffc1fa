"""What the pictures of a diagnosis are drawn on: sizes, colours, panels of the floor, PNG data."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from bcid.aliases import Floats

Columns = Mapping[str, Floats]

BEFORE, AFTER, DOTS, NEVER = "#d55e00", "#0072b2", "#808080", "#e3e3e3"
WIDTH = 9.0  # of the widest picture (inches)
MINUS = "−"
UNCHANGED = "base model"  # the only stage where nothing was changed


class Picture(NamedTuple):
    """One picture of the page."""

    title: str
    caption: str
    image: str  # a data URI


def data_uri(png: bytes) -> str:
    """The picture inside the page."""
    return "data:image/png;base64," + base64.b64encode(png).decode()


def png(figure: Figure) -> bytes:
    """The figure, drawn."""
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110, metadata={"Software": None})
    return data.getvalue()


def floor_panels(count: int, width: float, height: float) -> tuple[Figure, Sequence[Any]]:
    """Panels of the floor side by side, no higher than a hand."""
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
