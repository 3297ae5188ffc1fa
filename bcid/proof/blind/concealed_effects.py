"""Effects that blind cases conceal: sizes as the specification has them, drawn log-uniformly, with signs and places."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np


class SizeRange(NamedTuple):
    """Range of an effect's main parameter, its symbol, and the simulation's constant that holds it."""

    constant: str  # of the simulation's plant or sensor
    symbol: str
    low: float
    high: float
    signed: bool = False


@dataclass(frozen=True)
class ConcealedEffect:
    """An effect as constants of the simulation, and as parameters of the vocabulary by symbol."""

    effect: str
    plant: Mapping[str, float] = field(default_factory=dict)
    sensor: Mapping[str, float] = field(default_factory=dict)
    parameters: Mapping[str, float] = field(default_factory=dict)


SIZE_RANGES: dict[str, SizeRange] = {
    "rear_rolling_coulomb": SizeRange("rear_rolling_coulomb", "c", 12, 34),
    "rear_rolling_viscous": SizeRange("rear_rolling_viscous", "b", 10, 28),
    "front_coulomb_friction": SizeRange("front_coulomb_friction", "c", 35, 90),
    "quadratic_drag": SizeRange("quadratic_drag", "k", 6, 18),
    "rear_drag_asymmetry": SizeRange("rear_drag_asymmetry", "b", 7, 22, signed=True),
    "steering_drag": SizeRange("steering_drag", "k", 12, 40),
    "steering_friction": SizeRange("steering_friction", "c", 10, 40),
    "rough_patch": SizeRange("rough_patch", "b", 16, 45),
    "floor_slope": SizeRange("floor_slope", "g", 0.02, 0.06),
    "tether_pull": SizeRange("tether_pull", "k", 5, 15),
    "mass_change": SizeRange("mass_change", "d", 0.05, 0.16),
    "yaw_scrub": SizeRange("yaw_scrub", "c", 7, 21),
    "yaw_coulomb": SizeRange("yaw_coulomb", "c", 11, 26),
    "drive_lateral_offset": SizeRange("drive_lateral_offset", "a", 0.09, 0.25, signed=True),
    "tyre_relaxation": SizeRange("tyre_relaxation", "sigma", 0.025, 0.065),
    "friction_circle": SizeRange("friction_circle", "kappa", 1.6, 2.2),
    "tyre_soft_saturation": SizeRange("tyre_soft_saturation", "s", 0.6, 1.0),
    "load_transfer": SizeRange("load_transfer", "k", 0.08, 0.2),
    "front_ply_steer": SizeRange("front_ply_steer", "f", 10, 32, signed=True),
    "rear_toe": SizeRange("rear_toe", "epsilon", 0.006, 0.016, signed=True),
    "slippery_patch": SizeRange("slippery_patch", "D", 0.2, 0.45),
    "motor_delay": SizeRange("motor_delay", "tau", 0.035, 0.10),
    "motor_lag": SizeRange("motor_lag", "tau", 0.03, 0.09),
    "motor_dead_zone": SizeRange("motor_dead_zone", "width", 0.07, 0.2),
    "motor_sag": SizeRange("motor_sag", "s", 0.14, 0.4),
    "motor_power_limit": SizeRange("inverse_power_limit", "inverse_P", 1 / 230, 1 / 145),
    "motor_regeneration": SizeRange("motor_regeneration", "r", 0.1, 0.35),
    "steering_offset": SizeRange("steering_offset", "o", 0.0045, 0.0125, signed=True),
    "steering_backlash": SizeRange("steering_backlash", "b", 0.009, 0.027),
    "steering_dead_band": SizeRange("steering_dead_band", "b", 0.026, 0.07),
    "steering_delay": SizeRange("steering_delay", "tau", 0.008, 0.018),
    "steering_lag": SizeRange("steering_lag", "tau", 0.008, 0.02),
    "steering_nonlinearity": SizeRange("steering_nonlinearity", "k", 0.004, 0.012, signed=True),
    "steering_side_gain": SizeRange("steering_side_gain", "a", 0.006, 0.02, signed=True),
    "steering_speed_gain": SizeRange("steering_speed_gain", "k", 0.014, 0.042, signed=True),
    "steering_rate_asymmetry": SizeRange("steering_rate_asymmetry", "a", 0.0055, 0.0165, signed=True),
    "steering_compliance": SizeRange("steering_compliance", "k", 5e-5, 1.3e-4, signed=True),
    "pose_latency": SizeRange("pose_latency", "tau", 0.006, 0.017),
    "clock_drift": SizeRange("clock_drift", "rho", 2e-5, 5e-5, signed=True),
    "marker_offset": SizeRange("marker_offset", "d", 0.01, 0.035),
    "body_yaw_misalignment": SizeRange("body_yaw_misalignment", "psi", 0.007, 0.022, signed=True),
    "pose_scale": SizeRange("pose_scale", "kappa", 0.03, 0.09, signed=True),
}
"""Sizes of all effects of the vocabulary, from the specification (effects.md), for the bumper car on ten minutes."""

LARGEST_SIZES = {"tyre_soft_saturation": 1.0, "friction_circle": 4.0}
"""Largest sizes at which an effect makes sense."""

MEASUREMENT_EFFECTS = ("pose_latency", "clock_drift", "marker_offset", "body_yaw_misalignment", "pose_scale")

OUTSIDE_EFFECTS: dict[str, tuple[str, SizeRange]] = {
    "drive_unevenness": ("fx", SizeRange("drive_unevenness", "", 20, 50)),
    "washboard": ("fx", SizeRange("washboard", "", 15, 40)),
    "rear_roll_steer": ("fy", SizeRange("rear_roll_steer", "", 0.006, 0.015, signed=True)),
    "tyre_wear": ("fy", SizeRange("tyre_wear", "", 0.2, 0.5)),
    "steering_reaction": ("mz", SizeRange("steering_reaction", "", 10, 25)),
    "motor_ripple": ("motor", SizeRange("motor_ripple", "", 0.15, 0.4)),
    "motor_dropout": ("motor", SizeRange("motor_dropout", "", 0.3, 0.8)),
    "steering_shimmy": ("steering", SizeRange("steering_shimmy", "", 0.01, 0.03)),
    "lens_distortion": ("pose", SizeRange("lens_distortion", "", 0.001, 0.003)),
}
"""Effects that only the simulation has and no vocabulary names: channel, and range of the size."""

BASE_FLAW_RANGES = {"rear_track": (0.4, 0.7), "tyre_fall": (0.1, 0.4), "slip_speed": (0.8, 1.25)}
"""Ranges of the simulation's constants that make the base model imperfect and that no effect describes."""


