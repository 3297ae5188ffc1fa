"""The disturbance that a model leaves, knot by knot: in which component, over which quantities and where it shows.

A knot is a stretch of 0.25 s, and its values are means; the disturbance is the acceleration that a model would need and
does not have.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Bools, Floats
from bcid.documents.diagnosis import DiagnosisDocument
from bcid.report.canvas import AFTER, BEFORE, UNCHANGED, Columns
from bcid.report.formats import VARIABLES, with_minus_sign
from bcid.report.limits import LIMITS

COMPONENTS = {
    "fx": ("forward acceleration", "m/s²"), "fy": ("side acceleration", "m/s²"), "mz": ("yaw acceleration", "rad/s²")
}  # fmt: skip
COMPONENT_OF_CHANNEL = {"fx": "fx", "fy": "fy", "mz": "mz", "motor": "fx"}
"""The component in which a channel shows; for other channels it is chosen from the knots."""


class Residual(NamedTuple):
    """The disturbance in one component, before and after."""

    name: str
    unit: str
    stages: tuple[tuple[str, Floats, str], ...]  # title, values (K,), colour; one where nothing was changed

    @property
    def before(self) -> Floats:
        """The disturbance (K,) under the base model."""
        return self.stages[0][1]

    def select_rows(self, rows: Bools) -> Residual:
        """The disturbance at some of the knots."""
        return self._replace(stages=tuple((title, values[rows], colour) for title, values, colour in self.stages))


def located_windows(diagnosis: DiagnosisDocument) -> list[tuple[float, float]]:
    """Time windows (begin, end) (s) in which the diagnosis located the mismatch.

    Empty where they cover more than LIMITS.whole_recording_share of the recording, as then nothing is located.
    """
    windows = list(diagnosis.where.time_s)
    whole = diagnosis.duration_s or np.inf
    return [] if sum(b - a for a, b in windows) > LIMITS.whole_recording_share * whole else windows


def drop_incomplete_knots(knots: Columns) -> dict[str, Floats]:
    """The columns of `knots` without the rows at which any column is not finite."""
    columns = {name: np.asarray(values, dtype=float) for name, values in knots.items()}
    rows = np.all([np.isfinite(v) for v in columns.values()], axis=0)
    return {name: values[rows] for name, values in columns.items()}


def choose_residual(diagnosis: DiagnosisDocument, knots: Columns) -> Residual:
    """The unexplained acceleration in one component (forward, side, yaw), before and after the effects found are added.

    It is the component in which the diagnosis located the mismatch.  Where it located none, it is the one whose mean
    square the effects reduce by the largest share; without effects, the one of whose variance a single quantity such
    as speed explains most (adjusted R^2).  `knots` are means over a knot.
    """
    changed = any(not np.allclose(knots[f"before_{c}"], knots[f"after_{c}"]) for c in COMPONENTS)

    def telling(c: str) -> float:
        before, after = knots[f"before_{c}"], knots[f"after_{c}"]
        if changed:
            return float(1.0 - (after**2).mean() / max((before**2).mean(), 1e-30))
        return max(explained_share(before, equal_count_bins(knot_variable(n, knots))) for n in VARIABLES)

    channel = diagnosis.where.channel
    push = COMPONENT_OF_CHANNEL[channel] if channel in COMPONENT_OF_CHANNEL else max(COMPONENTS, key=telling)
    stages = (("before", knots[f"before_{push}"], BEFORE), ("after", knots[f"after_{push}"], AFTER))
    return Residual(*COMPONENTS[push], stages if changed else ((UNCHANGED, *stages[0][1:]),))


def knot_variable(name: str, knots: Columns) -> Floats:
    """Values (K,) of a quantity on which a mismatch may depend, such as "speed", from `knots`.

    >>> knot_variable("speed", {"v_x": np.array([3.0]), "v_y": np.array([4.0])})
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


def equal_count_bins(values: Floats) -> npt.NDArray[np.intp]:
    """The bin index (K,) of every value (K,), for bins with equally many values in each.

    There are K/12 bins, but 3 to 12; ties may leave fewer.
    """
    count = int(np.clip(len(values) // 12, 3, 12))
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, count + 1)))
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(len(edges) - 2, 0))


def explained_share(values: Floats, group: npt.NDArray[np.intp]) -> float:
    """Adjusted R^2 of a one-way analysis of variance: share of the variance of `values` (K,) that group means explain.

    `group` (K,) holds the group of each value.  1 - (residual variance)/(total variance), each over its degrees of
    freedom, is about 0 for random groups and can be negative.
    """
    _, group = np.unique(group, return_inverse=True)
    size = np.bincount(group)
    mean = np.bincount(group, values) / size
    rest, whole = float(((values - mean[group]) ** 2).sum()), float(((values - values.mean()) ** 2).sum())
    free = max(len(values) - len(size), 1)
    return 1.0 - (rest / free) / max(whole / max(len(values) - 1, 1), 1e-30)


