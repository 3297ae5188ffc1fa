"""What the commands of a model mean: its throttle by the law of its motor, its steering up to where it is clipped."""

from __future__ import annotations

from typing import Any

from bcid.export.formulas import COMMANDS, Variable
from bcid.models.interface import Model
from bcid.models.kinematic.state import KinematicCar
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.physics.car import Car

SPEED = Variable("u_m", "m/s", "throttle: the speed that the motor aims at")
FORCE = Variable("u_m", "", "throttle: the share of full force")
MEASURED = Variable("u_m", "m/s", "the driven wheel's measured speed, below zero backward")
BACKWARD, BRAKE = "below zero backward", "below zero the share of full brake"
NO_OWN_BRAKE = "a brake with a command of its own stays off"


def commands_of(model: Model) -> tuple[Variable, Variable]:
    """The steering and the throttle of `model` with their units and meanings, by the names of `COMMANDS`."""
    return _steering_of(model), _throttle_of(getattr(model, "car", None))


def steering_limit_of(model: Model) -> float | None:
    """The angle (rad) at which `model` clips the steering command to either side; None where it clips none."""
    return model.angle_limit if isinstance(model, AugmentedNewtonEuler) else None


def _steering_of(model: Model) -> Variable:
    """The steering command."""
    steering, limit = COMMANDS[0], steering_limit_of(model)
    if limit is None:
        return steering
    return steering._replace(meaning=f"{steering.meaning}; clipped beyond {limit:.6g} rad to either side")


def _throttle_of(car: Any) -> Variable:
    """The throttle of a `Car`, of a `KinematicCar`, or of a model that knows neither."""
    match car:
        case Car() if car.follows_wheel > 0.0:
            throttle = MEASURED
        case Car():
            throttle = FORCE if car.sets_force > 0.0 else SPEED
            throttle = throttle._replace(meaning=f"{throttle.meaning}, {BACKWARD if car.reverses > 0.0 else BRAKE}")
        case KinematicCar():
            throttle = SPEED if car.follow > 0.0 else FORCE
            throttle = throttle._replace(meaning=f"{throttle.meaning}; below zero as in the data of the fit")
        case _:
            throttle = COMMANDS[1]
    return throttle._replace(meaning=f"{throttle.meaning}; {NO_OWN_BRAKE}")
