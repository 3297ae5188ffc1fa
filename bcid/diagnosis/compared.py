"""The simulation that a recording is compared with."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from bcid.effects.table import effects_of
from bcid.likelihood.refit import Fit
from bcid.physics.car import Car


class Compared(NamedTuple):
    """The simulation that a recording is compared with, as a car and the effects that it has."""

    car: Car
    effects: dict[str, float]  # by field of the switches
    trust: float | None = None  # relative standard deviation of all that; None to refit it freely
    trust_of: Mapping[str, float] = MappingProxyType({})  # the same of a parameter or effect that is known otherwise

    @classmethod
    def of(cls, fit: Fit) -> Compared:
        """What was fitted, as a simulation."""
        return cls(fit.car(), fit.hypothesis.values(fit.phi))

    def assumed(self) -> tuple[str, ...]:
        """The effects' ids."""
        return effects_of(self.effects)

    def without(self, effect: str) -> Compared:
        """The same simulation, less that effect if it has it."""
        return self._replace(effects={f: v for f, v in self.effects.items() if effects_of([f]) != (effect,)})
