"""The simulated car as a lab would see it: its vehicle file, and its drives as recordings."""

import tomllib

from bcid.estimate.tuning import Noise, Tuning
from bcid.recording.assemble import assemble_recording
from bcid.recording.formats.raw import RawTake
from bcid.recording.types import Recording, SourceFile
from bcid.simulation.drive import Drive
from bcid.simulation.samples import VEHICLE
from bcid.vehicle import Vehicle

TUNING = Tuning(
    noise=Noise(q_v_f=0.15, q_beta_f=0.2, q_beta_r=0.025, q_delta=0.01, r_position=5e-4, r_yaw=1e-3), T_s=0.155, d=1.418
)
"""The estimator's constants for the simulated sensor, as `bcid.estimate.tune` identifies them there."""


def simulated_vehicle() -> Vehicle:
    """The checked settings of the vehicle file that belongs to the simulated bumper car."""
    return Vehicle.model_validate(tomllib.loads(VEHICLE))


def record_drive(drive: Drive, rate_hz: float, vehicle: Vehicle, name: str = "simulated") -> Recording:
    """The recording that a lab's log of a simulated drive would give, checked and mended; frames come at `rate_hz`."""
    source, stamps = SourceFile(name, "", "mcap"), drive.frame / rate_hz
    raw = RawTake(name, (source,), stamps, drive.pose, drive.command_time, drive.command, rate_hz)
    return assemble_recording(raw, vehicle)
