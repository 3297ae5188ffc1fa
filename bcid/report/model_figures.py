"""Pictures of models compared on the validation take: paths, errors by steering angle, errors over time."""

import itertools
from typing import NamedTuple

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from bcid.aliases import Bools
from bcid.report import canvas
from bcid.report.canvas import INK, MODEL_COLOURS, MUTED, RULE, TEXT_SIZE, Picture, insert_gaps, render_svg
from bcid.report.content import ReportContent
from bcid.report.limits import LIMITS

CHANNELS = (("v_x", "m/s"), ("v_y", "m/s"), ("yaw rate", "rad/s"))
# Lengths (s) of the excerpt whose paths are drawn, and of the states that are drawn at most.
EXCERPT_S, LONGEST_S = 40.0, 120.0


class Look(NamedTuple):
    """How a model is drawn in all pictures."""

    colour: str
    dash: str | tuple[int, tuple[float, ...]]
    marker: str


DASHES: tuple[str | tuple[int, tuple[float, ...]], ...] = (
    "-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)), (0, (3, 1)), (0, (8, 2, 1, 2, 1, 2))
)  # fmt: skip
LOOKS = {
    name: Look(colour, dash, marker)
    for name, colour, dash, marker in zip(
        ("newton-euler", "k-mlp", "k-sindy-mlp", "k-sindy", "narx-mlp", "newton-euler-linear"),
        MODEL_COLOURS, DASHES, "osD^vX", strict=True,
    )
}  # fmt: skip
UNKNOWN_LOOK = Look(INK, (0, (2, 2)), "*")


def draw_model_pictures(content: ReportContent) -> list[Picture]:
    """The pictures of a comparison of models, those of the best model first in each."""
    every = f"{content.restart_s:g} s"
    return [
        Picture(
            "Trajectories",
            f"The {EXCERPT_S:g} s with the largest steering angles; predicted paths restart from the measured state "
            f"every {every} (crosses). Broad and pale: measured. Best model first.",
            tuple(_draw_trajectories(content)),
        ),
        Picture(
            "Where the models differ",
            f"Error by steering angle, predictions restarted every {every}. "
            "The linearised model holds only near straight driving.",
            (_draw_error_over_steering(content),),
        ),
        Picture(
            "Closed-loop errors over time",
            "All models driven by the take's commands alone from its first sample. Above: the smoothed estimate, and "
            "dashed the best model with its 95 % interval. Below, on one scale: predicted less measured, a row for "
            "each model, with its root mean square. What leaves its row is cut.",
            tuple(_draw_errors_over_time(content)),
        ),
    ]


def _look(name: str) -> Look:
    """How the model called `name` is drawn; one way for all unknown names."""
    return LOOKS.get(name, UNKNOWN_LOOK)


def _draw_trajectories(content: ReportContent) -> list[Markup]:
    """Predicted paths over the measured one, an SVG element for each model.

    Drawn are the EXCERPT_S seconds with the largest steering angles; predictions restart from the measured state
    every few seconds.
    """
    take = content.validation
    shown = _hardest_rows(content)
    x, y = take.pose[shown, 0], take.pose[shown, 1]
    measured = insert_gaps(take.pose[shown, :2], np.flatnonzero(np.diff(take.segment[shown])) + 1)
    panels = []
    for model in content.ranked_models():
        miss = np.linalg.norm(model.restart_pose[shown, :2] - take.pose[shown, :2], axis=1)
        rms = np.sqrt(np.mean(miss**2))
        title = f"{model.name}: {f'RMS miss {100 * rms:.2g} cm' if np.isfinite(rms) else 'diverges'}"
        figure, ax = canvas.create_floor_panel(np.ptp(x) + 1.2, np.ptp(y) + 1.2, title)
        ax.plot(*measured.T, color=RULE, lw=4.0)
        starts = np.flatnonzero(model.restart[shown])
        path = insert_gaps(model.restart_pose[shown, :2], starts)
        ax.plot(*path.T, color=_look(model.name).colour, lw=1.4)
        ax.plot(x[starts], y[starts], "x", color=INK, ms=5)
        ax.set_xlim(x.min() - 0.6, x.max() + 0.6)
        ax.set_ylim(y.min() - 0.6, y.max() + 0.6)
        panels.append(render_svg(figure, f"Paths predicted by {title}"))
    return panels


def _hardest_rows(content: ReportContent) -> slice:
    """Rows of the EXCERPT_S seconds of the validation take, from a restart on, with the largest sum of |delta|."""
    take = content.validation
    size = round(EXCERPT_S / take.period_s)
    starts = np.flatnonzero(content.models[0].restart)
    turning = np.r_[0.0, np.cumsum(np.abs(take.kinematic[:, 3]))]
    gains = [turning[min(k + size, len(take))] - turning[k] for k in starts]
    first = int(starts[int(np.argmax(gains))])
    return slice(first, min(first + size, len(take)))


