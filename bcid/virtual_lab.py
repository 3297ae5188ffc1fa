"""The simulated car as a lab would see it: its vehicle file, and its drives as recordings."""

import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory

from bcid.diagnosis.reference import reference_from_parameters
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.estimate.tuning import Noise, Tuning
from bcid.estimate.types import Estimate
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
    return read_vehicle_text(VEHICLE)


def read_vehicle_text(text: str) -> Vehicle:
    """The checked settings in the text (TOML) of a vehicle file."""
    return Vehicle.model_validate(tomllib.loads(text))


def read_simulation_text(text: str, estimate: Estimate, vehicle: Vehicle) -> ReferenceModel:
    """The reference model in the text (TOML) of a published simulation, read as a file of it would be."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "simulation.toml"
        path.write_text(text, encoding="utf-8")
        return reference_from_parameters(path, [estimate], vehicle)


def record_drive(drive: Drive, rate_hz: float, vehicle: Vehicle, name: str = "simulated") -> Recording:
    """The recording that a lab's log of a simulated drive would give, checked and mended; frames come at `rate_hz`."""
    source, stamps = SourceFile(name, "", "mcap"), drive.frame / rate_hz
    raw = RawTake(name, (source,), stamps, drive.pose, drive.command_time, drive.command, rate_hz)
    return assemble_recording(raw, vehicle)
