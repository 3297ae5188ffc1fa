"""The simulation that a recording is compared with."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from bcid.effects.table import effect_ids
from bcid.likelihood.refit import Fit
from bcid.likelihood.unnamed_functions import NO_UNNAMED, UnnamedFunctions
from bcid.physics.car import Car


class ReferenceModel(NamedTuple):
    """The simulation that a recording is compared with: a car, its effects, and functions without a name."""

    car: Car
    effects: dict[str, float]  # effect parameters by field of the switches
    relative_sd: float | None = None  # how well all of it is known; None to refit it freely
    relative_sd_of: Mapping[str, float] = MappingProxyType({})  # of parameters and effects that are known otherwise
    begin: Mapping[str, float] = MappingProxyType({})  # factors of parameters where a fit begins: the model is the same
    known: UnnamedFunctions = NO_UNNAMED  # functions without a name that it has, too: they are not refitted

    @classmethod
    def from_fit(cls, fit: Fit) -> ReferenceModel:
        """The fitted car with the effects that the fit holds, to be refitted freely, and what has no name, held."""
        h = fit.hypothesis
        return cls(fit.car(), h.effect_values(fit.phi), known=h.known.join(h.functions(fit.phi)))

    def without(self, effect: str) -> ReferenceModel:
        """The reference model less one effect, if it has that."""
        return self._replace(effects={f: v for f, v in self.effects.items() if effect_ids([f]) != (effect,)})
