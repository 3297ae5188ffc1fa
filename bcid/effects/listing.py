"""The vocabulary in print: for the terminal, as JSON, and as the page docs/effects.md."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from bcid.effects.entry import Effect, unit_in_words

INTRODUCTION = """\
# The vocabulary of missing physics

Made by `bcid effects --markdown`. State [v_x, v_y, ω] in the body frame at the CoG, V the planar velocity, δ the servo's angle,
δ_w the angle at the wheel, F_m motor force, F_d drag, F_αf side force of the front tyre, t seconds since the recording began, T its length.
With every parameter off an effect changes nothing to the last bit. "Size" is where ten minutes of the bumper car just show it.
"""  # noqa: E501


REFERENCES = """\
Sources: Armstrong-Hélouvry, Dupont and Canudas de Wit, A survey of models, analysis tools and compensation methods for
the control of machines with friction, Automatica 30 (1994). Gillespie, Fundamentals of Vehicle Dynamics (1992). Ljung,
System Identification (1999). Pacejka, Tire and Vehicle Dynamics (2012). Visintin, Differential Models of Hysteresis (1994).
"""  # noqa: E501


def as_json(effect: Effect) -> dict[str, Any]:
    """One entry."""
    return {
        "effect": effect.id,
        "equation": effect.equation,
        "channel": effect.channel,
        "kind": effect.kind,
        "looks_like": list(effect.looks_like),
        "depends_on": list(effect.depends_on),
        "held": effect.held or None,
        "source": effect.source,
        "parameters": [p._asdict() for p in effect.parameters],
    }


def details(effect: Effect) -> str:
    """One entry for the terminal."""
    lines = [f"{effect.id}: {effect.equation}", f"  {effect.kind}, channel {effect.channel}"]
    for p in effect.parameters:
        size = "" if p.places else f", size about {p.size:g}"
        lines.append(
            f"  {p.symbol} ({unit_in_words(p.unit)}): {p.meaning}, {p.low:g} to {p.high:g}, off at {p.off:g}{size}"
        )
    if effect.looks_like:
        lines.append(f"  may look like {', '.join(effect.looks_like)}")
    if effect.held:
        lines.append(f"  a wrong value of {effect.held} would look the same")
    lines.append(f"  source: {effect.source}")
    return "\n".join(lines)


def as_markdown(effects: Sequence[Effect]) -> str:
    """The page."""
    columns = ("id", "equation", "parameters", "size", "channel", "kind", "may look like", "source")
    rows = [f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    for e in effects:
        numbers = "; ".join(f"{p.symbol} {unit_in_words(p.unit)}" for p in e.parameters)
        sizes = "; ".join(f"{p.symbol} {p.size:g}" for p in e.amplitudes)
        cells = [f"`{e.id}`", e.equation, numbers, sizes, e.channel, e.kind, ", ".join(e.looks_like) or "–", e.source]
        rows.append(f"| {' | '.join(cells)} |")
    return INTRODUCTION + "\n" + "\n".join(rows) + "\n\n" + REFERENCES.rstrip()
