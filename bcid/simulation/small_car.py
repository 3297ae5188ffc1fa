"""Small cars to make logs with, drawn at random: between a 1:10 car of 1.5 kg and a 1:8 car of 6 kg."""

from typing import NamedTuple

import numpy as np

from bcid.simulation.car import Plant, Sensor


class SmallCar(NamedTuple):
    """A small car of a force-law motor, with what its builders know of it, and how fast it is driven."""

    plant: Plant
    slow: float  # m/s
    fast: float


SMALL_CAR_SENSOR = Sensor(rate_hz=100.0, position_noise=4e-4, yaw_noise=3e-3)
"""A motion capture as usual in a room for small cars, whose markers stand close together."""

TRACK_SHARE = 0.65  # of the wheelbase
WIDER_LOCK = 1.25  # times the usual servo's range, where the linkage gives way towards its ends
OWN_CONSTANTS = (
    "motor_dead_zone", "motor_lag", "pulsed_fade", "rear_rolling_coulomb", "steering_drag", "steering_side_gain",
    "steering_nonlinearity", "tyre_soft_saturation",
)  # fmt: skip
"""Constants, off in the paper's car, that a drawn small car has and a published model of it would have, too."""


def draw_small_car(rng: np.random.Generator, having: tuple[str, ...] = (), lacking: tuple[str, ...] = ()) -> SmallCar:
    """Draw a small car: size, mass, drive, motor, servo and tyres, and the speeds (m/s) between which it is driven.

    All forces are drawn per kg.  A car has a dead zone and a lag of the motor, dry friction, and a servo that turns
    farther to one side, its angle slightly bent; some have soft tyres, a steered wheel that drags, a motor whose force
    fades with throttle times speed.  It has those of OWN_CONSTANTS that are named in `having`, and none in `lacking`.
    """
    wheelbase = rng.uniform(0.17, 0.33)
    mass = float(np.clip(rng.uniform(130.0, 300.0) * wheelbase**3, 1.5, 6.0))
    front_lever = wheelbase * rng.uniform(0.44, 0.56)
    rear_lever = wheelbase - front_lever
    stiffness, grip = rng.uniform(24.0, 36.0) * mass, rng.uniform(1.8, 3.4) * mass
    # a car that goes straight on its own: the rear's moment is the larger
    stiff_rear = stiffness * front_lever / rear_lever * rng.uniform(1.1, 1.4)
    constants = {
        "mass": mass, "inertia": rng.uniform(0.5, 1.2) * mass * front_lever * rear_lever, "front_lever": front_lever,
        "rear_lever": rear_lever, "angle_limit": rng.uniform(0.42, 0.48), "servo_time": rng.uniform(0.03, 0.09),
        "servo_rate": rng.uniform(5.0, 20.0), "motor_limit": 15.0 * mass, "brake_gain": rng.uniform(1.5, 3.0) * mass,
        "front_stiffness": stiffness, "rear_stiffness": stiff_rear, "front_grip": grip,
        "rear_grip": grip * rng.uniform(1.0, 1.15) * front_lever / rear_lever,
        "rolling_drag": rng.uniform(0.25, 0.5) * mass, "rolling_drag_2": rng.uniform(0.01, 0.08) * mass,
        "slip_speed": 1.0, "rear_drive": rng.choice([0.0, 1.0, rng.uniform(0.35, 0.65)]),
        "throttle_force": rng.uniform(9.0, 16.0) * mass, "motor_fade": rng.uniform(0.3, 1.0) * mass,
        "rough_force": 0.02 * mass, "rough_moment": 0.04 * mass * front_lever * rear_lever,
        "asymmetry_track": TRACK_SHARE * wheelbase,
    }  # fmt: skip
    always = {
        "motor_dead_zone": rng.uniform(0.08, 0.18), "motor_lag": rng.uniform(0.05, 0.13),
        "rear_rolling_coulomb": rng.uniform(0.35, 0.85) * mass,
        "steering_side_gain": rng.choice([-1.0, 1.0]) * rng.uniform(0.04, 0.1),
        "steering_nonlinearity": rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 0.45),
    }  # fmt: skip
    sometimes = {
        "tyre_soft_saturation": rng.uniform(0.6, 1.0), "steering_drag": rng.uniform(0.8, 1.8) * mass,
        "pulsed_fade": rng.uniform(1.0, 3.0) * mass,
    }  # fmt: skip
    drawn = {name for name in sometimes if rng.random() < 0.5} | set(always) | set(having)
    own = {name: v for name, v in (always | sometimes).items() if name in drawn and name not in lacking}
    plant = Plant(**{name: float(value) for name, value in (constants | own).items()})
    return SmallCar(plant, 0.5, float(rng.uniform(1.8, 2.6)))


def draw_car_of_other_laws(rng: np.random.Generator, with_dry_steered_drag: bool = False) -> SmallCar:
    """Draw a small car as `draw_small_car` does, but with laws of other formulas, as real authors publish them.

    Pacejka tyres, slip angles that are regularised otherwise, a dead zone that ends smoothly, a dry friction that sets
    in slowly beside a quadratic part of negative sign, a linkage that bends towards a limit of its own on either side
    and is off centre, a servo of second order; half of the cars have a nearly dry drag of the steered wheels, and all
    `with_dry_steered_drag`.
    """
    car = draw_small_car(rng, lacking=("steering_drag", "steering_side_gain", "steering_nonlinearity",
                                       "tyre_soft_saturation"))  # fmt: skip
    p, lock = car.plant, WIDER_LOCK * car.plant.angle_limit
    # at full lock the linkage turns less than its slope says: to one side by about a fifth, to the other by a third
    left, right = rng.permutation(lock / np.array([rng.uniform(0.8, 1.0), rng.uniform(1.2, 1.4)]))
    laws = {
        "zone_steepness": rng.uniform(80.0, 150.0), "dry_speed": rng.uniform(0.1, 0.16),
        "rolling_drag_2": -rng.uniform(0.03, 0.08) * p.mass, "front_magic": rng.uniform(0.8, 1.4),
        "rear_magic": rng.uniform(0.8, 1.4), "magic_curvature": rng.uniform(-0.5, 0.5),
        "slip_fade": rng.uniform(2.0, 4.0), "angle_limit": lock, "left_reach": left, "right_reach": right,
        "linkage_centre": rng.choice([-1.0, 1.0]) * rng.uniform(0.004, 0.012), "servo_damping": rng.uniform(0.65, 1.0),
        "dry_steered_rise": rng.uniform(0.2, 0.4),
    }  # fmt: skip
    friction = rng.uniform(1.2, 2.8) * p.mass
    if rng.random() < 0.5 or with_dry_steered_drag:
        laws["dry_steered_drag"] = friction
    return car._replace(plant=p._replace(**{name: float(value) for name, value in laws.items()}))
