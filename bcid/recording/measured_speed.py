"""A throttle that is no command but a measured wheel speed: between two samples it runs on, and is not held."""

from dataclasses import replace

import numpy as np

from bcid.recording.limits import STREAM as LIMITS
from bcid.recording.types import Recording, Stream
from bcid.vehicle import Vehicle


def let_measured_speed_run(recording: Recording, vehicle: Vehicle) -> Recording:
    """The recording with its throttle linear between samples, where the vehicle's motor law is "measured-speed".

    A command holds until the next; a measured speed held so would come half a sampling period late.  Rows are added
    between samples, at most `LIMITS.max_measured_step_s` apart, each with the speed in the middle of its time, so that
    the mean over any sample's period is that of the straight line.  Steering commands hold as before, and so does a
    speed before a pause of more than `hold_s`.  Recordings of other vehicles are returned as they are.
    """
    if vehicle.motor.law != "measured-speed" or len(recording.commands) < 2:
        return recording
    time_s, (steering, speed) = recording.commands.time_s, recording.commands.values.T
    steps = np.diff(time_s)
    known = steps <= recording.hold_s
    parts = np.where(known, np.ceil(steps / LIMITS.max_measured_step_s - 1e-9), 1.0).astype(np.int64)
    row = np.repeat(np.arange(len(parts)), parts)
    within = np.arange(len(row)) - np.repeat(np.cumsum(parts) - parts, parts)
    share = np.where(known[row], (within + 0.5) / parts[row], 0.0)
    added_s = time_s[row] + steps[row] * within / parts[row]
    running = speed[row] + share * np.diff(speed)[row]
    values = np.column_stack([np.r_[steering[row], steering[-1]], np.r_[running, speed[-1]]])
    return replace(recording, commands=Stream(np.r_[added_s, time_s[-1]], values))
