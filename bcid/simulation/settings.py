"""A plant and a sensor from what the command line says."""

from __future__ import annotations

import difflib
from collections.abc import Sequence

from bcid.errors import UsageError
from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor

NOT_NEGATIVE = (
    "friction_circle", "motor_regeneration", "motor_lag", "motor_delay", "motor_dead_zone", "motor_power_limit",
    "steering_lag", "steering_delay", "steering_backlash", "steering_dead_band", "tyre_relaxation", "softness",
    "tyre_soft_saturation", "tyre_fall", "rear_track", "rough_force", "rough_moment",
)  # fmt: skip
"""Constants that mean nothing below zero."""


def plant_and_sensor(ideal: bool, changes: Sequence[str], rate_hz: float) -> tuple[Plant, Sensor]:
    """The car (with a real one's extras unless `ideal`) and the motion capture, changed by NAME=VALUE.

    Raises:
        UsageError: an unknown name or a value that is no number.
    """
    plant: dict[str, float] = {} if ideal else dict(REAL_EXTRAS)
    sensor: dict[str, float] = {"rate_hz": rate_hz}
    for change in changes:
        name, _, text = change.partition("=")
        try:
            value = float(text)
        except ValueError:
            raise UsageError(f"--set {change}: {text!r} is no number\n  next: write NAME=VALUE") from None
        if name in NOT_NEGATIVE and value < 0.0:
            raise UsageError(f"--set {change}: {name} cannot be negative\n  next: give a value from 0 up")
        if name == "motor_power_limit":  # the vocabulary's id, in W; off at infinity
            plant["inverse_power_limit"] = 1.0 / value if value > 0.0 else 0.0
        elif name in Plant._fields:
            plant[name] = value
        elif name in Sensor._fields:
            sensor[name] = value
        else:
            near = difflib.get_close_matches(name, [*Plant._fields, *Sensor._fields], n=3)
            raise UsageError(
                f"--set {change}: there is no constant {name!r}\n  next: try {', '.join(near) or 'another'}"
            )
    return Plant(**plant), Sensor(**sensor)
