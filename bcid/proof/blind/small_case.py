"""Cases of small cars: there is a published simulation to compare with, exact or not, and something lacks in it."""

import hashlib
from dataclasses import dataclass

from bcid.proof.blind.blind_case import BlindCase, LabFiles
from bcid.proof.blind.concealed_effects import ConcealedEffect
from bcid.proof.blind.small_files import (
    BODY,
    SMALL_VEHICLE_FILE,
    published_simulation_text,
    small_vehicle_text,
)
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import Drive
from bcid.simulation.room_drive import simulate_room_drive
from bcid.simulation.small_car import SMALL_CAR_SENSOR, SmallCar


@dataclass(frozen=True, kw_only=True)
class SmallCase(BlindCase):
    """One simulated take of a small car, whose published simulation lacks what is concealed."""

    car: SmallCar  # as published, with what is withheld from the simulation
    trust: float  # share to which all that is published is said to be known
    withheld: tuple[str, ...] = ()  # effects of the published car that the simulation lacks
    flaws: tuple[ConcealedEffect, ...] = ()  # what else is otherwise in the car than published
    command_hz: float = 20.0

    @property
    def also(self) -> dict[str, dict[str, float]]:
        """True parameters by symbol of the flaws that the vocabulary knows: it is right to name them."""
        return {flaw.effect: dict(flaw.parameters) for flaw in self.flaws if flaw.parameters}

    @property
    def lab_files(self) -> LabFiles:
        """The vehicle file and the published simulation of the car."""
        simulation = published_simulation_text(self.car.plant, self.trust, self.withheld)
        return LabFiles(small_vehicle_text(self.car.plant), SMALL_VEHICLE_FILE, BODY, simulation)

    def plant(self) -> Plant:
        """The car as it is driven: as published, with what is concealed and with its flaws."""
        more = {k: v for c in (*self.concealed, *self.flaws) for k, v in c.plant.items()}
        return self.car.plant._replace(**more)

    def sensor(self) -> Sensor:
        """The room's motion capture with what is concealed in it and with its flaws."""
        more = {k: v for c in (*self.concealed, *self.flaws) for k, v in c.sensor.items()}
        return SMALL_CAR_SENSOR._replace(rate_hz=self.rate_hz, **more)

    def digest(self) -> str:
        """Digest (16 hex digits) of what is driven, how, and of the files that belong to it."""
        made = [
            self._drive_seed(), self.driver, self.duration_s, self.command_hz, self.left_out, self.car.slow,
            self.car.fast, *self.changed_constants(), self.lab_files,
        ]  # fmt: skip
        return hashlib.sha256(repr(made).encode()).hexdigest()[:16]

    def simulate(self) -> Drive:
        """Simulate the case's drive: its car, driver, room and motion capture."""
        return simulate_room_drive(
            self.plant(), self.sensor(), self.duration_s, self._drive_seed(), self.driver,
            (self.car.slow, self.car.fast), self.command_hz,
        )  # fmt: skip
