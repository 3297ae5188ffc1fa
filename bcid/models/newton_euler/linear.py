"""The linearised Newton-Euler model: small angles, constant forward speed (paper, fig. original_newton_euler).

    v_x' = (K_t (u_m - v_x) - R v_x)/m
    v_y' = -(C_f + C_r)/(m s) v_y + ((C_r l_r - C_f l_f)/(m s) - v) w + C_f v/(m s) delta
    w'   = (C_r l_r - C_f l_f)/(I_z s) v_y - (C_f l_f^2 + C_r l_r^2)/(I_z s) w + C_f l_f v/(I_z s) delta

with v the mean forward speed driven, s = max(v, v_0) by the advanced slip ratio, and R = R_1 + R_2 v, so
that rest stays rest.  Below zero u_m brakes: v_x' = (u_m K_b - R) v_x/m.  The constants are those of the
fitted Newton-Euler model.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple, Self

import numpy as np
from pydantic import Field

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.models.fitting.windows import single_steps
from bcid.models.interface import Arrays, CompiledModel, FitTask, History, ScanKernels, build_scan_kernels
from bcid.models.limits import LIMITS
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.saved_car import SavedCar
from bcid.models.saved_parts import Period, SavedPart, check_arrays, parse_saved
from bcid.physics.car import Car
from bcid.physics.steering import steering_step


class LinearCar(NamedTuple):
    """A linearised car: [v_y, w]' = A [v_y, w] + b delta, and the constants of v_x'."""

    A: Floats  # (2, 2)
    b: Floats  # (2,)
    throttle: float  # 1/s, v_x' per u_m above u_0
    follow: float  # 1/s, v_x' per -v_x while the throttle is on
    brake: float  # 1/s, v_x' per u_m v_x below zero
    drag: float  # 1/s, v_x' per -v_x
    u_0: float
    T_s: float
    d: float
    reverses: float  # 1 where a throttle below zero drives backward, 0 where it brakes


def linearise(p: Car, v: float) -> LinearCar:
    """Linearise the car `p` for small angles at the constant forward speed `v` (m/s): the linear single-track model.

    [v_y, w]' = A [v_y, w] + b delta, w the yaw rate, with v_x' apart (paper, fig. original_newton_euler).
    """
    s = max(v, p.v_0)
    C, moment = p.C_f + p.C_r, p.C_r * p.l_r - p.C_f * p.l_f
    damping = p.C_f * p.l_f**2 + p.C_r * p.l_r**2
    A = np.array([[-C / (p.m * s), moment / (p.m * s) - v], [moment / (p.I_z * s), -damping / (p.I_z * s)]])
    b = p.C_f * v / s * np.array([1.0 / p.m, p.l_f / p.I_z])
    follow = p.K_v if p.sets_force else p.K_t
    return LinearCar(
        A, b, p.K_t / p.m, follow / p.m, p.K_b / p.m, (p.R_1 + p.R_2 * v) / p.m, p.u_0, p.T_s, p.d, p.reverses
    )


@njit
def advance_linear(x: Floats, delta: float, command: Floats, lin: LinearCar, period: float) -> tuple[Floats, float]:
    """Twist x = [v_x, v_y, w] (m/s, rad/s) and steering angle (rad) of a linearised car one `period` (s) later.

    RK4 in two substeps from x and `delta` (rad) under the `command` (3,), u_s (rad), u_m
    and brake share.
    """
    u_s, u_m, brake_share = command[0], command[1], command[2]
    after = steering_step(delta, u_s, lin.T_s, lin.d, period)
    backward = u_m < 0.0 and lin.reverses > 0.0
    gain, push, u = (0.0 if backward else lin.brake * min(u_m, 0.0)) - lin.drag, 0.0, -u_m if backward else u_m
    if u > lin.u_0 or (u >= 0.0 and lin.u_0 == 0.0):
        gain, push = gain - lin.follow, lin.throttle * (u - lin.u_0)
    push = -push if backward else push
    gain -= lin.brake * brake_share
    M = np.zeros((3, 3))
    M[0, 0] = gain
    M[1:, 1:] = lin.A
    h = 0.5 * period
    for half in range(2):
        angle = delta + (0.25 + 0.5 * half) * (after - delta)
        c = np.array([push, lin.b[0] * angle, lin.b[1] * angle])
        k1 = np.dot(M, x) + c
        k2 = np.dot(M, x + 0.5 * h * k1) + c
        k3 = np.dot(M, x + 0.5 * h * k2) + c
        k4 = np.dot(M, x + h * k3) + c
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return x, after


@njit
def _scan_linear(carry: Floats, parts: Floats, lin: LinearCar) -> Floats:
    """Twists (N, 3) of one linearised car after N periods of commands `parts` (N, W, 4).

    `carry` (4,) is the state [v_x, v_y, yaw rate, delta]: the first on entry, the last on return.
    """
    twists = np.empty((len(parts), 3))
    x, delta = carry[:3].copy(), carry[3]
    for k in range(len(parts)):
        for j in range(parts.shape[1]):
            if parts[k, j, 0] > 0.0:
                x, delta = advance_linear(x, delta, parts[k, j, 1:], lin, parts[k, j, 0])
        twists[k] = x
    carry[:3], carry[3] = x, delta
    return twists


class SavedLinear(SavedPart):
    """The JSON part of a saved linearisation."""

    car: SavedCar
    speed_mps: Annotated[float, Field(gt=0.0, le=LIMITS.fastest_twist[0])]
    period_s: Period


@dataclass(frozen=True)
class NewtonEulerLinear(CompiledModel):
    """The linearisation of a fitted Newton-Euler model; its carry is [v_x, v_y, w, delta]."""

    car: Car
    speed_mps: float
    period_s: float
    kernels: ClassVar[ScanKernels] = build_scan_kernels(_scan_linear)
    name: ClassVar[str] = "newton-euler-linear"

    @property
    def parameter_count(self) -> int:
        """How many constants enter: I_z, C_f, C_r, K_t, K_b, R and the speed."""
        return 7

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """Linearise the fitted Newton-Euler model at the mean forward speed of the training takes."""
        if not isinstance(task.base, NewtonEuler):
            raise TypeError("newton-euler-linear is derived from a fitted newton-euler model")
        forward = single_steps(task.estimates).twist[:, 0, 0]
        speed = float(forward[forward > 0.0].mean()) if np.any(forward > 0.0) else 0.0
        return cls(task.base.car, max(speed, 0.1), task.period_s)

    def init(self, history: History) -> Floats:
        """The carry [v_x, v_y, w, delta] at the history's last row."""
        return np.append(history.twist[-1], history.kinematic[-1, 3])

    @property
    def kernel_arguments(self) -> tuple[Any, ...]:
        """The linearised car, as the compiled scan takes it."""
        return (linearise(self.car, self.speed_mps),)

    def describe(self) -> str:
        """The linear equations with their values (SI)."""
        lin = linearise(self.car, self.speed_mps)
        (a, b), (c, d) = lin.A
        start = f" - {lin.u_0:.3g}" if lin.u_0 else ""
        lines = [
            f"about straight driving at {self.speed_mps:.3f} m/s (v in m/s, w in rad/s, delta in rad, rates per s)",
            f"v_x' = {lin.throttle:.4g} (u_m{start}) - {lin.follow + lin.drag:.4g} v_x   throttle on",
            f"v_x' = ({'' if lin.reverses else f'{lin.brake:.4g} min(0, u_m) '}- {lin.drag:.4g}) v_x   otherwise",
            f"v_y' = {a:.4g} v_y {b:+.4g} w {lin.b[0]:+.4g} delta",
            f"w'   = {c:.4g} v_y {d:+.4g} w {lin.b[1]:+.4g} delta",
            f"delta' = sat((u_s - delta)/{lin.T_s:g} s) within +-{lin.d:g} rad/s",
        ]
        return "\n".join(lines)

    def to_saved(self) -> tuple[dict[str, Any], Arrays]:
        """The JSON object from which `from_saved` restores the model; no arrays."""
        return {"car": self.car._asdict(), "speed_mps": self.speed_mps, "period_s": self.period_s}, {}

    @classmethod
    def from_saved(cls, data: Mapping[str, Any], arrays: Arrays) -> Self:
        """The model that `to_saved` gave `data` of.

        Raises:
            ValueError: it holds anything that no such model has.
        """
        check_arrays(arrays, {})
        saved = parse_saved(SavedLinear, data)
        return cls(saved.car.to_car(), saved.speed_mps, saved.period_s)
