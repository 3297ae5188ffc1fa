"""Scores of location: the channel, the circle on the floor, the stretch of time."""

from typing import Any

import numpy as np

from bcid.effects.table import EFFECTS

ALL_CHANNELS = "any"
TWO_CHANNEL_EFFECTS = {
    "rear_drag_asymmetry": ("fx", "mz"), "floor_slope": ("fx", "fy"), "tether_pull": ("fx", "fy"),
    "washboard": ("fx", "fy"), "attraction": ("fx", "fy"), "floor_sway": ("fx", "fy"), "swinging_load": ("fx", "fy"),
    "gusts": ("fx", "fy"),
}  # fmt: skip
"""Effects that act in two channels, by the specification or their physics: either counts as right."""


def effect_channels(effect: str, default: str = "") -> tuple[str, ...]:
    """Channels ("fx", "fy", "mz", "motor" ...) in which an effect acts on the car; any of them counts as right.

    `default` is the channel of an effect that the vocabulary does not contain.
    """
    return TWO_CHANNEL_EFFECTS.get(effect, (EFFECTS[effect].channel if effect in EFFECTS else default,))


def is_channel_right(row: dict[str, Any]) -> bool | None:
    """Whether "located", the channel in which a row says physics is missing, is one in which its effect acts.

    Reads "answer" (effects there) and "channel" (of an effect without a name).  None unless exactly one effect is
    there, and if that acts in all channels.
    """
    if len(row["answer"]) != 1 or "located" not in row:
        return None
    right = effect_channels(row["answer"][0], row["channel"])
    return None if ALL_CHANNELS in right else row["located"] in right


def place_overlap(row: dict[str, Any]) -> float | None:
    """Intersection over union (0 to 1) of the reported circle on the floor and the true one.

    The reported circle is in a finding's "values", or else the row's "place"; 0 without one.  The true one is in
    "truth", the concealed effects' parameters; None if none of them has a radius.
    """
    true = next((t for t in row["truth"].values() if "radius" in t), None)
    if true is None:
        return None
    named = next((f["values"] for f in row["findings"] if "radius" in f["values"]), None)
    circle = [named[s][0] for s in ("x", "y", "radius")] if named else row.get("place")
    return circle_overlap((true["x"], true["y"], true["radius"]), (circle[0], circle[1], circle[2])) if circle else 0.0


def time_overlap(row: dict[str, Any]) -> float | None:
    """Intersection over union (0 to 1) of the reported time interval in which an effect acts and the true one.

    The true one is from t_s (s) in "truth", the concealed effects' parameters, to "duration_s"; None without t_s.
    The reported one is from t_s in a finding's "values" to "duration_s", or else the row's "window"; 0 without one.
    """
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
