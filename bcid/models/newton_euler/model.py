"""Newton-Euler, fitted: the car of `bcid.physics.car` with the constants that predict best."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numba
import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_parallel
from bcid.models.interface import Arrays, CompiledModel, FitTask, History, ScanKernels
from bcid.models.newton_euler.objective import CARS_PER_CHUNK
from bcid.models.newton_euler.parameters import constant_lines
from bcid.physics.car import Car, advance_cars, advance_period


@njit
def _scan_newton_euler(carry: Floats, commands: Floats, p: Car, period: float) -> Floats:
    """Twists (N, 3) of one Newton-Euler car (rigid body with tyres) after each of `commands` (N, 2), [u_s (rad), u_m].

    `carry` (4,) is the state [v_x, v_y, yaw rate, delta]: the first on entry, the last on return.
    """
    twists = np.empty((len(commands), 3))
    state = (carry[0], carry[1], carry[2], carry[3])
    for k in range(len(commands)):
        state = advance_period(state, commands[k, 0], commands[k, 1], p, period)
        twists[k, 0], twists[k, 1], twists[k, 2] = state[0], state[1], state[2]
    carry[0], carry[1], carry[2], carry[3] = state
    return twists


@njit_parallel
def _scan_newton_euler_batch(carries: Floats, commands: Floats, p: Car, period: float) -> Floats:
    """Twists (B, N, 3) of B Newton-Euler cars under `commands` (B, N, 2), in chunks on all cores.

    `carries` (B, 4) are their states [v_x, v_y, yaw rate, delta]: the first on entry, the last on return.
    """
    B, N = commands.shape[:2]
    twists = np.empty((B, N, 3))
    for chunk in numba.prange((B + CARS_PER_CHUNK - 1) // CARS_PER_CHUNK):
        rows = slice(chunk * CARS_PER_CHUNK, min((chunk + 1) * CARS_PER_CHUNK, B))
        state, command = carries[rows].T.copy(), np.empty((2, rows.stop - rows.start))
        for k in range(N):
            command[:] = commands[rows, k].T
            advance_cars(state, command, p, period)
            twists[rows, k] = state[:3].T
        carries[rows] = state.T
    return twists


def equation_lines(p: Car) -> list[str]:
    """The equations of a Newton-Euler car in print, one a line, with the motor's for its law (speed or force)."""
    motor = (
        "F_m = K_t (u_m - u_0) - K_v v_w for u_m > u_0, u_m K_b v_w for u_m < 0"
        if p.sets_force
        else "F_m = clip(K_t (u_m - v_w), 0, F_m_max) for u_m >= 0, clip(u_m K_b v_w, +-F_m_max) for u_m < 0"
    )
    return [
        "v_x' = F_x/m + w v_y,  v_y' = F_y/m - w v_x,  w' = M_z/I_z",
        "delta' = sat((u_s - delta)/T_s) within +-d",
        "F_x = cos(delta) (F_m - F_d) - sin(delta) F_af",
        "F_y = sin(delta) (F_m - F_d) + cos(delta) F_af + F_ar",
        "M_z = l_f (sin(delta) (F_m - F_d) + cos(delta) F_af) - l_r F_ar",
        f"{motor},  F_d = R_1 v_w + R_2 v_w |v_w|",
        "F_ai = clip(-C_i a_i, +-F_i_max),  a_i = arctan(v_iy / max(|v_ix|, v_0)),  i = f, r",
        f"w: yaw rate; v_w: rolling speed of the driven wheel; front share {p.front_share:g}",
    ]


@dataclass(frozen=True)
class NewtonEuler(CompiledModel):
    """The fitted Newton-Euler model; its carry is [v_x, v_y, w, delta]."""

    car: Car
    period_s: float
    facts: Mapping[str, Any]  # how it was fitted: optimiser, objective, parameters at a bound
    kernels: ClassVar[ScanKernels] = ScanKernels(_scan_newton_euler, _scan_newton_euler_batch)
    name: ClassVar[str] = "newton-euler"

    @property
    def parameter_count(self) -> int:
        """How many constants were fitted; those of the vehicle file do not count."""
        return len(self.facts.get("fitted", {}))

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """The car whose predictions of the twist are best, or for the loss "poses" the likeliest (App. parameters)."""
        from bcid.models.newton_euler.fit_to_poses import fit_car_to_poses
        from bcid.models.newton_euler.fit_to_twists import fit_car_to_twists

        car, facts = (fit_car_to_poses if task.settings.get("loss") == "poses" else fit_car_to_twists)(task)
        return cls(car, task.period_s, facts)

    def with_period(self, period_s: float) -> Self:
        """This car advancing by `period_s` (s) a step."""
        return replace(self, period_s=period_s)

    def init(self, history: History) -> Floats:
        """The carry [v_x, v_y, w, delta] at the history's last row."""
        return np.append(history.twist[-1], history.kinematic[-1, 3])

    @property
    def kernel_arguments(self) -> tuple[Any, ...]:
        """The car and the period, as the compiled scans take them."""
        return (self.car, self.period_s)

    def describe(self) -> str:
        """The equations and the table of constants, fitted ones marked with *."""
        return "\n".join([*equation_lines(self.car), *constant_lines(self.car, self.facts)])

    def to_saved(self) -> tuple[dict[str, Any], Arrays]:
        """The JSON object from which `from_saved` restores the model; no arrays."""
        return {"car": self.car._asdict(), "period_s": self.period_s, "facts": dict(self.facts)}, {}

    @classmethod
    def from_saved(cls, data: Mapping[str, Any], arrays: Arrays) -> Self:
        """The model that `to_saved` gave `data` of."""
        return cls(Car(**data["car"]), data["period_s"], data["facts"])
