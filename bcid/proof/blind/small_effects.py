"""What small cars conceal: sizes per kg, per metre of wheelbase or plain, and where it is in their room.

Sizes of the vocabulary are, at their lowest, some 3.5 times what a take of one to two minutes shows by 20 nats (by the
expected information, at the median of fourteen takes of drawn cars), and some 9 times at their highest: refitted with
the truth, forty takes gained 105 to some thousand nats over the rest.  What has no name costs the exact simulation
as many.  Effects that a published model would have are withheld at the size at which such cars have them.
"""

from typing import NamedTuple

import numpy as np

from bcid.proof.blind.concealed_effects import (
    MORE_OUTSIDE_EFFECTS,
    OUTSIDE_EFFECTS,
    ConcealedEffect,
    Places,
    SizeRange,
    draw_size,
    place_effect,
    place_outside_effect,
)
from bcid.simulation.car import Plant

ROOM_PLACES = Places(1.5, 0.9, (0.5, 0.9), 3.0, 2.2, (0.3, 1.0), (0.6, 1.2))
"""Places in a room for small cars."""


class ScaledSize(NamedTuple):
    """Range of an effect's size in a small car, in units of a power of its mass (kg) and of its wheelbase (m)."""

    low: float
    high: float
    kg: int = 0
    m: int = 0
    signed: bool = False
    constant: str = ""  # of the simulation, where it is not the effect's id
    symbol: str = ""


SMALL_SIZES: dict[str, ScaledSize] = {
    "rear_rolling_coulomb": ScaledSize(0.13, 0.35, kg=1, symbol="c"),
    "rear_rolling_viscous": ScaledSize(0.22, 0.6, kg=1, symbol="b"),
    "front_coulomb_friction": ScaledSize(0.13, 0.35, kg=1, symbol="c"),
    "quadratic_drag": ScaledSize(0.17, 0.45, kg=1, symbol="k"),
    "rear_drag_asymmetry": ScaledSize(0.06, 0.15, kg=1, signed=True, symbol="b"),
    "steering_drag": ScaledSize(0.17, 0.45, kg=1, symbol="k"),
    "steering_friction": ScaledSize(0.2, 0.5, kg=1, symbol="c"),
    "rough_patch": ScaledSize(0.12, 0.4, kg=1, symbol="b"),
    "floor_slope": ScaledSize(0.045, 0.12, symbol="g"),
    "tether_pull": ScaledSize(0.05, 0.15, kg=1, symbol="k"),
    "mass_change": ScaledSize(0.035, 0.1, symbol="d"),
    "yaw_scrub": ScaledSize(0.05, 0.12, kg=1, m=1, symbol="c"),
    "yaw_coulomb": ScaledSize(0.022, 0.055, kg=1, m=1, symbol="c"),
    "drive_lateral_offset": ScaledSize(0.012, 0.03, m=1, signed=True, symbol="a"),
    "tyre_relaxation": ScaledSize(0.006, 0.016, symbol="sigma"),
    "friction_circle": ScaledSize(0.8, 2.2, symbol="kappa"),
    "tyre_soft_saturation": ScaledSize(0.5, 1.0, symbol="s"),
    "load_transfer": ScaledSize(0.025, 0.065, symbol="k"),
    "front_ply_steer": ScaledSize(0.04, 0.1, kg=1, signed=True, symbol="f"),
    "rear_toe": ScaledSize(0.0011, 0.0028, signed=True, symbol="epsilon"),
    "slippery_patch": ScaledSize(0.25, 0.5, symbol="D"),
    "motor_delay": ScaledSize(0.008, 0.02, symbol="tau"),
    "motor_lag": ScaledSize(0.008, 0.02, symbol="tau"),
    "motor_dead_zone": ScaledSize(0.015, 0.05, symbol="width"),
    "motor_sag": ScaledSize(0.08, 0.2, symbol="s"),
    "motor_power_limit": ScaledSize(0.35, 0.8, kg=-1, constant="inverse_power_limit", symbol="inverse_P"),
    "steering_offset": ScaledSize(0.0023, 0.006, signed=True, symbol="o"),
    "steering_backlash": ScaledSize(0.002, 0.006, symbol="b"),
    "steering_dead_band": ScaledSize(0.0025, 0.008, symbol="b"),
    "steering_delay": ScaledSize(0.002, 0.006, symbol="tau"),
    "steering_lag": ScaledSize(0.002, 0.006, symbol="tau"),
    "steering_nonlinearity": ScaledSize(0.08, 0.2, signed=True, symbol="k"),
    "steering_side_gain": ScaledSize(0.008, 0.02, signed=True, symbol="a"),
    "steering_speed_gain": ScaledSize(0.015, 0.04, signed=True, symbol="k"),
    "steering_rate_asymmetry": ScaledSize(0.2, 0.6, signed=True, symbol="a"),
    "steering_compliance": ScaledSize(0.01, 0.026, kg=-1, signed=True, symbol="k"),
    "pose_latency": ScaledSize(0.002, 0.006, symbol="tau"),
    "clock_drift": ScaledSize(4e-5, 1e-4, signed=True, symbol="rho"),
    "marker_offset": ScaledSize(0.003, 0.008, symbol="d"),
    "body_yaw_misalignment": ScaledSize(0.0014, 0.0035, signed=True, symbol="psi"),
    "pose_scale": ScaledSize(0.012, 0.03, signed=True, symbol="kappa"),
}
"""Sizes of all effects of the vocabulary that a small car with a force-law motor can have, beside an exact model."""

