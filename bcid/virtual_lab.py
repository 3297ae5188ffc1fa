"""The simulated car as a lab would see it: its vehicle file, and its drives as recordings."""

from __future__ import annotations

import tomllib

from bcid.estimate.noise import Noise
from bcid.estimate.tuning import Tuning
from bcid.recording.assemble import assemble
from bcid.recording.formats.raw import RawTake
from bcid.recording.types import Recording, Source
from bcid.simulation.drive import Drive
from bcid.simulation.samples import VEHICLE
from bcid.vehicle import Vehicle

TUNING = Tuning(Noise(0.15, 0.2, 0.025, 0.01, 5e-4, 1e-3), 0.155, 1.418)
"""The estimator's constants for the simulated sensor, as `bcid.estimate.tuning` finds them there."""


def vehicle() -> Vehicle:
    """The simulated car's vehicle file, read."""
    return Vehicle.model_validate(tomllib.loads(VEHICLE))


def recorded(run: Drive, rate_hz: float, of: Vehicle, name: str = "simulated") -> Recording:
    """The drive's recording as a reader would hand it on."""
    return assemble(
        RawTake(
            name, (Source(name, "", "mcap"),), run.frame / rate_hz, run.pose, run.command_time, run.command, rate_hz
        ),
        of,
    )
