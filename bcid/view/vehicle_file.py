"""The vehicle file by which bcid reads a view back: the car as it was, and topics and units of the view itself."""

from typing import Any

import tomli_w

from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

POSE_TOPIC, COMMAND_TOPIC = "/bcid/measured/pose", "/bcid/command"


def view_vehicle(vehicle: Vehicle, recording: Recording) -> Vehicle:
    """The vehicle whose logs are a view's.

    Poses are the CoG's and commands in SI units there, so that nothing that the first file says of mounting, clocks,
    columns or units holds any more.
    """
    kept = vehicle.model_dump(mode="json", by_alias=True, exclude_none=True, include={"body", "steering", "motor"})
    speed = vehicle.mocap.max_speed_mps
    return Vehicle.model_validate({
        "name": vehicle.name, **kept, "mocap": {"up_axis": "Z", **({"max_speed_mps": speed} if speed else {})},
        "topics": {"pose": POSE_TOPIC, "command": COMMAND_TOPIC, "time": "header"},
        "command": {"max_hold_s": recording.hold_s},
    })  # fmt: skip


def vehicle_toml(vehicle: Vehicle) -> str:
    """A vehicle file's text, without what is not stated."""
    tables: dict[str, Any] = vehicle.model_dump(mode="json", by_alias=True, exclude_none=True, exclude_defaults=True)
    return tomli_w.dumps(tables)
