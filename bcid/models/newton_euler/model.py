"""Newton-Euler, fitted: the car of `bcid.physics.car` with the constants that predict best."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numba
import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_parallel
from bcid.models.interface import Arrays, FitTask, History, Kernels, Scanned
from bcid.physics.car import Car, advance, advance_all

ABREAST = 256  # vehicles whose states advance together: few enough to stay in the nearest cache


@njit
def _scan(carry: Floats, commands: Floats, p: Car, period: float) -> Floats:
    twists = np.empty((len(commands), 3))
    state = (carry[0], carry[1], carry[2], carry[3])
    for k in range(len(commands)):
        state = advance(state, commands[k, 0], commands[k, 1], p, period)
        twists[k, 0], twists[k, 1], twists[k, 2] = state[0], state[1], state[2]
    carry[0], carry[1], carry[2], carry[3] = state
    return twists


@njit_parallel
def _scan_many(carries: Floats, commands: Floats, p: Car, period: float) -> Floats:
    B, N = commands.shape[:2]
    twists = np.empty((B, N, 3))
    for chunk in numba.prange((B + ABREAST - 1) // ABREAST):
        rows = slice(chunk * ABREAST, min((chunk + 1) * ABREAST, B))
        state, driven = carries[rows].T.copy(), np.empty((2, rows.stop - rows.start))
        for k in range(N):
            driven[:] = commands[rows, k].T
            advance_all(state, driven, p, period)
            twists[rows, k] = state[:3].T
        carries[rows] = state.T
    return twists


def equation_lines(p: Car) -> list[str]:
    """The equations of the car."""
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
class NewtonEuler(Scanned):
    """The fitted Newton-Euler model."""

    car: Car
    period_s: float
    facts: Mapping[str, Any]  # how it was fitted: optimiser, objective, parameters at a bound
    kernels: ClassVar[Kernels] = Kernels(_scan, _scan_many)
    name: ClassVar[str] = "newton-euler"
    lags: ClassVar[int] = 0

    @property
    def parameter_count(self) -> int:
        """The fitted parameters; the vehicle file's are not counted."""
        return len(self.facts.get("fitted", {}))

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """The constants whose predictions of the twist are best (paper, App. parameters, and `NewtonEulerSettings`)."""
        from bcid.models.newton_euler.fit_to_poses import fit_car_to_poses
        from bcid.models.newton_euler.fit_to_twists import fit_car

        car, facts = (fit_car_to_poses if task.settings.get("loss") == "poses" else fit_car)(task)
        return cls(car, task.period_s, facts)

    def in_steps_of(self, period_s: float) -> Self:
        """See `Continuous`."""
        return replace(self, period_s=period_s)

    def init(self, history: History) -> Floats:
        """[v_x, v_y, w, delta]."""
        return np.append(history.twist[-1], history.kinematic[-1, 3])

    @property
    def arguments(self) -> tuple[Any, ...]:
        """See `Scanned`."""
        return (self.car, self.period_s)

    def describe(self) -> str:
        """The equations and the table of constants, fitted ones marked with *."""
        from bcid.models.newton_euler.parameters import parameter_lines

        return "\n".join([*equation_lines(self.car), *parameter_lines(self.car, self.facts)])

    def state(self) -> tuple[dict[str, Any], Arrays]:
        """See `Model.state`."""
        return {"car": self.car._asdict(), "period_s": self.period_s, "facts": dict(self.facts)}, {}

    @classmethod
    def from_state(cls, data: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> Self:
        """See `Model.from_state`."""
        return cls(Car(**data["car"]), data["period_s"], data["facts"])
