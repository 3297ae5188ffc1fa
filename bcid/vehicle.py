"""The vehicle file: what is known of a car and how its logs are to be read."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, ValidationInfo, field_validator, model_validator
from pydantic_core import PydanticCustomError

from bcid.files.toml import Settings, read_toml
from bcid.limits import VEHICLE as LIMITS
from bcid.mapping import Columns, CommandColumns, CommandFields, Name, PoseFields

Positive = Annotated[float, Field(gt=0)]

OTHER_UNITS = {
    "rad": (("degrees", math.pi / 180), ("milliradians", 1e-3)),
    "rad/s": (("degrees per second", math.pi / 180),),
    "m": (("mm", 1e-3), ("cm", 1e-2)),
    "m/s": (("km/h", 1 / 3.6), ("mm/s", 1e-3)),
    "kg": (("g", 1e-3), ("t", 1e3)),
    "s": (("ms", 1e-3), ("µs", 1e-6)),
}
"""Units that are mistaken for those of a vehicle file, each with its size in that unit."""


def _refuse_beyond(value: float, low: float, high: float, unit: str, what: str = "") -> None:
    """Raise pydantic's error where the size of `value` is outside [low, high], with the units in which it is inside.

    `what` names the quantity where it is not the entry itself.
    """
    if low <= abs(value) <= high:
        return
    meant = [f"{value * k:.4g} if that is in {name}" for name, k in OTHER_UNITS[unit] if low <= abs(value * k) <= high]
    text = f"{what}{value:g} {unit} is beyond any car ({low:.3g} to {high:.3g} {unit})"
    text += f": write {', or '.join(meant)}" if meant else ""
    raise PydanticCustomError("beyond_any_car", "{text}", {"text": text})


def _within(low: float, high: float, unit: str) -> AfterValidator:
    """A validator of numbers in `unit` whose size lies in [low, high]."""

    def check(value: float) -> float:
        """Return the value; raise pydantic's error where no car has it."""
        _refuse_beyond(value, low, high, unit)
        return value

    return AfterValidator(check)


class Body(Settings):
    """The table [body]: rigid body and drive."""

    cog_to_front_m: Positive
    cog_to_rear_m: Positive
    mass_kg: Annotated[Positive, _within(LIMITS.min_mass_kg, LIMITS.max_mass_kg, "kg")] | None = None
    drive: Literal["front", "rear", "all"] = "front"
    front_drive_share: Annotated[float, Field(ge=0, le=1)] | None = None
    rear_track_m: Annotated[Positive, _within(LIMITS.min_track_m, LIMITS.max_track_m, "m")] | None = None

    @model_validator(mode="after")
    def _check_body(self) -> Body:
        """Refuse a wheelbase that no car has, a mass that no car of it has, and a share of no all-wheel drive."""
        if self.front_drive_share is not None and self.drive != "all":
            raise PydanticCustomError("drive", 'front_drive_share goes with drive = "all"')
        wheelbase_m = self.wheelbase_m
        _refuse_beyond(
            wheelbase_m, LIMITS.min_wheelbase_m, LIMITS.max_wheelbase_m, "m", "cog_to_front_m + cog_to_rear_m, "
        )
        if self.mass_kg is not None:
            low, high = (k * wheelbase_m**3 for k in (LIMITS.min_mass_kgpm3, LIMITS.max_mass_kgpm3))
            _refuse_beyond(self.mass_kg, low, high, "kg", f"with a wheelbase of {wheelbase_m:g} m, mass_kg, ")
        return self

    @property
    def wheelbase_m(self) -> float:
        """Distance (m) between the front and the rear axle."""
        return self.cog_to_front_m + self.cog_to_rear_m


class Steering(Settings):
    """The table [steering]: the servo; time constant and rate are identified where absent."""

    max_angle_rad: Annotated[Positive, _within(LIMITS.min_steering_rad, LIMITS.max_steering_rad, "rad")]
    max_rate_radps: (
        Annotated[Positive, _within(LIMITS.min_steering_rate_radps, LIMITS.max_steering_rate_radps, "rad/s")] | None
    ) = None
    # RK4 at 0.05 s is unstable below 0.02 s
    time_constant_s: Annotated[float, Field(ge=0.02), _within(0.0, LIMITS.max_time_constant_s, "s")] | None = None


class Motor(Settings):
    """The table [motor]: the motor controller (errata 13); law "force" is F_m = K (u - u_0) - K_v v_w.

    Under the law "measured-speed" the throttle is no command: it is the driven wheel's measured speed (m/s), which has
    a sign, and which the car follows, F_m = K (u - v_w).  Where the motor `reverses`, a throttle below zero is a speed
    or a force backward; braking is a channel of its own.
    """

    law: Literal["speed", "force", "measured-speed"] = "speed"
    reference_speed_mps: (
        Annotated[Positive, _within(LIMITS.min_reference_speed_mps, LIMITS.max_reference_speed_mps, "m/s")] | None
    ) = None
    reverses: bool = False

    @model_validator(mode="before")
    @classmethod
    def _let_measured_speeds_reverse(cls, data: Any) -> Any:
        """A measured speed below zero is one backward, unless the file says otherwise."""
        measured = isinstance(data, dict) and data.get("law") == "measured-speed"
        return {"reverses": True, **data} if measured else data


