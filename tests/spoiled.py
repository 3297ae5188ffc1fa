"""Ways in which a clean drive is made unusable, and the cause that ought to be named first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from fleet import Drive, draw_drive, shifted, with_commands

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.recording.assemble import assemble_recording
from bcid.recording.formats.raw import RawTake


@dataclass(frozen=True)
class Spoiled:
    """One way: what it makes of a take, what of the vehicle file, and a pattern of the cause."""

    make: Callable[[Drive, np.random.Generator], RawTake]
    cause: str
    vehicle: Callable[[Drive], dict[str, Any]] = lambda drive: {}
    kinds: tuple[str, ...] = ()  # of vehicles; empty for all


def commands(change: Callable[[Floats, Floats], Any]) -> Callable[[Drive, np.random.Generator], RawTake]:
    """A way that changes the commands (M, 2) at their times (M,)."""
    return lambda drive, rng: with_commands(drive.raw, change)


def poses(change: Callable[[Floats, np.random.Generator], Floats]) -> Callable[[Drive, np.random.Generator], RawTake]:
    """A way that changes the poses (N, 3)."""
    return lambda drive, rng: replace(drive.raw, pose=change(drive.raw.pose.copy(), rng))


def another_take(drive: Drive, rng: np.random.Generator) -> RawTake:
    """The take with the commands of another drive of the same car."""
    other = draw_drive(int(rng.integers(10**6)), drive.kind, drive.label.split("/")[1], 200.0).raw
    return replace(drive.raw, command_time_s=other.command_time_s, command=other.command)


def half(t: Floats, first: Floats, second: Floats, share: float = 0.5) -> Floats:
    """The `first` values (M, ...) up to a share of the take of times (M,), the `second` from there on."""
    early = t < t[0] + share * (t[-1] - t[0])
    return np.where(early.reshape(-1, *[1] * (first.ndim - 1)), first, second)


def drifted(t: Floats, by_the_end_s: float) -> Floats:
    """The times t (M,) in s of a clock that has gained `by_the_end_s` (s) when the take ends."""
    return t + by_the_end_s * (t - t[0]) / (t[-1] - t[0])


def throttle_of_another(drive: Drive, rng: np.random.Generator) -> RawTake:
    """The take with its own steering and the throttle of another drive of the same car."""
    other = another_take(drive, rng)
    rows = np.searchsorted(other.command_time_s, drive.raw.command_time_s, side="right") - 1
    return with_commands(drive.raw, lambda t, u: np.column_stack([u[:, 0], other.command[np.maximum(rows, 0), 1]]))


def limit_in_degrees(drive: Drive) -> dict[str, Any]:
    """The largest angle in degrees."""
    return {"steering": {"max_angle_rad": float(np.degrees(drive.kind.plant.angle_limit))}}


SPEED = ("bumper", "rc", "f1tenth", "tricycle")  # vehicles whose throttle is a reference speed
SPOILED = {
    "another take's commands": Spoiled(another_take, "another take"),
    "3 s early": Spoiled(lambda d, rng: shifted(d.raw, -3.0), r"(3\.\d|2\.9\d?)\d* (to .* )?s early"),
    "1 s late": Spoiled(lambda d, rng: shifted(d.raw, 1.0), "late"),
    "half a second late": Spoiled(lambda d, rng: shifted(d.raw, 0.5), "ms late"),
    "poses 1.5 s later from the middle on": Spoiled(
        lambda d, rng: replace(d.raw, pose_time_s=half(d.raw.pose_time_s, d.raw.pose_time_s, d.raw.pose_time_s + 1.5)),
        r"1\.[456] s earlier",
    ),
    "commands 0.5 s later from the middle on": Spoiled(
        lambda d, rng: replace(
            d.raw,
            command_time_s=half(d.raw.command_time_s, d.raw.command_time_s, d.raw.command_time_s + 0.5),
        ),
        r"0\.[456] s later",
    ),
    "the commands' clock gains a second": Spoiled(
        lambda d, rng: replace(d.raw, command_time_s=drifted(d.raw.command_time_s, 1.0)),
        r"drifts .*(0\.9|1\.[01]) s late",
    ),
    "the commands' clock loses half a second": Spoiled(
        lambda d, rng: replace(d.raw, command_time_s=drifted(d.raw.command_time_s, -0.5)), r"drifts .*0\.[456] s early"
    ),
    "steering zero": Spoiled(commands(lambda t, u: u * [0.0, 1.0]), "steering command stays at 0"),
    "steering stuck": Spoiled(commands(lambda t, u: u * [0.0, 1.0] + [0.1, 0.0]), "steering command stays at 0.1"),
    "steering frozen from the middle on": Spoiled(
        commands(lambda t, u: half(t, u, np.column_stack([0 * t + u[len(u) // 2, 0], u[:, 1]]))), "stands at"
    ),
    "steering zero in the last third": Spoiled(
        commands(lambda t, u: half(t, u, u * [0.0, 1.0], 0.67)), "steering command stands at 0"
    ),
    "steering inverted": Spoiled(commands(lambda t, u: u * [-1.0, 1.0]), "turns right where"),
    "steering's sign changes": Spoiled(commands(lambda t, u: half(t, u, u * [-1.0, 1.0])), "sign changes"),
    "steering is noise": Spoiled(
        lambda d, rng: with_commands(
            d.raw, lambda t, u: np.column_stack([0.5 * d.kind.steer_rad * rng.standard_normal(len(u)), u[:, 1]])
        ),
        "another take's or another car's",
    ),
    "steering and throttle swapped": Spoiled(commands(lambda t, u: u[:, ::-1]), "swapped"),
    "throttle inverted": Spoiled(commands(lambda t, u: u * [1.0, -1.0]), "sign"),
    "throttle zero": Spoiled(commands(lambda t, u: u * [1.0, 0.0]), "throttle stays at 0"),
    "throttle of another take": Spoiled(throttle_of_another, "throttle explains"),
    "throttle as a duty": Spoiled(
        commands(lambda t, u: u / [1.0, u[:, 1].max()]), "duty", kinds=("bumper", "f1tenth", "tricycle")
    ),
    "throttle in percent": Spoiled(
        commands(lambda t, u: np.column_stack([u[:, 0], np.maximum(u[:, 1], 0) * 100 / u[:, 1].max()])),
        "percent",
        kinds=SPEED,
    ),
    "throttle in µs": Spoiled(
        commands(lambda t, u: np.column_stack([u[:, 0], 1500 + 400 * u[:, 1] / u[:, 1].max()])),
        "PWM|µs|percent",
        kinds=SPEED,
    ),
    "steering in µs": Spoiled(commands(lambda t, u: u * [400.0, 1.0] + [1500.0, 0.0]), "PWM|µs|degrees"),
    "steering in degrees": Spoiled(commands(lambda t, u: u * [np.degrees(1), 1.0]), "degrees"),
    "steering and limit in degrees": Spoiled(
        commands(lambda t, u: u * [np.degrees(1), 1.0]), "degrees", limit_in_degrees
    ),
    "yaw zero": Spoiled(poses(lambda p, rng: p * [1.0, 1.0, 0.0]), "yaw stays|orientation|yaw"),
    "poses of noise": Spoiled(
        poses(lambda p, rng: p + rng.standard_normal(p.shape) * [0.1, 0.1, 0.0]), "noise|scatter"
    ),
    "yaw clockwise": Spoiled(poses(lambda p, rng: p * [1.0, 1.0, -1.0]), "clockwise|turns right"),
    "an axis mirrored": Spoiled(poses(lambda p, rng: p * [1.0, -1.0, 1.0]), "mirrored"),
    "lengths in mm": Spoiled(poses(lambda p, rng: p * [1e3, 1e3, 1.0]), "mm"),
    "yaw in degrees": Spoiled(poses(lambda p, rng: p * [1.0, 1.0, np.degrees(1)]), "degrees"),
    "time constant in ms": Spoiled(
        lambda d, rng: d.raw,
        "time_constant",
        lambda d: {"steering": {"time_constant_s": 1e3 * d.kind.plant.servo_time}},
    ),
}


def name_first_cause(raw: RawTake, drive: Drive, minimal: bool = False, **changes: Any) -> str | None:
    """The first cause why a take cannot be used, in words; None where it can."""
    try:
        recording = assemble_recording(raw, drive.kind.vehicle(minimal, **changes))
    except InputRefused as refusal:
        return f"{refusal.problems[0].place}: {refusal.problems[0].cause}"
    except ValueError as error:
        return str(error)
    return next((i.detail for i in recording.irregularities if i.action == "no-go"), None)
