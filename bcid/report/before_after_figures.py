"""What was found, shown by what it takes away: errors by horizon, predicted paths, residuals there and elsewhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from bcid.aliases import Floats
from bcid.report.canvas import AFTER, BEFORE, MINUS, UNCHANGED, WIDTH, Columns, Picture, data_uri, floor_panels, png
from bcid.report.knots import FEWEST, Residual, finite, located, residual_of, rms

HIDDEN = "_hidden"  # a label that no legend shows
STRETCH_S = 20.0


def proof_pictures(diagnosis: Mapping[str, Any], knots: Columns, tracks: Columns) -> list[Picture]:
    """Errors by horizon, predicted paths, and the disturbance at the place located."""
    knots, pictures = finite(knots), []
    if diagnosis.get("horizons"):
        caption = "Closed-loop error on held-out blocks with 95 % intervals (block bootstrap); bars: the noise floor."
        pictures.append(Picture("Error by horizon", caption, data_uri(_horizons(diagnosis["horizons"]))))
    if len(tracks["time_s"]) > 2:
        shown = _worst(tracks)
        begin, end = tracks["time_s"][shown][[0, -1]]
        caption = (
            f"The {end - begin:.0f} s from {begin:.0f} s on, where the base model misses most; predictions start anew "
            "from the measured state every 2 s (crosses). Held-out throughout."
        )
        pictures.append(
            Picture("Predicted paths where the base model is worst", caption, data_uri(_paths(tracks, shown)))
        )
    if len(knots["time_s"]) >= FEWEST:
        inside, words = located(diagnosis, knots)
        if FEWEST // 3 <= inside.sum() < len(inside):
            caption = f"There: {words}. Dashed lines: means."
            image = data_uri(_there_and_elsewhere(residual_of(diagnosis, knots), inside))
            pictures.append(Picture("Residuals where the mismatch was located, and elsewhere", caption, image))
    return pictures


def _there_and_elsewhere(of: Residual, inside: npt.NDArray[np.bool_]) -> bytes:
    figure = Figure(figsize=(WIDTH, 2.7), layout="constrained")
    axes = figure.subplots(1, 2, sharex=True)
    frame = float(np.quantile(np.abs(of.before), 0.99)) * 1.2 + 1e-6
    bins = np.linspace(-frame, frame, 31)
    for ax, rows, where in zip(axes, (inside, ~inside), ("there", "elsewhere"), strict=True):
        for title, values, colour in of.stages:
            part = values[rows]
            label = f"{title}: mean {part.mean():+.2g}, RMS {rms(part):.2g}".replace("-", MINUS)
            ax.hist(
                np.clip(part, -frame, frame), bins, histtype="step", color=colour, lw=1.7, density=True, label=label
            )
            ax.axvline(part.mean(), 0.0, 0.7, color=colour, lw=1.2, ls="--")
        ax.set_title(f"{where} ({int(rows.sum())} knots)", fontsize=10)
        ax.set_xlabel(f"{of.name} ({of.unit})")
        ax.set_yticks([])
        ax.set_ylim(top=1.45 * ax.get_ylim()[1])
        ax.legend(fontsize=8, loc="upper center", ncols=1, frameon=False)
    return png(figure)


def _horizons(horizons: Sequence[Mapping[str, Any]]) -> bytes:
    figure = Figure(figsize=(7.5, 0.9 + 0.5 * len(horizons)), layout="constrained")
    ax = figure.subplots()
    changed = any(h.get("nmse_after") not in (None, h.get("nmse_before")) for h in horizons)
    names = {"before": "before" if changed else UNCHANGED, "after": "after"}
    labelled: set[str] = set()
    for row, h in enumerate(horizons):
        for stage, colour, offset in (("before", BEFORE, -0.16), ("after", AFTER, 0.16)):
            value, interval = h.get(f"nmse_{stage}"), h.get(f"{stage}_ci95")
            if value is None or (stage == "after" and not changed):
                continue
            if interval and None not in interval:
                ax.plot(1e3 * np.array(interval), [row + offset] * 2, color=colour, lw=2.2)
            label = HIDDEN if stage in labelled else names[stage]
            labelled.add(stage)
            ax.plot(1e3 * value, row + offset, "o" if stage == "before" else "s", color=colour, ms=7, label=label)
        if h.get("nmse_floor") is not None:
            label = HIDDEN if "floor" in labelled else "noise floor"
            labelled.add("floor")
            ax.vlines(1e3 * h["nmse_floor"], row - 0.36, row + 0.36, color="black", lw=2, label=label)
    ax.set_xscale("log")
    ax.set_yticks(range(len(horizons)), [f"{h['horizon_s']:g} s" for h in horizons])
    ax.set_ylim(len(horizons) - 0.5, -0.5)
    ax.set_xlabel("closed-loop NMSE × 10³")
    ax.xaxis.set_major_formatter("{x:g}")
    ax.grid(axis="x", which="both", alpha=0.25)
    if labelled:
        ax.legend(fontsize=8, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
    return png(figure)


def _worst(tracks: Columns) -> npt.NDArray[np.intp]:
    """The rows of the STRETCH_S, from a fresh start on, over which the base model misses most."""
    time = tracks["time_s"]
    square = (tracks["before_x"] - tracks["x"]) ** 2 + (tracks["before_y"] - tracks["y"]) ** 2
    total = np.r_[0.0, np.cumsum(np.nan_to_num(square))]
    starts = np.flatnonzero(tracks["start"] > 0.5)
    starts = starts if len(starts) else np.array([0])
    ends = np.searchsorted(time, time[starts] + STRETCH_S)
    best = int(np.argmax(total[ends] - total[starts]))
    return np.arange(starts[best], ends[best])


def _paths(tracks: Columns, shown: npt.NDArray[np.intp]) -> bytes:
    part = {name: np.asarray(values)[shown] for name, values in tracks.items()}
    x, y, start = part["x"], part["y"], part["start"] > 0.5
    gap = np.r_[False, np.diff(part["time_s"]) > 3.0 * np.median(np.diff(tracks["time_s"]))]
    stages = [("before", BEFORE), ("after", AFTER)]
    if all(np.allclose(part[f"before_{c}"], part[f"after_{c}"], equal_nan=True) for c in "xy"):
        stages = stages[:1]
    titles = [stage for stage, _ in stages] if len(stages) > 1 else [UNCHANGED]
    figure, axes = floor_panels(len(stages), np.ptp(x) + 1.0, np.ptp(y) + 1.0)
    for ax, title, (stage, colour) in zip(axes, titles, stages, strict=True):
        px, py = part[f"{stage}_x"], part[f"{stage}_y"]
        ax.plot(*_broken(x, y, gap), color="black", lw=1.0, label="measured")
        ax.plot(*_broken(px, py, start | gap), color=colour, lw=1.7, label="predicted")
        ax.plot(x[start], y[start], "x", color="black", ms=5, label="started anew")
        miss = float(np.sqrt(np.nanmean((px - x) ** 2 + (py - y) ** 2)))
        ax.set_title(f"{title}: RMS miss {100 * miss:.2g} cm", fontsize=10)
        ax.set_xlim(x.min() - 0.5, x.max() + 0.5)
        ax.set_ylim(y.min() - 0.5, y.max() + 0.5)
    figure.legend(*axes[0].get_legend_handles_labels(), fontsize=8, loc="outside right upper", frameon=False)
    return png(figure)


def _broken(x: Floats, y: Floats, breaks: npt.NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """The path with a hole before every break."""
    at = np.flatnonzero(breaks)
    at = at[at > 0]
    return np.insert(x, at, np.nan), np.insert(y, at, np.nan)
