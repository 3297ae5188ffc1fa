"""Values that no such car can have: units, signs and ranges judged by the motion itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bcid.errors import InputRefused
from bcid.recording.course import commanded_angle, course
from bcid.recording.types import Irregularity, Recording
from bcid.vehicle import Vehicle

DEGREES_FACTOR = 3.0
WHEELBASE_FACTOR = 4.0
MIN_CORRELATION = 0.5
MIN_SPEED_MPS = 0.1
MIN_SAMPLES = 100


def check_plausible(recording: Recording, vehicle: Vehicle) -> Recording:
    """The recording, with what looked odd noted.

    Raises:
        InputRefused: steering in degrees or inverted, lengths or yaw in other units, brake shares below -1.
    """
    odd = _check_commands(recording, vehicle)
    _check_turning(recording, vehicle)
    return replace(recording, irregularities=(*recording.irregularities, *odd))


def _check_commands(recording: Recording, vehicle: Vehicle) -> list[Irregularity]:
    source = recording.sources[-1].path
    u_s, u_m = recording.commands.values.T
    limit = vehicle.steering.max_angle_rad
    high = float(np.quantile(np.abs(u_s), 0.95))
    if high > DEGREES_FACTOR * limit:
        raise InputRefused(
            source, "steering_rad", f"reaches {high:.3g} where the car's limit is {limit:.3g} rad: degrees?",
            "log the command in rad, or map it with gain = 0.017453 in the vehicle file",
        )  # fmt: skip
    if u_m.min() < -1.05 and vehicle.motor.law == "speed":
        raise InputRefused(
            source, "throttle_mps", f"falls to {u_m.min():.3g}, where below 0 a brake share in [-1, 0] is meant",
            "map the throttle with gain and offset in the vehicle file",
        )  # fmt: skip
    beyond = np.abs(u_s) > limit * (1 + 1e-9)
    if not beyond.any():
        return []
    text = f"commands beyond the limit of {limit:g} rad act as the limit"
    return [Irregularity("steering command", "warning", int(beyond.sum()), source, text)]


def _check_turning(recording: Recording, vehicle: Vehicle) -> None:
    """Without slip, yaw rate * wheelbase = v_f sin(delta): the slope shows units, the sign the steering's."""
    motion = course(recording, vehicle)
    if len(motion.time_s) < 2:
        return
    angle = commanded_angle(recording, vehicle, motion.time_s)
    use = motion.good & (motion.v_f > MIN_SPEED_MPS)
    turn = motion.v_f[use] * np.sin(angle[use])
    if use.sum() < MIN_SAMPLES or np.std(turn) < 1e-6 or np.std(motion.yaw_rate[use]) < 1e-6:
        return
    correlation = float(np.corrcoef(turn, motion.yaw_rate[use])[0, 1])
    source = recording.sources[0].path
    if correlation < -MIN_CORRELATION:
        raise InputRefused(
            source, "steering", f"the car turns right where the command says left (correlation {correlation:.2f})",
            "positive steering turns left: map the command with a negative gain, or correct up_axis",
        )  # fmt: skip
    if correlation < MIN_CORRELATION:
        return
    seen = float(turn @ turn / (turn @ motion.yaw_rate[use]))
    stated = vehicle.body.cog_to_front_m + vehicle.body.cog_to_rear_m
    if not stated / WHEELBASE_FACTOR < seen < stated * WHEELBASE_FACTOR:
        raise InputRefused(
            source, "pose", f"the car turns as if its wheelbase were {seen:.3g} m, the vehicle file says "
            f"{stated:.3g} m: lengths in mm or cm, or yaw in degrees?",
            "set the unit (mocap.length_unit, or a gain in [columns]) or correct the vehicle file",
        )  # fmt: skip