class Mocap(Settings):
    """The table [mocap]: how the tracked body sits on the car, and how positions are written in any format."""

    rigid_body: Name | None = None
    # Motive's world is Y-up unless exported otherwise; positions of other formats are Z-up where they move so
    up_axis: Literal["Y", "Z"] = "Y"
    yaw_offset_rad: Annotated[float, _within(0.0, LIMITS.max_yaw_offset_rad, "rad")] | None = None
    marker_offset_m: Annotated[tuple[float, float], Field(strict=False)] | None = None
    # of positions whose file states none, and that no gain turns into m
    length_unit: Literal["m", "cm", "mm"] | None = None
    # a jump beyond it is a tracking failure
    max_speed_mps: Annotated[Positive, _within(0.0, LIMITS.max_speed_mps, "m/s")] | None = None

    @property
    def metres_per_unit(self) -> float:
        """The size (m) of the unit in which positions are written; 1 where none is stated."""
        return {"m": 1.0, "cm": 1e-2, "mm": 1e-3}[self.length_unit or "m"]


class CommandTopics(Settings):
    """The topics of a command whose steering and throttle are messages of their own."""

    steering: Name
    throttle: Name


class Topics(Settings):
    """The table [topics] of MCAP topics; fields are given only for messages of no known type."""

    pose: Name
    command: Name | CommandTopics
    time: Literal["auto", "header", "log"] = "auto"
    child_frame: Name | None = None  # which body of a TFMessage or RigidBodies
    world_frame: Name | None = None  # the frame of a TFMessage in which the body is wanted; else the tree's root
    pose_fields: PoseFields | None = None
    command_fields: CommandFields | None = None


class Command(Settings):
    """The table [command]: how long a command value holds when no new row comes."""

    max_hold_s: Annotated[Positive, _within(0.0, LIMITS.max_hold_s, "s")] = 0.5


class Clock(Settings):
    """The table [clock]: the corrections of the command clock against the pose clock; none unless stated.

    `commands_read_every_s` (s) says that the recorder reads the commands at its own rate, so that each is logged late:
    by an age that is found from how the car turns and taken off (`bcid.recording.checks.command_age`).
    """

    offset_s: float = 0.0
    commands_read_every_s: float | None = Field(default=None, ge=0.03, le=0.5)


class Vehicle(Settings):
    """All of a vehicle file."""

    name: str
    body: Body
    steering: Steering
    motor: Motor = Motor()
    mocap: Mocap = Mocap()
    topics: Topics | None = None
    columns: Columns | None = None
    commands: CommandColumns = CommandColumns()
    command: Command = Command()
    clock: Clock = Clock()

    @field_validator("mocap")
    @classmethod
    def _check_marker(cls, mocap: Mocap, info: ValidationInfo) -> Mocap:
        """Refuse a tracked point that lies several wheelbases from the CoG."""
        body = info.data.get("body")
        if body is not None and mocap.marker_offset_m is not None:
            high = LIMITS.max_marker_wheelbases * body.wheelbase_m
            _refuse_beyond(math.hypot(*mocap.marker_offset_m), 0.0, high, "m", "marker_offset_m, a distance of ")
        return mocap

    @model_validator(mode="after")
    def _check_reading(self) -> Vehicle:
        """Refuse an age of commands where the throttle is none: a measured speed is as old as its encoder makes it."""
        if self.clock.commands_read_every_s and self.motor.law == "measured-speed":
            raise PydanticCustomError(
                "reading", "commands_read_every_s is of commands, and the throttle is a measured speed"
            )
        return self

    @property
    def front_share(self) -> float:
        """Share of motor force and drag at the front axle, in [0, 1]: a half of all-wheel drive unless it is stated."""
        if self.body.drive == "all":
            return 0.5 if self.body.front_drive_share is None else self.body.front_drive_share
        return 1.0 if self.body.drive == "front" else 0.0

    @property
    def has_raw_steering(self) -> bool:
        """Whether steering commands come in raw units, which a gain or calibration points turn into rad."""
        mapped = (self.columns, self.commands, self.topics.command_fields if self.topics else None)
        angles = [m.steering_rad for m in mapped if m and m.steering_rad is not None]
        gains = {abs(g) for a in angles for g in (a.gain, a.gain_negative) if g is not None}
        return bool(gains - {1.0}) or any(a.points for a in angles)

    @property
    def mass_kg(self) -> float:
        """The vehicle's mass; 1 kg where the file has none, so that forces read as accelerations."""
        return self.body.mass_kg or 1.0


def read_vehicle(path: Path) -> Vehicle:
    """The checked settings in the vehicle file (TOML) at `path`; raises `InputRefused` that names all wrong entries."""
    return read_toml(path, Vehicle, "vehicle file")
