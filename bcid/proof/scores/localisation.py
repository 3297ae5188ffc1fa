"""How well a diagnosis says where: the channel, the circle on the floor, the stretch of time."""

from __future__ import annotations

from typing import Any

import numpy as np

from bcid.effects.table import EFFECTS

ANY = "any"
SEVERAL = {
    "rear_drag_asymmetry": ("fx", "mz"), "floor_slope": ("fx", "fy"), "tether_pull": ("fx", "fy"),
    "washboard": ("fx", "fy"),
}  # fmt: skip
"""Effects that act in two channels (specification): either is right."""


def channels_of(effect: str, otherwise: str = "") -> tuple[str, ...]:
    """In which an effect acts; `otherwise` for one without an entry."""
    return SEVERAL.get(effect, (EFFECTS[effect].channel if effect in EFFECTS else otherwise,))


def channel_right(row: dict[str, Any]) -> bool | None:
    """Whether the channel located first is the effect's; None of no effect, of several, or of one that acts on all."""
    if len(row["answer"]) != 1 or "located" not in row:
        return None
    right = channels_of(row["answer"][0], row["channel"])
    return None if ANY in right else row["located"] in right


def place_overlap(row: dict[str, Any]) -> float | None:
    """Intersection over union of the circle that was told and the true one; None where no circle is concealed."""
    true = next((t for t in row["truth"].values() if "radius" in t), None)
    if true is None:
        return None
    named = next((f["values"] for f in row["findings"] if "radius" in f["values"]), None)
    told = [named[s][0] for s in ("x", "y", "radius")] if named else row.get("place")
    return overlap((true["x"], true["y"], true["radius"]), (told[0], told[1], told[2])) if told else 0.0


def time_overlap(row: dict[str, Any]) -> float | None:
    """The same of the stretch of time; None where nothing begins during the recording."""
    true = next((t["t_s"] for t in row["truth"].values() if "t_s" in t), None)
    if true is None:
        return None
    end = row["duration_s"]
    named = next((f["values"]["t_s"][0] for f in row["findings"] if "t_s" in f["values"]), None)
    told = (named, end) if named is not None else row.get("window")
    if not told:
        return 0.0
    both = max(0.0, min(end, told[1]) - max(true, told[0]))
    return float(both / (max(end, told[1]) - min(true, told[0])))


def overlap(one: tuple[float, float, float], other: tuple[float, float, float]) -> float:
    """Intersection over union of two circles, each x, y, radius."""
    (x, y, r), (u, v, s) = one, other
    d = float(np.hypot(u - x, v - y))
    if d >= r + s:
        return 0.0
    small, large = min(r, s), max(r, s)
    if d <= large - small:
        return (small / large) ** 2
    # two circular segments
    a = (d * d + r * r - s * s) / (2.0 * d)
    b = d - a
    lens = r * r * np.arccos(a / r) - a * np.sqrt(r * r - a * a) + s * s * np.arccos(b / s) - b * np.sqrt(s * s - b * b)
    return float(lens / (np.pi * (r * r + s * s) - lens))
