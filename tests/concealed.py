"""Simulated drives of a car with something that a model lacks: short ones with a base model, and blind cases."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

from bcid.diagnosis.diagnose import BaseFit, fit_base_model
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.estimate.run import estimate_motion
from bcid.estimate.types import Estimate
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take
from bcid.proof.blind.blind_case import BlindCase
from bcid.proof.blind.diagnose_case import estimate_concealed_drive
from bcid.proof.blind.small_suite import draft_small_cases
from bcid.recording.types import Recording
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import simulate_drive
from bcid.vehicle import Vehicle
from bcid.virtual_lab import TUNING, read_vehicle_text, record_drive, simulated_vehicle

USUAL = Sensor()


@cache
def concealing(seconds: float = 120.0, seed: int = 4, sensor: Sensor = USUAL, **plant: float) -> tuple[Fit, Take]:
    """The base model's fit, and the take, of so many seconds at 60 poses a second; `plant` are constants of the car."""
    vehicle = simulated_vehicle()
    recording = record_drive(simulate_drive(Plant(**plant), sensor, seconds, seed), 60.0, vehicle)
    base = fit_base_model([recording], [estimate_motion(recording, vehicle, TUNING)], vehicle)
    return base.fit, base.take


class RecordedCase(NamedTuple):
    """A blind case as the diagnosis is given it."""

    recording: Recording
    estimate: Estimate
    vehicle: Vehicle
    reference: ReferenceModel | None  # None where nothing is published


def record_case(case: BlindCase, name: str = "concealed") -> RecordedCase:
    """A blind case driven and recorded under a `name`, its motion estimated, and what is published read."""
    files = case.lab_files
    vehicle = read_vehicle_text(files.vehicle)
    recording = record_drive(case.simulate(), case.rate_hz, vehicle, name)
    estimate, reference = estimate_concealed_drive(recording, vehicle, files.vehicle, files.simulation)
    return RecordedCase(recording, estimate, vehicle, reference)


@cache
def nothing_missing(seed: int, number: int) -> BaseFit:
    """The published model of a small car, fitted to its drive; nothing is missing.  `number` is that of its case."""
    (draw_nothing, *_) = draft_small_cases(repeats=0, nulls=1)
    case = record_case(draw_nothing(seed, number))
    return fit_base_model([case.recording], [case.estimate], case.vehicle, case.reference)
