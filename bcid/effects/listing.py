"""The vocabulary in print: for the terminal, as JSON, and as the page docs/effects.md."""

import inspect
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bcid.effects.entry import Effect, Parameter, unit_in_words
from bcid.files.source_code import PACKAGE

INTRODUCTION = """\
# The vocabulary of missing physics

Made by `bcid effects --markdown`. State [v_x, v_y, ω] in the body frame at the CoG, V the planar velocity, δ the servo's angle,
δ_w the angle at the wheel, F_m motor force, F_d drag, F_αf side force of the front tyre, t seconds since the recording began, T its length.
With every parameter off an effect changes nothing to the last bit. "Size" is where ten minutes of the bumper car just show it.
An effect that is not here can be tried from a file of your own: [own_effects.md](own_effects.md).
"""  # noqa: E501


REFERENCES = """\
Sources: Armstrong-Hélouvry, Dupont and Canudas de Wit, A survey of models, analysis tools and compensation methods for
the control of machines with friction, Automatica 30 (1994). Gillespie, Fundamentals of Vehicle Dynamics (1992). Ljung,
System Identification (1999). Pacejka, Tire and Vehicle Dynamics (2012). Visintin, Differential Models of Hysteresis (1994).
"""  # noqa: E501


def locate_law(effect: Effect) -> tuple[str, int]:
    """File and line of the function that is the effect's equation.

    The file is relative to the package's parent folder, or as it was named where it is a user's own.
    """
    code = inspect.unwrap(effect.law).__code__
    path = Path(code.co_filename)
    return (path.relative_to(PACKAGE.parent) if path.is_relative_to(PACKAGE) else path).as_posix(), code.co_firstlineno


def effect_json(effect: Effect) -> dict[str, Any]:
    """One effect as an element of `bcid effects --format json`, with the file and line of its compiled equation."""
    file, line = locate_law(effect)
    return {
        "effect": effect.id,
        "equation": effect.equation,
        "channel": effect.channel,
        "kind": effect.kind,
        "looks_like": list(effect.looks_like),
        "depends_on": list(effect.depends_on),
        "held": effect.confounded_with or None,
        "source": effect.source,
        "parameters": [_parameter_json(p) for p in effect.parameters],
        "law": {"function": f"{effect.law.__module__}.{effect.id}", "file": file, "line": line},
    }


def _parameter_json(p: Parameter) -> dict[str, Any]:
    """One parameter of an effect as an element of its "parameters" in JSON; "places" marks a place or a time."""
    return {
        "symbol": p.symbol, "unit": p.unit, "low": p.low, "high": p.high, "size": p.size, "meaning": p.meaning,
        "off": p.off, "places": p.is_place, "inverse_of": p.inverse_of,
    }  # fmt: skip


def describe_effect(effect: Effect) -> str:
    """One effect as text for the terminal: equation, parameters, similar effects, source, and where its code is."""
    lines = [f"{effect.id}: {effect.equation}", f"  {effect.kind}, channel {effect.channel}"]
    for p in effect.parameters:
        size = "" if p.is_place else f", size about {p.size:g}"
        lines.append(
            f"  {p.symbol} ({unit_in_words(p.unit)}): {p.meaning}, {p.low:g} to {p.high:g}, off at {p.off:g}{size}"
        )
    if effect.looks_like:
        lines.append(f"  may look like {', '.join(effect.looks_like)}")
    if effect.confounded_with:
        lines.append(f"  a wrong value of {effect.confounded_with} would look the same")
    lines += [f"  source: {effect.source}", "  law: {}:{}".format(*locate_law(effect))]
    return "\n".join(lines)


def effects_page(effects: Sequence[Effect]) -> str:
    """The page docs/effects.md in Markdown: a table of `effects` with an introduction and the references."""
    columns = ("id", "equation", "parameters", "size", "channel", "kind", "may look like", "source")
    rows = [f"| {' | '.join(columns)} |", f"|{'---|' * len(columns)}"]
    for e in effects:
        numbers = "; ".join(f"{p.symbol} {unit_in_words(p.unit)}" for p in e.parameters)
        sizes = "; ".join(f"{p.symbol} {p.size:g}" for p in e.amplitude_parameters)
        cells = [f"`{e.id}`", e.equation, numbers, sizes, e.channel, e.kind, ", ".join(e.looks_like) or "–", e.source]
        rows.append(f"| {' | '.join(cells)} |")
    return INTRODUCTION + "\n" + "\n".join(rows) + "\n\n" + REFERENCES.rstrip()
