"""What every effect declares: its law, the equation in print, parameters with unit and bounds, where it acts."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

Channel = Literal["fx", "fy", "mz", "steering", "motor", "pose", "time", "any"]
Kind = Literal["vehicle", "environment", "measurement"]

BOUND_REL_TOL = 1e-6  # a search that ends at a bound ends there to rounding


class Parameter(NamedTuple):
    """One number of an effect, in SI; `low` and `high` bound the search.

    Searches start from `size`, at which ten minutes of the bumper car just show the effect (specification).
    """

    symbol: str
    unit: str  # a product of powers of kg, m, s, rad, such as "kg m s^-2"
    low: float
    high: float
    size: float
    meaning: str
    off: float = 0.0
    is_place: bool = False  # a place or a time, which means nothing while the effect is off
    inverse_of: str = ""  # what is quoted in its place: its inverse, where off is infinity

    def is_at_bound(self, value: float) -> bool:
        """Whether a fitted `value` lies at a bound, so that its search might have gone on beyond."""
        return any(math.isclose(value, bound, rel_tol=BOUND_REL_TOL) for bound in (self.low, self.high))

    def scale(self, factor: float) -> Parameter:
        """The parameter for a vehicle for which such numbers are `factor` times as large: bounds and size."""
        return self._replace(low=self.low * factor, high=self.high * factor, size=self.size * factor)

    def quote(self, value: float, se: float | None) -> QuotedValue:
        """The fitted `value` and its standard error `se` as they are printed and saved, with the unit in words.

        A parameter that stands for an inverse (1/P for a power) is inverted, its standard error to first order.
        """
        if not self.inverse_of or value == 0.0:
            return QuotedValue(self.symbol, value, se, unit_in_words(self.unit))
        unit = " ".join(base if n == -1 else f"{base}^{-n}" for base, n in parse_unit(self.unit))
        return QuotedValue(self.inverse_of, 1.0 / value, None if se is None else se / value**2, unit_in_words(unit))


class QuotedValue(NamedTuple):
    """A fitted parameter as it is printed and saved."""

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


def parse_unit(unit: str) -> list[tuple[str, int]]:
    """Base units and their exponents in a unit that is written as a product of powers.

    >>> parse_unit("kg m^-2")
    [('kg', 1), ('m', -2)]
    """
    return [(base, int(power or 1)) for base, _, power in (part.partition("^") for part in unit.split())]


def unit_in_words(unit: str) -> str:
    """A unit, given as a product of powers, as an engineer writes it: a derived unit such as "N", where there is one.

    >>> unit_in_words("kg s^-1"), unit_in_words("kg m^4")
    ('N s/m', 'kg m⁴')
    """
    if unit in UNITS_IN_WORDS:
        return UNITS_IN_WORDS[unit]
    return " ".join(base if n == 1 else base + str(n).translate(_SUPERSCRIPTS) for base, n in parse_unit(unit))


@dataclass(frozen=True)
class Effect:
    """One entry of the vocabulary, or one of the base model's corrections."""

    law: Callable[..., Any]  # the compiled function that is the equation; the car calls it
    equation: str
    parameters: tuple[Parameter, ...]
    channel: Channel
    kind: Kind = "vehicle"
    looks_like: tuple[str, ...] = ()
    depends_on: tuple[str, ...] = ()  # the quantities it varies with, in the words of diagnosis.json
    confounded_with: str = ""  # what is visible only because the vehicle file's value is held
    source: str = ""
    suits_one_vehicle: bool = False  # bounds and sizes are meant for the user's vehicle, not for the bumper car

    @property
    def id(self) -> str:
        """Name of the effect, which is that of its law."""
        return self.law.__name__

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the effect's parameters among the switches: id, two underscores, symbol, as in "rough_patch__b"."""
        return tuple(f"{self.id}__{p.symbol}" for p in self.parameters)

    @property
    def place_parameters(self) -> tuple[Parameter, ...]:
        """Parameters that say where or when the effect acts; none for what acts everywhere."""
        return tuple(p for p in self.parameters if p.is_place)

    @property
    def amplitude_parameters(self) -> tuple[Parameter, ...]:
        """Parameters that say how strong the effect is."""
        return tuple(p for p in self.parameters if not p.is_place)


class VehicleScale(NamedTuple):
    """How many times the bumper car's a vehicle's mass, length and time are."""

    kg: float = 1.0
    m: float = 1.0
    s: float = 1.0
    rad: float = 1.0

    @property
    def circle_factor(self) -> float:
        """How much wider circles on the floor are: by the vehicle's length, or by how far it drives in a time."""
        return max(self.m, self.m / self.s)

    def factor_of(self, unit: str) -> float:
        """Factor between this vehicle and the bumper car of a number in `unit`, powers such as "kg m s^-2"."""
        return float(math.prod(getattr(self, base) ** n for base, n in parse_unit(unit) if base != "1"))


def resize_effect(effect: Effect, units: VehicleScale) -> Effect:
    """The effect with bounds and starting sizes scaled from the bumper car to a vehicle of other mass or size.

    `units` holds the ratios of the vehicle's mass, length and time to the bumper car's; a parameter is scaled by the
    ratio of its unit.  Places, times, delays and lags are not scaled (electronics are no faster in a small car);
    radii are scaled by the vehicle's length, or by how far it drives in its time if that is more.  An effect that is
    meant for this vehicle already stays as it is.
    """
    if effect.suits_one_vehicle:
        return effect

    def scaled(p: Parameter) -> Parameter:
        factor = units.factor_of(p.unit)
        if p.symbol in ("radius", "r_0"):
            high, size = p.high * max(1.0, units.circle_factor), p.size * units.circle_factor
            return p._replace(low=p.low * factor, high=high, size=size, off=p.off * factor)
        return p if p.is_place or p.unit == "s" else p.scale(factor)

    return replace(effect, parameters=tuple(scaled(p) for p in effect.parameters))
