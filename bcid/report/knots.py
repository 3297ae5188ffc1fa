"""The disturbance that a model leaves, knot by knot: in which component, over which quantities and where it shows.

Knots are half-second means; the disturbance is the acceleration that a model would need and does not have.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.report.canvas import AFTER, BEFORE, MINUS, UNCHANGED, Columns

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
FEWEST = 24  # knots, below which nothing is drawn
PER_CELL = 8  # knots in a square over which the floor is smoothed
ALIKE = 0.8  # correlation from which the second of two quantities is not drawn
WHOLE = 0.95  # share of the take from which a time is "throughout"


class Residual(NamedTuple):
    """The disturbance in one component."""

    name: str
    unit: str
    stages: tuple[tuple[str, Floats, str], ...]  # title, values (K,), colour; one where nothing was changed

    @property
    def before(self) -> Floats:
        """Under the base model."""
        return self.stages[0][1]

    def at(self, rows: npt.NDArray[np.bool_]) -> Residual:
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


def finite(knots: Columns) -> dict[str, Floats]:
    """The knots of which everything is known."""
    columns = {name: np.asarray(values, dtype=float) for name, values in knots.items()}
    rows = np.all([np.isfinite(v) for v in columns.values()], axis=0)
    return {name: values[rows] for name, values in columns.items()}


def residual_of(diagnosis: Mapping[str, Any], knots: Columns) -> Residual:
    """In the component where the located channel shows, else where most vanishes, or most is predictable."""
    changed = any(not np.allclose(knots[f"before_{c}"], knots[f"after_{c}"]) for c in PUSHES)

    def telling(c: str) -> float:
        before, after = knots[f"before_{c}"], knots[f"after_{c}"]
        if changed:
            return float(1.0 - (after**2).mean() / max((before**2).mean(), 1e-30))
        return max(explained(before, bins_of(variable(n, knots))[1]) for n in VARIABLES)

    channel = where_of(diagnosis)["channel"]
    push = PUSH_OF[channel] if channel in PUSH_OF else max(PUSHES, key=telling)
    stages = (("before", knots[f"before_{push}"], BEFORE), ("after", knots[f"after_{push}"], AFTER))
    return Residual(*PUSHES[push], stages if changed else ((UNCHANGED, *stages[0][1:]),))


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


def bins_of(values: Floats, most: int = 12) -> tuple[Floats, npt.NDArray[np.intp]]:
    """Edges with as many knots in each bin, and every knot's bin."""
    count = int(np.clip(len(values) // 12, 3, most))
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, count + 1)))
    return edges, np.clip(np.searchsorted(edges, values, side="right") - 1, 0, max(len(edges) - 2, 0))


def explained(values: Floats, group: npt.NDArray[np.intp]) -> float:
    """Share of the variance that the groups' means explain, less what chance would."""
    _, group = np.unique(group, return_inverse=True)
    size = np.bincount(group)
    mean = np.bincount(group, values) / size
    rest, whole = float(((values - mean[group]) ** 2).sum()), float(((values - values.mean()) ** 2).sum())
    free = max(len(values) - len(size), 1)
    return 1.0 - (rest / free) / max(whole / max(len(values) - 1, 1), 1e-30)


def two_variables(diagnosis: Mapping[str, Any], knots: Columns, of: Residual) -> list[str]:
    """Those of `depends_on`, filled up with what explains most; place and time have pictures of their own.

    Fewer than two where all else says the same.
    """
    told = [n for n in where_of(diagnosis)["depends_on"] or [] if n in VARIABLES][:2]
    rest = sorted(VARIABLES, key=lambda n: -explained(of.before, bins_of(variable(n, knots))[1]))
    for name in (n for n in rest if np.ptp(variable(n, knots)) > 0.0):
        if len(told) < 2 and name not in told and not any(_alike(name, t, knots) for t in told):
            told.append(name)
    return told or rest[:1]


def _alike(one: str, other: str, knots: Columns) -> bool:
    """Whether two quantities say the same."""
    a, b = variable(one, knots), variable(other, knots)
    return bool(a.std() * b.std() == 0.0 or abs(np.corrcoef(a, b)[0, 1]) > ALIKE)


def square_of(knots: Columns) -> float:
    """Side of squares that hold about PER_CELL knots each (m)."""
    x, y = knots["x"], knots["y"]
    return float(np.clip(np.sqrt(max(np.ptp(x) * np.ptp(y), 1e-6) * PER_CELL / len(x)), 0.3, 1.5))


def by_magnitude(of: Residual, knots: Columns) -> bool:
    """Whether places differ in the disturbance's size rather than in its mean."""
    column, row = (np.floor(knots[c] / square_of(knots)) for c in ("x", "y"))
    cell = ((column - column.min()) * (1.0 + np.ptp(row)) + row - row.min()).astype(int)
    return explained(np.abs(of.before), cell) > max(1.5 * explained(of.before, cell), 0.02)


def rms(values: Floats) -> float:
    """Root of the mean square."""
    return float(np.sqrt((values**2).mean()))


def located(diagnosis: Mapping[str, Any], knots: Columns) -> tuple[npt.NDArray[np.bool_], str]:
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
    value, push = variable(name, knots), residual_of(diagnosis, knots).before
    low, high = np.quantile(value, [1 / 3, 2 / 3])
    words, unit = VARIABLES[name]
    thirds = (
        (value < low, f"where the {words} is below {low:.2g} {unit}"),
        ((value >= low) & (value <= high), f"where the {words} is from {low:.2g} to {high:.2g} {unit}"),
        (value > high, f"where the {words} is above {high:.2g} {unit}"),
    )
    filled = [(rows, text.replace("-", MINUS)) for rows, text in thirds if rows.any()]
    return max(filled, key=lambda third: rms(push[third[0]]))


def located_part(diagnosis: Mapping[str, Any], knots: Columns) -> tuple[npt.NDArray[np.bool_], str]:
    """The knots at the place or time located, where they are enough to show a dependence; else all of them."""
    if where_of(diagnosis)["place"] or windows_of(diagnosis):
        inside, words = located(diagnosis, knots)
        if inside.sum() >= FEWEST:
            return inside, f" {words}"
    return np.ones(len(knots["time_s"]), dtype=bool), ""
