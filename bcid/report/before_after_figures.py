"""Pictures of a model before and after its findings: errors by horizon, predicted paths, residuals by place or time."""

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.ticker import LogLocator, MaxNLocator, NullFormatter

from bcid.aliases import Bools, Floats
from bcid.documents.diagnosis import DiagnosisDocument, HorizonError
from bcid.report import canvas
from bcid.report.canvas import AFTER, BEFORE, INK, TEXT_SIZE, UNCHANGED, Columns, Picture, render_svg
from bcid.report.disturbance import Residual, choose_residual, drop_incomplete_knots, located_knots, root_mean_square
from bcid.report.formats import format_thousandths, with_minus_sign
from bcid.report.limits import LIMITS
from bcid.report.path_stretch import choose_stretch

DASHES = {BEFORE: "-", AFTER: (0, (4, 1.5))}
"""Dash pattern of each stage, so that colour is not all that tells them apart."""


def draw_before_after_pictures(diagnosis: DiagnosisDocument, knots: Columns, tracks: Columns) -> list[Picture]:
    """Pictures of errors by horizon, predicted paths, and residuals inside and outside where the mismatch was located.

    "Before" is the base model, "after" the model with the effects found.  `knots` are columns (K,) of means
    over a knot of states and residual acceleration, `tracks` columns of measured and predicted positions.
    """
    knots, pictures = drop_incomplete_knots(knots), []
    if diagnosis.horizons:
        caption = (
            "Closed-loop error on held-out blocks, NMSE × 10³, with 95 % intervals (block bootstrap), on a scale of "
            "factors. Upright bars: the noise floor."
        )
        pictures.append(Picture("Error by horizon", caption, (_draw_horizon_errors(diagnosis.horizons),)))
    if len(tracks["time_s"]) > 2:
        stretch = choose_stretch(tracks)
        part = {name: np.asarray(values)[stretch.rows] for name, values in tracks.items()}
        factor = _magnification(part)
        larger = f" Misses are drawn {factor:g} times as large as they are." if factor > 1.0 else ""
        panels = (*_draw_paths(part, factor), _draw_misses(part))
        pictures.append(Picture(stretch.title, stretch.caption + larger, panels))
    if len(knots["time_s"]) >= LIMITS.min_knots:
        inside, words = located_knots(diagnosis, knots)
        if LIMITS.min_knots // 3 <= inside.sum() < len(inside):
            caption = f"There: {words}. Dotted lines: means."
            panels = tuple(_draw_residual_histograms(choose_residual(diagnosis, knots), inside))
            pictures.append(Picture("Residuals where the mismatch was located, and elsewhere", caption, panels))
    return pictures


def _draw_residual_histograms(residual: Residual, inside: Bools) -> list[Markup]:
    """Histograms of the residual acceleration before and after the effects found are added, as SVG elements.

    One panel is of the knots that lie `inside` (K,) the place, time or range where the mismatch was
    located, the other of the rest.
    """
    frame = float(np.quantile(np.abs(residual.before), 0.99)) * 1.2 + 1e-6
    bins = np.linspace(-frame, frame, 31)
    panels = []
    for rows, where in ((inside, "there"), (~inside, "elsewhere")):
        title = f"{where} ({int(rows.sum())} knots)"
        figure, ax = canvas.create_panel(2.5)
        for stage, values, colour in residual.stages:
            part = values[rows]
            label = with_minus_sign(f"{stage}: mean {part.mean():+.2g}, RMS {root_mean_square(part):.2g}")
            part = np.clip(part, -frame, frame)
            ax.hist(part, bins, histtype="step", color=colour, lw=1.7, density=True, label=label, ls=DASHES[colour])
            ax.axvline(values[rows].mean(), 0.0, 0.7, color=colour, lw=1.2, ls=":")
        ax.set_xlabel(f"{residual.name} ({residual.unit}), {title}")
        ax.xaxis.set_major_locator(MaxNLocator(7))
        ax.set_yticks([])
        ax.spines["left"].set_visible(False)
        canvas.add_legend(ax, columns=1)
        panels.append(render_svg(figure, f"{residual.name}, {title}"))
    return panels


