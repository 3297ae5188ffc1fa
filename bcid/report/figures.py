"""The report's figures as PNG data, drawn from the report's content alone."""

from __future__ import annotations

import base64
import io
import itertools
from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np

from bcid.report.content import Content

mpl.use("Agg")
import matplotlib.pyplot as plt  # the backend must be chosen first

COLOURS = {
    "newton-euler": "#0072b2", "newton-euler-linear": "#999999", "narx-mlp": "#e69f00",
    "k-mlp": "#009e73", "k-sindy": "#cc79a7", "k-sindy-mlp": "#d55e00",
}  # fmt: skip
CHANNELS = (("v_x", "m/s"), ("v_y", "m/s"), ("yaw rate", "rad/s"))
MEASURED = {"color": "black", "lw": 1.4, "label": "measured (smoothed)"}
EXCERPT_S = 40.0
LONGEST_S = 120.0


def png(figure: Any) -> str:
    """The figure as a data URL; it is closed."""
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110, metadata={"Software": None})
    plt.close(figure)
    return "data:image/png;base64," + base64.b64encode(data.getvalue()).decode()


def _colour(name: str) -> str:
    return COLOURS.get(name, "#56b4e9")


def trajectories(content: Content) -> str:
    """One panel a model: its path, started anew every few seconds, over the measured one."""
    take = content.validation
    ranked = content.ranked()
    columns = min(3, len(ranked))
    rows = -(-len(ranked) // columns)
    shown = _hardest(content)
    x, y = take.pose[shown, 0], take.pose[shown, 1]
    height = 0.6 + rows * (11.0 / columns) * (np.ptp(y) + 1.2) / (np.ptp(x) + 1.2)
    figure, axes = plt.subplots(
        rows, columns, figsize=(11, height), sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    for ax, model in zip(axes.flat, ranked, strict=False):
        segments = np.flatnonzero(np.diff(take.segment[shown])) + 1
        ax.plot(*_with_breaks(take.pose[shown, :2], segments).T, color="black", lw=1.0, label="measured")
        starts = np.flatnonzero(model.restart[shown])
        path = _with_breaks(model.restart_pose[shown, :2], starts)
        ax.plot(*path.T, color=_colour(model.name), lw=1.6, label="predicted")
        ax.plot(x[starts], y[starts], "x", color="black", ms=5, label="started anew")
        ax.set_title(model.name, fontsize=10)
        ax.set_aspect("equal")
        ax.set_xlim(x.min() - 0.6, x.max() + 0.6)
        ax.set_ylim(y.min() - 0.6, y.max() + 0.6)
    for ax in axes.flat[len(ranked) :]:
        ax.axis("off")
    axes[0, 0].legend(fontsize=8, loc="upper right")
    figure.supxlabel("x (m)", fontsize=9)
    figure.supylabel("y (m)", fontsize=9)
    return png(figure)


def _hardest(content: Content) -> slice:
    """The rows of the excerpt with the largest steering angles; it begins where predictions start anew."""
    take = content.validation
    size = round(EXCERPT_S / take.period_s)
    starts = np.flatnonzero(content.models[0].restart)
    turning = np.r_[0.0, np.cumsum(np.abs(take.kinematic[:, 3]))]
    gains = [turning[min(k + size, len(take))] - turning[k] for k in starts]
    first = int(starts[int(np.argmax(gains))])
    return slice(first, min(first + size, len(take)))


def _with_breaks(points: Any, starts: Any) -> Any:
    return np.insert(points, starts[starts > 0], np.nan, axis=0)


def states(content: Content) -> str:
    """Closed-loop v_x, v_y and yaw rate of all models from the take's first sample, the measured ones above."""
    take = content.validation
    shown = take.time_s <= take.time_s[0] + LONGEST_S
    figure, axes = plt.subplots(3, 1, figsize=(11, 7.5), sharex=True, layout="constrained")
    for c, (ax, (name, unit)) in enumerate(zip(axes, CHANNELS, strict=True)):
        for model in reversed(content.ranked()):
            ax.plot(take.time_s[shown], model.twist[shown, c], color=_colour(model.name), lw=0.9, label=model.name)
        best = content.ranked()[0]
        band = (best.twist[shown, c] - best.half[shown, c], best.twist[shown, c] + best.half[shown, c])
        ax.fill_between(take.time_s[shown], *band, color=_colour(best.name), alpha=0.2, lw=0.0)
        ax.plot(take.time_s[shown], take.twist[shown, c], **MEASURED)
        _around(ax, take.twist[shown, c])
        ax.set_ylabel(f"{name} ({unit})")
    axes[0].legend(fontsize=8, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), frameon=False)
    axes[-1].set_xlabel("time (s)")
    return png(figure)


def _around(ax: Any, values: Any) -> None:
    room = 0.35 * float(np.ptp(values)) + 1e-6
    ax.set_ylim(values.min() - room, values.max() + room)


def error_over_steering(content: Content) -> str:
    """RMS error of the weighted twist over the steering angle, predictions started anew every few seconds."""
    take = content.validation
    angle = np.abs(take.kinematic[:, 3])
    edges = np.linspace(0.0, max(float(angle.max()), 1e-3), 9)
    weights = np.array(content.models[0].figures["weights"])
    figure, ax = plt.subplots(figsize=(8, 4), layout="constrained")
    for model in content.ranked():
        squares = ((weights * (model.restart_twist - take.twist)) ** 2).mean(axis=1)
        rows = [(angle >= a) & (angle <= b) for a, b in itertools.pairwise(edges)]
        rms = [float(np.sqrt(squares[r].mean())) if r.sum() > 5 else np.nan for r in rows]
        ax.plot(0.5 * (edges[1:] + edges[:-1]), rms, "o-", ms=4, color=_colour(model.name), label=model.name)
    ax.set_yscale("log")
    ax.set_xlabel("steering angle |δ| (rad)")
    ax.set_ylabel("RMS of W (predicted − measured)")
    ax.grid(alpha=0.3, which="both")
    ax.legend(fontsize=8, ncols=2)
    return png(figure)


def all_figures(content: Content) -> Sequence[tuple[str, str, str]]:
    """(title, caption, PNG data) of each figure, in the page's order."""
    every = f"{content.restart_s:g} s"
    return (
        (
            "Trajectories",
            f"The {EXCERPT_S:g} s with the largest steering angles; predicted paths start anew from the measured state "
            f"every {every} (crosses). Best model first.",
            trajectories(content),
        ),
        (
            "Where the models differ",
            f"Error by steering angle, predictions started anew every {every}. "
            "The linearised model holds only near straight driving.",
            error_over_steering(content),
        ),
        (
            "Closed-loop states",
            "All models driven by the take's commands alone from its first sample; black is the smoothed estimate. "
            "Shaded: the best model's 95 % interval. Curves that leave the frame are cut.",
            states(content),
        ),
    )
