"""Where a mismatch lies: the disturbance over the floor, over time and over what it depends on, before and after.

Before and after share their scales, so that what was found is seen to vanish.  No text of the input is drawn.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgba
from matplotlib.ticker import MaxNLocator
from scipy.ndimage import gaussian_filter

from bcid.aliases import Floats
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.report import canvas, disturbance
from bcid.report.canvas import INK, TEXT_SIZE, Columns, Picture, create_panel, render_svg
from bcid.report.disturbance import Residual, differs_in_magnitude, knot_variable, located_windows, root_mean_square
from bcid.report.formats import VARIABLES
from bcid.report.limits import LIMITS

# Fine squares along the side of a square of the floor map, and the standard deviation of its smoothing in squares.
FINE_PER_SQUARE, SMOOTHING_SD = 3, 0.45


def draw_where_pictures(diagnosis: DiagnosisDocument, knots: Columns) -> list[Picture]:
    """Pictures of the unexplained acceleration over the floor, over time and over the quantities it depends on most.

    `knots` are columns (K,) of means over a knot.  The picture of what was located (place, time, or a dependence)
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
        tuple(_draw_floor_maps(diagnosis, knots, residual)),
    )
    shaded = " Shaded yellow: the time located." if located_windows(diagnosis) else ""
    drawn = tuple(_draw_over_time(diagnosis, knots, residual))
    time = Picture("Over time", f"{what}: median and middle two thirds.{shaded}", drawn)
    variables = Picture(
        f"Over {' and '.join(VARIABLES[n][0] for n in names)}",
        f"{what}: means of 0.25 s{there}, and medians of bins ± 2 standard errors. Those beyond the frame are cut."
        f"{f' For comparison: {more}.' if more else ''}",
        tuple(_draw_over_variables(part, residual.select_rows(inside), names)),
    )
    if circle:
        return [floor, variables, time]
    return [time, variables, floor] if located_windows(diagnosis) else [variables, floor, time]


def _draw_floor_maps(diagnosis: DiagnosisDocument, knots: Columns, residual: Residual) -> list[Markup]:
    """Smoothed maps of the unexplained acceleration on the floor, before and after effects are added, as SVG."""
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
    scale = Normalize(low if size else -high, high)
    colours = canvas.SIZE_COLOURS if size else canvas.SIGNED_COLOURS
    label = f"{'mean size of ' if size else ''}{residual.name} ({residual.unit})"
    panels = []
    for grid, (stage, values, _) in zip(grids, residual.stages, strict=True):
        title = f"{stage}: RMS {root_mean_square(values):.2g} {residual.unit}"
        figure, ax = canvas.create_floor_panel(np.ptp(edges[0]), np.ptp(edges[1]), title, below=0.7)
        frame = (edges[0][0], edges[0][-1], edges[1][0], edges[1][-1])
        image = colours(scale(np.ma.masked_invalid(grid.T)))
        image[~seen.T] = to_rgba(canvas.UNDRIVEN_COLOUR)
        ax.imshow(image, extent=frame, origin="lower", interpolation="nearest")
        _mark_place_and_contacts(ax, diagnosis)
        bar: Any = figure.colorbar(
            ScalarMappable(scale, colours), ax=ax, extend="max" if size else "both", location="bottom", aspect=40,
            pad=0.03, shrink=0.8,
        )  # fmt: skip
        bar.solids.set_rasterized(True)
        bar.ax.patch.set_visible(False)
        bar.set_label(label, size=TEXT_SIZE, color=INK)
        bar.ax.tick_params(labelsize=TEXT_SIZE - 0.5, labelcolor=INK, color=canvas.MUTED)
        bar.outline.set_edgecolor(canvas.MUTED)
        bar.locator = MaxNLocator(5)
        bar.update_ticks()
        panels.append(render_svg(figure, f"{label} over the floor, {title}"))
    return panels


def _mark_place_and_contacts(ax: Any, diagnosis: DiagnosisDocument) -> None:
    """Draw the circle where the mismatch was located and the contacts (bumps, crashes) as crosses into the map `ax`."""
    place = diagnosis.where.place
    if place:
        around = np.linspace(0.0, 2.0 * np.pi, 90)
        x, y = place.x_m + place.radius_m * np.cos(around), place.y_m + place.radius_m * np.sin(around)
        ax.plot(x, y, color=INK, lw=1.4)
    ax.plot([c.x_m for c in diagnosis.contacts], [c.y_m for c in diagnosis.contacts], "x", color=INK, ms=6, mew=1.6)


