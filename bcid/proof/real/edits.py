"""Effects made in a real recording: what is done to its poses or commands can be undone, so their size is known."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from bcid.aliases import Floats
from bcid.recording.types import Recording, Stream


def _stamped(of: Recording, stamp: Callable[[Floats], Floats]) -> Recording:
    """With poses stamped otherwise."""
    breaks = tuple(stamp(np.array(of.breaks_s, dtype=float)).tolist())
    return replace(of, poses=Stream(stamp(of.poses.time_s), of.poses.values), breaks_s=breaks)


def _posed(of: Recording, factor: float = 1.0, turned: float = 0.0) -> Recording:
    return replace(of, poses=Stream(of.poses.time_s, of.poses.values * [factor, factor, 1.0] + [0.0, 0.0, turned]))


def _shifted(of: Recording, d: float) -> Recording:
    x, y, yaw = of.poses.values.T
    values = np.column_stack([x + d * np.cos(yaw), y + d * np.sin(yaw), yaw])
    return replace(of, poses=Stream(of.poses.time_s, values))


def _commanded(of: Recording, angle: Callable[[Floats], Floats]) -> Recording:
    """With other logged steering commands."""
    values = of.commands.values.copy()
    values[:, 0] = angle(values[:, 0])
    return replace(of, commands=Stream(of.commands.time_s, values))


def _earlier(of: Recording, tau: float, which: int) -> Recording:
    """One of the commands logged `tau` before it came: as if it acted that much later."""
    t, values = of.commands.time_s, of.commands.values
    times = np.union1d(t, t - tau)
    times = times[(times >= t[0]) & (times <= t[-1] - tau)]
    now = values[np.searchsorted(t, times, side="right") - 1].copy()
    now[:, which] = values[np.searchsorted(t, times + tau, side="right") - 1, which]
    return replace(of, commands=Stream(times, now))


EDITS: Mapping[str, Callable[[Recording, float], Recording]] = {
    "pose_latency": lambda of, tau: _stamped(of, lambda t: t + tau),
    "clock_drift": lambda of, drift: _stamped(of, lambda t: t + drift * (t - of.poses.time_s[0])),
    "marker_offset": _shifted,
    "body_yaw_misalignment": lambda of, psi: _posed(of, turned=psi),
    "pose_scale": lambda of, kappa: _posed(of, factor=1.0 + kappa),
    "steering_offset": lambda of, o: _commanded(of, lambda u: u - o),
    "steering_side_gain": lambda of, a: _commanded(of, lambda u: u / (1.0 + a * np.sign(u))),
    "steering_delay": lambda of, tau: _earlier(of, tau, 0),
    "motor_delay": lambda of, tau: _earlier(of, tau, 1),
}
"""What is done to a recording so that the car in it has the effect of this size."""
