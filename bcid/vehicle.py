"""The vehicle file: what is known of a car and how its logs are to be read."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from bcid.files.toml import Settings, read_toml

Positive = Annotated[float, Field(gt=0)]


class Body(Settings):
    """The table [body]: rigid body and drive."""

    cog_to_front_m: Positive
    cog_to_rear_m: Positive
    mass_kg: Positive | None = None
    drive: Literal["front", "rear", "all"] = "front"
    front_drive_share: Annotated[float, Field(ge=0, le=1)] | None = None
    rear_track_m: Positive | None = None

    @property
    def wheelbase_m(self) -> float:
        """Distance (m) between the front and the rear axle."""
        return self.cog_to_front_m + self.cog_to_rear_m


class Steering(Settings):
    """The table [steering]: the servo; time constant and rate are identified where absent."""

    max_angle_rad: Positive
    max_rate_radps: Positive | None = None
    time_constant_s: Annotated[float, Field(ge=0.02)] | None = None  # RK4 at 0.05 s is unstable below


class Motor(Settings):
    """The table [motor]: the motor controller (errata 13); law "force" is F_m = K (u - u_0) - K_v v_w."""

    law: Literal["speed", "force"] = "speed"
    reference_speed_mps: Positive | None = None


class Mocap(Settings):
    """The table [mocap]: how the tracked body sits on the car and how the export names it."""

    rigid_body: str | None = None
    up_axis: Literal["Y", "Z"] = "Y"
    yaw_offset_rad: float | None = None
    marker_offset_m: Annotated[tuple[float, float], Field(strict=False)] | None = None
    length_unit: Literal["m", "cm", "mm"] | None = None  # only where the export's header has none
    max_speed_mps: Positive | None = None  # a jump beyond it is a tracking failure


class Condition(Settings):
    """Selects rows in which a logged field equals a value."""

    field: str
    equals: float


CalibrationPoint = Annotated[tuple[float, float], Field(strict=False)]


class FieldMapping(Settings):
    """How a logged field is turned into SI: gain * dead_zone(raw) + offset, within [low, high].

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
    points: Annotated[tuple[CalibrationPoint, ...], Field(min_length=2, strict=False)] | None = None

    @model_validator(mode="after")
    def _check_points(self) -> FieldMapping:
        """Refuse calibration points that do not rise, or that stand beside a gain or a dead zone."""
        if self.points is None:
            return self
        raw = [a for a, _ in self.points]
        if any(b <= a for a, b in pairwise(raw)):
            raise ValueError("points must rise in their raw value")
        if self.gain != 1.0 or self.gain_negative is not None or self.dead_zone:
            raise ValueError("points stand in the place of gain, gain_negative and dead_zone")
        return self


# a bare field name stands for the mapping of gain 1
LoggedField = Annotated[FieldMapping, BeforeValidator(lambda raw: {"from": raw} if isinstance(raw, str) else raw)]

OPTIONAL_CHANNELS = ("measured_steering_rad", "wheel_speed_mps", "yaw_rate_radps")
"""Quantities that may be logged beside pose and command."""


class PoseFields(Settings):
    """Where a pose is in a table's row or a message."""

    x_m: LoggedField
    y_m: LoggedField
    yaw_rad: LoggedField
    time_s: str | None = None


class CommandFields(Settings):
    """Where a command is in a table's row or a message."""

    steering_rad: LoggedField
    throttle_mps: LoggedField
    time_s: str | None = None
    measured_steering_rad: LoggedField | None = None
    wheel_speed_mps: LoggedField | None = None
    yaw_rate_radps: LoggedField | None = None


class Topics(Settings):
    """The table [topics] of MCAP topics; fields are given only for messages of no known type."""

    pose: str
    command: str
    time: Literal["auto", "header", "log"] = "auto"
    child_frame: str | None = None  # which body of a TFMessage or RigidBodies
    world_frame: str | None = None  # the frame of a TFMessage in which the body is wanted; else the tree's root
    pose_fields: PoseFields | None = None
    command_fields: CommandFields | None = None


class Columns(PoseFields, CommandFields):
    """The table [columns] of a CSV or Parquet log, whose commands stand in the same rows as its poses."""

    time_s: str
    comment: Annotated[str, Field(min_length=1, max_length=1)] | None = None


class Command(Settings):
    """The table [command]: how long a command value holds when no new row comes."""

    max_hold_s: Positive = 0.5


class Clock(Settings):
    """The table [clock]: the correction of the command clock against the pose clock; none unless stated."""

    offset_s: float = 0.0


class Vehicle(Settings):
    """All of a vehicle file."""

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
        """Share of motor force and drag at the front axle, in [0, 1]."""
        if self.body.front_drive_share is not None and self.body.drive == "all":
            return self.body.front_drive_share
        return 1.0 if self.body.drive == "front" else 0.0

    @property
    def has_raw_steering(self) -> bool:
        """Whether steering commands come in raw units, which a gain or calibration points turn into rad."""
        mapped = (self.columns, self.topics.command_fields if self.topics else None)
        angles = [m.steering_rad for m in mapped if m]
        gains = {abs(g) for a in angles for g in (a.gain, a.gain_negative) if g is not None}
        return bool(gains - {1.0}) or any(a.points for a in angles)

    @property
    def mass_kg(self) -> float:
        """The vehicle's mass; 1 kg where the file has none, so that forces read as accelerations."""
        return self.body.mass_kg or 1.0


def read_vehicle(path: Path) -> Vehicle:
    """The checked settings in the vehicle file (TOML) at `path`; raises `InputRefused` that names all wrong entries."""
    return read_toml(path, Vehicle, "vehicle file")
