"""What every effect declares: its equation, its parameters with unit and bounds, where it acts.

The compiled function beside an entry is the equation itself; `bcid.effects.car` puts them together.
"""

from __future__ import annotations

import math
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
    inverse_of: str = ""  # what is quoted in its place: its inverse, where off is infinity

    def at_bound(self, value: float) -> bool:
        """Whether a search that ended here might have gone on."""
        return any(math.isclose(value, bound, rel_tol=1e-6) for bound in (self.low, self.high))

    def times(self, factor: float) -> Parameter:
        """The same for a vehicle for which such a number is `factor` times as large."""
        return self._replace(low=self.low * factor, high=self.high * factor, size=self.size * factor)

    def quoted(self, value: float, se: float | None) -> Quoted:
        """The value as it is printed and saved, with a unit in words."""
        if not self.inverse_of or value == 0.0:
            return Quoted(self.symbol, value, se, unit_in_words(self.unit))
        unit = " ".join(_inverted(part) for part in self.unit.split())
        return Quoted(self.inverse_of, 1.0 / value, None if se is None else se / value**2, unit_in_words(unit))


class Quoted(NamedTuple):
    """A parameter as it is told."""

    symbol: str
    value: float
    se: float | None
    unit: str


UNITS_IN_WORDS = {
    "1": "–", "kg m s^-2": "N", "kg s^-1": "N s/m", "kg s^-2": "N/m", "kg m^-1": "N s²/m²", "kg m^2 s^-2": "N m",
    "kg m^2 s^-1 rad^-1": "N m s", "kg s^-1 rad^-1": "N s/(m rad)", "kg m^2 s^-3": "W", "m s^-1": "m/s",
    "m s^-2": "m/s²", "kg m s^-2 rad^-1": "N/rad", "rad s^-1": "rad/s", "m^-1 s^2": "s²/m", "m^-1 s": "s/m",
    "kg^-1 m^-1 s^2 rad": "rad/N", "rad^-2": "rad⁻²", "kg^-1 m^-2 s^3": "1/W",
}  # fmt: skip
"""Products of powers as an engineer writes them (specification)."""

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def unit_in_words(unit: str) -> str:
    """A unit as an engineer writes it.

    >>> unit_in_words("kg s^-1"), unit_in_words("kg m^4")
    ('N s/m', 'kg m⁴')
    """
    if unit in UNITS_IN_WORDS:
        return UNITS_IN_WORDS[unit]
    parts = [p.split("^", 1) for p in unit.split(" ")]
    return " ".join(p[0] + (p[1].translate(_SUPERSCRIPTS) if len(p) > 1 else "") for p in parts)


def _inverted(part: str) -> str:
    """One power of a unit, inverted.

    >>> _inverted("m^-2"), _inverted("s^3")
    ('m^2', 's^-3')
    """
    base, _, power = part.partition("^")
    inverse = -int(power or 1)
    return base if inverse == 1 else f"{base}^{inverse}"


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
    source: str = ""

    @property
    def fields(self) -> tuple[str, ...]:
        """The parameters' names among the switches."""
        return tuple(field_of(self.id, p.symbol) for p in self.parameters)

    @property
    def places(self) -> tuple[Parameter, ...]:
        """Where and when it acts; empty for what acts everywhere."""
        return tuple(p for p in self.parameters if p.places)

    @property
    def amplitudes(self) -> tuple[Parameter, ...]:
        """How strong it is."""
        return tuple(p for p in self.parameters if not p.places)


def field_of(effect: str, symbol: str) -> str:
    """The name of an effect's parameter among the switches."""
    return f"{effect}__{symbol}"


class Units(NamedTuple):
    """How much larger than the bumper car's a vehicle's mass, length and time are."""

    kg: float = 1.0
    m: float = 1.0
    s: float = 1.0
    rad: float = 1.0

    @property
    def reach(self) -> float:
        """How much wider its circles on the floor are: by its size, or by how far it drives in a time."""
        return max(self.m, self.m / self.s)

    def of(self, unit: str) -> float:
        """The factor of a product of powers such as "kg m s^-2"."""
        factor = 1.0
        for part in unit.split():
            base, _, power = part.partition("^")
            if base != "1":
                factor *= getattr(self, base) ** int(power or 1)
        return float(factor)


def resized(effect: Effect, units: Units) -> Effect:
    """The effect with sizes and bounds as they suit another vehicle.

    Where and when stay free, how far around is wider for what is larger or faster; delays and lags stay: electronics
    and servos are no faster in a small car.
    """

    def scaled(p: Parameter) -> Parameter:
        factor = units.of(p.unit)
        if p.unit == "s":
            return p
        if p.symbol in ("radius", "r_0"):
            high, size = p.high * max(1.0, units.reach), p.size * units.reach
            return p._replace(low=p.low * factor, high=high, size=size, off=p.off * factor)
        if p.places:
            return p
        return p.times(factor)

    return replace(effect, parameters=tuple(scaled(p) for p in effect.parameters))