def _draw_over_time(diagnosis: DiagnosisDocument, knots: Columns, residual: Residual) -> list[Markup]:
    """Median and middle two thirds of the unexplained acceleration over time, located times shaded, as SVG."""
    time = knots["time_s"]
    edges = np.linspace(time.min(), time.max() + 1e-6, int(np.clip(len(time) // 40, 3, 60)) + 1)
    group = np.clip(np.searchsorted(edges, time, side="right") - 1, 0, len(edges) - 2)
    middle = 0.5 * (edges[1:] + edges[:-1])
    drawn, frame = [], 1e-6
    for stage, values, colour in residual.stages:
        parts = [values[group == b] for b in range(len(middle))]
        bands = np.array(
            [np.quantile(p, [1 / 6, 0.5, 5 / 6]) if len(p) >= LIMITS.min_knots_per_bin else [np.nan] * 3 for p in parts]
        ).T
        frame = max(frame, 1.1 * float(np.max(np.abs(bands), initial=0.0, where=np.isfinite(bands))))
        drawn.append((stage, bands, colour))
    panels = []
    for stage, (low, median, high), colour in drawn:
        figure, ax = create_panel(2.1, stage)
        for begin, end in located_windows(diagnosis):
            ax.axvspan(begin, end, color="#f0e442", alpha=0.35, lw=0)
        ax.axhline(0.0, color=INK, lw=0.6)
        ax.fill_between(middle, low, high, color=colour, alpha=0.25, lw=0)
        ax.plot(middle, median, color=colour, lw=1.5)
        ax.set_ylabel(f"{residual.name}\n({residual.unit})")
        ax.set_xlim(time.min(), time.max())
        ax.set_ylim(-frame, frame)
        ax.set_xlabel("time (s)")
        panels.append(render_svg(figure, f"{residual.name} over time, {stage}"))
    return panels


def _draw_over_variables(knots: Columns, residual: Residual, names: Sequence[str]) -> list[Markup]:
    """Unexplained acceleration over each quantity in `names`, means over a knot and binned medians, as SVG.

    The panels of one quantity follow each other, before and after, in frames of one height for all.
    """
    medians = {n: [_binned_medians(knot_variable(n, knots), v) for _, v, _ in residual.stages] for n in names}
    # a frame that shows the binned values and most knots
    first = [medians[n][0] for n in names]
    largest = max((float(np.max(np.abs(median) + error)) for _, median, error in first if len(median)), default=0.0)
    spread = 1.4826 * float(np.median(np.abs(residual.before - np.median(residual.before))))
    frame = max(1.15 * largest, 1.6 * spread, 1e-6)
    dot = float(np.clip(80.0 / np.sqrt(len(residual.before)), 2.4, 6.0))
    panels = []
    for name in names:
        words, unit = VARIABLES[name]
        for (stage, values, colour), (at, median, error) in zip(residual.stages, medians[name], strict=True):
            figure, ax = create_panel(2.3, stage)
            x = knot_variable(name, knots)
            ax.plot(x, values, ".", color=canvas.DOT_COLOUR, ms=dot, alpha=0.6, mew=0, rasterized=True)
            ax.axhline(0.0, color=INK, lw=0.6)
            ax.errorbar(at, median, error, fmt="o-", color=colour, ms=4, lw=1.5, capsize=2)
            ax.set_ylim(-frame, frame)
            ax.locator_params(axis="x", nbins=7)
            ax.set_ylabel(f"{residual.name}\n({residual.unit})")
            ax.set_xlabel(f"{words} ({unit})" if unit else words)
            panels.append(render_svg(figure, f"{residual.name} over {words}, {stage}"))
    return panels


def _binned_medians(x: Floats, values: Floats) -> tuple[Floats, Floats, Floats]:
    """Mean of `x`, median of `values` and twice that median's standard error, in bins of equally many values of `x`.

    Bins with fewer than LIMITS.min_knots_per_bin values are left out.  The standard error is that of normal values, of
    which neighbours in time are correlated: of an autoregression of first order (1 - rho) / (1 + rho) of them count.
    """
    group = disturbance.equal_count_bins(x)
    rows = [group == b for b in np.unique(group) if (group == b).sum() >= LIMITS.min_knots_per_bin]
    at = np.array([x[r].mean() for r in rows])
    median = np.array([np.median(values[r]) for r in rows])
    rho = max(0.0, float(np.corrcoef(values[:-1], values[1:])[0, 1])) if values.std() > 0.0 else 0.0
    counting = (1.0 - rho) / (1.0 + rho)
    error = np.array([2.0 * 1.2533 * values[r].std() / np.sqrt(counting * r.sum()) for r in rows])
    return at, median, error
