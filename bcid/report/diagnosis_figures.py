"""The pictures of a diagnosis as PNG data: the disturbance that a model leaves, before and after, and its predictions.

Knots are half-second means; the disturbance is the acceleration that a model would need and does not have.
Before and after share their scales, so that what was found is seen to vanish.  No text of the input is drawn.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from scipy.ndimage import gaussian_filter

Floats = npt.NDArray[np.float64]
Columns = Mapping[str, Floats]

BEFORE, AFTER, DOTS, NEVER = "#d55e00", "#0072b2", "#808080", "#e3e3e3"
WIDTH = 9.0  # of the widest picture (inches)
PUSHES = {
    "fx": ("forward acceleration", "m/s²"),
    "fy": ("side acceleration", "m/s²"),
    "mz": ("yaw acceleration", "rad/s²"),
}
PUSH_OF = {"fx": "fx", "fy": "fy", "mz": "mz", "motor": "fx"}
"""The component in which a channel shows; for the others it is found from the knots."""

VARIABLES = {
    "v_x": ("forward speed", "m/s"), "v_y": ("side speed", "m/s"), "speed": ("speed", "m/s"),
    "yaw_rate": ("yaw rate", "rad/s"), "steering": ("steering angle", "rad"),
    "steering_rate": ("steering rate", "rad/s"), "throttle": ("throttle", "m/s"), "braking": ("braking", "share"),
    "alpha_f": ("front slip angle", "rad"), "alpha_r": ("rear slip angle", "rad"), "heading": ("heading", "rad"),
}  # fmt: skip
MINUS = "−"
HIDDEN = "_hidden"  # a label that no legend shows
UNCHANGED = "base model"  # the only stage where nothing was changed
FEWEST = 24  # knots, below which nothing is drawn
PER_CELL = 8  # knots in a square over which the floor is smoothed
SPLIT = 3  # fine squares along the side of one
SMOOTH = 0.45  # standard deviation of the smoothing, in squares
LEAST_SHARE = 0.25  # of PER_CELL, below which the floor counts as hardly driven over
ALIKE = 0.8  # correlation from which the second of two quantities is not drawn
STRETCH_S = 20.0
WHOLE = 0.95  # share of the take from which a time is "throughout"


class Picture(NamedTuple):
    """One picture of the page."""

    title: str
    caption: str
    image: str  # a data URI


class _Residual(NamedTuple):
    """The disturbance in one component."""

    name: str
    unit: str
    stages: tuple[tuple[str, Floats, str], ...]  # title, values (K,), colour; one where nothing was changed

    @property
    def before(self) -> Floats:
        """Under the base model."""
        return self.stages[0][1]

    def at(self, rows: npt.NDArray[np.bool_]) -> _Residual:
        """Some knots of it."""
        return self._replace(stages=tuple((title, values[rows], colour) for title, values, colour in self.stages))


def where_of(diagnosis: Mapping[str, Any]) -> dict[str, Any]:
    """The mismatch's place in channel, quantity, time and floor; what is not told is null."""
    told = (diagnosis.get("mismatch") or {}).get("where") or {}
    return dict.fromkeys(("channel", "depends_on", "regime", "time_s", "place")) | dict(told)


def windows_of(diagnosis: Mapping[str, Any]) -> list[tuple[float, float]]:
    """The times located, none where they are the whole recording."""
    windows = [(float(a), float(b)) for a, b in where_of(diagnosis)["time_s"] or []]
    whole = diagnosis.get("duration_s") or np.inf
    return [] if sum(b - a for a, b in windows) > WHOLE * whole else windows


