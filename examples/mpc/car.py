"""The car that is driven: bcid's independent simulation, stepped at its own 480 Hz under commands as they come."""

import math

import numpy as np

from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import ROUGHNESS_TIME_S
from bcid.simulation.dynamics import STATE_SIZE, STEPS_PER_S, advance_plant
from bcid.simulation.wheels import PlantInputs

WHOLE_TAKE_S = 1000.0
"""Length of a take that nothing here reaches, for effects that come with a share of it."""


class SimulatedCar:
    """A simulated car from rest at a pose, its motion capture, and the floor's random force, drawn from a seed."""

    def __init__(self, plant: Plant, sensor: Sensor, pose: np.ndarray, seed: int) -> None:
        self.plant, self.sensor = plant, sensor
        self._floor, self._noise = np.random.default_rng([seed, 1]), np.random.default_rng([seed, 2])
        self._s, self._play, self._push = np.zeros(STATE_SIZE), 0.0, np.zeros(3)
        self._s[:3] = pose
        self._sent: list[tuple[float, float]] = []  # a command for each fine step so far

    @property
    def pose(self) -> np.ndarray:
        """True x, y (m) and yaw (rad)."""
        return self._s[:3].copy()

    @property
    def speed(self) -> float:
        """True speed (m/s) of the centre of gravity."""
        return math.hypot(self._s[3], self._s[4])

    @property
    def servo_angle(self) -> float:
        """True angle (rad) of the steering servo."""
        return float(self._s[6])

    def measure_pose(self) -> np.ndarray:
        """The pose (3,) as the motion capture sees it now."""
        sd = [self.sensor.position_noise, self.sensor.position_noise, self.sensor.yaw_noise]
        return self.pose + self._noise.standard_normal(3) * sd

    def advance(self, u: np.ndarray, seconds: float) -> None:
        """Drive on for whole fine steps in `seconds`, the command `u` (2,) sent at their beginning and held."""
        p = self.plant
        keep = math.exp(-1.0 / (STEPS_PER_S * ROUGHNESS_TIME_S))
        late = [round(delay * STEPS_PER_S) for delay in (p.steering_delay, p.motor_delay)]
        for _ in range(round(seconds * STEPS_PER_S)):
            now = len(self._sent)
            self._sent.append((float(u[0]), float(u[1])))
            # before the first command has come through, the wheel is held straight and the motor off
            steer, drive = (self._sent[now - k][c] if now >= k else 0.0 for c, k in enumerate(late))
            self._push = keep * self._push + math.sqrt(1.0 - keep**2) * self._floor.standard_normal(3)
            x, y, turn = self._push * [p.rough_force, p.rough_force, p.rough_moment]
            inputs = PlantInputs(now / STEPS_PER_S, WHOLE_TAKE_S, steer, drive, x, y, turn)
            self._s, self._play = advance_plant(self._s, self._play, inputs, 1.0 / STEPS_PER_S, p)
