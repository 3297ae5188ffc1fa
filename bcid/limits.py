"""Limits of the vehicle file: quantities beyond which no car from a 1:87 model to a heavy truck lies.

They are wide: a value beyond one of them is in another unit or a slip of the pen, never an unusual car.
"""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class VehicleLimits:
    """The largest and smallest quantities that a vehicle file may state."""

    # wheelbase of a 1:87 car: 0.03 m
    min_wheelbase_m: float = 0.02
    # heavy trucks have 7 m, self-propelled platforms 12 m
    max_wheelbase_m: float = 15.0
    # track of a 1:87 car: 0.02 m
    min_track_m: float = 0.01
    # the widest mining trucks have 5 m, and no public road more than 3 m
    max_track_m: float = 6.0
    # the tracked point by the wheelbase: a marker on a mast or a trailer's hitch is within it
    max_marker_wheelbases: float = 3.0
    # mass of a 1:87 car: 0.01 kg
    min_mass_kg: float = 0.005
    # a loaded road train has 60 t, a mining truck 600 t
    max_mass_kg: float = 700e3
    # mass by the wheelbase's cube: a car of 1.5 t has 75 kg/m³, a bicycle's frame on wheels 5
    min_mass_kgpm3: float = 0.5
    # a 1:43 car has 400 kg/m³, a bumper car 490, a robot of 20 kg on 0.2 m 2,500; in grams they have a thousandfold
    max_mass_kgpm3: float = 20e3
    # the steered wheel of a tricycle or a forklift turns at most half round
    max_steering_rad: float = math.pi
    # an angle of 0.6 degrees steers no car
    min_steering_rad: float = 0.01
    # model servos turn 60 degrees in 0.05 s (21 rad/s), the fastest in 0.03 s (35 rad/s)
    max_steering_rate_radps: float = 60.0
    # a lorry's steering wheel takes seconds from stop to stop: 0.1 rad/s
    min_steering_rate_radps: float = 0.02
    # hydraulic steering of heavy machines has half a second
    max_time_constant_s: float = 3.0
    # 360 km/h, faster than any car that drives by a reference speed
    max_reference_speed_mps: float = 100.0
    # slower than any drive that is worth a recording
    min_reference_speed_mps: float = 0.01
    # 540 km/h, faster than any race car
    max_speed_mps: float = 150.0
    # more than a whole turn is in degrees
    max_yaw_offset_rad: float = 2.0 * math.pi
    # who drives by a command every ten seconds drives blind
    max_hold_s: float = 10.0


VEHICLE = VehicleLimits()