def _draw_error_over_steering(content: ReportContent) -> Markup:
    """RMS prediction error of each model in bins of the steering angle |delta|, as an SVG element.

    The error is that of the twist (v_x, v_y, yaw rate), each channel divided by its standard deviation in the
    training data; predictions restart from the measured state every few seconds.
    """
    take = content.validation
    angle = np.abs(take.kinematic[:, 3])
    edges = np.linspace(0.0, max(float(angle.max()), 1e-3), 9)
    weights = np.array(content.models[0].evaluation.weights)
    figure, ax = canvas.create_panel(3.4)
    ends = []
    middle = 0.5 * (edges[1:] + edges[:-1])
    ax.set_yscale("log")
    for model in content.ranked_models():
        squares = ((weights * (model.restart_twist - take.twist)) ** 2).mean(axis=1)
        rows = [(angle >= a) & (angle <= b) for a, b in itertools.pairwise(edges)]
        rms = np.array(
            [float(np.sqrt(squares[r].mean())) if r.sum() >= LIMITS.min_rows_per_bin else np.nan for r in rows]
        )
        look = _look(model.name)
        ax.plot(middle, rms, marker=look.marker, ls=look.dash, ms=4, lw=1.4, color=look.colour)
        last = np.flatnonzero(np.isfinite(rms))
        if len(last):
            ends.append((float(middle[last[-1]]), float(rms[last[-1]]), model.name, look.colour))
    low, high = ax.get_ylim()
    # a model that is lost stretches the axis over many decades
    within_two_decades = high < 100.0 * low
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if within_two_decades else (1.0,), numticks=8))
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter(NullFormatter())
    ax.set_xlabel("steering angle |δ| (rad)")
    ax.set_ylabel("RMS of W (predicted − measured)")
    ax.grid(axis="y", color=RULE, lw=0.6)
    canvas.label_line_ends(ax, ends, log=True)
    return render_svg(figure, "Error by steering angle")


def _draw_errors_over_time(content: ReportContent) -> list[Markup]:
    """Measured v_x, v_y and yaw rate, and below each the errors of all models in rows of one scale, as SVG elements.

    Predictions run in closed loop from the validation take's first sample; drawn are its first LONGEST_S seconds.
    """
    take = content.validation
    shown = take.time_s <= take.time_s[0] + LONGEST_S
    return [_draw_channel_errors(content, shown, channel) for channel in range(len(CHANNELS))]


def _draw_channel_errors(content: ReportContent, shown: Bools, channel: int) -> Markup:
    """One channel of the twist over the rows `shown`: measured and best model, and the errors of all models below."""
    name, unit = CHANNELS[channel]
    time, measured = content.validation.time_s[shown], content.validation.twist[shown, channel]
    ranked = content.ranked_models()
    figure = Figure(figsize=(canvas.WIDTH, 1.75 + 0.5 * len(ranked)), layout="constrained")
    ratios = [2.6, *(1.0 for _ in ranked)]
    top, *rows = figure.subplots(1 + len(ranked), 1, sharex=True, height_ratios=ratios)
    best = ranked[0]
    predicted, half = best.twist[shown, channel], best.half[shown, channel]
    colour = _look(best.name).colour
    top.fill_between(time, predicted - half, predicted + half, color=colour, alpha=0.25, lw=0.0)
    top.plot(time, measured, color=INK, lw=1.3)
    top.plot(time, predicted, color=colour, lw=1.0, ls=(0, (3, 1.5)))
    room = 0.2 * float(np.ptp(measured)) + 1e-6
    top.set_ylim(measured.min() - room, measured.max() + room)
    top.set_title(f"{name} ({unit})", fontsize=TEXT_SIZE + 0.5, loc="left", color=INK)
    errors = [model.twist[shown, channel] - measured for model in ranked]
    sizes = [float(np.sqrt(np.mean(e**2))) for e in errors]
    finite = [s for s in sizes if np.isfinite(s)]
    # a scale on which the middling model fills its row
    frame = 3.0 * float(np.median(finite)) if finite else 1.0
    for ax, model, error, size in zip(rows, ranked, errors, sizes, strict=True):
        look = _look(model.name)
        ax.axhline(0.0, color=RULE, lw=0.6)
        ax.fill_between(time, np.clip(error, -frame, frame), color=look.colour, alpha=0.35, lw=0.0)
        ax.plot(time, error, color=look.colour, lw=0.8)
        ax.set_ylim(-frame, frame)
        words = f"{model.name}: {f'{size:.2g} {unit}' if np.isfinite(size) else 'diverges'}"
        ax.set_title(words, fontsize=TEXT_SIZE - 0.5, loc="left", pad=1.0, color=look.colour, parse_math=False)
    for ax in (top, *rows):
        canvas.style_axes(ax)
    tick = float(f"{frame / 1.5:.1g}")
    for ax in rows:
        ax.set_yticks([-tick, tick], [f"−{tick:g}", f"+{tick:g}"])
        ax.tick_params(labelsize=TEXT_SIZE - 1.5, color=MUTED)
    for ax in (top, *rows[:-1]):
        ax.spines["bottom"].set_visible(False)
        ax.tick_params(axis="x", length=0)
    rows[-1].tick_params(axis="x", labelsize=TEXT_SIZE - 0.5)
    rows[-1].set_xlabel("time (s)")
    return render_svg(figure, f"Errors in {name} over time")
