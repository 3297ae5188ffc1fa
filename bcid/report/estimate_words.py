"""What is said of an estimate in words: the steering's constants, and when its filter had lost the car."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


def steering_lines(facts: Mapping[str, Any]) -> list[tuple[str, str]]:
    """T_s and d with where they come from."""
    tuning = facts["tuning"]
    told = dict.fromkeys(tuning["identified"], "identified") | dict.fromkeys(tuning.get("defaults", []), "default")
    lines = [
        ("T_s", f"{facts['T_s']:.3g} s ({told.get('time_constant_s', 'given')})"),
        ("d", f"{facts['d']:.3g} rad/s ({told.get('max_rate_radps', 'given')})"),
    ]
    if tuning.get("at_bound") or (told.get("max_rate_radps") == "identified" and not tuning.get("rate_reached")):
        lines.append(("steering", "at its bound or never driven to its rate limit: not well identified"))
    if tuning["noise_at_bound"]:
        lines.append(("noise at its bound", ", ".join(tuning["noise_at_bound"])))
    return lines


def lost_car(facts: Mapping[str, Any]) -> str:
    """When the filter had lost the car and began anew; nothing where it never did."""
    at = ", ".join(f"{t:.1f} s" for t in facts.get("restarts_s", ()))
    return f"lost the car and began anew at {at}" if at else ""
