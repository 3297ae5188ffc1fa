"""The base model fitted to short simulated drives of a car with something that the model lacks."""

from __future__ import annotations

from functools import cache

from bcid.diagnosis.diagnose import fit_base_model
from bcid.estimate.run import estimate_motion
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import simulate_drive
from bcid.virtual_lab import TUNING, record_drive, simulated_vehicle

USUAL = Sensor()


@cache
def concealing(seconds: float = 120.0, seed: int = 4, sensor: Sensor = USUAL, **plant: float) -> tuple[Fit, Take]:
    """The base model's fit, and the take, of so many seconds at 60 poses a second; `plant` are constants of the car."""
    vehicle = simulated_vehicle()
    recording = record_drive(simulate_drive(Plant(**plant), sensor, seconds, seed), 60.0, vehicle)
    base = fit_base_model([recording], [estimate_motion(recording, vehicle, TUNING)], vehicle)
    return base.fit, base.take
