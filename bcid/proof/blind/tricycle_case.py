"""Cases of tricycles, forward and backward: driven at a measured wheel speed, measured by tape, something concealed."""

import hashlib
from dataclasses import dataclass

from bcid.proof.blind.blind_case import BlindCase, LabFiles
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import Drive
from bcid.simulation.tricycle import Tricycle
from bcid.simulation.tricycle_drive import Encoder, TricycleHandling, simulate_tricycle

TRICYCLE_FILE, BODY = "tricycle.toml", "tricycle"

VEHICLE_TEXT = """\
# A tricycle of a simulated laboratory: what is measured by tape, on scales and with a protractor.
name = "tricycle"

[body]
mass_kg = {mass:.1f}
cog_to_front_m = {front_lever:.3f}
cog_to_rear_m = {rear_lever:.3f}
drive = "front"
rear_track_m = {rear_track:.3f}

[steering]
max_angle_rad = {angle_limit:.3f}

[motor]
law = "measured-speed"

[mocap]
rigid_body = "tricycle"
marker_offset_m = [{marker_x:.3f}, {marker_y:.3f}]

[topics]
pose = "/mocap/tricycle/pose"
command = "/tricycle/command"
"""


@dataclass(frozen=True, kw_only=True)
class TricycleCase(BlindCase):
    """One simulated take of a tricycle whose servo, tyres and logger nobody has measured."""

    tricycle: Tricycle
    handling: TricycleHandling
    encoder: Encoder
    tracker: Sensor  # with the tracked point where the lab believes that it is
    command_hz: float = 20.0

    @property
    def also(self) -> dict[str, dict[str, float]]:
        """True parameters by symbol of what the rear wheels' rolling resistance is called: it is right to name it."""
        p = self.tricycle
        return {
            "rear_rolling_coulomb": {"c": p.rolling_share * p.rear_weight},
            "rear_rolling_viscous": {"b": p.rolling_growth * p.rear_weight},
        }

    @property
    def lab_files(self) -> LabFiles:
        """The vehicle file; there is no published simulation."""
        marker = {"marker_x": self.tracker.marker_offset_x, "marker_y": self.tracker.marker_offset_y}
        return LabFiles(VEHICLE_TEXT.format(**self.tricycle._asdict(), **marker), TRICYCLE_FILE, BODY)

    def driven_tricycle(self) -> Tricycle:
        """The tricycle with what is concealed in it."""
        return self.tricycle._replace(**{k: v for c in self.concealed for k, v in c.plant.items()})

    def sensor(self) -> Sensor:
        """The tracking with what is concealed in it; how far the tracked point is off adds to its believed place."""
        more = {k: v for c in self.concealed for k, v in c.sensor.items()}
        for axis in ("marker_offset_x", "marker_offset_y"):
            more[axis] = getattr(self.tracker, axis) + more.get(axis, 0.0)
        return self.tracker._replace(rate_hz=self.rate_hz, **more)

    def plant(self) -> Plant:
        """Not to be had: a tricycle is no car.

        Raises:
            TypeError: always.
        """
        raise TypeError("a tricycle has a plant of its own, `driven_tricycle`")

    def digest(self) -> str:
        """Digest (16 hex digits) of what is driven, how, and of the files that belong to it."""
        made = [
            self._drive_seed(), self.duration_s, self.command_hz, self.left_out, self.handling, self.encoder,
            self.driven_tricycle(), self.sensor(), self.lab_files,
        ]  # fmt: skip
        return hashlib.sha256(repr(made).encode()).hexdigest()[:16]

    def simulate(self) -> Drive:
        """Simulate the case's drive."""
        return simulate_tricycle(
            self.driven_tricycle(), self.sensor(), self.duration_s, self._drive_seed(), self.command_hz, self.handling,
            self.encoder,
        )  # fmt: skip
