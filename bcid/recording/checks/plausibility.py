"""Values that no such car can have: units, signs and ranges judged by the motion itself."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused, Problems
from bcid.recording.checks.channels import check_channels
from bcid.recording.checks.raw_motion import commanded_angle, course
from bcid.recording.types import Irregularity, Recording, Stream
from bcid.vehicle import Vehicle

DEGREES_FACTOR = 3.0
WHEELBASE_FACTOR = 4.0
MIN_CORRELATION = 0.5
MOST = 0.5  # of the commands
THROTTLE_FACTOR = 3.0
SPEED_FACTOR = 1.2
SLOW_SHARE = 0.1  # of the take's top speed
MIN_YAW_RATE = 1e-3
MIN_TURN = 0.02  # of the top speed, that commanded turning comes to
GENTLE_MPS2 = 3.0  # lateral acceleration
MIN_HEADING, CLEAR_HEADING = 0.6, 0.8
MIN_SAMPLES = 100
MISREADINGS = {
    "an axis is mirrored (x)": (-1.0, 1.0, 1.0),
    "an axis is mirrored (y)": (1.0, -1.0, 1.0),
    "yaw is clockwise": (1.0, 1.0, -1.0),
}
"""Other ways in which the pose may have been written: factors of x, y, yaw."""


def check_plausible(recording: Recording, vehicle: Vehicle) -> Recording:
    """The recording, with what looked odd noted.

    Raises:
        InputRefused: inverted steering, lengths or yaw in other units, channels likewise.
    """
    problems, odd = Problems(), list[Irregularity]()
    with problems.gathered():
        odd += _check_turning(recording, vehicle)
        odd += _check_speed(recording, vehicle)
    with problems.gathered():
        odd += check_channels(recording, vehicle)
    problems.refuse(recording.sources[0].path)
    return replace(recording, irregularities=(*recording.irregularities, *odd))


def check_commands(commands: Floats, vehicle: Vehicle, source: str) -> list[Irregularity]:
    """What is odd about the commands (M, 2) of the file `source`.

    Raises:
        InputRefused: steering in degrees, a throttle in percent, brake shares below -1.
    """
    problems, odd = Problems(), list[Irregularity]()
    with problems.gathered():
        odd = _check_steering(commands[:, 0], vehicle.steering.max_angle_rad, source)
    with problems.gathered():
        _check_throttle(commands[:, 1], vehicle, source)
    problems.refuse(source)
    return odd


def _check_throttle(u_m: Floats, vehicle: Vehicle, source: str) -> None:
    if vehicle.motor.law != "speed":
        return
    top = vehicle.motor.reference_speed_mps
    if top is not None and u_m.max() > THROTTLE_FACTOR * top:
        raise InputRefused(
            source, "throttle_mps", f"reaches {u_m.max():.3g}, the largest reference speed is {top:g} m/s: percent?",
            "log the throttle in m/s, or map it with a gain",
        )  # fmt: skip
    if u_m.min() < -1.05:
        raise InputRefused(
            source, "throttle_mps", f"falls to {u_m.min():.3g}, where below 0 a brake share in [-1, 0] is meant",
            "log it so, or map a table's or MCAP's field with gain, offset and low",
        )  # fmt: skip


def _check_steering(u_s: Floats, limit: float, source: str) -> list[Irregularity]:
    high = float(np.quantile(np.abs(u_s), 0.95))
    if high > DEGREES_FACTOR * limit:
        raise InputRefused(
            source, "steering_rad", f"reaches {high:.3g} where the car's limit is {limit:.3g} rad: degrees?",
            "log the command in rad (a table or MCAP field can be mapped with gain = 0.017453)",
        )  # fmt: skip
    beyond = np.abs(u_s) > limit * (1 + 1e-9)
    if beyond.mean() > MOST:
        cause = f"{beyond.mean():.0%} of the commands are beyond the limit of {limit:g} rad: degrees?"
        raise InputRefused(source, "steering_rad", cause, "log the command in rad, or correct steering.max_angle_rad")
    if not beyond.any():
        return []
    text = f"commands beyond the limit of {limit:g} rad act as the limit"
    return [Irregularity("steering command", "warning", int(beyond.sum()), source, text)]


class _Turning(NamedTuple):
    correlation: float  # of yaw rate and commanded turning, about zero
    heading: float  # 1 where the front wheel heads where it is steered up to a constant, 0 where it does not
    wheelbase_m: float | None  # as the motion shows it


def _turning(recording: Recording, vehicle: Vehicle) -> _Turning | None:
    """Yaw rate * wheelbase is about speed * sin(delta); None where too little moves to tell."""
    motion = course(recording, vehicle)
    if len(motion.time_s) < 2:
        return None
    angle = commanded_angle(recording, vehicle, motion.time_s)
    # the CoG's speed: the front axle's holds yaw rate * l_f, whatever the unit of lengths
    v_x = motion.v_f * np.cos(motion.beta_f)
    speed = np.hypot(v_x, motion.v_f * np.sin(motion.beta_f) - vehicle.body.cog_to_front_m * motion.yaw_rate)
    use = motion.good & (speed > SLOW_SHARE * np.quantile(speed, 0.95))
    turn, yaw_rate = speed[use] * np.sin(angle[use]), motion.yaw_rate[use]
    size, rate = (float(np.sqrt(np.mean(x**2))) for x in (turn, yaw_rate)) if use.any() else (0.0, 0.0)
    if use.sum() < MIN_SAMPLES or size < MIN_TURN * np.max(speed) or rate < MIN_YAW_RATE:
        return None
    heading = abs(np.mean(np.exp(1j * (motion.beta_f - angle)[use])))
    correlation = float(turn @ yaw_rate) / (size * rate * len(turn))
    return _Turning(correlation, float(heading), _wheelbase(turn, yaw_rate, speed[use], vehicle))


def _wheelbase(turn: Floats, yaw_rate: Floats, speed: Floats, vehicle: Vehicle) -> float | None:
    """That with which turning is as strong as commanded (m), of all the motion or of the gentle part.

    Strength, not slope: a servo that is slower than the vehicle file says makes the slope what it likes.  A car that
    slips turns as if it were longer, and where it turns little for a while as if it were endless; of the two, the one
    nearer to what is stated.
    """
    stated = vehicle.body.cog_to_front_m + vehicle.body.cog_to_rear_m
    found = []
    for part in (np.ones(len(turn), dtype=bool), np.abs(speed * yaw_rate) < GENTLE_MPS2):
        size, rate = np.linalg.norm(turn[part]), np.linalg.norm(yaw_rate[part])
        if part.sum() > MIN_SAMPLES and size > 0.0 and rate > 0.0:
            found.append(float(size / rate))
    return min(found, key=lambda length: abs(np.log(length / stated)), default=None)


def _misread(recording: Recording, scale: tuple[float, float, float]) -> Recording:
    """The recording as if x, y and yaw had been written with other units or axes."""
    return replace(recording, poses=Stream(recording.poses.time_s, recording.poses.values * np.array(scale)))


def _check_turning(recording: Recording, vehicle: Vehicle) -> list[Irregularity]:
    """The slope shows units, the sign the steering's; what explains the motion only when misread is refused."""
    seen = _turning(recording, vehicle)
    if seen is None:
        return []
    source = recording.sources[0].path
    if seen.correlation < -MIN_CORRELATION:
        raise InputRefused(
            source, "steering", f"the car turns right where the command says left (correlation {seen.correlation:.2f})",
            "positive steering turns left: log or map the command with the other sign, or correct up_axis or the order "
            "of the quaternions (x, y, z, w)",
        )  # fmt: skip
    if seen.heading < MIN_HEADING:
        for name, scale in MISREADINGS.items():
            other = _turning(_misread(recording, scale), vehicle)
            if other is not None and other.heading > CLEAR_HEADING:
                raise InputRefused(
                    source, "pose", f"the car moves where it is steered only if {name} (agreement {seen.heading:.2f}, "
                    f"then {other.heading:.2f})", "correct up_axis, or the axes of the pose",
                )  # fmt: skip
    if seen.correlation < MIN_CORRELATION or seen.heading < MIN_HEADING:
        text = (
            f"the commands explain little of the motion (turning {seen.correlation:.2f}, heading {seen.heading:.2f}): "
            "check axes and units"
        )
        return [Irregularity("steering response", "warning", 1, source, text)]
    stated = vehicle.body.cog_to_front_m + vehicle.body.cog_to_rear_m
    if seen.wheelbase_m and not stated / WHEELBASE_FACTOR < seen.wheelbase_m < stated * WHEELBASE_FACTOR:
        raise InputRefused(
            source, "pose", f"the car turns as if its wheelbase were {seen.wheelbase_m:.3g} m, the vehicle file says "
            f"{stated:.3g} m: lengths in mm or cm, or yaw in degrees?",
            "set the unit (mocap.length_unit, or a gain in [columns]) or correct the vehicle file",
        )  # fmt: skip
    return []


def _check_speed(recording: Recording, vehicle: Vehicle) -> list[Irregularity]:
    """Word of a car that is faster than its motor: a scale set on export, or another car's file."""
    top, motion = vehicle.motor.reference_speed_mps, course(recording, vehicle)
    if top is None or vehicle.motor.law != "speed" or not motion.good.any():
        return []
    fast = float(np.quantile(motion.v_f[motion.good], 0.99))
    if fast < SPEED_FACTOR * top:
        return []
    source, text = (
        recording.sources[0].path,
        f"the front wheel reaches {fast:.3g} m/s, the motor's largest is {top:g} m/s",
    )
    if fast > WHEELBASE_FACTOR * top:
        step = "set the unit (mocap.length_unit, or a gain in [columns]) or correct the vehicle file"
        raise InputRefused(source, "pose", f"{text}: lengths in mm or cm?", step)
    return [Irregularity("scale", "warning", 1, source, f"{text}: a scale set on export?")]
