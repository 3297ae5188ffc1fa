"""Pictures of a model before and after its findings: errors by horizon, predicted paths, residuals by place or time."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from bcid.aliases import Bools
from bcid.documents.diagnosis import DiagnosisDocument, HorizonError
from bcid.report import canvas
from bcid.report.canvas import AFTER, BEFORE, UNCHANGED, WIDTH, Columns, Picture, insert_gaps, render_data_uri
from bcid.report.disturbance import Residual, choose_residual, drop_incomplete_knots, located_knots, root_mean_square
from bcid.report.formats import with_minus_sign
from bcid.report.limits import LIMITS
from bcid.report.path_stretch import choose_stretch

# A label that no legend shows, for what a legend has already.
HIDDEN_LABEL = "_hidden"


def draw_before_after_pictures(diagnosis: DiagnosisDocument, knots: Columns, tracks: Columns) -> list[Picture]:
    """Pictures of errors by horizon, predicted paths, and residuals inside and outside where the mismatch was located.

    "Before" is the base model, "after" the model with the effects found.  `knots` are columns (K,) of half-second
    means of states and residual acceleration, `tracks` columns of measured and predicted positions.
    """
    knots, pictures = drop_incomplete_knots(knots), []
    if diagnosis.horizons:
        caption = "Closed-loop error on held-out blocks with 95 % intervals (block bootstrap); bars: the noise floor."
        pictures.append(Picture("Error by horizon", caption, _draw_horizon_errors(diagnosis.horizons)))
    if len(tracks["time_s"]) > 2:
        stretch = choose_stretch(tracks)
        pictures.append(Picture(stretch.title, stretch.caption, _draw_paths(tracks, stretch.rows)))
    if len(knots["time_s"]) >= LIMITS.min_knots:
        inside, words = located_knots(diagnosis, knots)
        if LIMITS.min_knots // 3 <= inside.sum() < len(inside):
            caption = f"There: {words}. Dashed lines: means."
            image = _draw_residual_histograms(choose_residual(diagnosis, knots), inside)
            pictures.append(Picture("Residuals where the mismatch was located, and elsewhere", caption, image))
    return pictures


def _draw_residual_histograms(residual: Residual, inside: Bools) -> str:
    """Histograms of the residual acceleration before and after the effects found are added, as an image's data URI.

    One panel is of the half-second means that lie `inside` (K,) the place, time or range where the mismatch was
    located, the other of the rest.
    """
    figure = Figure(figsize=(WIDTH, 2.7), layout="constrained")
    axes = figure.subplots(1, 2, sharex=True)
    frame = float(np.quantile(np.abs(residual.before), 0.99)) * 1.2 + 1e-6
    bins = np.linspace(-frame, frame, 31)
    for ax, rows, where in zip(axes, (inside, ~inside), ("there", "elsewhere"), strict=True):
        for title, values, colour in residual.stages:
            part = values[rows]
            label = with_minus_sign(f"{title}: mean {part.mean():+.2g}, RMS {root_mean_square(part):.2g}")
            part = np.clip(part, -frame, frame)
            ax.hist(part, bins, histtype="step", color=colour, lw=1.7, density=True, label=label)
            ax.axvline(values[rows].mean(), 0.0, 0.7, color=colour, lw=1.2, ls="--")
        ax.set_title(f"{where} ({int(rows.sum())} knots)", fontsize=10)
        ax.set_xlabel(f"{residual.name} ({residual.unit})")
        ax.set_yticks([])
        ax.set_ylim(top=1.45 * ax.get_ylim()[1])
        ax.legend(fontsize=8, loc="upper center", ncols=1, frameon=False)
    return render_data_uri(figure)


def _draw_horizon_errors(horizons: Sequence[HorizonError]) -> str:
    """Closed-loop NMSE by prediction horizon, before and after effects found are added, as the data URI of an image.

    The noise floor is drawn beside it: the NMSE that the model has on a recording simulated by the model itself.
    """
    figure = Figure(figsize=(7.5, 0.9 + 0.5 * len(horizons)), layout="constrained")
    ax = figure.subplots()
    changed = any(h.nmse_after not in (None, h.nmse_before) for h in horizons)
    labels = {"before": "before" if changed else UNCHANGED, "after": "after", "floor": "noise floor"}
    for row, h in enumerate(horizons):
        before = ("before", BEFORE, -0.16, h.nmse_before, h.before_ci95)
        after = ("after", AFTER, 0.16, h.nmse_after, h.after_ci95)
        for stage, colour, offset, value, interval in (before, after):
            if value is None or (stage == "after" and not changed):
                continue
            if interval:
                ax.plot(1e3 * np.array(interval), [row + offset] * 2, color=colour, lw=2.2)
            label = labels.pop(stage, HIDDEN_LABEL)
            ax.plot(1e3 * value, row + offset, "o" if stage == "before" else "s", color=colour, ms=7, label=label)
        if h.nmse_floor is not None:
            label = labels.pop("floor", HIDDEN_LABEL)
            ax.vlines(1e3 * h.nmse_floor, row - 0.36, row + 0.36, color="black", lw=2, label=label)
    ax.set_xscale("log")
    ax.set_yticks(range(len(horizons)), [f"{h.horizon_s:g} s" for h in horizons])
    ax.set_ylim(len(horizons) - 0.5, -0.5)
    ax.set_xlabel("closed-loop NMSE × 10³")
    ax.xaxis.set_major_formatter("{x:g}")
    ax.grid(axis="x", which="both", alpha=0.25)
    if len(labels) < 3:
        ax.legend(fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
    return render_data_uri(figure)


def _draw_paths(tracks: Columns, shown: npt.NDArray[np.intp]) -> str:
    """Measured and predicted paths over the rows `shown` of `tracks`, as the data URI of an image.

    One panel is of the base model, one of the model with the effects found; if both are equal, there is one panel.
    """
    part = {name: np.asarray(values)[shown] for name, values in tracks.items()}
    x, y, start = part["x"], part["y"], part["start"] > 0.5
    gap = np.r_[False, np.diff(part["time_s"]) > 3.0 * np.median(np.diff(tracks["time_s"]))]
    stages = [("before", BEFORE), ("after", AFTER)]
    if all(np.allclose(part[f"before_{c}"], part[f"after_{c}"], equal_nan=True) for c in "xy"):
        stages = stages[:1]
    titles = [stage for stage, _ in stages] if len(stages) > 1 else [UNCHANGED]
    figure, axes = canvas.create_floor_panels(len(stages), np.ptp(x) + 1.0, np.ptp(y) + 1.0)
    for ax, title, (stage, colour) in zip(axes, titles, stages, strict=True):
        px, py = part[f"{stage}_x"], part[f"{stage}_y"]
        ax.plot(*insert_gaps(np.column_stack([x, y]), np.flatnonzero(gap)).T, color="black", lw=1.0, label="measured")
        predicted = insert_gaps(np.column_stack([px, py]), np.flatnonzero(start | gap))
        ax.plot(*predicted.T, color=colour, lw=1.7, label="predicted")
        ax.plot(x[start], y[start], "x", color="black", ms=5, label="restarted")
        miss = float(np.sqrt(np.nanmean((px - x) ** 2 + (py - y) ** 2)))
        ax.set_title(f"{title}: RMS miss {100 * miss:.2g} cm", fontsize=10)
        ax.set_xlim(x.min() - 0.5, x.max() + 0.5)
        ax.set_ylim(y.min() - 0.5, y.max() + 0.5)
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, loc="outside right upper", frameon=False)
    return render_data_uri(figure)