MORE_OUTSIDE_EFFECTS: dict[str, tuple[str, SizeRange]] = {
    "bearing_heat": ("fx", SizeRange("bearing_heat", "", 25, 60)),
    "stick_slip": ("fx", SizeRange("stick_slip", "", 60, 150)),
    "floor_stripes": ("fx", SizeRange("floor_stripes", "", 30, 70)),
    "attraction": ("fx", SizeRange("attraction", "", 25, 60)),
    "floor_sway": ("fx", SizeRange("floor_sway", "", 15, 40)),
    "swinging_load": ("fx", SizeRange("swinging_load", "", 0.1, 0.3)),
    "gusts": ("fy", SizeRange("gusts", "", 40, 100)),
    "tyre_warming": ("fy", SizeRange("tyre_warming", "", 0.15, 0.4)),
    "compass_moment": ("mz", SizeRange("compass_moment", "", 15, 35, signed=True)),
    "motor_heating": ("motor", SizeRange("motor_heating", "", 0.15, 0.4)),
    "brake_fading": ("motor", SizeRange("brake_fading", "", 1.5, 3.5)),
    "steering_creep": ("steering", SizeRange("steering_creep", "", 0.012, 0.03, signed=True)),
    "camera_shake": ("pose", SizeRange("camera_shake", "", 0.001, 0.003)),
}
"""Further ones: slow changes, periodic forces, attractions, fading, resonance; a suite has them after all that it had.
"""

OF_THE_CAPTURE = ("lens_distortion", "camera_shake")
"""Effects outside the vocabulary that are in the motion capture."""


class Places(NamedTuple):
    """Where in an arena an effect is put that has a place: largest |x|, |y|, and ranges, in m."""

    patch_x: float
    patch_y: float
    radius: tuple[float, float]
    anchor_x: float
    anchor_y: float
    slack: tuple[float, float]
    reach: tuple[float, float]


