"""What every effect declares: its equation, its parameters with unit and bounds, where it acts.

The compiled function beside an entry is the equation itself; `bcid.effects.car` puts them together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

Channel = Literal["fx", "fy", "mz", "steering", "motor", "pose", "time", "any"]
Kind = Literal["vehicle", "environment", "measurement"]


class Parameter(NamedTuple):
    """One number of an effect, in SI.

    `low` and `high` bound the search; `size` is a magnitude at which ten minutes of the bumper car just
    show the effect (specification), from which searches start.
    """

    symbol: str
    unit: str  # a product of powers of kg, m, s, rad, such as "kg m s^-2"
    low: float
    high: float
    size: float
    meaning: str
    off: float = 0.0
    places: bool = False  # a place or a time, which means nothing while the effect is off


@dataclass(frozen=True)
class Effect:
    """One entry of the vocabulary."""

    id: str
    equation: str
    parameters: tuple[Parameter, ...]
    channel: Channel
    kind: Kind = "vehicle"
    looks_like: tuple[str, ...] = ()
    depends_on: tuple[str, ...] = ()  # the quantities it varies with, in the words of diagnosis.json
    held: str = ""  # what is visible only because the vehicle file's value is held

    @property
    def fields(self) -> tuple[str, ...]:
        """The parameters' names in `Switches`."""
        return tuple(field_of(self.id, p.symbol) for p in self.parameters)


def field_of(effect: str, symbol: str) -> str:
    """The name of an effect's parameter in `Switches`."""
    return f"{effect}__{symbol}"


class Units(NamedTuple):
    """How much larger than the bumper car's a vehicle's mass, length and time are."""

    kg: float = 1.0
    m: float = 1.0
    s: float = 1.0
    rad: float = 1.0

    def of(self, unit: str) -> float:
        """The factor of a product of powers such as "kg m s^-2"."""
        factor = 1.0
        for part in unit.split():
            base, _, power = part.partition("^")
            if base != "1":
                factor *= getattr(self, base) ** int(power or 1)
        return float(factor)


def resized(effect: Effect, units: Units) -> Effect:
    """The effect with sizes and bounds as they suit another vehicle; where and when stay free."""

    def scaled(p: Parameter) -> Parameter:
        factor = units.of(p.unit)
        if p.places:
            return p._replace(low=p.low * factor, off=p.off * factor) if p.symbol == "radius" else p
        return p._replace(low=p.low * factor, high=p.high * factor, size=p.size * factor)

    return replace(effect, parameters=tuple(scaled(p) for p in effect.parameters))
