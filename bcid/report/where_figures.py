"""Where a mismatch lies: the disturbance over the floor, over time and over what it depends on, before and after.

Before and after share their scales, so that what was found is seen to vanish.  No text of the input is drawn.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter

from bcid.aliases import Floats
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.report import canvas, disturbance
from bcid.report.canvas import WIDTH, Columns, Picture, render_data_uri
from bcid.report.disturbance import Residual, differs_in_magnitude, knot_variable, located_windows, root_mean_square
from bcid.report.formats import VARIABLES
from bcid.report.limits import LIMITS

# Fine squares along the side of a square of the floor map, and the standard deviation of its smoothing in squares.
FINE_PER_SQUARE, SMOOTHING_SD = 3, 0.45


def draw_where_pictures(diagnosis: DiagnosisDocument, knots: Columns) -> list[Picture]:
    """Pictures of the unexplained acceleration over the floor, over time and over the quantities it depends on most.

    `knots` are columns (K,) of half-second means.  The picture of what was located (place, time, or a dependence)
    comes first; there are none for fewer than LIMITS.min_knots rows.
    """
    knots = disturbance.drop_incomplete_knots(knots)
    if len(knots["time_s"]) < LIMITS.min_knots:
        return []
    residual = disturbance.choose_residual(diagnosis, knots)
    names = disturbance.choose_variables(diagnosis, knots, residual)
    located = diagnosis.where.depends_on
    more = " and ".join(VARIABLES[n][0] for n in names if located and n not in located)
    what = f"{residual.name[0].upper()}{residual.name[1:]} that the model lacks"
    sizes, circle = ("mean size" if differs_in_magnitude(residual, knots) else "mean"), diagnosis.where.place
    inside, there = disturbance.located_or_all_knots(diagnosis, knots)
    part = {n: v[inside] for n, v in knots.items()}
    floor = Picture(
        "Over the arena floor",
        f"{what}: {sizes}, smoothed over {disturbance.square_size(knots):.1f} m. Grey: hardly driven over. "
        f"{'Circle: the place located. ' if circle else ''}{'Crosses: contacts.' if diagnosis.contacts else ''}",
        _draw_floor_map(diagnosis, knots, residual),
    )
    drawn = _draw_over_time(diagnosis, knots, residual)
    time = Picture("Over time", f"{what}: median and middle two thirds.", drawn)
    variables = Picture(
        f"Over {' and '.join(VARIABLES[n][0] for n in names)}",
        f"{what}: knots of 0.5 s{there}, and medians of bins ± 2 standard errors. Knots beyond the frame are cut."
        f"{f' For comparison: {more}.' if more else ''}",
        _draw_over_variables(part, residual.select_rows(inside), names),
    )
    if circle:
        return [floor, variables, time]
    return [time, variables, floor] if located_windows(diagnosis) else [variables, floor, time]


def _draw_floor_map(diagnosis: DiagnosisDocument, knots: Columns, residual: Residual) -> str:
    """Smoothed map of the unexplained acceleration on the floor, before and after effects are added, as a data URI."""
    fine = disturbance.square_size(knots) / FINE_PER_SQUARE
    edges = [np.arange(v.min() - fine, v.max() + 2.0 * fine, fine) for v in (knots["x"], knots["y"])]
    size = differs_in_magnitude(residual, knots)

    def smooth(weights: Floats) -> Floats:
        total, _, _ = np.histogram2d(knots["x"], knots["y"], edges, weights=weights)
        return np.asarray(gaussian_filter(total, SMOOTHING_SD * FINE_PER_SQUARE, mode="constant"), dtype=float)

    count = smooth(np.ones_like(residual.before))
    seen = count > LIMITS.driven_square_share * LIMITS.knots_per_square / FINE_PER_SQUARE**2
    sums = [smooth(np.abs(values) if size else values) for _, values, _ in residual.stages]
    grids = [np.where(seen, total / np.maximum(count, 1e-12), np.nan) for total in sums]
    level = np.abs(grids[0][seen]) if seen.any() else np.zeros(1)
    low, high = (float(np.quantile(level, q)) for q in (0.02, 0.99))
    high = max(high, 1e-6 if size else root_mean_square(residual.before))  # a mean well below the scatter stays pale
    figure, axes = canvas.create_floor_panels(len(grids), np.ptp(edges[0]), np.ptp(edges[1]))
    for ax, grid, (title, values, _) in zip(axes, grids, residual.stages, strict=True):
        ax.set_facecolor(canvas.UNDRIVEN_COLOUR)
        mesh = ax.pcolormesh(
            *edges, grid.T, cmap="cividis" if size else "RdBu_r", vmin=low if size else -high, vmax=high
        )
        ax.set_title(f"{title}: RMS {root_mean_square(values):.2g} {residual.unit}", fontsize=10)
        _mark_place_and_contacts(ax, diagnosis, "white" if size else "black")
    label = f"{'mean size of ' if size else ''}{residual.name} ({residual.unit})"
    figure.colorbar(mesh, ax=list(axes), extend="max" if size else "both", shrink=0.9).set_label(label, size=9)
    return render_data_uri(figure)


def _mark_place_and_contacts(ax: Any, diagnosis: DiagnosisDocument, colour: str) -> None:
    """Draw the circle where the mismatch was located and the contacts (bumps, crashes) as crosses into the map `ax`."""
    place = diagnosis.where.place
    if place:
        around = np.linspace(0.0, 2.0 * np.pi, 90)
        x, y = place.x_m + place.radius_m * np.cos(around), place.y_m + place.radius_m * np.sin(around)
        ax.plot(x, y, color=colour, lw=1.6)
    contacts = diagnosis.contacts
    for ink, thick in (("white", 3.6), ("black", 1.6)):
        ax.plot([c.x_m for c in contacts], [c.y_m for c in contacts], "x", color=ink, ms=6, mew=thick)


def _draw_over_time(diagnosis: DiagnosisDocument, knots: Columns, residual: Residual) -> str:
    """Median and middle two thirds of the unexplained acceleration over time, located times shaded, as a data URI."""
    time = knots["time_s"]
    edges = np.linspace(time.min(), time.max() + 1e-6, int(np.clip(len(time) // 20, 3, 60)) + 1)
    group = np.clip(np.searchsorted(edges, time, side="right") - 1, 0, len(edges) - 2)
    middle = 0.5 * (edges[1:] + edges[:-1])
    figure = Figure(figsize=(WIDTH, 0.9 + 1.1 * len(residual.stages)), layout="constrained")
    axes = figure.subplots(len(residual.stages), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    for ax, (title, values, colour) in zip(axes, residual.stages, strict=True):
        parts = [values[group == b] for b in range(len(middle))]
        low, median, high = np.array(
            [np.quantile(p, [1 / 6, 0.5, 5 / 6]) if len(p) >= LIMITS.min_knots_per_bin else [np.nan] * 3 for p in parts]
        ).T
        for begin, end in located_windows(diagnosis):
            ax.axvspan(begin, end, color="#f0e442", alpha=0.35, lw=0)
        ax.axhline(0.0, color="black", lw=0.6)
        ax.fill_between(middle, low, high, color=colour, alpha=0.25, lw=0)
        ax.plot(middle, median, color=colour, lw=1.5)
        ax.set_ylabel(f"{title} ({residual.unit})", fontsize=9)
        ax.set_xlim(time.min(), time.max())
    axes[-1].set_xlabel("time (s)")
    return render_data_uri(figure)


def _draw_over_variables(knots: Columns, residual: Residual, names: Sequence[str]) -> str:
    """Unexplained acceleration over each quantity in `names`, half-second means and binned medians, as a data URI."""
    figure = Figure(figsize=(WIDTH, 4.4 if len(residual.stages) > 1 else 2.5), layout="constrained")
    rows = figure.subplots(len(residual.stages), len(names), sharex="col", sharey=True, squeeze=False)
    medians = [[_binned_medians(knot_variable(n, knots), values) for n in names] for _, values, _ in residual.stages]
    # a frame that shows the binned values and most knots
    largest = max(
        (float(np.max(np.abs(median) + error)) for _, median, error in medians[0] if len(median)), default=0.0
    )
    spread = 1.4826 * float(np.median(np.abs(residual.before - np.median(residual.before))))
    frame = max(1.15 * largest, 1.6 * spread, 1e-6)
    dot = float(np.clip(100.0 / np.sqrt(len(residual.before)), 2.8, 7.0))
    for axes, stage, row in zip(rows, residual.stages, medians, strict=True):
        title, values, colour = stage
        for ax, name, (at, median, error) in zip(axes, names, row, strict=True):
            ax.plot(knot_variable(name, knots), values, ".", color=canvas.DOT_COLOUR, ms=dot, alpha=0.6, mew=0)
            ax.axhline(0.0, color="black", lw=0.6)
            ax.errorbar(at, median, error, fmt="o-", color=colour, ms=4, lw=1.5, capsize=2)
            ax.set_ylim(-frame, frame)
            ax.locator_params(axis="x", nbins=7)
        axes[0].set_ylabel(f"{title} ({residual.unit})", fontsize=9)
    for ax, name in zip(rows[-1], names, strict=True):
        words, unit = VARIABLES[name]
        ax.set_xlabel(f"{words} ({unit})" if unit else words)
    return render_data_uri(figure)


def _binned_medians(x: Floats, values: Floats) -> tuple[Floats, Floats, Floats]:
    """Mean of `x`, median of `values` and twice that median's standard error, in bins of equally many values of `x`.

    Bins with fewer than LIMITS.min_knots_per_bin values are left out.  The standard error is that of normal values.
    """
    group = disturbance.equal_count_bins(x)
    rows = [group == b for b in np.unique(group) if (group == b).sum() >= LIMITS.min_knots_per_bin]
    at = np.array([x[r].mean() for r in rows])
    median = np.array([np.median(values[r]) for r in rows])
    error = np.array([2.0 * 1.2533 * values[r].std() / np.sqrt(r.sum()) for r in rows])
    return at, median, error