SMALL_OUTSIDE_SIZES: dict[str, ScaledSize] = {
    "drive_unevenness": ScaledSize(0.1, 0.2, kg=1),
    "washboard": ScaledSize(0.1, 0.25, kg=1),
    "rear_roll_steer": ScaledSize(0.004, 0.01, signed=True),
    "tyre_wear": ScaledSize(0.15, 0.35),
    "steering_reaction": ScaledSize(0.05, 0.12, kg=1, m=1),
    "motor_ripple": ScaledSize(0.2, 0.4),
    "motor_dropout": ScaledSize(0.15, 0.4),
    "steering_shimmy": ScaledSize(0.004, 0.012),
    "lens_distortion": ScaledSize(0.003, 0.008),
    "bearing_heat": ScaledSize(0.25, 0.6, kg=1),
    "stick_slip": ScaledSize(0.3, 0.8, kg=1),
    "floor_stripes": ScaledSize(0.1, 0.2, kg=1),
    "attraction": ScaledSize(0.15, 0.35, kg=1),
    "floor_sway": ScaledSize(0.1, 0.22, kg=1),
    "swinging_load": ScaledSize(0.05, 0.15),
    "gusts": ScaledSize(0.3, 0.7, kg=1),
    "tyre_warming": ScaledSize(0.1, 0.3),
    "compass_moment": ScaledSize(0.05, 0.12, kg=1, m=1, signed=True),
    "motor_heating": ScaledSize(1.2, 2.5),
    "brake_fading": ScaledSize(1.5, 3.5),
    "steering_creep": ScaledSize(0.006, 0.015, signed=True),
    "camera_shake": ScaledSize(0.001, 0.003),
}
"""Sizes of what only the simulation has, in a small car."""

OUTSIDE_CHANNELS = {name: channel for name, (channel, _) in (OUTSIDE_EFFECTS | MORE_OUTSIDE_EFFECTS).items()}
"""Channel of each effect outside the vocabulary, in whatever car."""

WHEN_BRAKING = "stop-and-go"
NEEDED_DRIVERS = {"brake_fading": WHEN_BRAKING, "stick_slip": WHEN_BRAKING}
"""Who has to drive for an effect to show at all."""


def _range_in_car(effect: str, size: ScaledSize, plant: Plant) -> SizeRange:
    """Range of an effect's size (SI) in the small car `plant`."""
    scale = plant.mass**size.kg * (plant.front_lever + plant.rear_lever) ** size.m
    return SizeRange(size.constant or effect, size.symbol, scale * size.low, scale * size.high, size.signed)


def draw_small_effect(effect: str, plant: Plant, rng: np.random.Generator, duration: float) -> ConcealedEffect:
    """Draw size, sign, and place or time (in a take of `duration` s) of an effect of SMALL_SIZES in a small car."""
    size = _range_in_car(effect, SMALL_SIZES[effect], plant)
    return place_effect(effect, size, draw_size(size, rng), rng, duration, ROOM_PLACES)


def draw_small_outside_effect(name: str, plant: Plant, rng: np.random.Generator) -> ConcealedEffect:
    """Draw size, sign and place of an effect of SMALL_OUTSIDE_SIZES in a small car."""
    size = _range_in_car(name, SMALL_OUTSIDE_SIZES[name], plant)
    return place_outside_effect(name, {size.constant: draw_size(size, rng)}, rng, ROOM_PLACES)


def kinds_of_car(plant: Plant) -> tuple[str, ...]:
    """Effects of SMALL_SIZES that the small car can have: a front wheel that is not driven spends no grip on it."""
    return tuple(name for name in SMALL_SIZES if name != "friction_circle" or plant.rear_drive < 1.0)
