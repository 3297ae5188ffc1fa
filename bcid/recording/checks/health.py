"""A take's health: whether it is worth fitting, told while its car still stands in the arena."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from bcid.recording.checks.mounting import yaw_offset
from bcid.recording.checks.raw_motion import Course, course
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

STANDS = 0.1  # wheelbases a second, below which a car stands
LEAST_MOTION_S = 30.0  # twenty stretches of 1.5 s
LEAST_KNOWN = 0.8  # share of the take in which the pose is known
LEAST_ANGLE, LEAST_TURN_MPS2 = 0.1, 0.5  # that steering (rad) or lateral acceleration reaches
LEAST_SPREAD = 0.3  # of the speeds, as a share of the fastest
LEAST_BRAKING_S = 2.0
LARGE_OFFSET_S = 0.1


class Health(NamedTuple):
    """What a take is good for."""

    go: bool
    sentence: str
    against: tuple[str, ...]  # reasons not to fit it
    unknown: tuple[str, ...]  # what it will not show
    odd: tuple[str, ...]  # what to look at
    facts: dict[str, Any]

    def as_json(self) -> dict[str, Any]:
        """For machines."""
        return self._asdict()


def health(recording: Recording, vehicle: Vehicle) -> Health:
    """The take's health: go, or no-go with the reasons and what to do."""
    motion = course(recording, vehicle)
    wheelbase = vehicle.body.cog_to_front_m + vehicle.body.cog_to_rear_m
    moving = motion.good & (motion.v_f > STANDS * wheelbase)
    step_s = float(motion.time_s[1] - motion.time_s[0]) if len(motion.time_s) > 1 else 0.0
    known = _known_share(recording)
    facts: dict[str, Any] = {
        "duration_s": recording.duration_s,
        "moving_s": float(moving.sum() * step_s),
        "pose_known": known,
        "command_known": _commanded_share(recording),
        "top_speed_mps": float(np.quantile(motion.v_f[moving], 0.99)) if moving.any() else 0.0,
    }
    against = []
    if facts["moving_s"] < LEAST_MOTION_S:
        against.append(f"the car moves for {facts['moving_s']:.0f} s only, {LEAST_MOTION_S:.0f} s are the least")
    if known < LEAST_KNOWN:
        against.append(f"the pose is known in {known:.0%} of the take, {LEAST_KNOWN:.0%} are the least")
    if facts["command_known"] < LEAST_KNOWN:
        against.append(f"commands are known in {facts['command_known']:.0%} of the take")
    unknown = _unknown(recording, vehicle, motion, moving)
    if any(text.startswith("steering") for text in unknown):
        against.append("it shows straight driving only")
    odd = _odd(recording)
    offset = yaw_offset(recording, vehicle)
    facts["yaw_offset_rad"] = None if offset is None else offset._asdict()
    if against:
        sentence = f"no-go: {'; '.join(against)}; drive it again"
    else:
        shown = f"{facts['moving_s']:.0f} s of motion, the pose known in {known:.0%}"
        sentence = f"go: {shown}" + (f"; it will not show {', '.join(_named(unknown))}" if unknown else "")
    return Health(not against, sentence, tuple(against), tuple(unknown), tuple(odd), facts)


def _known_share(recording: Recording) -> float:
    """The share of the take's frames whose pose is there."""
    return min(1.0, len(recording.poses) / max(1.0, recording.duration_s * recording.rate_hz + 1.0))


def _commanded_share(recording: Recording) -> float:
    """The share of the poses at which a command holds."""
    t, c = recording.poses.time_s, recording.commands.time_s
    row = np.searchsorted(c, t, side="right") - 1
    holds = (row >= 0) & (t - c[np.maximum(row, 0)] <= recording.hold_s)
    return float(holds.mean())


def _unknown(recording: Recording, vehicle: Vehicle, motion: Course, moving: npt.NDArray[np.bool_]) -> list[str]:
    """What the drive does not excite: the constants that no fit can find in it."""
    rows = np.searchsorted(recording.commands.time_s, motion.time_s, side="right") - 1
    u_s, u_m = recording.commands.values[np.maximum(rows, 0)].T
    if not moving.any():
        return []
    found, v = [], motion.v_f[moving]
    gentle = np.quantile(np.abs(v * motion.yaw_rate[moving]), 0.95) < LEAST_TURN_MPS2
    if gentle and np.quantile(np.abs(u_s[moving]), 0.95) < LEAST_ANGLE:
        found.append("steering: cornering stiffness, grip and inertia (C_f, C_r, F_f_max, F_r_max, I_z)")
    if np.quantile(v, 0.95) - np.quantile(v, 0.05) < LEAST_SPREAD * np.quantile(v, 0.95):
        found.append("other speeds: motor and drag apart (K_t, R_1, R_2)")
    step_s = float(motion.time_s[1] - motion.time_s[0])
    if vehicle.motor.law == "speed" and (u_m[moving] < 0.0).sum() * step_s < LEAST_BRAKING_S:
        found.append("braking: the brake gain (K_b)")
    return found


def _named(unknown: list[str]) -> list[str]:
    return [text.partition(": ")[2] for text in unknown]


def _odd(recording: Recording) -> list[str]:
    """A clock far off, and what reading it has found."""
    told, (low, high) = list[str](), recording.clock.get("offset_ci95", (0.0, 0.0))
    if low > LARGE_OFFSET_S or high < -LARGE_OFFSET_S:
        told.append(f"poses and commands are {1e3 * low:.0f} to {1e3 * high:.0f} ms apart beyond the vehicle file's")
    return told + [f"{i.kind}, {i.action} {i.count} times at {i.where}: {i.detail}" for i in recording.irregularities]
