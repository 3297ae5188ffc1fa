"""What the estimator assumes: noise of process and sensors, and the steering's time constant and rate limit."""

from typing import Literal

import numpy as np
from pydantic import ConfigDict

from bcid.aliases import Floats
from bcid.documents.document import Document, Part

Origin = Literal["given", "identified", "default"]
"""Where a constant comes from: the vehicle file, the recordings, or the documented default."""


class Noise(Part):
    """Square roots of the process noise's spectral densities (q) and standard deviations of the sensors (r).

    The paper states none of them (errata 18); the defaults are where their identification starts.
    """

    model_config = ConfigDict(extra="forbid")

    q_v_f: float = 1.0  # m/s per sqrt(s)
    q_beta_f: float = 1.0  # rad per sqrt(s)
    q_beta_r: float = 0.2  # rad per sqrt(s)
    q_delta: float = 0.01  # rad per sqrt(s); keeps the smoother's covariances regular
    r_position: float = 1e-3  # m
    r_yaw: float = 2e-3  # rad
    r_steering: float = 0.01  # rad, where a steering angle is measured
    r_yaw_rate: float = 0.02  # rad/s, gyro
    r_wheel_speed: float = 0.05  # m/s

    def Q(self) -> Floats:
        """Spectral density matrix (7, 7) of the process noise, in the order of the EKF's state; SI units per second."""
        return np.diag(np.array([0.0, 0.0, 0.0, self.q_v_f, self.q_beta_f, self.q_beta_r, self.q_delta]) ** 2)

    def R(self) -> Floats:
        """Variances (6,) of the measured quantities, in the order of `process.MEASURED`; SI units squared."""
        p = self.r_position
        return np.array([p, p, self.r_yaw, self.r_steering, self.r_yaw_rate, self.r_wheel_speed]) ** 2


class SteeringOrigin(Part):
    """Where the steering's constants come from, and whether their identification can be relied on."""

    T_s: Origin = "given"
    d: Origin = "given"
    at_bound: bool = False  # an identified constant stopped at a bound of its search
    rate_reached: bool | None = None  # the commands drive the steering at d; None where nothing was identified

    @property
    def poorly_identified(self) -> bool:
        """Whether a constant stopped at its bound, or d was identified from commands that never reach it."""
        return self.at_bound or (self.d == "identified" and not self.rate_reached)


class Tuning(Document):
    """The estimator's constants (tuning.json): noise, steering constants T_s (s) and d (rad/s), and their origin."""

    model_config = ConfigDict(extra="forbid")

    noise: Noise
    T_s: float
    d: float
    steering: SteeringOrigin = SteeringOrigin()
    noise_at_bound: tuple[str, ...] = ()  # fields of Noise whose search stopped at a bound

    def describe_steering(self) -> list[tuple[str, str]]:
        """Names and values of T_s and d as text, with their origin, and what makes the tuning doubtful."""
        origin = self.steering
        lines = [("T_s", f"{self.T_s:.3g} s ({origin.T_s})"), ("d", f"{self.d:.3g} rad/s ({origin.d})")]
        if origin.poorly_identified:
            lines.append(("steering", "at its bound or never driven to its rate limit: not well identified"))
        if self.noise_at_bound:
            lines.append(("noise at its bound", ", ".join(self.noise_at_bound)))
        return lines
