"""Scores of location: the channel, the circle on the floor, the stretch of time."""

from typing import Any

import numpy as np

from bcid.effects.table import EFFECTS

ALL_CHANNELS = "any"
TWO_CHANNEL_EFFECTS = {
    "rear_drag_asymmetry": ("fx", "mz"), "floor_slope": ("fx", "fy"), "tether_pull": ("fx", "fy"),
    "washboard": ("fx", "fy"),
}  # fmt: skip
"""Effects that act in two channels by the specification: either counts as right."""


def effect_channels(effect: str, default: str = "") -> tuple[str, ...]:
    """Channels in which an effect acts; `default` for an effect outside the vocabulary."""
    return TWO_CHANNEL_EFFECTS.get(effect, (EFFECTS[effect].channel if effect in EFFECTS else default,))


def is_channel_right(row: dict[str, Any]) -> bool | None:
    """Whether a row locates its only effect's channel first; None unless it has one effect and that has a channel."""
    if len(row["answer"]) != 1 or "located" not in row:
        return None
    right = effect_channels(row["answer"][0], row["channel"])
    return None if ALL_CHANNELS in right else row["located"] in right


def place_overlap(row: dict[str, Any]) -> float | None:
    """Intersection over union of the circle where a row places an effect and the true one; None without a true one."""
    true = next((t for t in row["truth"].values() if "radius" in t), None)
    if true is None:
        return None
    named = next((f["values"] for f in row["findings"] if "radius" in f["values"]), None)
    circle = [named[s][0] for s in ("x", "y", "radius")] if named else row.get("place")
    return circle_overlap((true["x"], true["y"], true["radius"]), (circle[0], circle[1], circle[2])) if circle else 0.0


def time_overlap(row: dict[str, Any]) -> float | None:
    """Intersection over union of the stretch of time that a row reports and the true one; None without a true one."""
    true = next((t["t_s"] for t in row["truth"].values() if "t_s" in t), None)
    if true is None:
        return None
    end = row["duration_s"]
    named = next((f["values"]["t_s"][0] for f in row["findings"] if "t_s" in f["values"]), None)
    window = (named, end) if named is not None else row.get("window")
    if not window:
        return 0.0
    both = max(0.0, min(end, window[1]) - max(true, window[0]))
    return float(both / (max(end, window[1]) - min(true, window[0])))


def circle_overlap(first: tuple[float, float, float], second: tuple[float, float, float]) -> float:
    """Intersection over union (0 to 1) of two circles, each given as x, y, radius in m."""
    (x, y, r), (u, v, s) = first, second
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