def _draw_horizon_errors(horizons: Sequence[HorizonError]) -> Markup:
    """Closed-loop NMSE by prediction horizon, before and after effects found are added, as an SVG element.

    The noise floor is drawn beside it: the NMSE that the model has on a recording simulated by the model itself.
    """
    figure, ax = canvas.create_panel(0.8 + 0.62 * len(horizons))
    changed = any(h.nmse_after not in (None, h.nmse_before) for h in horizons)
    shown = {"before": "before" if changed else UNCHANGED, "after": "after", "floor": "noise floor"}
    for row, h in enumerate(horizons):
        before = ("before", BEFORE, -0.2, h.nmse_before, h.before_ci95)
        after = ("after", AFTER, 0.2, h.nmse_after, h.after_ci95)
        for stage, colour, offset, value, interval in (before, after):
            if not value or (stage == "after" and not changed):
                continue
            if interval:
                ax.plot(1e3 * np.array(interval), [row + offset] * 2, color=colour, lw=2.0)
            label, mark = shown.pop(stage, ""), "o" if stage == "before" else "s"
            ax.plot(1e3 * value, row + offset, mark, color=colour, ms=6, label=label or None)
            ax.annotate(
                format_thousandths(value), (1e3 * (interval[1] if interval else value), row + offset), xytext=(6, 0),
                textcoords="offset points", va="center", fontsize=TEXT_SIZE - 1.0, color=colour,
            )  # fmt: skip
        if h.nmse_floor:
            label = shown.pop("floor", "")
            ax.vlines(1e3 * h.nmse_floor, row - 0.4, row + 0.4, color=INK, lw=1.6, label=label or None)
    ax.set_xscale("log")
    low, high = ax.get_xlim()
    ax.set_xlim(low, high * (high / low) ** 0.12)  # room for the last number
    # as many ticks as have room for their words: tenths on a wide scale, 1, 2, 5 on a narrow one
    subdivisions = (
        (1.0,) if high / low > 200.0 else (1.0, 2.0, 5.0) if high / low > 4.0 else tuple(np.arange(1.0, 10.0))
    )
    ax.xaxis.set_major_locator(LogLocator(subs=subdivisions, numticks=12))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.set_yticks(range(len(horizons)), [f"{h.horizon_s:g} s" for h in horizons])
    ax.set_ylim(len(horizons) - 0.5, -0.5)
    ax.set_xlabel("closed-loop NMSE × 10³")
    ax.grid(axis="x", color=canvas.RULE, lw=0.6)
    if ax.get_legend_handles_labels()[0]:
        canvas.add_legend(ax)
    return render_svg(figure, "Error by horizon")


def _changed_stages(part: Columns) -> list[tuple[str, str, str]]:
    """Column prefix, title and colour of each stage; the base model alone where nothing was changed."""
    same = all(np.allclose(part[f"before_{c}"], part[f"after_{c}"], equal_nan=True) for c in "xy")
    return [("before", UNCHANGED, BEFORE)] if same else [("before", "before", BEFORE), ("after", "after", AFTER)]


def _misses(part: Columns, stage: str) -> Floats:
    """Differences (N, 2) (m) between predicted and measured positions of a stage, "before" or "after"."""
    return np.column_stack([part[f"{stage}_x"] - part["x"], part[f"{stage}_y"] - part["y"]])


def _magnification(part: Columns) -> float:
    """The round factor 1 to 100 by which the base model's misses are drawn larger, so that they can be seen.

    It makes their root mean square at most a tenth of the longer side of the measured path.
    """
    rms = float(np.sqrt(np.nanmean((_misses(part, "before") ** 2).sum(axis=1))))
    side = max(float(np.ptp(part["x"])), float(np.ptp(part["y"])), 1e-6)
    fitting = [f for f in (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0) if f * rms <= side / 10.0]
    return max(fitting, default=1.0)


def _restarts_and_gaps(part: Columns) -> tuple[Bools, Bools]:
    """Rows (N,) at which predictions start anew, and those before which measurements are missing."""
    steps = np.diff(part["time_s"])
    gap = np.r_[False, steps > 3.0 * np.median(steps)]
    return part["start"] > 0.5, gap


def _draw_paths(part: Columns, factor: float) -> list[Markup]:
    """Measured and predicted paths, misses drawn `factor` times as large, as an SVG element for each stage."""
    x, y = part["x"], part["y"]
    start, gap = _restarts_and_gaps(part)
    measured = canvas.insert_gaps(np.column_stack([x, y]), np.flatnonzero(gap))
    panels = []
    for stage, words, colour in _changed_stages(part):
        miss = _misses(part, stage)
        title = f"{words}: RMS miss {100 * float(np.sqrt(np.nanmean((miss**2).sum(axis=1)))):.2g} cm"
        figure, ax = canvas.create_floor_panel(np.ptp(x) + 1.0, np.ptp(y) + 1.0, title, below=0.3)
        ax.plot(*measured.T, color=INK, lw=1.0, label="measured")
        drawn = np.column_stack([x, y]) + factor * miss
        ax.plot(
            *canvas.insert_gaps(drawn, np.flatnonzero(start | gap)).T, color=colour, lw=1.6,
            label=f"predicted, miss × {factor:g}" if factor > 1.0 else "predicted",
        )  # fmt: skip
        ax.plot(x[start], y[start], "x", color=INK, ms=4.5, label="restarted")
        ax.set_xlim(x.min() - 0.5, x.max() + 0.5)
        ax.set_ylim(y.min() - 0.5, y.max() + 0.5)
        figure.legend(
            *ax.get_legend_handles_labels(), fontsize=TEXT_SIZE - 0.5, loc="outside lower center", ncols=3,
            frameon=False, labelcolor=INK,
        )  # fmt: skip
        panels.append(render_svg(figure, f"Predicted paths, {title}"))
    return panels


def _draw_misses(part: Columns) -> Markup:
    """How far predictions are from the measured path over time, before and after, as an SVG element."""
    start, gap = _restarts_and_gaps(part)
    figure, ax = canvas.create_panel(2.3)
    for stage, words, colour in _changed_stages(part):
        distance = np.column_stack([part["time_s"], 100.0 * np.hypot(*_misses(part, stage).T)])
        path = canvas.insert_gaps(distance, np.flatnonzero(start | gap))
        ax.plot(*path.T, color=colour, lw=1.6, ls=DASHES[colour], label=words)
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("time (s)")
    ax.set_ylabel("miss (cm)")
    ax.grid(axis="y", color=canvas.RULE, lw=0.6)
    canvas.add_legend(ax)
    return render_svg(figure, "Distance between predicted and measured position over time")