def where_pictures(diagnosis: Mapping[str, Any], knots: Columns) -> list[Picture]:
    """Over the floor, over time, over the two quantities it depends on most; the most telling first."""
    knots = _finite(knots)
    if len(knots["time_s"]) < FEWEST:
        return []
    of = _residual(diagnosis, knots)
    names = _two_variables(diagnosis, knots, of)
    told = where_of(diagnosis)["depends_on"] or []
    more = " and ".join(VARIABLES[n][0] for n in names if told and n not in told)
    what = f"{of.name[0].upper()}{of.name[1:]} that the model lacks"
    sizes, circle = ("mean size" if _magnitude(of, knots) else "mean"), where_of(diagnosis)["place"]
    inside, there = _located_part(diagnosis, knots)
    part = {n: v[inside] for n, v in knots.items()}
    floor = Picture(
        "Over the arena floor",
        f"{what}: {sizes}, smoothed over {_square(knots):.1f} m. Grey: hardly driven over. "
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


def proof_pictures(diagnosis: Mapping[str, Any], knots: Columns, tracks: Columns) -> list[Picture]:
    """Errors by horizon, predicted paths, and the disturbance at the place located."""
    knots, pictures = _finite(knots), []
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
        inside, words = _located(diagnosis, knots)
        if FEWEST // 3 <= inside.sum() < len(inside):
            caption = f"There: {words}. Dashed lines: means."
            image = data_uri(_there_and_elsewhere(_residual(diagnosis, knots), inside))
            pictures.append(Picture("Residuals where the mismatch was located, and elsewhere", caption, image))
    return pictures


def place_picture(diagnosis: Mapping[str, Any], knots: Columns) -> bytes:
    """The disturbance over the arena floor, before and after, as a PNG (of FEWEST knots or more)."""
    knots = _finite(knots)
    return _map(diagnosis, knots, _residual(diagnosis, knots))


def dependence_picture(diagnosis: Mapping[str, Any], knots: Columns) -> bytes:
    """The disturbance over the two quantities it depends on most, before and after, as a PNG."""
    knots = _finite(knots)
    of = _residual(diagnosis, knots)
    inside, _ = _located_part(diagnosis, knots)
    part = {n: v[inside] for n, v in knots.items()}
    return _over_variables(part, of.at(inside), _two_variables(diagnosis, knots, of))


def data_uri(png: bytes) -> str:
    """The picture inside the page."""
    return "data:image/png;base64," + base64.b64encode(png).decode()


def _png(figure: Figure) -> bytes:
    data = io.BytesIO()
    figure.savefig(data, format="png", dpi=110, metadata={"Software": None})
    return data.getvalue()


def _finite(knots: Columns) -> dict[str, Floats]:
    columns = {name: np.asarray(values, dtype=float) for name, values in knots.items()}
    rows = np.all([np.isfinite(v) for v in columns.values()], axis=0)
    return {name: values[rows] for name, values in columns.items()}


def _residual(diagnosis: Mapping[str, Any], knots: Columns) -> _Residual:
    """In the component where the located channel shows, else where most vanishes, or most is predictable."""
    changed = any(not np.allclose(knots[f"before_{c}"], knots[f"after_{c}"]) for c in PUSHES)

    def telling(c: str) -> float:
        before, after = knots[f"before_{c}"], knots[f"after_{c}"]
        if changed:
            return float(1.0 - (after**2).mean() / max((before**2).mean(), 1e-30))
        return max(_explained(before, _bins(variable(n, knots))[1]) for n in VARIABLES)

    channel = where_of(diagnosis)["channel"]
    push = PUSH_OF[channel] if channel in PUSH_OF else max(PUSHES, key=telling)
    stages = (("before", knots[f"before_{push}"], BEFORE), ("after", knots[f"after_{push}"], AFTER))
    return _Residual(*PUSHES[push], stages if changed else ((UNCHANGED, *stages[0][1:]),))


def variable(name: str, knots: Columns) -> Floats:
    """A quantity of `depends_on` at every knot.

    >>> variable("speed", {"v_x": np.array([3.0]), "v_y": np.array([4.0])})
    array([5.])
    """
    if name == "speed":
        return np.hypot(knots["v_x"], knots["v_y"])
    if name == "throttle":
        return np.maximum(knots["throttle"], 0.0)
    if name == "braking":
        return np.maximum(-knots["throttle"], 0.0)
    if name == "heading":
        return np.arctan2(np.sin(knots["heading"]), np.cos(knots["heading"]))
    return knots[name]


def _bins(values: Floats, most: int = 12) -> tuple[Floats, npt.NDArray[np.intp]]:
    """Edges with as many knots in each bin, and every knot's bin."""
    count = int(np.clip(len(values) // 12, 3, most))
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, count + 1)))
    return edges, np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(len(edges) - 2, 0))


def _explained(values: Floats, group: npt.NDArray[np.intp]) -> float:
    """Share of the variance that the groups' means explain, less what chance would."""
    _, group = np.unique(group, return_inverse=True)
    size = np.bincount(group)
    mean = np.bincount(group, values) / size
    rest, whole = float(((values - mean[group]) ** 2).sum()), float(((values - values.mean()) ** 2).sum())
    free = max(len(values) - len(size), 1)
    return 1.0 - (rest / free) / max(whole / max(len(values) - 1, 1), 1e-30)


