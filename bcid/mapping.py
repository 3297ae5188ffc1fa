"""How logged fields and columns are turned into SI units: the part of a vehicle file that readers use."""

from __future__ import annotations

from datetime import datetime, time
from itertools import pairwise
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator

from bcid.files.toml import Settings

Name = Annotated[str, Field(min_length=1, pattern=r"\S")]
"""The name of a field, column, topic or body: it is never blank."""


class Condition(Settings):
    """Selects rows in which a logged field equals a value."""

    field: Name
    equals: float


CalibrationPoint = Annotated[tuple[float, float], Field(strict=False)]


class FieldMapping(Settings):
    """How a logged field is turned into SI: gain * dead_zone(raw) + offset, within [low, high].

    `gain_negative` is the gain for raw values below the dead zone where it differs.  A calibrated servo has `points`
    instead, of raw value and angle: straight lines between them, the ends beyond.
    """

    source: Annotated[Name, Field(alias="from")]
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


def _map_bare_name(raw: Any) -> Any:
    """The mapping {"from": raw} where a bare name stands; anything else as it is."""
    return {"from": raw} if isinstance(raw, str) else raw


# a bare field name stands for the mapping of gain 1
LoggedField = Annotated[FieldMapping, BeforeValidator(_map_bare_name)]

OPTIONAL_CHANNELS = ("measured_steering_rad", "wheel_speed_mps", "yaw_rate_radps", "brake_share")
"""Quantities that may be logged beside pose and command."""


class PoseMapping(Settings):
    """Where the position and the orientation, a yaw or a quaternion, of a pose are in a table's row or a message.

    With `z_m`, positions are points in space, whose vertical is `mocap.up_axis`; without, they lie on the floor.
    """

    x_m: LoggedField
    y_m: LoggedField
    z_m: LoggedField | None = None
    yaw_rad: LoggedField | None = None
    qx: LoggedField | None = None
    qy: LoggedField | None = None
    qz: LoggedField | None = None
    qw: LoggedField | None = None

    @model_validator(mode="after")
    def _check_orientation(self) -> PoseMapping:
        """Refuse a mapping without an orientation, with a part of a quaternion, or with both kinds."""
        parts = [part for part in ("qx", "qy", "qz", "qw") if getattr(self, part) is not None]
        if len(parts) not in (0, 4):
            raise ValueError(f"a quaternion has qx, qy, qz and qw; there is {', '.join(parts)} only")
        if (self.yaw_rad is not None) == bool(parts):
            raise ValueError("an orientation is either yaw_rad or qx, qy, qz and qw")
        return self

    @property
    def position_fields(self) -> list[FieldMapping]:
        """The fields of x, y and, where it is mapped, z."""
        return [f for f in (self.x_m, self.y_m, self.z_m) if f is not None]

    @property
    def orientation_fields(self) -> list[FieldMapping]:
        """The field of the yaw, or the four of the quaternion x, y, z, w."""
        return [f for f in (self.yaw_rad, self.qx, self.qy, self.qz, self.qw) if f is not None]

    @property
    def fields(self) -> list[FieldMapping]:
        """All mapped fields: position, then orientation."""
        return [*self.position_fields, *self.orientation_fields]


class ChannelMapping(Settings):
    """Where further channels are in a table's row or a message."""

    measured_steering_rad: LoggedField | None = None
    wheel_speed_mps: LoggedField | None = None
    yaw_rate_radps: LoggedField | None = None
    # braking of a car that reverses, from 0 to 1
    brake_share: LoggedField | None = None

    @property
    def channels(self) -> dict[str, FieldMapping]:
        """The fields of the optional channels that are mapped, by the channels' names."""
        fields = {name: getattr(self, name) for name in OPTIONAL_CHANNELS}
        return {name: field for name, field in fields.items() if field is not None}


class CommandMapping(ChannelMapping):
    """Where a command and further channels are in a table's row or a message."""

    steering_rad: LoggedField
    throttle_mps: LoggedField


class PoseFields(PoseMapping):
    """Where a pose and its stamp are in a message."""

    time_s: Name | None = None


class CommandFields(CommandMapping):
    """Where a command and its stamp are in a message."""

    time_s: Name | None = None


class StampMapping(Settings):
    """Where a row's stamp is: a column `from`, as gain * raw + offset in s, or columns of seconds and nanoseconds.

    Columns of dates, clock times and time spans need no gain.
    """

    source: Annotated[Name | None, Field(alias="from")] = None
    sec: Name | None = None
    nanosec: Name | None = None
    gain: Annotated[float, Field(gt=0)] = 1.0
    offset: float = 0.0

    @model_validator(mode="after")
    def _check_columns(self) -> StampMapping:
        """Refuse a mapping that names neither one column nor both of a pair."""
        if (self.source is None) != (self.sec is not None) or (self.sec is None) != (self.nanosec is None):
            raise ValueError("a stamp is either one column (from) or two (sec and nanosec)")
        return self

    @property
    def columns(self) -> list[str]:
        """The names of the columns that the stamp is in."""
        return [name for name in (self.source, self.sec, self.nanosec) if name is not None]


def _write_moment(raw: Any) -> Any:
    """A date or a clock time that TOML has read as one, as text again; anything else as it is."""
    return raw.isoformat() if isinstance(raw, datetime | time) else raw


StampColumn = Annotated[StampMapping, BeforeValidator(_map_bare_name)]
CommentSign = Annotated[str, Field(min_length=1, max_length=1)]


class Columns(PoseMapping, ChannelMapping):
    """The table [columns] of a CSV or Parquet log: its poses, and its commands unless a file holds them."""

    time_s: StampColumn
    steering_rad: LoggedField | None = None
    throttle_mps: LoggedField | None = None
    comment: CommentSign | None = None

    @model_validator(mode="after")
    def _check_commands(self) -> Columns:
        """Refuse a mapping of one half of a command."""
        if (self.steering_rad is None) != (self.throttle_mps is None):
            raise ValueError("map both steering_rad and throttle_mps, or neither where a commands file holds them")
        return self

    @property
    def command_fields(self) -> list[FieldMapping]:
        """The fields of steering and throttle; none where a commands file holds them."""
        return [f for f in (self.steering_rad, self.throttle_mps) if f is not None]


class CommandColumns(CommandMapping):
    """The table [commands]: columns and units of the commands file beside a Motive export or a table of poses.

    `time_zero` is what the stamps read at the take's time zero (Motive's frame 0, a table's first pose): a stamp as the
    file writes it, or "capture start", which is the export's own Capture Start Time.
    """

    time_s: StampColumn = StampMapping.model_validate({"from": "time_s"})
    steering_rad: LoggedField = FieldMapping.model_validate({"from": "steering_rad"})
    throttle_mps: LoggedField = FieldMapping.model_validate({"from": "throttle_mps"})
    time_zero: Annotated[Name | float | None, BeforeValidator(_write_moment)] = None
    comment: CommentSign | None = None
