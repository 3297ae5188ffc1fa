"""One case of a blind test: a simulated take that conceals something, its answer, and what a lab has of the car."""

import hashlib
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bcid.proof.blind.concealed_effects import BASE_FLAW_RANGES, ConcealedEffect
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import Drive, simulate_drive, slow_circle_commands
from bcid.simulation.samples import VEHICLE, VEHICLE_FILE
from bcid.simulation.writing import BODY

ROUGHNESS = {"rough_force": 3.0, "rough_moment": 1.5}
"""Random force (N) and moment (N m) of the floor where the base model is imperfect or the recording is not a usual one.
"""


class LabFiles(NamedTuple):
    """What a lab has of a simulated car: texts of its vehicle file and of a published simulation, if there is one."""

    vehicle: str
    vehicle_file: str  # its name
    body: str  # of the car, in topics
    simulation: str = ""  # TOML; without one the base model is fitted freely


@dataclass(frozen=True)
class BlindCase:
    """One simulated take with concealed effects, and its answer."""

    tier: str
    number: int
    concealed: tuple[ConcealedEffect, ...]
    imperfect: bool = False
    left_out: tuple[str, ...] = ()
    channel: str = ""  # of a left-out family
    duration_s: float = 600.0
    rate_hz: float = 60.0
    noise: float = 1.0  # times the usual
    driver: str = "drawn"  # or "pursuit", "circles"
    seed: int = 0

    @property
    def name(self) -> str:
        """The case's name, unique within a suite: its tier and number."""
        return f"{self.tier}-{self.number:04d}"

    @property
    def answer(self) -> tuple[str, ...]:
        """Ids of the concealed effects."""
        return tuple(c.effect for c in self.concealed)

    @property
    def also(self) -> dict[str, dict[str, float]]:
        """True parameters by symbol of effects of the vocabulary that are there besides: right to be named."""
        return {}

    @property
    def other_parameters(self) -> dict[str, float]:
        """True values by symbol of parameters that the published simulation has otherwise: right to be told."""
        return {}

    @property
    def lab_files(self) -> LabFiles:
        """What a lab has of the car beside the recording."""
        return LabFiles(VEHICLE, VEHICLE_FILE, BODY)

    @property
    def nameable_effects(self) -> dict[str, dict[str, float]]:
        """True parameters by symbol of each concealed effect that the diagnosis may name."""
        return {} if self.channel else {c.effect: dict(c.parameters) for c in self.concealed}

    def plant(self) -> Plant:
        """The simulated car with the concealed effects, and with flaws that no effect describes if it is imperfect."""
        rng = np.random.default_rng([self.seed, self.number, 7])
        flaws = {name: float(rng.uniform(low, high)) for name, (low, high) in BASE_FLAW_RANGES.items()}
        base = {**ROUGHNESS, **flaws} if self.imperfect else {}
        if (self.duration_s, self.rate_hz, self.noise) != (USUAL_CASE.duration_s, USUAL_CASE.rate_hz, USUAL_CASE.noise):
            base |= ROUGHNESS
        more = {k: v for c in self.concealed for k, v in c.plant.items()}
        return Plant(**{**base, **more})

    def changed_constants(self) -> list[list[tuple[str, float]]]:
        """The constants of car and motion capture that are not the usual ones: what others there are does not count."""
        pairs = (self.plant(), Plant()), (self.sensor(), Sensor())
        return [[(k, v) for k, v in of._asdict().items() if v != getattr(usual, k)] for of, usual in pairs]

    def digest(self) -> str:
        """Digest (16 hex digits) of what is driven and of the names left out, whatever the case's tier and number."""
        made = [self._drive_seed(), self.driver, self.duration_s, self.left_out, *self.changed_constants()]
        return hashlib.sha256(repr(made).encode()).hexdigest()[:16]

    def sensor(self) -> Sensor:
        """The simulated motion capture with the concealed effects."""
        more = {k: v for c in self.concealed for k, v in c.sensor.items()}
        usual = Sensor()
        return usual._replace(
            rate_hz=self.rate_hz, position_noise=self.noise * usual.position_noise,
            yaw_noise=self.noise * usual.yaw_noise, **more,
        )  # fmt: skip

    def simulate(self) -> Drive:
        """Simulate the case's drive: its car, driver and motion capture."""
        given = slow_circle_commands(self.duration_s) if self.driver == "circles" else None
        return simulate_drive(
            self.plant(), self.sensor(), self.duration_s, self._drive_seed(), given_commands=given,
            follows_path=self.driver == "pursuit",
        )  # fmt: skip

    def _drive_seed(self) -> int:
        """Seed of the driver and of the noise."""
        return int(np.random.default_rng([self.seed, self.number, 11]).integers(2**31))


USUAL_CASE = BlindCase("usual", 0, ())
