"""Further channels judged by the motion: a quantity in other units, or with the other sign, is refused."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.errors import Problem, Problems
from bcid.recording.checks.raw_motion import Course, commanded_angle, course
from bcid.recording.types import Irregularity, Recording, log_of
from bcid.vehicle import Vehicle

CLEAR = 0.7  # correlation with what the poses or commands say of the same quantity
UNITS = 3.0  # times what they say, or its inverse: another unit
FEWEST = 200  # rows of the grid on which they are compared
LATE_S, LAGS = 0.5, 21  # by which a channel may be late, and lags tried
HINTS = {
    "measured_steering_rad": ("the commanded angle", "log it in rad, positive to the left"),
    "wheel_speed_mps": ("the speed of the front axle", "log it in m/s, positive forward"),
    "yaw_rate_radps": ("the yaw rate of the poses", "log it in rad/s, positive counter-clockwise"),
}


def check_channels(recording: Recording, vehicle: Vehicle) -> list[Irregularity]:
    """What is odd about the channels.

    Raises:
        InputRefused: one that follows the motion in other units or with the other sign.
    """
    if not recording.channels:
        return []
    motion, odd = course(recording, vehicle), list[Irregularity]()
    if len(motion.time_s) < FEWEST:
        return []
    problems = Problems()
    for name, stream in recording.channels.items():
        expected, (what, hint) = _expected(name, motion, recording, vehicle), HINTS[name]
        seen = np.interp(motion.time_s, stream.time_s, stream.values[:, 0])
        inside = (motion.time_s >= stream.time_s[0]) & (motion.time_s <= stream.time_s[-1])
        if name == "wheel_speed_mps":
            seen = np.abs(seen)  # what the poses say has no sign
        use = motion.good & inside
        x, y = expected[use], seen[use]
        if len(x) < FEWEST or x.std() < 1e-6:
            continue
        if y.std() < 1e-12:
            odd.append(Irregularity("channel", "warning", 1, name, f"does not change, {what} does"))
            continue
        like = _likeness(expected, seen, use, round(LATE_S / float(motion.time_s[1] - motion.time_s[0])))
        times = float(np.sqrt((y @ y) / (x @ x)))
        if like < -CLEAR:
            cause = f"runs against {what} (correlation {like:.2f}): its sign is inverted"
            problems.append(Problem(name, cause, hint))
        if like > CLEAR and not 1.0 / UNITS < times < UNITS:
            problems.append(Problem(name, f"is {times:.3g} times {what}: degrees, or mm?", hint))
        if abs(like) < CLEAR:
            text = f"does not follow {what} (correlation {like:.2f})"
            odd.append(Irregularity("channel", "warning", 1, name, text))
    problems.refuse(log_of(recording.sources))
    return odd


def _likeness(x: Floats, y: Floats, use: npt.NDArray[np.bool_], reach: int) -> float:
    """The correlation that is farthest from nothing when one of them is late by up to `reach` rows."""
    found = []
    for shift in np.unique(np.linspace(-reach, reach, LAGS).round().astype(int)):
        late = np.roll(y, -shift)
        kept = use.copy()
        kept[len(kept) - shift if shift > 0 else 0 : len(kept) if shift > 0 else -shift] = False
        if kept.sum() >= FEWEST and late[kept].std() > 0.0:
            found.append(float(np.corrcoef(x[kept], late[kept])[0, 1]))
    return max(found, key=abs, default=0.0)


def _expected(name: str, motion: Course, recording: Recording, vehicle: Vehicle) -> Floats:
    """What the poses, or the commands, say of the channel on the motion's grid."""
    if name == "yaw_rate_radps":
        return motion.yaw_rate
    return motion.v_f if name == "wheel_speed_mps" else commanded_angle(recording, vehicle, motion.time_s)