def _two_variables(diagnosis: Mapping[str, Any], knots: Columns, of: _Residual) -> list[str]:
    """Those of `depends_on`, filled up with what explains most; place and time have pictures of their own."""
    told = [n for n in where_of(diagnosis)["depends_on"] or [] if n in VARIABLES][:2]
    rest = sorted(VARIABLES, key=lambda n: -_explained(of.before, _bins(variable(n, knots))[1]))
    while len(told) < 2:
        told.append(next(n for n in rest if n not in told and not any(_alike(n, t, knots) for t in told)))
    return told


def _alike(one: str, other: str, knots: Columns) -> bool:
    """Whether two quantities say the same."""
    a, b = variable(one, knots), variable(other, knots)
    return bool(a.std() * b.std() == 0.0 or abs(np.corrcoef(a, b)[0, 1]) > ALIKE)


def _square(knots: Columns) -> float:
    """Side of squares that hold about PER_CELL knots each (m)."""
    x, y = knots["x"], knots["y"]
    return float(np.clip(np.sqrt(max(np.ptp(x) * np.ptp(y), 1e-6) * PER_CELL / len(x)), 0.3, 1.5))


def _edges(values: Floats, size: float) -> Floats:
    return np.arange(values.min() - size, values.max() + 2.0 * size, size)


def _magnitude(of: _Residual, knots: Columns) -> bool:
    """Whether places differ in the disturbance's size rather than in its mean."""
    column, row = (np.floor(knots[c] / _square(knots)) for c in ("x", "y"))
    cell = ((column - column.min()) * (1.0 + np.ptp(row)) + row - row.min()).astype(int)
    return _explained(np.abs(of.before), cell) > max(1.5 * _explained(of.before, cell), 0.02)


def _map(diagnosis: Mapping[str, Any], knots: Columns, of: _Residual) -> bytes:
    fine = _square(knots) / SPLIT
    edges = _edges(knots["x"], fine), _edges(knots["y"], fine)
    size = _magnitude(of, knots)

    def smooth(weights: Floats) -> Floats:
        total, _, _ = np.histogram2d(knots["x"], knots["y"], edges, weights=weights)
        return np.asarray(gaussian_filter(total, SMOOTH * SPLIT, mode="constant"), dtype=float)

    count = smooth(np.ones_like(of.before))
    seen = count > LEAST_SHARE * PER_CELL / SPLIT**2
    sums = [smooth(np.abs(values) if size else values) for _, values, _ in of.stages]
    grids = [np.where(seen, total / np.maximum(count, 1e-12), np.nan) for total in sums]
    level = np.abs(grids[0][seen]) if seen.any() else np.zeros(1)
    low, high = (float(np.quantile(level, q)) for q in (0.02, 0.99))
    high = max(high, 1e-6 if size else _rms(of.before))  # a mean well below the scatter stays pale
    figure, axes = _floor_panels(len(grids), np.ptp(edges[0]), np.ptp(edges[1]))
    for ax, grid, (title, values, _) in zip(axes, grids, of.stages, strict=True):
        ax.set_facecolor(NEVER)
        mesh = ax.pcolormesh(
            *edges, grid.T, cmap="cividis" if size else "RdBu_r", vmin=low if size else -high, vmax=high
        )
        ax.set_title(f"{title}: RMS {_rms(values):.2g} {of.unit}", fontsize=10)
        _mark(ax, diagnosis, "white" if size else "black")
    label = f"{'mean size of ' if size else ''}{of.name} ({of.unit})"
    figure.colorbar(mesh, ax=list(axes), extend="max" if size else "both", shrink=0.9).set_label(label, size=9)
    return _png(figure)


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


def _floor_panels(count: int, width: float, height: float) -> tuple[Figure, Sequence[Any]]:
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


def _rms(values: Floats) -> float:
    return float(np.sqrt((values**2).mean()))


def _frame(of: _Residual, shown: Sequence[float]) -> float:
    """Half the height that shows the binned values and most knots."""
    spread = 1.4826 * float(np.median(np.abs(of.before - np.median(of.before))))
    return max(1.15 * max(map(abs, shown), default=0.0), 1.6 * spread, 1e-6)


