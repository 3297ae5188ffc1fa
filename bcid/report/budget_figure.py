"""The error budget of a diagnosis as one bar."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from bcid.documents.error_budget import ErrorBudget
from bcid.report.budget_words import part_colours, percent
from bcid.report.canvas import render_data_uri

LABELLED_SHARE = 0.06
"""Of the whole bar, from which a part's share fits into it."""


def draw_budget(budget: ErrorBudget) -> str:
    """The budget as one stacked bar whose length is the base model's error, as the data URI of an image.

    A part whose share is below zero, as chance may make it, has no length; its row in the table says so.
    """
    figure = Figure(figsize=(7.5, 1.0), layout="constrained")
    ax: Any = figure.subplots()
    shares = np.array([max(p.share, 0.0) for p in budget.parts])
    left = np.r_[0.0, np.cumsum(shares)]
    for begin, share, colour in zip(left, shares, part_colours(budget.parts), strict=False):
        ax.barh(0.0, share, left=begin, color=colour, edgecolor="white", lw=0.8, height=0.8)
        if share >= LABELLED_SHARE * left[-1]:
            ax.text(begin + share / 2, 0.0, percent(share), ha="center", va="center", color="white", fontsize=10)
    ax.set_xlim(0.0, max(left[-1], 1e-9))
    ax.axis("off")
    return render_data_uri(figure)
