"""Logged fields turned into SI quantities by the vehicle file's mapping."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from bcid.aliases import Floats
from bcid.vehicle import Mapped


def mapped(field: Mapped, column: Callable[[str], Floats]) -> Floats:
    """The SI values of `field`; `column` looks a raw field up by its name.

    value = gain * dead_zone(raw) + offset within [low, high], where the dead zone swallows |raw| < dead_zone; or
    the line through the field's points at raw, + offset.
    """
    raw = column(field.source)
    known = np.isfinite(raw)
    values = np.array(raw, dtype=float)  # what is no number stays none
    values[known] = np.clip(_law(field, raw[known]) + field.offset, field.low, field.high)
    if field.zero_where is not None:
        values = np.where(column(field.zero_where.field) == field.zero_where.equals, 0.0, values)
    return values


def _law(field: Mapped, raw: Floats) -> Floats:
    """The value before the offset."""
    if field.points is not None:
        return np.asarray(np.interp(raw, *np.transpose(field.points)))
    beyond = np.sign(raw) * np.maximum(np.abs(raw) - field.dead_zone, 0.0)
    gain_negative = field.gain if field.gain_negative is None else field.gain_negative
    return np.asarray(np.where(beyond < 0.0, gain_negative, field.gain) * beyond)


def field_names(fields: Iterable[Mapped]) -> list[str]:
    """The raw fields that mappings look up, each once."""
    names = [name for f in fields for name in (f.source, f.zero_where.field if f.zero_where else None) if name]
    return list(dict.fromkeys(names))
