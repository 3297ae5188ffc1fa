"""Whether an effect of the user's is declared as it must be, and whether its law is one (`own_law_checks`)."""

from __future__ import annotations

import math
from collections.abc import Iterator

from bcid.effects.entry import Parameter, parse_unit
from bcid.effects.own import QUANTITIES, OwnEffect
from bcid.effects.own_law_checks import wrong_in_compiled_code, wrong_on_states
from bcid.effects.own_laws import MOTOR, PUSHES, STEERING
from bcid.effects.table import ENTRIES
from bcid.errors import Problem

PLACES = (set[str](), {"t_s"}, {"x", "y", "radius"}, {"x", "y", "r_0"})
"""Sets of places and times that a diagnosis searches for: none, a time, a circle on the floor, and a point with a slack
length."""

NEXT_STEP = "see docs/own_effects.md"


def find_problems(effect: OwnEffect, digest: str) -> list[Problem]:
    """What is wrong with an effect of the file with this SHA-256; nothing where all is right.

    How it is declared is looked at first; where that is right, what its law does; and then whether it can be compiled.
    """
    problems = [Problem(effect.id, cause, NEXT_STEP) for cause in _declared_wrong(effect)]
    if problems:
        return problems
    try:
        causes = list(wrong_on_states(effect)) or list(wrong_in_compiled_code(effect, digest))
    # whatever the user's own law raises is the user's to read
    except Exception as error:
        causes = [f"its law raises {type(error).__name__}: {error}"]
    return [Problem(effect.id, cause, NEXT_STEP) for cause in causes]


# --- as it is declared --------------------------------------------------------------------------------------------


def _declared_wrong(effect: OwnEffect) -> Iterator[str]:
    """What is wrong with what an effect declares."""
    if effect.id in ENTRIES:
        yield "the vocabulary has an effect of this name"
    if "__" in effect.id or effect.id.startswith("_"):
        yield "its name begins with an underscore, or holds two in a row"
    if effect.channel not in (*PUSHES, *STEERING, *MOTOR):
        yield f"its channel {effect.channel!r} is none of {', '.join((*PUSHES, *STEERING, *MOTOR))}"
        return
    if effect.kind not in ("vehicle", "environment"):
        yield f"its kind {effect.kind!r} is neither vehicle nor environment"
    if unknown := sorted(set(effect.looks_like) - set(ENTRIES)):
        yield f"it looks like {', '.join(unknown)}, which the vocabulary does not have"
    if not effect.equation:
        yield "it has no equation"
    if not effect.amplitude_parameters:
        yield "it has no parameter that says how strong it is"
    if {p.symbol for p in effect.place_parameters} not in PLACES:
        named = "; ".join(", ".join(sorted(symbols)) for symbols in PLACES[1:])
        yield f"its places are none that a diagnosis can search for: {named}"
    for p in effect.parameters:
        yield from (f"parameter {p.symbol}: {cause}" for cause in _parameter_wrong(p))
    yield from (f"constant {c.symbol}: {cause}" for c in effect.constants for cause in _unit_wrong(c.unit))
    yield from _arguments_wrong(effect)


def _parameter_wrong(p: Parameter) -> Iterator[str]:
    """What is wrong with one declared parameter."""
    yield from _unit_wrong(p.unit)
    if not p.meaning:
        yield "says nothing of what it means"
    if not all(map(math.isfinite, (p.low, p.high, p.size))) or not p.low < p.high:
        yield f"is bound by {p.low:g} and {p.high:g}"
    elif not p.is_place and not (p.low <= 0.0 <= p.high and p.off == 0.0):
        yield f"must be off at zero, which lies outside {p.low:g} to {p.high:g}, or is not declared so"
    elif not p.is_place and (p.size == 0.0 or not p.low <= p.size <= p.high):
        yield f"has the size {p.size:g}, which is zero or lies outside {p.low:g} to {p.high:g}"


def _unit_wrong(unit: str) -> Iterator[str]:
    """What is wrong with a unit as it is written."""
    try:
        known = all(base in ("kg", "m", "s", "rad", "1") for base, _ in parse_unit(unit)) and bool(unit)
    except ValueError:
        known = False
    if not known:
        yield f'has the unit {unit!r}, which is no product of powers such as "kg m s^-2" (1 for a number)'


def _arguments_wrong(effect: OwnEffect) -> Iterator[str]:
    """What is wrong with the names of a law's arguments."""
    own = [p.symbol for p in effect.parameters] + [c.symbol for c in effect.constants]
    allowed = [name for name, q in QUANTITIES.items() if effect.channel in q.channels]
    if twice := sorted({s for s in own if own.count(s) > 1 or s in QUANTITIES}):
        yield f"{', '.join(twice)} stands for two things, of its parameters, its constants and the quantities"
    if unused := sorted(set(own) - set(effect.arguments)):
        yield f"its law takes no {', '.join(unused)}"
    if unknown := [name for name in effect.arguments if name not in (*own, *allowed)]:
        yield (
            f"its law takes {', '.join(unknown)}, which is no parameter and no constant of it, and no quantity that a "
            f"law of {effect.channel} can have ({', '.join(allowed)})"
        )
