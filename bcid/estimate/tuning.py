"""What the estimator assumes: noise of process and sensors, and the steering's time constant and rate limit."""

from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field

from bcid.aliases import Floats
from bcid.documents.document import Document, Interval, Part
from bcid.estimate.limits import LIMITS

Origin = Literal["given", "identified", "default"]
"""Where a constant comes from: the vehicle file, the recordings, or the documented default."""

NoiseValue = Annotated[float, Field(ge=LIMITS.min_noise, le=LIMITS.max_noise)]
SteeringConstant = Annotated[float, Field(ge=LIMITS.min_steering, le=LIMITS.max_steering)]


class Noise(Part):
    """Square roots of the process noise's spectral densities (q) and standard deviations of the sensors (r).

    The paper states none of them (errata 18); the defaults are where their identification starts.
    """

    model_config = ConfigDict(extra="forbid")

    q_v_f: NoiseValue = 1.0  # m/s per sqrt(s)
    q_beta_f: NoiseValue = 1.0  # rad per sqrt(s)
    q_beta_r: NoiseValue = 0.2  # rad per sqrt(s)
    q_delta: NoiseValue = 0.01  # rad per sqrt(s); keeps the smoother's covariances regular
    r_position: NoiseValue = 1e-3  # m
    r_yaw: NoiseValue = 2e-3  # rad
    r_steering: NoiseValue = 0.01  # rad, where a steering angle is measured
    r_yaw_rate: NoiseValue = 0.02  # rad/s, gyro
    r_wheel_speed: NoiseValue = 0.05  # m/s

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
    at_bound: tuple[str, ...] = ()  # identified constants that stopped at a bound of their search
    rate_reached: bool | None = None  # the commands drive the steering at d; None where it was not sought
    T_s_ci95: Interval | None = None  # s, of what was identified
    d_ci95: Interval | None = None  # rad/s

    def describe(self, name: Literal["T_s", "d"]) -> str:
        """The origin of a constant in words, with its 95 % interval, or why there is none."""
        origin, ends = (self.T_s, self.T_s_ci95) if name == "T_s" else (self.d, self.d_ci95)
        if name in self.at_bound:
            return f"{origin}, at the bound of its search: no interval"
        if origin == "default":
            return "default: the turning does not tell it"
        return origin if ends is None else f"{origin}, 95 %: {ends[0]:.3g} to {ends[1]:.3g}"


class Tuning(Document):
    """The estimator's constants (tuning.json): noise, steering constants T_s (s) and d (rad/s), and their origin."""

    model_config = ConfigDict(extra="forbid")

    noise: Noise
    T_s: SteeringConstant
    d: SteeringConstant
    steering: SteeringOrigin = SteeringOrigin()
    noise_at_bound: tuple[str, ...] = ()  # fields of Noise whose search stopped at a bound

    def describe_steering(self) -> list[tuple[str, str]]:
        """Names and values of T_s and d as text, with their origin, and what makes the tuning doubtful."""
        origin = self.steering
        lines = [
            ("T_s", f"{self.T_s:.3g} s ({origin.describe('T_s')})"),
            ("d", f"{self.d:.3g} rad/s ({origin.describe('d')})"),
        ]
        if origin.rate_reached is False:
            lines.append(("steering", "never driven to its rate limit, which is not identified"))
        if origin.at_bound:
            lines.append(("steering", f"{' and '.join(origin.at_bound)} at a bound: not well identified"))
        if self.noise_at_bound:
            lines.append(("noise at its bound", ", ".join(self.noise_at_bound)))
        return lines
