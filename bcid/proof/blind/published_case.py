"""Cases of small cars whose published simulation is not the car's own: its figures are others, or of other formulas."""

import math
from dataclasses import dataclass
from functools import cached_property

from bcid.proof.blind.blind_case import LabFiles
from bcid.proof.blind.concealed_effects import LARGEST_SIZES
from bcid.proof.blind.nearest_figures import fit_servo, fit_servo_of_two_lags, nearest_figures
from bcid.proof.blind.small_case import SmallCase
from bcid.proof.blind.small_files import (
    BODY,
    SMALL_VEHICLE_FILE,
    Figures,
    plant_figures,
    simulation_text,
    small_vehicle_text,
)
from bcid.simulation.car import Plant


@dataclass(frozen=True, kw_only=True)
class PublishedCase(SmallCase):
    """One simulated take of a small car, beside a simulation whose figures are off as far as it says.

    Where a figure is another in the car than published, it is right to say so, and no name: `other_parameters` and
    `also` have the true ones.
    """

    relative_sd_of: tuple[tuple[str, float], ...]  # how well figures are said to be known; the rest by `trust`
    errors: tuple[tuple[str, float], ...] = ()  # of published figures as shares, by symbol or effect's id
    other_laws: bool = False  # the car's laws are of other formulas than the vocabulary's

    @cached_property
    def true_figures(self) -> Figures:
        """The figures of the vocabulary's laws that are, or come nearest to, those of the car as it is driven."""
        return self._find_figures(self.plant())

    @cached_property
    def published_figures(self) -> Figures:
        """The figures of the published simulation and of what is withheld: the published car's, with their errors."""
        factor = {name: 1.0 + error for name, error in self.errors}
        figures = self._find_figures(self.car.plant)
        effects = {
            effect: {
                symbol: min(value * factor.get(effect, 1.0), LARGEST_SIZES.get(effect, math.inf))
                for symbol, value in values.items()
            }
            for effect, values in figures.effects.items()
        }
        return Figures({s: value * factor.get(s, 1.0) for s, value in figures.parameters.items()}, effects)

    def _find_figures(self, plant: Plant) -> Figures:
        """The figures of a car in the vocabulary's words."""
        return nearest_figures(plant) if self.other_laws else plant_figures(plant)

    @property
    def other_parameters(self) -> dict[str, float]:
        """True values of the base model's parameters that are published otherwise, by symbol."""
        published = self.published_figures.parameters
        return {s: value for s, value in self.true_figures.parameters.items() if published[s] != value}

    @property
    def also(self) -> dict[str, dict[str, float]]:
        """True parameters by symbol of effects that may be named, too: the simulation lacks them, or their true size.

        A servo of second order turns more like two lags than like one: a further lag is there, though of no size of its
        own, as what is published for the first has taken up a part of it.
        """
        published = self.published_figures.effects
        others = {
            effect: values
            for effect, values in self.true_figures.effects.items()
            if effect not in self.answer and (effect in self.withheld or published[effect] != values)
        }
        plant = self.plant()
        if self.other_laws and fit_servo_of_two_lags(plant).error < fit_servo(plant).error:
            others["steering_lag"] = {}
        return others

    @property
    def lab_files(self) -> LabFiles:
        """The vehicle file and the published simulation; a servo of another law is known from the latter alone."""
        figures = self.published_figures.without(self.withheld)
        given = {*figures.parameters, *figures.effects}
        known = {name: sd for name, sd in self.relative_sd_of if name in given}
        vehicle = small_vehicle_text(self.car.plant, knows_servo=not self.other_laws)
        return LabFiles(vehicle, SMALL_VEHICLE_FILE, BODY, simulation_text(figures, self.trust, known))
