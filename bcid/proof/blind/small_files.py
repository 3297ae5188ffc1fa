"""What a lab would have of a drawn small car: its vehicle file, and the published simulation that it is compared with.

The simulation is written in the vocabulary's words, from the plant's constants: the same physics under other names.
"""

from collections.abc import Iterable

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
max_rate_radps = {servo_rate!r}
time_constant_s = {servo_time!r}

[motor]
law = "force"

[mocap]
rigid_body = "small_car"

[topics]
pose = "/mocap/small_car/pose"
command = "/small_car/command"
"""


def small_vehicle_text(plant: Plant) -> str:
    """The vehicle file (TOML) of a small car: mass, levers, drive, servo, and that its throttle sets a force."""
    drive = {0.0: "front", 1.0: "rear"}.get(plant.rear_drive, "all")
    share = f"\nfront_drive_share = {1.0 - plant.rear_drive!r}" if drive == "all" else ""
    return VEHICLE_TEXT.format(drive=drive, share=share, **plant._asdict())


def published_simulation_text(plant: Plant, trust: float, withheld: Iterable[str] = ()) -> str:
    """The published simulation (TOML) of a small car, as `bcid diagnose --simulation` reads it.

    It has all parameters and effects of `plant`, whose values are known to the share `trust`, but for the effects whose
    ids are `withheld`.
    """
    parameters = {
        "I_z": plant.inertia, "K_t": plant.throttle_force, "K_v": plant.motor_fade, "K_b": plant.brake_gain,
        "C_f": plant.front_stiffness, "C_r": plant.rear_stiffness, "F_f_max": plant.front_grip,
        "F_r_max": plant.rear_grip, "R_1": plant.rolling_drag, "R_2": plant.rolling_drag_2,
    }  # fmt: skip
    lines = ["# The published simulation of the small car.", f"relative_sd = {trust!r}", "", "[parameters]"]
    lines += [f"{symbol} = {value!r}" for symbol, value in parameters.items()]
    lines += ["", "[effects]"]
    for constant, (effect, symbol) in PUBLISHED.items():
        value = getattr(plant, constant)
        if value != 0.0 and effect not in withheld:
            lines.append(f"{effect} = {{ {symbol} = {value!r} }}")
    return "\n".join([*lines, ""])