def _over_time(diagnosis: Mapping[str, Any], knots: Columns, of: _Residual) -> bytes:
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
    return _png(figure)


def _over_variables(knots: Columns, of: _Residual, names: Sequence[str]) -> bytes:
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
    return _png(figure)


def _medians(x: Floats, values: Floats) -> tuple[Floats, Floats, Floats]:
    """Middle, median and two standard errors of it in every bin with knots enough."""
    _, group = _bins(x)
    rows = [group == b for b in np.unique(group) if (group == b).sum() > 4]
    at = np.array([x[r].mean() for r in rows])
    median = np.array([np.median(values[r]) for r in rows])
    error = np.array([2.0 * 1.2533 * values[r].std() / np.sqrt(r.sum()) for r in rows])
    return at, median, error


def _located(diagnosis: Mapping[str, Any], knots: Columns) -> tuple[npt.NDArray[np.bool_], str]:
    """Which knots lie where the mismatch was located, in words too."""
    where, windows = where_of(diagnosis), windows_of(diagnosis)
    place = where["place"]
    if place:
        distance = np.hypot(knots["x"] - place["x_m"], knots["y"] - place["y_m"])
        return distance < place["radius_m"], "within the circle located"
    if windows:
        time = knots["time_s"]
        return np.any([(time >= a) & (time <= b) for a, b in windows], axis=0), "in the time located"
    name = next((n for n in where["depends_on"] or [] if n in VARIABLES), None)
    if name is None:
        return np.ones(len(knots["time_s"]), dtype=bool), "throughout"
    value, push = variable(name, knots), _residual(diagnosis, knots).before
    low, high = np.quantile(value, [1 / 3, 2 / 3])
    words, unit = VARIABLES[name]
    thirds = (
        (value < low, f"where the {words} is below {low:.2g} {unit}"),
        ((value >= low) & (value <= high), f"where the {words} is from {low:.2g} to {high:.2g} {unit}"),
        (value > high, f"where the {words} is above {high:.2g} {unit}"),
    )
    filled = [(rows, text.replace("-", MINUS)) for rows, text in thirds if rows.any()]
    return max(filled, key=lambda third: _rms(push[third[0]]))


def _located_part(diagnosis: Mapping[str, Any], knots: Columns) -> tuple[npt.NDArray[np.bool_], str]:
    """The knots at the place or time located, where they are enough to show a dependence; else all of them."""
    if where_of(diagnosis)["place"] or windows_of(diagnosis):
        inside, words = _located(diagnosis, knots)
        if inside.sum() >= FEWEST:
            return inside, f" {words}"
    return np.ones(len(knots["time_s"]), dtype=bool), ""


def _there_and_elsewhere(of: _Residual, inside: npt.NDArray[np.bool_]) -> bytes:
    figure = Figure(figsize=(WIDTH, 2.7), layout="constrained")
    axes = figure.subplots(1, 2, sharex=True)
    frame = float(np.quantile(np.abs(of.before), 0.99)) * 1.2 + 1e-6
    bins = np.linspace(-frame, frame, 31)
    for ax, rows, where in zip(axes, (inside, ~inside), ("there", "elsewhere"), strict=True):
        for title, values, colour in of.stages:
            part = values[rows]
            label = f"{title}: mean {part.mean():+.2g}, RMS {_rms(part):.2g}".replace("-", MINUS)
            ax.hist(
                np.clip(part, -frame, frame), bins, histtype="step", color=colour, lw=1.7, density=True, label=label
            )
            ax.axvline(part.mean(), 0.0, 0.7, color=colour, lw=1.2, ls="--")
        ax.set_title(f"{where} ({int(rows.sum())} knots)", fontsize=10)
        ax.set_xlabel(f"{of.name} ({of.unit})")
        ax.set_yticks([])
        ax.set_ylim(top=1.45 * ax.get_ylim()[1])
        ax.legend(fontsize=8, loc="upper center", ncols=1, frameon=False)
    return _png(figure)


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
    return _png(figure)


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
    figure, axes = _floor_panels(len(stages), np.ptp(x) + 1.0, np.ptp(y) + 1.0)
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
    return _png(figure)


def _broken(x: Floats, y: Floats, breaks: npt.NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """The path with a hole before every break."""
    at = np.flatnonzero(breaks)
    at = at[at > 0]
    return np.insert(x, at, np.nan), np.insert(y, at, np.nan)
