"""What is concealed in a case: the specification's effects at its sizes, drawn from a seed.

Sizes are the specification's ranges, log-uniform; the constants' names are the simulation's own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np


class Size(NamedTuple):
    """The range of one effect's main parameter and where it goes."""

    constant: str  # of the simulation's plant or sensor
    symbol: str
    low: float
    high: float
    signed: bool = False


@dataclass(frozen=True)
class Concealed:
    """One effect as the simulation has it, and its parameters as the vocabulary has them."""

    effect: str
    plant: Mapping[str, float] = field(default_factory=dict)
    sensor: Mapping[str, float] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)


SIZES: dict[str, Size] = {
    "rear_rolling_coulomb": Size("rear_rolling_coulomb", "c", 12, 34),
    "rear_rolling_viscous": Size("rear_rolling_viscous", "b", 10, 28),
    "front_coulomb_friction": Size("front_coulomb_friction", "c", 35, 90),
    "quadratic_drag": Size("quadratic_drag", "k", 6, 18),
    "rear_drag_asymmetry": Size("rear_drag_asymmetry", "b", 7, 22, signed=True),
    "steering_drag": Size("steering_drag", "k", 12, 40),
    "rough_patch": Size("rough_patch", "b", 16, 45),
    "floor_slope": Size("floor_slope", "g", 0.02, 0.06),
    "tether_pull": Size("tether_pull", "k", 5, 15),
    "mass_change": Size("mass_change", "d", 0.05, 0.16),
    "yaw_scrub": Size("yaw_scrub", "c", 7, 21),
    "yaw_coulomb": Size("yaw_coulomb", "c", 11, 26),
    "drive_lateral_offset": Size("drive_lateral_offset", "a", 0.09, 0.25, signed=True),
    "tyre_relaxation": Size("tyre_relaxation", "sigma", 0.025, 0.065),
    "friction_circle": Size("friction_circle", "kappa", 1.6, 2.2),
    "tyre_soft_saturation": Size("tyre_soft_saturation", "s", 0.6, 1.0),
    "load_transfer": Size("load_transfer", "k", 0.08, 0.2),
    "front_ply_steer": Size("front_ply_steer", "f", 10, 32, signed=True),
    "rear_toe": Size("rear_toe", "epsilon", 0.006, 0.016, signed=True),
    "slippery_patch": Size("slippery_patch", "D", 0.2, 0.45),
    "motor_delay": Size("motor_delay", "tau", 0.035, 0.10),
    "motor_lag": Size("motor_lag", "tau", 0.03, 0.09),
    "motor_dead_zone": Size("motor_dead_zone", "width", 0.07, 0.2),
    "motor_sag": Size("motor_sag", "s", 0.14, 0.4),
    "motor_power_limit": Size("inverse_power_limit", "inverse_P", 1 / 230, 1 / 145),
    "motor_regeneration": Size("motor_regeneration", "r", 0.1, 0.35),
    "steering_offset": Size("steering_offset", "o", 0.0045, 0.0125, signed=True),
    "steering_backlash": Size("steering_backlash", "b", 0.009, 0.027),
    "steering_dead_band": Size("steering_dead_band", "b", 0.026, 0.07),
    "steering_delay": Size("steering_delay", "tau", 0.008, 0.018),
    "steering_lag": Size("steering_lag", "tau", 0.008, 0.02),
    "steering_nonlinearity": Size("steering_nonlinearity", "k", 0.004, 0.012, signed=True),
    "steering_side_gain": Size("steering_side_gain", "a", 0.006, 0.02, signed=True),
    "steering_speed_gain": Size("steering_speed_gain", "k", 0.014, 0.042, signed=True),
    "steering_rate_asymmetry": Size("steering_rate_asymmetry", "a", 0.0055, 0.0165, signed=True),
    "steering_compliance": Size("steering_compliance", "k", 5e-5, 1.3e-4, signed=True),
    "pose_latency": Size("pose_latency", "tau", 0.006, 0.017),
    "clock_drift": Size("clock_drift", "rho", 2e-5, 5e-5, signed=True),
    "marker_offset": Size("marker_offset", "d", 0.01, 0.035),
    "body_yaw_misalignment": Size("body_yaw_misalignment", "psi", 0.007, 0.022, signed=True),
    "pose_scale": Size("pose_scale", "kappa", 0.03, 0.09, signed=True),
}
"""Of the specification (effects.md), for the bumper car on ten minutes."""

MOST = {"tyre_soft_saturation": 1.0, "friction_circle": 4.0}
"""What an effect cannot be larger than."""

