"""The vehicle file: what is known of a car and how its logs are to be read."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from bcid.files.toml import Settings, read_toml

Positive = Annotated[float, Field(gt=0)]


class Body(Settings):
    """Rigid body and drive."""

    cog_to_front_m: Positive
    cog_to_rear_m: Positive
    mass_kg: Positive | None = None
    drive: Literal["front", "rear", "all"] = "front"
    front_drive_share: Annotated[float, Field(ge=0, le=1)] | None = None
    rear_track_m: Positive | None = None


class Steering(Settings):
    """The steering actuator; time constant and rate are identified where absent."""

    max_angle_rad: Positive
    max_rate_radps: Positive | None = None
    time_constant_s: Annotated[float, Field(ge=0.02)] | None = None  # RK4 at 0.05 s is unstable below


class Motor(Settings):
    """The motor controller (errata 13); law "force" is F_m = K (u - u_0) - K_v v_w."""

    law: Literal["speed", "force"] = "speed"
    reference_speed_mps: Positive | None = None


class Mocap(Settings):
    """How the tracked body sits on the car and how the export names it."""

    rigid_body: str | None = None
    up_axis: Literal["Y", "Z"] = "Y"
    yaw_offset_rad: float | None = None
    marker_offset_m: Annotated[tuple[float, float], Field(strict=False)] | None = None
    length_unit: Literal["m", "cm", "mm"] | None = None  # only where the export's header has none
    max_speed_mps: Positive | None = None  # a jump beyond it is a tracking failure


class Condition(Settings):
    """Rows in which a field equals a value."""

    field: str
    equals: float


Point = Annotated[tuple[float, float], Field(strict=False)]


class Mapped(Settings):
    """A logged field turned into SI: gain * dead_zone(raw) + offset, within [low, high].

    `gain_negative` is the gain for raw values below the dead zone where it differs.  A calibrated servo has `points`
    instead, of raw value and angle: straight lines between them, the ends beyond.
    """

    source: Annotated[str, Field(alias="from")]
    gain: float = 1.0
    gain_negative: float | None = None
    offset: float = 0.0
    dead_zone: Annotated[float, Field(ge=0)] = 0.0
    low: float | None = None
    high: float | None = None
    zero_where: Condition | None = None
    points: Annotated[tuple[Point, ...], Field(min_length=2, strict=False)] | None = None

    @model_validator(mode="after")
    def _one_law(self) -> Mapped:
        if self.points is None:
            return self
        raw = [a for a, _ in self.points]
        if any(b <= a for a, b in pairwise(raw)):
            raise ValueError("points must rise in their raw value")
        if self.gain != 1.0 or self.gain_negative is not None or self.dead_zone:
            raise ValueError("points stand in the place of gain, gain_negative and dead_zone")
        return self


def _bare(value: object) -> object:
    """A bare name is a mapping of gain 1."""
    return {"from": value} if isinstance(value, str) else value


Logged = Annotated[Mapped, BeforeValidator(_bare)]

CHANNELS = ("measured_steering_rad", "wheel_speed_mps", "yaw_rate_radps")
"""Optional quantities that may be logged beside pose and command."""


class PoseFields(Settings):
    """Where a pose is found in a table's row or a message."""

    x_m: Logged
    y_m: Logged
    yaw_rad: Logged
    time_s: str | None = None


class CommandFields(Settings):
    """Where a command is found in a table's row or a message."""

    steering_rad: Logged
    throttle_mps: Logged
    time_s: str | None = None
    measured_steering_rad: Logged | None = None
    wheel_speed_mps: Logged | None = None
    yaw_rate_radps: Logged | None = None


class Topics(Settings):
    """MCAP topics; fields only for messages of no known type."""

    pose: str
    command: str
    time: Literal["auto", "header", "log"] = "auto"
    child_frame: str | None = None  # which body of a TFMessage or RigidBodies
    world_frame: str | None = None  # the frame of a TFMessage in which the body is wanted; else the tree's root
    pose_fields: PoseFields | None = None
    command_fields: CommandFields | None = None


class Columns(PoseFields, CommandFields):
    """A table's columns; the command columns are those of the same rows."""

    time_s: str
    comment: Annotated[str, Field(min_length=1, max_length=1)] | None = None


class Command(Settings):
    """How long a command value holds when no new row comes."""

    max_hold_s: Positive = 0.5


class Clock(Settings):
    """The correction of the command clock against the pose clock; none unless stated."""

    offset_s: float = 0.0


class Vehicle(Settings):
    """One vehicle file."""

    name: str
    body: Body
    steering: Steering
    motor: Motor = Motor()
    mocap: Mocap = Mocap()
    topics: Topics | None = None
    columns: Columns | None = None
    command: Command = Command()
    clock: Clock | None = None

    @property
    def front_share(self) -> float:
        """Share of motor force and drag at the front axle."""
        if self.body.front_drive_share is not None and self.body.drive == "all":
            return self.body.front_drive_share
        return 1.0 if self.body.drive == "front" else 0.0

    @property
    def raw_steering(self) -> bool:
        """Whether steering commands come in units of their own, which this file turns into rad."""
        mapped = (self.columns, self.topics.command_fields if self.topics else None)
        angles = [m.steering_rad for m in mapped if m]
        gains = {abs(g) for a in angles for g in (a.gain, a.gain_negative) if g is not None}
        return bool(gains - {1.0}) or any(a.points for a in angles)

    @property
    def mass_kg(self) -> float:
        """The mass; 1 kg where it is not given, so that forces read as accelerations."""
        return self.body.mass_kg or 1.0


def read_vehicle(path: Path) -> Vehicle:
    """The vehicle file at `path`; raises `InputRefused` with every problem in it."""
    return read_toml(path, Vehicle, "vehicle file")
