"""Vehicle files with values that no car has are refused by name, with the unit that is likely meant."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bcid.errors import InputRefused
from bcid.vehicle import Vehicle, read_vehicle

BUMPER_CAR: dict[str, dict[str, Any]] = {
    "body": {"mass_kg": 319.6, "cog_to_front_m": 0.54, "cog_to_rear_m": 0.33, "rear_track_m": 0.6},
    "steering": {"max_angle_rad": 2.012, "max_rate_radps": 1.418, "time_constant_s": 0.155},
    "motor": {"reference_speed_mps": 2.033},
    "mocap": {"yaw_offset_rad": 1.57, "marker_offset_m": [0.12, 0.0]},
    "command": {"max_hold_s": 0.5},
}

WRONG: dict[str, tuple[str, str, Any, str]] = {
    "angle in degrees": ("steering", "max_angle_rad", 115.3, "2.012 if that is in degrees"),
    "rate in degrees": ("steering", "max_rate_radps", 81.2, "1.417 if that is in degrees per second"),
    "time constant in ms": ("steering", "time_constant_s", 155, "0.155 if that is in ms"),
    "mass in g": ("body", "mass_kg", 319600, "319.6 if that is in g"),
    "mass in t": ("body", "mass_kg", 0.3196, "319.6 if that is in t"),
    "lengths in cm": ("body", "cog_to_front_m", 54, "0.5433 if that is in cm"),
    "track in mm": ("body", "rear_track_m", 600, "0.6 if that is in mm"),
    "hold in ms": ("command", "max_hold_s", 500, "0.5 if that is in ms"),
    "yaw offset in degrees": ("mocap", "yaw_offset_rad", 90, "1.571 if that is in degrees"),
    "marker in mm": ("mocap", "marker_offset_m", [120, 0], "0.12 if that is in mm"),
    "speed in mm/s": ("motor", "reference_speed_mps", 2033, "2.033 if that is in mm/s"),
}


def written(folder: Path, table: str, key: str, value: Any) -> Path:
    """The vehicle file with another value."""
    tables = {**BUMPER_CAR, table: {**BUMPER_CAR[table], key: value}}
    lines = ['name = "car"']
    for name, entries in tables.items():
        lines += [f"[{name}]", *(f"{k} = {v}" for k, v in entries.items())]
    (folder / "car.toml").write_text("\n".join(lines))
    return folder / "car.toml"


@pytest.mark.parametrize("name", list(WRONG))
def test_a_value_that_no_car_has_is_refused_with_the_likely_unit(name: str, tmp_path: Path) -> None:
    table, key, value, meant = WRONG[name]
    with pytest.raises(InputRefused) as error:
        read_vehicle(written(tmp_path, table, key, value))
    assert meant.split(" if ")[1] in error.value.cause
    assert meant.split(" if ")[0][:4] in error.value.cause
    assert table in error.value.place
    assert "Value error" not in error.value.cause


CARS = {
    "1:43": {"mass_kg": 0.08, "cog_to_front_m": 0.03, "cog_to_rear_m": 0.03, "rear_track_m": 0.03},
    "1:10": {"mass_kg": 1.7, "cog_to_front_m": 0.08, "cog_to_rear_m": 0.09, "rear_track_m": 0.15},
    "F1TENTH": {"mass_kg": 3.5, "cog_to_front_m": 0.16, "cog_to_rear_m": 0.17, "rear_track_m": 0.25},
    "a heavy robot": {"mass_kg": 40.0, "cog_to_front_m": 0.12, "cog_to_rear_m": 0.12, "rear_track_m": 0.5},
    "a kart": {"mass_kg": 160.0, "cog_to_front_m": 0.6, "cog_to_rear_m": 0.45, "rear_track_m": 1.1},
    "a car": {"mass_kg": 1500.0, "cog_to_front_m": 1.2, "cog_to_rear_m": 1.5, "rear_track_m": 1.55},
    "a truck": {"mass_kg": 40e3, "cog_to_front_m": 3.0, "cog_to_rear_m": 3.0, "rear_track_m": 2.1},
    "a mining truck": {"mass_kg": 600e3, "cog_to_front_m": 4.0, "cog_to_rear_m": 3.2, "rear_track_m": 5.1},
}


@pytest.mark.parametrize("name", list(CARS))
def test_cars_from_a_toy_to_a_truck_are_allowed(name: str) -> None:
    vehicle = Vehicle.model_validate({"name": "car", "body": CARS[name], "steering": {"max_angle_rad": 0.5}})
    assert vehicle.body.model_dump(exclude_unset=True) == CARS[name]


@pytest.mark.parametrize(
    ("table", "entries"),
    [
        ("topics", {"pose": "", "command": "/c"}),
        ("topics", {"pose": "/p", "command": {"steering": "/a", "throttle": " "}}),
        ("mocap", {"rigid_body": ""}),
        ("columns", {"time_s": "t", "x_m": "x", "y_m": "y", "yaw_rad": "", "steering_rad": "s", "throttle_mps": "u"}),
        ("columns", {"time_s": "t", "x_m": "x", "y_m": "y", "yaw_rad": "w", "steering_rad": "s"}),
        ("columns", {"time_s": "t", "x_m": "x", "y_m": "y", "steering_rad": "s", "throttle_mps": "u"}),
        ("columns", {"time_s": "t", "x_m": "x", "y_m": "y", "yaw_rad": "w", "qx": "q"}),
        ("columns", {"time_s": {"sec": "t"}, "x_m": "x", "y_m": "y", "yaw_rad": "w"}),
        ("commands", {"time_s": {"gain": 0.001}}),
    ],
)
def test_names_that_are_blank_and_half_mappings_are_refused(table: str, entries: dict[str, Any]) -> None:
    car = {"name": "car", "body": CARS["1:10"], "steering": {"max_angle_rad": 0.5}}
    with pytest.raises(ValueError, match=table):
        Vehicle.model_validate({**car, table: entries})


def test_a_motor_may_reverse() -> None:
    car = {"name": "car", "body": CARS["1:10"], "steering": {"max_angle_rad": 0.5}}
    assert not Vehicle.model_validate(car).motor.reverses
    assert Vehicle.model_validate({**car, "motor": {"reverses": True}}).motor.reverses


@pytest.mark.parametrize(
    ("drive", "stated", "share"),
    [("front", None, 1.0), ("rear", None, 0.0), ("all", None, 0.5), ("all", 0.3, 0.3)],
)
def test_half_of_an_all_wheel_drive_s_force_is_at_the_front_unless_it_is_stated(
    drive: str, stated: float | None, share: float
) -> None:
    body = {"cog_to_front_m": 0.16, "cog_to_rear_m": 0.15, "drive": drive, "front_drive_share": stated}
    car = Vehicle.model_validate({"name": "car", "body": body, "steering": {"max_angle_rad": 0.4}})
    assert car.front_share == share


def test_a_share_of_no_all_wheel_drive_is_refused(tmp_path: Path) -> None:
    path = written(tmp_path, "body", "front_drive_share", 0.3)
    with pytest.raises(InputRefused, match='front_drive_share goes with drive = "all"'):
        read_vehicle(path)
