"""All effects by id, in the specification's order of families."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from bcid.effects import forces, measurement, motor, steering, tyres
from bcid.effects.corrections import CORRECTIONS
from bcid.effects.entry import Effect
from bcid.errors import UsageError

EFFECTS: dict[str, Effect] = {
    e.id: e for module in (forces, tyres, motor, steering, measurement) for e in module.EFFECTS
}
"""The vocabulary."""

ENTRIES: dict[str, Effect] = EFFECTS | CORRECTIONS
"""All that can be fitted: the vocabulary and the base model's own simplifications."""

OFF: dict[str, float] = {name: p.off for e in ENTRIES.values() for name, p in zip(e.fields, e.parameters, strict=True)}
"""Every parameter's value at which nothing changes."""

_LAYOUT = np.dtype((np.record, [(name, np.float64) for name in OFF]))


def switches(on: Mapping[str, float] | None = None) -> Any:
    """One number for every parameter of every effect, `on` by field and all others at rest.

    A record, not a tuple: kernels take it by its address, and sixty numbers copied at every call cost them a third.
    """
    return np.array(tuple((OFF | dict(on or {})).values()), dtype=_LAYOUT)[()]


def off() -> Any:
    """Switches at which nothing changes to the last bit."""
    return switches()


def effects_of(fields: Iterable[str]) -> tuple[str, ...]:
    """The ids of the effects with these fields among the switches."""
    return tuple(dict.fromkeys(field.partition("__")[0] for field in fields))


def effect_of(name: str) -> Effect:
    """The effect with this id.

    Raises:
        UsageError: an unknown id, with near ones.
    """
    if name not in EFFECTS:
        near = ", ".join(difflib.get_close_matches(name, EFFECTS, n=3)) or "see `bcid effects`"
        raise UsageError(f"there is no effect {name!r}\n  next: {near}")
    return EFFECTS[name]
