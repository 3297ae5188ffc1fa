"""What a lab would have of a drawn small car: its vehicle file, and the published simulation that it is compared with.

The simulation is written in the vocabulary's words, from the plant's constants: the same physics under other names.
"""

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import NamedTuple

from bcid.simulation.car import Plant

SMALL_VEHICLE_FILE, SIMULATION_FILE = "small_car.toml", "simulation.toml"

PUBLISHED = {
    "motor_dead_zone": ("motor_dead_zone", "width"),
    "motor_lag": ("motor_lag", "tau"),
    "pulsed_fade": ("motor_fade", "k"),
    "rear_rolling_coulomb": ("rear_rolling_coulomb", "c"),
    "steering_drag": ("steering_drag", "k"),
    "steering_side_gain": ("steering_side_gain", "a"),
    "steering_nonlinearity": ("steering_nonlinearity", "k"),
    "tyre_soft_saturation": ("tyre_soft_saturation", "s"),
}
"""What a simulation of a small car has beside base parameters: the plant's constant, the effect's id and its symbol."""

BODY = "small_car"
VEHICLE_TEXT = """\
# A small car of a simulated laboratory: what is measured on a bench or read from data sheets.
name = "small-car"

[body]
mass_kg = {mass!r}
cog_to_front_m = {front_lever!r}
cog_to_rear_m = {rear_lever!r}
drive = "{drive}"{share}
rear_track_m = {asymmetry_track!r}

[steering]
max_angle_rad = {angle_limit!r}
max_rate_radps = {servo_rate!r}{servo}

[motor]
law = "force"

[mocap]
rigid_body = "small_car"

[topics]
pose = "/mocap/small_car/pose"
command = "/small_car/command"
"""


class Figures(NamedTuple):
    """The figures (SI) of a simulation in the vocabulary's words."""

    parameters: dict[str, float]  # of the base model, by symbol
    effects: dict[str, dict[str, float]]  # parameters by symbol, by the effect's id

    def without(self, effects: Iterable[str]) -> "Figures":
        """The figures less those of some `effects`."""
        return self._replace(effects={name: values for name, values in self.effects.items() if name not in effects})


def small_vehicle_text(plant: Plant, knows_servo: bool = True) -> str:
    """The vehicle file (TOML) of a small car: mass, levers, drive, servo, and that its throttle sets a force.

    The servo's time constant is left out unless the lab `knows_servo`.
    """
    drive = {0.0: "front", 1.0: "rear"}.get(plant.rear_drive, "all")
    share = f"\nfront_drive_share = {1.0 - plant.rear_drive!r}" if drive == "all" else ""
    servo = f"\ntime_constant_s = {plant.servo_time!r}" if knows_servo else ""
    return VEHICLE_TEXT.format(drive=drive, share=share, servo=servo, **plant._asdict())


def plant_figures(plant: Plant) -> Figures:
    """The figures of a `plant` whose laws are the vocabulary's: all parameters, and the effects that it has."""
    parameters = {
        "I_z": plant.inertia, "K_t": plant.throttle_force, "K_v": plant.motor_fade, "K_b": plant.brake_gain,
        "C_f": plant.front_stiffness, "C_r": plant.rear_stiffness, "F_f_max": plant.front_grip,
        "F_r_max": plant.rear_grip, "R_1": plant.rolling_drag, "R_2": plant.rolling_drag_2,
    }  # fmt: skip
    sizes = {effect: (symbol, getattr(plant, constant)) for constant, (effect, symbol) in PUBLISHED.items()}
    sizes["steering_offset"] = "o", plant.steering_offset  # of a car that was not trimmed
    return Figures(parameters, {name: {symbol: v} for name, (symbol, v) in sizes.items() if v != 0.0})


def published_simulation_text(plant: Plant, trust: float, withheld: Iterable[str] = ()) -> str:
    """The published simulation (TOML) of a small car, as `bcid diagnose --simulation` reads it.

    It has all parameters and effects of `plant`, whose values are known to the share `trust`, but for the effects whose
    ids are `withheld`.
    """
    return simulation_text(plant_figures(plant).without(set(withheld)), trust)


def simulation_text(
    figures: Figures, relative_sd: float, relative_sd_of: Mapping[str, float] = MappingProxyType({})
) -> str:
    """A published simulation (TOML) of these `figures`, as `bcid diagnose --simulation` reads it.

    All of them are known to the share `relative_sd`, but those in `relative_sd_of`, by symbol or effect's id.
    """
    lines = ["# The published simulation of the small car.", f"relative_sd = {relative_sd!r}"]
    if relative_sd_of:
        lines.append(f"relative_sd_of = {{ {', '.join(f'{name} = {sd!r}' for name, sd in relative_sd_of.items())} }}")
    lines += ["", "[parameters]", *(f"{symbol} = {value!r}" for symbol, value in figures.parameters.items())]
    lines += ["", "[effects]"]
    for effect, values in figures.effects.items():
        lines.append(f"{effect} = {{ {', '.join(f'{symbol} = {value!r}' for symbol, value in values.items())} }}")
    return "\n".join([*lines, ""])