def choose_variables(diagnosis: DiagnosisDocument, knots: Columns, residual: Residual) -> list[str]:
    """Names of up to two quantities over which the unexplained acceleration `residual` is drawn.

    First come those on which the diagnosis found the mismatch to depend, then those that explain most of its
    variance; one correlated with another beyond LIMITS.max_correlation is left out.  Place and time are drawn
    separately.
    """
    chosen = [n for n in diagnosis.where.depends_on if n in VARIABLES][:2]
    values = {name: knot_variable(name, knots) for name in VARIABLES}
    rest = sorted(VARIABLES, key=lambda n: -explained_share(residual.before, equal_count_bins(values[n])))
    for name in (n for n in rest if np.ptp(values[n]) > 0.0 and n not in chosen):
        if len(chosen) < 2 and not any(_strongly_correlated(values[name], values[other]) for other in chosen):
            chosen.append(name)
    return chosen or rest[:1]


def _strongly_correlated(a: Floats, b: Floats) -> bool:
    """Whether quantities `a` and `b` (K,) correlate by more than LIMITS.max_correlation, or one of them is constant."""
    return bool(a.std() * b.std() == 0.0 or abs(np.corrcoef(a, b)[0, 1]) > LIMITS.max_correlation)


def square_size(knots: Columns) -> float:
    """Side (m), 0.3 to 1.5, of squares of the floor that hold LIMITS.knots_per_square knots on average."""
    x, y = knots["x"], knots["y"]
    return float(np.clip(np.sqrt(max(np.ptp(x) * np.ptp(y), 1e-6) * LIMITS.knots_per_square / len(x)), 0.3, 1.5))


def differs_in_magnitude(residual: Residual, knots: Columns) -> bool:
    """Whether squares of the floor differ in the size of the unexplained acceleration rather than in its mean.

    That is so where the squares explain LIMITS.magnitude_factor times more variance of its absolute value than of
    the value itself, and at least LIMITS.min_explained_share of it.
    """
    column, row = (np.floor(knots[c] / square_size(knots)) for c in ("x", "y"))
    cell = ((column - column.min()) * (1.0 + np.ptp(row)) + row - row.min()).astype(int)
    of_mean, of_size = (explained_share(v, cell) for v in (residual.before, np.abs(residual.before)))
    return of_size > max(LIMITS.magnitude_factor * of_mean, LIMITS.min_explained_share)


def root_mean_square(values: Floats) -> float:
    """Root mean square of the values: sqrt(mean(values^2))."""
    return float(np.sqrt((values**2).mean()))


def located_knots(diagnosis: DiagnosisDocument, knots: Columns) -> tuple[Bools, str]:
    """Mask (K,) of knots that lie where the mismatch was located, and a description of that place or time.

    Where only a dependence on a quantity was found, the mask is that third of the quantity's values in which the
    residual acceleration has the largest root mean square; where nothing was located, the mask is true throughout.
    """
    where, windows = diagnosis.where, located_windows(diagnosis)
    place = where.place
    if place:
        distance = np.hypot(knots["x"] - place.x_m, knots["y"] - place.y_m)
        return distance < place.radius_m, "within the circle located"
    if windows:
        time = knots["time_s"]
        return np.any([(time >= a) & (time <= b) for a, b in windows], axis=0), "in the time located"
    name = next((n for n in where.depends_on if n in VARIABLES), None)
    if name is None:
        return np.ones(len(knots["time_s"]), dtype=bool), "throughout"
    value, push = knot_variable(name, knots), choose_residual(diagnosis, knots).before
    low, high = np.quantile(value, [1 / 3, 2 / 3])
    words, unit = VARIABLES[name]
    thirds = (
        (value < low, f"where the {words} is below {low:.2g} {unit}"),
        ((value >= low) & (value <= high), f"where the {words} is from {low:.2g} to {high:.2g} {unit}"),
        (value > high, f"where the {words} is above {high:.2g} {unit}"),
    )
    filled = [(rows, with_minus_sign(text)) for rows, text in thirds if rows.any()]
    return max(filled, key=lambda third: root_mean_square(push[third[0]]))


def located_or_all_knots(diagnosis: DiagnosisDocument, knots: Columns) -> tuple[Bools, str]:
    """Which knots (K,) lie at the located place or time, and a description of it.

    All are taken, with an empty description, where none was located or fewer than LIMITS.min_knots lie there.
    """
    if diagnosis.where.place or located_windows(diagnosis):
        inside, words = located_knots(diagnosis, knots)
        if inside.sum() >= LIMITS.min_knots:
            return inside, f" {words}"
    return np.ones(len(knots["time_s"]), dtype=bool), ""