ARENA = Places(3.5, 1.5, (0.9, 1.5), 6.0, 3.5, (0.5, 2.0), (1.0, 2.0))
"""Places in the arena of the bumper car."""


def draw_size(size: SizeRange, rng: np.random.Generator, factor: float = 1.0, largest: float = np.inf) -> float:
    """Draw an effect's size log-uniformly from its range, times `factor`, and limit it to `largest`.

    If the range is `signed`, the sign is random; otherwise the size is positive.
    """
    value = min(factor * float(np.exp(rng.uniform(np.log(size.low), np.log(size.high)))), largest)
    return -value if size.signed and rng.random() < 0.5 else value


def draw_concealed_effect(
    effect: str, rng: np.random.Generator, duration: float, factor: float = 1.0
) -> ConcealedEffect:
    """Draw the parameters of one of the effects of the vocabulary: size, and where it has them, sign and place or time.

    The size is log-uniform in its range in SIZE_RANGES, times `factor`.  Directions, circles on the floor and anchors
    of a cable are uniform; a change of mass happens at 0.3 to 0.7 of `duration` (s).
    """
    size = SIZE_RANGES[effect]
    value = draw_size(size, rng, factor, LARGEST_SIZES.get(effect, np.inf))
    return place_effect(effect, size, value, rng, duration, ARENA)


def place_effect(
    effect: str, size: SizeRange, value: float, rng: np.random.Generator, duration: float, places: Places
) -> ConcealedEffect:
    """An effect of the size `value`, with the direction, place or time that it has drawn.

    `size` has the names of the parameter and of the simulation's constant.  Directions, circles on the floor and
    anchors of a cable are uniform in `places`; a change of mass happens at 0.3 to 0.7 of `duration` (s).
    """
    constants, parameters = {size.constant: value}, {size.symbol: value}
    if effect in ("floor_slope", "marker_offset"):
        angle = rng.uniform(-np.pi, np.pi)
        vector = {"x": float(value * np.cos(angle)), "y": float(value * np.sin(angle))}
        constants = {f"{effect}_{axis}": v for axis, v in vector.items()}
        parameters = {f"{size.symbol}_{axis}": v for axis, v in vector.items()}
    elif effect in ("rough_patch", "slippery_patch"):
        x, y = (float(rng.uniform(-reach, reach)) for reach in (places.patch_x, places.patch_y))
        radius = float(rng.uniform(*places.radius))
        constants |= {f"{effect}_x": x, f"{effect}_y": y, f"{effect}_radius": radius}
        parameters |= {"x": x, "y": y, "radius": radius}
    elif effect == "tether_pull":
        x, y = (float(rng.uniform(-reach, reach)) for reach in (places.anchor_x, places.anchor_y))
        slack = float(rng.uniform(*places.slack))
        constants |= {"tether_x": x, "tether_y": y, "tether_slack": slack}
        parameters |= {"x": x, "y": y, "r_0": slack}
    elif effect == "mass_change":
        at = float(rng.uniform(0.3, 0.7) * duration)
        constants, parameters = constants | {"mass_change_at": at}, parameters | {"t_s": at}
    place = "sensor" if effect in MEASUREMENT_EFFECTS else "plant"
    return ConcealedEffect(effect, parameters=parameters, **{place: constants})


def draw_outside_effect(name: str, rng: np.random.Generator) -> ConcealedEffect:
    """Draw size, sign and place of an effect that only the simulation has and that no diagnosis can name.

    It is one of OUTSIDE_EFFECTS or MORE_OUTSIDE_EFFECTS.
    """
    _, size = (OUTSIDE_EFFECTS | MORE_OUTSIDE_EFFECTS)[name]
    return place_outside_effect(name, {size.constant: draw_size(size, rng)}, rng, ARENA)


def place_outside_effect(
    name: str, constants: Mapping[str, float], rng: np.random.Generator, places: Places
) -> ConcealedEffect:
    """An effect outside the vocabulary with these `constants` of the simulation; a magnet is put into `places`."""
    where = dict(constants)
    if name == "attraction":
        x, y = (float(rng.uniform(-reach, reach)) for reach in (places.patch_x, places.patch_y))
        where |= {"attraction_x": x, "attraction_y": y, "attraction_reach": float(rng.uniform(*places.reach))}
    return ConcealedEffect(name, sensor=where) if name in OF_THE_CAPTURE else ConcealedEffect(name, plant=where)