MEASUREMENT = ("pose_latency", "clock_drift", "marker_offset", "body_yaw_misalignment", "pose_scale")

OUTSIDE: dict[str, tuple[str, Size]] = {
    "drive_unevenness": ("fx", Size("drive_unevenness", "", 20, 50)),
    "washboard": ("fx", Size("washboard", "", 15, 40)),
    "rear_roll_steer": ("fy", Size("rear_roll_steer", "", 0.006, 0.015, signed=True)),
    "tyre_wear": ("fy", Size("tyre_wear", "", 0.2, 0.5)),
    "steering_reaction": ("mz", Size("steering_reaction", "", 10, 25)),
    "motor_ripple": ("motor", Size("motor_ripple", "", 0.15, 0.4)),
    "motor_dropout": ("motor", Size("motor_dropout", "", 0.3, 0.8)),
    "steering_shimmy": ("steering", Size("steering_shimmy", "", 0.01, 0.03)),
    "lens_distortion": ("pose", Size("lens_distortion", "", 0.001, 0.003)),
}
"""What no vocabulary has an id for: it lives in the simulation alone.  Channel, constant and range."""

FLAWS = {"rear_track": (0.4, 0.7), "tyre_fall": (0.1, 0.4), "slip_speed": (0.8, 1.25)}
"""Of an imperfect base, which no effect describes, and their ranges."""


def _drawn(size: Size, rng: np.random.Generator, times: float = 1.0, most: float = np.inf) -> float:
    """A size of the range (`times` it, `most` at the most) and its sign."""
    value = min(times * float(np.exp(rng.uniform(np.log(size.low), np.log(size.high)))), most)
    return -value if size.signed and rng.random() < 0.5 else value


def conceal(effect: str, rng: np.random.Generator, duration: float, times: float = 1.0) -> Concealed:
    """The effect at a drawn size (`times` the specification's), sign and place."""
    size = SIZES[effect]
    value = _drawn(size, rng, times, MOST.get(effect, np.inf))
    if effect in ("floor_slope", "marker_offset"):
        angle = rng.uniform(-np.pi, np.pi)
        pair = [float(value * np.cos(angle)), float(value * np.sin(angle))]
        if effect == "floor_slope":
            made = dict(zip(("floor_slope_x", "floor_slope_y"), pair, strict=True))
            return Concealed(effect, plant=made, parameters=dict(zip(("g_x", "g_y"), pair, strict=True)))
        made = dict(zip(("marker_offset_x", "marker_offset_y"), pair, strict=True))
        return Concealed(effect, sensor=made, parameters=dict(zip(("d_x", "d_y"), pair, strict=True)))
    if effect in ("rough_patch", "slippery_patch"):
        x, y, radius = (float(v) for v in (rng.uniform(-3.5, 3.5), rng.uniform(-1.5, 1.5), rng.uniform(0.9, 1.5)))
        plant = {effect: value, f"{effect}_x": x, f"{effect}_y": y, f"{effect}_radius": radius}
        return Concealed(effect, plant=plant, parameters={size.symbol: value, "x": x, "y": y, "radius": radius})
    if effect == "tether_pull":
        x, y, slack = (float(v) for v in (rng.uniform(-6.0, 6.0), rng.uniform(-3.5, 3.5), rng.uniform(0.5, 2.0)))
        plant = {effect: value, "tether_x": x, "tether_y": y, "tether_slack": slack}
        return Concealed(effect, plant=plant, parameters={"k": value, "x": x, "y": y, "r_0": slack})
    if effect == "mass_change":
        at = float(rng.uniform(0.3, 0.7) * duration)
        return Concealed(effect, plant={effect: value, "mass_change_at": at}, parameters={"d": value, "t_s": at})
    where = {size.constant: value}
    if effect in MEASUREMENT:
        return Concealed(effect, sensor=where, parameters={size.symbol: value})
    return Concealed(effect, plant=where, parameters={size.symbol: value})


def outside(name: str, rng: np.random.Generator) -> Concealed:
    """An effect without an id at a drawn size and sign."""
    _, size = OUTSIDE[name]
    where = {size.constant: _drawn(size, rng)}
    return Concealed(name, sensor=where) if name == "lens_distortion" else Concealed(name, plant=where)


def flaws(rng: np.random.Generator) -> dict[str, float]:
    """The constants of an imperfect base."""
    return {name: float(rng.uniform(low, high)) for name, (low, high) in FLAWS.items()}
