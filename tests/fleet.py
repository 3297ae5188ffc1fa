"""Clean drives of five vehicles: what the checks of commands, clock and servo are measured on.

`python tests/measure_checks.py` measures them on fresh seeds and writes docs/results/checks.json.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.recording.formats.raw import RawTake
from bcid.recording.types import SourceFile
from bcid.simulation.car import REAL_EXTRAS, Plant
from bcid.simulation.open_loop import simulate_open_loop
from bcid.vehicle import Motor, Vehicle


@dataclass(frozen=True)
class Kind:
    """A kind of vehicle: its plant, what its vehicle file says, and how it is driven and measured."""

    name: str
    plant: Plant
    file: dict[str, Any]
    throttle: tuple[float, float]  # from slow to fast
    steer_rad: float  # usual largest command
    brake: float  # share or reverse throttle that it may get, 0 for none
    rates_hz: tuple[float, ...]  # of poses
    noise: tuple[float, float]  # largest, m and rad

    def vehicle(self, minimal: bool = False, **changes: Any) -> Vehicle:
        """The vehicle file as read; `minimal` leaves out what is not needed, as a file of four lines does."""
        file = {table: dict(entries) if isinstance(entries, dict) else entries for table, entries in self.file.items()}
        if minimal:
            file["steering"] = {"max_angle_rad": file["steering"]["max_angle_rad"]}
            file["body"] = {k: v for k, v in file["body"].items() if k in ("cog_to_front_m", "cog_to_rear_m", "drive")}
        for table, entries in changes.items():
            file[table] = {**file.get(table, {}), **entries}
        return Vehicle.model_validate(file)


def small_car(m: float, l_f: float, l_r: float, inertia: float, **constants: float) -> Plant:
    """A plant of a small car: stiff tyres of usual grip, drag in proportion to its mass."""
    usual = {
        "mass": m, "front_lever": l_f, "rear_lever": l_r, "inertia": inertia, "front_stiffness": 28.0 * m,
        "rear_stiffness": 34.0 * m, "front_grip": 4.0 * m, "rear_grip": 4.3 * m, "rolling_drag": 0.35 * m,
        "rolling_drag_2": 0.05 * m, "slip_speed": 0.3, "brake_gain": 2.0 * m, "motor_limit": 6.0 * m,
        "rear_bearing": 0.2 * m, "softness": 0.5, "rough_force": 0.05 * m, "rough_moment": 0.05 * inertia,
    }  # fmt: skip
    return Plant(**{**usual, **constants})


def kinds() -> dict[str, Kind]:
    """The five vehicles, some with several drive trains."""
    bumper = Kind(
        "bumper", Plant(**REAL_EXTRAS),
        {"name": "bumper", "body": {"mass_kg": 319.6, "cog_to_front_m": 0.54, "cog_to_rear_m": 0.33, "drive": "front"},
         "steering": {"max_angle_rad": 2.012, "max_rate_radps": 1.418, "time_constant_s": 0.155},
         "motor": {"reference_speed_mps": 2.033}},
        (0.9, 2.033), 1.6, -0.5, (60.0, 120.0), (1e-3, 2e-3),
    )  # fmt: skip
    rc = Kind(
        "rc", small_car(2.5, 0.16, 0.15, 0.055, servo_time=0.06, servo_rate=6.0, angle_limit=0.45, rear_drive=1.0,
                        top_speed=3.0, motor_gain=5.0),
        {"name": "rc", "body": {"mass_kg": 2.5, "cog_to_front_m": 0.16, "cog_to_rear_m": 0.15, "drive": "rear"},
         "steering": {"max_angle_rad": 0.45, "max_rate_radps": 6.0, "time_constant_s": 0.06}},
        (1.0, 3.0), 0.42, -0.3, (100.0, 120.0, 240.0), (1e-3, 3e-3),
    )  # fmt: skip
    dart = Kind(
        "dart", small_car(1.58, 0.0805, 0.093, 0.0048, servo_time=0.05, servo_rate=20.0, angle_limit=0.42,
                          rear_drive=0.5, throttle_force=12.0, motor_fade=3.0, motor_dead_zone=0.164,
                          steering_side_gain=0.12, rolling_drag=0.5),
        {"name": "dart", "body": {"mass_kg": 1.58, "cog_to_front_m": 0.0805, "cog_to_rear_m": 0.093, "drive": "all",
                                  "front_drive_share": 0.5},
         "steering": {"max_angle_rad": 0.42, "time_constant_s": 0.05, "max_rate_radps": 20.0},
         "motor": {"law": "force"}},
        (0.25, 0.55), 0.33, 0.0, (100.0,), (1e-3, 3e-3),
    )  # fmt: skip
    f1tenth = Kind(
        "f1tenth", small_car(4.0, 0.162, 0.145, 0.1, servo_time=0.1, servo_rate=3.2, angle_limit=0.42, rear_drive=0.5,
                             top_speed=6.0, motor_gain=12.0, motor_limit=30.0),
        {"name": "f1tenth", "body": {"mass_kg": 4.0, "cog_to_front_m": 0.162, "cog_to_rear_m": 0.145, "drive": "all"},
         "steering": {"max_angle_rad": 0.42, "time_constant_s": 0.1, "max_rate_radps": 3.2}},
        (1.2, 3.2), 0.27, -0.4, (25.0, 40.0), (1e-2, 8e-3),
    )  # fmt: skip
    tricycle = Kind(
        "tricycle", small_car(180.0, 0.9, 0.6, 75.0, servo_time=0.3, servo_rate=1.0, angle_limit=1.2, slip_speed=0.6,
                              top_speed=2.5, motor_gain=150.0, motor_limit=400.0, rear_track=0.8),
        {"name": "tricycle", "body": {"mass_kg": 180.0, "cog_to_front_m": 0.9, "cog_to_rear_m": 0.6, "drive": "front"},
         "steering": {"max_angle_rad": 1.2, "time_constant_s": 0.3, "max_rate_radps": 1.0},
         "motor": {"reference_speed_mps": 2.5}},
        (0.8, 2.5), 0.9, -0.3, (50.0, 100.0), (3e-3, 4e-3),
    )  # fmt: skip
    return {k.name: k for k in (bumper, rc, dart, f1tenth, tricycle)}


KINDS = kinds()


def turned_around(kind: Kind) -> Kind:
    """That vehicle with an electronic speed control that reverses instead of braking."""
    said = {"reverses": True} if "reverses" in Motor.model_fields else {}
    file = {**kind.file, "motor": {**kind.file.get("motor", {}), **said}}
    return replace(kind, plant=kind.plant._replace(reverses=1.0), file=file, brake=-0.6 * kind.throttle[1])


def targets(rng: np.random.Generator, t: Floats, kind: Kind) -> Floats:
    """Commands (M, 2) of a driver who takes a new target at random every one or two seconds."""
    out, left, steer, throttle = np.zeros((len(t), 2)), 0.0, 0.0, kind.throttle[0]
    for k in range(len(t)):
        if left <= 0.0:
            steer = float(np.clip(0.55 * kind.steer_rad * rng.standard_normal(), -kind.steer_rad, kind.steer_rad))
            throttle = rng.uniform(*kind.throttle)
            left = rng.uniform(0.5, 2.5)
            if kind.brake and rng.random() < 0.15:
                throttle, left = kind.brake * rng.uniform(0.4, 1.0), rng.uniform(0.4, 1.0)
        out[k] = steer, throttle
        left -= t[1] - t[0]
    return out


def waves(rng: np.random.Generator, t: Floats, kind: Kind) -> Floats:
    """Commands (M, 2) of a slalom: sines of several periods, the throttle rising and falling slowly."""
    steer = sum(np.sin(2 * np.pi * t / rng.uniform(1.5, 9.0) + rng.uniform(0, 6)) for _ in range(3))
    low, high = kind.throttle
    throttle = low + (high - low) * (0.5 + 0.5 * np.sin(2 * np.pi * t / rng.uniform(6, 14) + rng.uniform(0, 6)))
    return np.column_stack([kind.steer_rad * steer / 3.0 * 1.2, throttle])


def wanders(rng: np.random.Generator, t: Floats, kind: Kind) -> Floats:
    """Commands (M, 2) of a hand on a stick: smooth noise in steering and throttle."""
    keep = np.exp(-(t[1] - t[0]) / np.array([0.7, 1.5]))
    x, out = np.zeros(2), np.zeros((len(t), 2))
    for k in range(len(t)):
        x = keep * x + np.sqrt(1 - keep**2) * rng.standard_normal(2)
        out[k] = x
    low, high = kind.throttle
    throttle = np.clip(0.5 * (low + high) + 0.35 * (high - low) * out[:, 1], low, high)
    return np.column_stack([np.clip(0.45 * kind.steer_rad * out[:, 0], -kind.steer_rad, kind.steer_rad), throttle])


def laps(rng: np.random.Generator, t: Floats, kind: Kind) -> Floats:
    """Commands (M, 2) of a lap driven again and again: straight, corner, and throttle lifted in the corner."""
    period = rng.uniform(6.0, 11.0)
    phase = (t + rng.uniform(0, period)) % period / period
    corner = ((phase > 0.3) & (phase < 0.5)) | ((phase > 0.8) & (phase < 0.95))
    wobble = 0.08 * np.sin(2 * np.pi * t / 1.7) + 0.03 * rng.standard_normal(len(t))
    low, high = kind.throttle
    throttle = np.where(corner, 0.7 * low + 0.3 * high, 0.15 * low + 0.85 * high)
    side = np.where(phase < 0.6, 1.0, -0.6)
    return np.column_stack([kind.steer_rad * (0.6 * corner * side + wobble), throttle])


def keeps_speed(rng: np.random.Generator, t: Floats, kind: Kind) -> Floats:
    """Commands (M, 2) at one throttle: only the steering changes."""
    out = targets(rng, t, kind)
    out[:, 1] = 0.4 * kind.throttle[0] + 0.6 * kind.throttle[1]
    return out


Driver = Callable[[np.random.Generator, Floats, Kind], Floats]
DRIVERS: dict[str, Driver] = {f.__name__: f for f in (targets, waves, wanders, laps, keeps_speed)}


@dataclass(frozen=True)
class Drive:
    """A clean drive as recorded."""

    label: str
    kind: Kind
    raw: RawTake


def draw_drive(
    seed: int, kind: str | Kind | None = None, driver: str | None = None, seconds: float | None = None,
    pose_hz: float | None = None,
) -> Drive:  # fmt: skip
    """A clean drive with everything that is not given drawn from `seed`: vehicle, driver, rates, phase and noise."""
    rng = np.random.default_rng([seed, 39])
    names = list(KINDS)
    drawn, who = names[seed % len(names)], list(DRIVERS)[(seed // len(names)) % len(DRIVERS)]
    chosen = kind if isinstance(kind, Kind) else KINDS[kind or drawn]
    if kind is None and drawn in ("rc", "f1tenth") and rng.random() < 0.3:
        chosen = turned_around(chosen)
    seconds = seconds or float(rng.uniform(45.0, 180.0))
    rate = float(pose_hz or rng.choice(chosen.rates_hz))
    command_hz = float(rng.choice([10.0, 20.0, 25.0, 50.0]))
    command_s = rng.uniform(0.0, 1.0 / command_hz) - 1.0 / command_hz + np.arange(seconds * command_hz + 2) / command_hz
    command = DRIVERS[driver or who](rng, command_s, chosen)
    limit = chosen.plant.angle_limit
    command[:, 0] = np.clip(command[:, 0], -limit, limit)
    pose_s = np.arange(int(seconds * rate)) / rate
    noise = (chosen.noise[0] * rng.uniform(0.2, 1.0), chosen.noise[1] * rng.uniform(0.2, 1.0))
    run = simulate_open_loop(chosen.plant, command_s, command, pose_s, noise, seed)
    pose = np.column_stack([run.pose[:, :2], run.pose[:, 2]])
    for start in rng.uniform(0.5, seconds, rng.poisson(seconds / 60.0)):
        pose[(pose_s >= start) & (pose_s < start + rng.uniform(0.02, 0.2))] = np.nan
    label = f"{chosen.name}/{driver or who}/{seed}"
    source = SourceFile(f"{chosen.name}_{seed}.csv", "0" * 64, "table")
    raw = RawTake(f"{chosen.name}_{seed}", (source,), pose_s, pose, command_s, command, rate)
    return Drive(label, chosen, raw)


def shifted(raw: RawTake, late_s: float) -> RawTake:
    """The take with commands stamped `late_s` seconds too late."""
    return replace(raw, command_time_s=raw.command_time_s + late_s)


def with_commands(raw: RawTake, change: Callable[[Floats, Floats], npt.ArrayLike]) -> RawTake:
    """The take with commands (M, 2) that `change` makes of their times (M,) and the true ones."""
    return replace(raw, command=np.asarray(change(raw.command_time_s, raw.command.copy()), dtype=float))
