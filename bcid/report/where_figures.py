"""Where a mismatch lies: the disturbance over the floor, over time and over what it depends on, before and after.

Before and after share their scales, so that what was found is seen to vanish.  No text of the input is drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter

from bcid.aliases import Floats
from bcid.report.canvas import DOTS, NEVER, WIDTH, Columns, Picture, data_uri, floor_panels, png
from bcid.report.knots import (
    FEWEST,
    PER_CELL,
    VARIABLES,
    Residual,
    bins_of,
    by_magnitude,
    finite,
    located_part,
    residual_of,
    rms,
    square_of,
    two_variables,
    variable,
    where_of,
    windows_of,
)

SPLIT = 3  # fine squares along the side of one
SMOOTH = 0.45  # standard deviation of the smoothing, in squares
LEAST_SHARE = 0.25  # of PER_CELL, below which the floor counts as hardly driven over


def where_pictures(diagnosis: Mapping[str, Any], knots: Columns) -> list[Picture]:
    """Over the floor, over time, over the two quantities it depends on most; the most telling first."""
    knots = finite(knots)
    if len(knots["time_s"]) < FEWEST:
        return []
    of = residual_of(diagnosis, knots)
    names = two_variables(diagnosis, knots, of)
    told = where_of(diagnosis)["depends_on"] or []
    more = " and ".join(VARIABLES[n][0] for n in names if told and n not in told)
    what = f"{of.name[0].upper()}{of.name[1:]} that the model lacks"
    sizes, circle = ("mean size" if by_magnitude(of, knots) else "mean"), where_of(diagnosis)["place"]
    inside, there = located_part(diagnosis, knots)
    part = {n: v[inside] for n, v in knots.items()}
    floor = Picture(
        "Over the arena floor",
        f"{what}: {sizes}, smoothed over {square_of(knots):.1f} m. Grey: hardly driven over. "
        f"{'Circle: the place located. ' if circle else ''}{'Crosses: contacts.' if diagnosis.get('contacts') else ''}",
        data_uri(_map(diagnosis, knots, of)),
    )
    time = Picture("Over time", f"{what}: median and middle two thirds.", data_uri(_over_time(diagnosis, knots, of)))
    variables = Picture(
        f"Over {' and '.join(VARIABLES[n][0] for n in names)}",
        f"{what}: knots of 0.5 s{there}, and medians of bins ± 2 standard errors. Knots beyond the frame are cut."
        f"{f' For comparison: {more}.' if more else ''}",
        data_uri(_over_variables(part, of.at(inside), names)),
    )
    if circle:
        return [floor, variables, time]
    return [time, variables, floor] if windows_of(diagnosis) else [variables, floor, time]


def place_picture(diagnosis: Mapping[str, Any], knots: Columns) -> bytes:
    """The disturbance over the arena floor, before and after, as a PNG (of FEWEST knots or more)."""
    knots = finite(knots)
    return _map(diagnosis, knots, residual_of(diagnosis, knots))


def dependence_picture(diagnosis: Mapping[str, Any], knots: Columns) -> bytes:
    """The disturbance over the two quantities it depends on most, before and after, as a PNG."""
    knots = finite(knots)
    of = residual_of(diagnosis, knots)
    inside, _ = located_part(diagnosis, knots)
    part = {n: v[inside] for n, v in knots.items()}
    return _over_variables(part, of.at(inside), two_variables(diagnosis, knots, of))


def _map(diagnosis: Mapping[str, Any], knots: Columns, of: Residual) -> bytes:
    fine = square_of(knots) / SPLIT
    edges = _edges(knots["x"], fine), _edges(knots["y"], fine)
    size = by_magnitude(of, knots)

    def smooth(weights: Floats) -> Floats:
        total, _, _ = np.histogram2d(knots["x"], knots["y"], edges, weights=weights)
        return np.asarray(gaussian_filter(total, SMOOTH * SPLIT, mode="constant"), dtype=float)

    count = smooth(np.ones_like(of.before))
    seen = count > LEAST_SHARE * PER_CELL / SPLIT**2
    sums = [smooth(np.abs(values) if size else values) for _, values, _ in of.stages]
    grids = [np.where(seen, total / np.maximum(count, 1e-12), np.nan) for total in sums]
    level = np.abs(grids[0][seen]) if seen.any() else np.zeros(1)
    low, high = (float(np.quantile(level, q)) for q in (0.02, 0.99))
    high = max(high, 1e-6 if size else rms(of.before))  # a mean well below the scatter stays pale
    figure, axes = floor_panels(len(grids), np.ptp(edges[0]), np.ptp(edges[1]))
    for ax, grid, (title, values, _) in zip(axes, grids, of.stages, strict=True):
        ax.set_facecolor(NEVER)
        mesh = ax.pcolormesh(
            *edges, grid.T, cmap="cividis" if size else "RdBu_r", vmin=low if size else -high, vmax=high
        )
        ax.set_title(f"{title}: RMS {rms(values):.2g} {of.unit}", fontsize=10)
        _mark(ax, diagnosis, "white" if size else "black")
    label = f"{'mean size of ' if size else ''}{of.name} ({of.unit})"
    figure.colorbar(mesh, ax=list(axes), extend="max" if size else "both", shrink=0.9).set_label(label, size=9)
    return png(figure)


def _edges(values: Floats, size: float) -> Floats:
    return np.arange(values.min() - size, values.max() + 2.0 * size, size)


def _mark(ax: Any, diagnosis: Mapping[str, Any], colour: str) -> None:
    """The circle located and the contacts."""
    place = where_of(diagnosis)["place"]
    if place:
        around = np.linspace(0.0, 2.0 * np.pi, 90)
        x, y = place["x_m"] + place["radius_m"] * np.cos(around), place["y_m"] + place["radius_m"] * np.sin(around)
        ax.plot(x, y, color=colour, lw=1.6)
    contacts = diagnosis.get("contacts") or []
    for ink, thick in (("white", 3.6), ("black", 1.6)):
        ax.plot([c["x_m"] for c in contacts], [c["y_m"] for c in contacts], "x", color=ink, ms=6, mew=thick)


def _over_time(diagnosis: Mapping[str, Any], knots: Columns, of: Residual) -> bytes:
    time = knots["time_s"]
    edges = np.linspace(time.min(), time.max() + 1e-6, int(np.clip(len(time) // 20, 3, 60)) + 1)
    group = np.clip(np.searchsorted(edges, time, side="right") - 1, 0, len(edges) - 2)
    middle = 0.5 * (edges[1:] + edges[:-1])
    figure = Figure(figsize=(WIDTH, 0.9 + 1.1 * len(of.stages)), layout="constrained")
    axes = figure.subplots(len(of.stages), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for ax, (title, values, colour) in zip(axes, of.stages, strict=True):
        parts = [values[group == b] for b in range(len(middle))]
        low, median, high = np.array(
            [np.quantile(p, [1 / 6, 0.5, 5 / 6]) if len(p) > 4 else [np.nan] * 3 for p in parts]
        ).T
        for begin, end in windows_of(diagnosis):
            ax.axvspan(begin, end, color="#f0e442", alpha=0.35, lw=0)
        ax.axhline(0.0, color="black", lw=0.6)
        ax.fill_between(middle, low, high, color=colour, alpha=0.25, lw=0)
        ax.plot(middle, median, color=colour, lw=1.5)
        ax.set_ylabel(f"{title} ({of.unit})", fontsize=9)
        ax.set_xlim(time.min(), time.max())
    axes[-1].set_xlabel("time (s)")
    return png(figure)


def _over_variables(knots: Columns, of: Residual, names: Sequence[str]) -> bytes:
    figure = Figure(figsize=(WIDTH, 4.4 if len(of.stages) > 1 else 2.5), layout="constrained")
    rows = figure.subplots(len(of.stages), len(names), sharex="col", sharey=True, squeeze=False)
    found = [[_medians(variable(n, knots), values) for n in names] for _, values, _ in of.stages]
    frame = _frame(of, [float(np.max(np.abs(m) + e)) for m, e in ((f[1], f[2]) for f in found[0]) if len(m)])
    dot = float(np.clip(100.0 / np.sqrt(len(of.before)), 2.8, 7.0))
    for axes, stage, row in zip(rows, of.stages, found, strict=True):
        title, values, colour = stage
        for ax, name, (at, median, error) in zip(axes, names, row, strict=True):
            ax.plot(variable(name, knots), values, ".", color=DOTS, ms=dot, alpha=0.6, mew=0)
            ax.axhline(0.0, color="black", lw=0.6)
            ax.errorbar(at, median, error, fmt="o-", color=colour, ms=4, lw=1.5, capsize=2)
            ax.set_ylim(-frame, frame)
            ax.locator_params(axis="x", nbins=7)
        axes[0].set_ylabel(f"{title} ({of.unit})", fontsize=9)
    for ax, name in zip(rows[-1], names, strict=True):
        words, unit = VARIABLES[name]
        ax.set_xlabel(f"{words} ({unit})" if unit else words)
    return png(figure)


def _frame(of: Residual, shown: Sequence[float]) -> float:
    """Half the height that shows the binned values and most knots."""
    spread = 1.4826 * float(np.median(np.abs(of.before - np.median(of.before))))
    return max(1.15 * max(map(abs, shown), default=0.0), 1.6 * spread, 1e-6)


def _medians(x: Floats, values: Floats) -> tuple[Floats, Floats, Floats]:
    """Middle, median and two standard errors of it in every bin with knots enough."""
    _, group = bins_of(x)
    rows = [group == b for b in np.unique(group) if (group == b).sum() > 4]
    at = np.array([x[r].mean() for r in rows])
    median = np.array([np.median(values[r]) for r in rows])
    error = np.array([2.0 * 1.2533 * values[r].std() / np.sqrt(r.sum()) for r in rows])
    return at, median, error
