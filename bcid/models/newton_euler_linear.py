"""The linearised Newton-Euler model: small angles, constant forward speed (paper, fig. original_newton_euler).

    v_x' = (K_t (u_m - v_x) - R v_x)/m
    v_y' = -(C_f + C_r)/(m v) v_y + ((C_r l_r - C_f l_f)/(m v) - v) w + C_f/m delta
    w'   = (C_r l_r - C_f l_f)/(I_z v) v_y - (C_f l_f^2 + C_r l_r^2)/(I_z v) w + C_f l_f/I_z delta

with v the mean forward speed driven and R = R_1 + 2 R_2 v the drag's slope there; below zero u_m
brakes with u_m K_b v.  Its constants are those of the fitted Newton-Euler model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from bcid.compiled import njit
from bcid.models.interface import Arrays, FitTask, Floats, History
from bcid.models.newton_euler import Car, NewtonEuler
from bcid.models.samples import transitions
from bcid.physics.steering import steering_step


class Linear(NamedTuple):
    """x' = A x + B [drive, delta] + a, x = [v_x, v_y, w]; drive is u_m above zero and below."""

    A: Floats  # (3, 3)
    b_throttle: float  # v_x' per u_m >= 0
    b_brake: float  # v_x' per u_m < 0
    b_delta: Floats  # (3,)
    offset: float  # v_x' with everything at zero
    T_s: float
    d: float


def linearise(p: Car, v: float) -> Linear:
    """The linear model of car `p` about straight driving at `v` (m/s)."""
    C, moment = p.C_f + p.C_r, p.C_r * p.l_r - p.C_f * p.l_f
    A = np.zeros((3, 3))
    R = p.R_1 + 2.0 * p.R_2 * v
    gain = p.K_v if p.sets_force else p.K_t
    A[0, 0] = -(gain + R) / p.m
    A[1, 1], A[1, 2] = -C / (p.m * v), moment / (p.m * v) - v
    A[2, 1], A[2, 2] = moment / (p.I_z * v), -(p.C_f * p.l_f**2 + p.C_r * p.l_r**2) / (p.I_z * v)
    b_delta = np.array([0.0, p.C_f / p.m, p.C_f * p.l_f / p.I_z])
    offset = (p.R_2 * v * v - (p.K_t * p.u_0 if p.sets_force else 0.0)) / p.m
    return Linear(A, p.K_t / p.m, p.K_b * v / p.m, b_delta, offset, p.T_s, p.d)


@njit
def advance(x: Floats, delta: float, u_s: float, u_m: float, lin: Linear, period: float) -> tuple[Floats, float]:
    """Twist and steering angle one period later: RK4 in two substeps, as the full model."""
    after = steering_step(delta, u_s, lin.T_s, lin.d, period)
    drive = lin.b_throttle * u_m if u_m >= 0.0 else lin.b_brake * u_m
    h = 0.5 * period
    for half in range(2):
        angle = delta + (0.25 + 0.5 * half) * (after - delta)
        push = lin.b_delta * angle
        push[0] += drive + lin.offset
        k1 = np.dot(lin.A, x) + push
        k2 = np.dot(lin.A, x + 0.5 * h * k1) + push
        k3 = np.dot(lin.A, x + 0.5 * h * k2) + push
        k4 = np.dot(lin.A, x + h * k3) + push
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return x, after


@njit
def _scan(carry: Floats, commands: Floats, lin: Linear, period: float) -> Floats:
    twists = np.empty((len(commands), 3))
    x, delta = carry[:3].copy(), carry[3]
    for k in range(len(commands)):
        x, delta = advance(x, delta, commands[k, 0], commands[k, 1], lin, period)
        twists[k] = x
    return twists


@dataclass(frozen=True)
class NewtonEulerLinear:
    """The linearisation of a fitted Newton-Euler model."""

    car: Car
    speed_mps: float
    period_s: float
    name: ClassVar[str] = "newton-euler-linear"
    lags: ClassVar[int] = 0

    @property
    def parameter_count(self) -> int:
        """Constants that enter: I_z, C_f, C_r, K_t, K_b, R and the speed."""
        return 7

    @property
    def linear(self) -> Linear:
        """The matrices."""
        return linearise(self.car, self.speed_mps)

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """Linearise the fitted Newton-Euler model at the mean forward speed of the training takes."""
        if not isinstance(task.base, NewtonEuler):
            raise TypeError("newton-euler-linear is derived from a fitted newton-euler model")
        forward = transitions(task.estimates).twist[:, 0, 0]
        speed = float(forward[forward > 0.0].mean()) if np.any(forward > 0.0) else 0.0
        return cls(task.base.car, max(speed, 0.1), task.period_s)

    def init(self, history: History) -> Floats:
        """[v_x, v_y, w, delta]."""
        return np.append(history.twist[-1], history.kinematic[-1, 3])

    def step(self, carry: Floats, command: Floats) -> tuple[Floats, Floats]:
        """See `Model.step`."""
        x, delta = advance(carry[:3].copy(), carry[3], command[0], command[1], self.linear, self.period_s)
        return np.append(x, delta), x

    def scan(self, carry: Floats, commands: Floats) -> Floats:
        """See `Model.scan`."""
        twists: Floats = _scan(carry, commands, self.linear, self.period_s)
        return twists

    def describe(self) -> str:
        """The matrices with their units."""
        lin = self.linear
        rows = "\n".join("  [" + "  ".join(f"{a:9.4f}" for a in row) + "]" for row in lin.A)
        return (
            f"[v_x v_y w]' = A [v_x v_y w] + b_delta delta + b_m u_m, about {self.speed_mps:.3f} m/s (SI)\n"
            f"A =\n{rows}\n"
            f"b_delta = {np.array2string(lin.b_delta, precision=4)}\n"
            f"v_x' gains {lin.b_throttle:.4f} 1/s per u_m >= 0, {lin.b_brake:.4f} m/s^2 per u_m < 0"
        )

    def state(self) -> tuple[dict[str, Any], Arrays]:
        """See `Model.state`."""
        return {"car": self.car._asdict(), "speed_mps": self.speed_mps, "period_s": self.period_s}, {}

    @classmethod
    def from_state(cls, data: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> Self:
        """See `Model.from_state`."""
        return cls(Car(**data["car"]), data["speed_mps"], data["period_s"])
