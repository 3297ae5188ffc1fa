"""What a prediction needs beside initial states: the car, the effect switches and the commands after the actuators."""

import math
from typing import Any, NamedTuple

from bcid.aliases import Floats, Switches
from bcid.effects.actuators import ActuatorChain, actuator_chain
from bcid.effects.constants import Constants
from bcid.effects.measurement import to_pose_clock
from bcid.effects.table import NO_FUNCTIONS
from bcid.likelihood.take import Take
from bcid.likelihood.tracking_functions import NO_TRACKING
from bcid.physics.car import Car

CHAIN_SWITCHES = (
    "steering_backlash__b", "steering_dead_band__b", "steering_delay__tau", "steering_lag__tau",
    "steering_rate_asymmetry__a", "motor_delay__tau", "throttle_timing__tau", "pose_latency__tau", "clock_drift__rho",
)  # fmt: skip
"""The effect switches on which the actuator chain depends."""

CHAIN_CACHE_SIZE = 4
_CHAINS: dict[Any, tuple[tuple[Floats, ...], ActuatorChain]] = {}


class PredictionInputs(NamedTuple):
    """All that a prediction needs beside initial states and pushes."""

    car: Car
    switches: Switches  # record of the effects' parameters
    chain: ActuatorChain
    constants: Constants
    functions: Floats = NO_FUNCTIONS  # (K, COLUMNS) without a name that act on the body: the switches have them, too
    tracking: Floats = NO_TRACKING  # functions (M, TRACKING_COLUMNS) without a name that are added to seen poses
    known_tracking: Floats = NO_TRACKING  # those of a simulation, likewise

    @property
    def kernel_arguments(self) -> tuple[ActuatorChain, Car, Any, Constants]:
        """The inputs as the compiled loops over segments take them, the switches as an array of one record."""
        return self.chain, self.car, self.switches.reshape(1), self.constants


class ChangedCars(NamedTuple):
    """The car, and cars with one constant changed each, by which predictions are differentiated."""

    cars: Floats  # (R + 1, 22) constants in the order of `Car`, the car's own first
    widths: Floats  # (R,) changes of the parameters


def covering_steps(T: float, h: float) -> int:
    """Number of integration steps of `h` s that cover a recording of `T` s, with two to spare: ceil(T/h) + 2."""
    return math.ceil(T / h) + 2


def cached_actuator_chain(take: Take, car: Car, angle_limit: float, switches: Switches) -> ActuatorChain:
    """Steering angles and throttles of `car` at each integration step of `take`: commands after delays and servo.

    Steering is limited to +-`angle_limit` (rad).  Commands are shifted onto the poses' clock by the pose latency and
    clock drift in `switches` (the effects' parameters).  The last CHAIN_CACHE_SIZE results are cached by all inputs.
    """
    acting = tuple(getattr(switches, name) for name in CHAIN_SWITCHES)
    commands = take.command_s, take.command_zero_s, take.command
    key = (*map(id, commands), take.T, take.h, car.T_s, car.d, angle_limit, acting)
    if key not in _CHAINS:
        zero, steps = take.command_zero_s, covering_steps(take.T, take.h)
        times = zero + to_pose_clock(take.command_s - zero, switches)
        chain = actuator_chain(times, take.command, 0.0, steps, take.h, car, angle_limit, switches)
        if len(_CHAINS) >= CHAIN_CACHE_SIZE:
            _CHAINS.pop(next(iter(_CHAINS)))
        _CHAINS[key] = commands, chain  # the commands are kept, so that their ids stay theirs
    return _CHAINS[key][1]
