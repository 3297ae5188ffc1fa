"""Logged fields turned into SI quantities by the vehicle file's mapping."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from bcid.recording.types import Floats
from bcid.vehicle import Mapped


def mapped(field: Mapped, column: Callable[[str], Floats]) -> Floats:
    """The SI values of `field`; `column` looks a raw field up by its name.

    value = gain * dead_zone(raw) + offset within [low, high], where the dead zone swallows |raw| < dead_zone.
    """
    raw = column(field.source)
    known = np.isfinite(raw)
    beyond = np.sign(raw[known]) * np.maximum(np.abs(raw[known]) - field.dead_zone, 0.0)
    gain_negative = field.gain if field.gain_negative is None else field.gain_negative
    values = np.array(raw, dtype=float)  # what is no number stays none
    values[known] = np.clip(
        np.where(beyond < 0.0, gain_negative, field.gain) * beyond + field.offset, field.low, field.high
    )
    if field.zero_where is not None:
        values = np.where(column(field.zero_where.field) == field.zero_where.equals, 0.0, values)
    return values


def field_names(fields: Iterable[Mapped]) -> list[str]:
    """The raw fields that mappings look up, each once."""
    names = [name for f in fields for name in (f.source, f.zero_where.field if f.zero_where else None) if name]
    return list(dict.fromkeys(names))
