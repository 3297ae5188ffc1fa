"""Newton-Euler, fitted: the car of `bcid.physics.car` with the constants that predict best."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numba
import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_parallel
from bcid.models.interface import Arrays, CompiledModel, FitTask, History, ScanKernels, build_scan_kernels
from bcid.models.newton_euler.objective import CARS_PER_CHUNK
from bcid.models.newton_euler.parameters import constant_lines
from bcid.models.newton_euler.saved_car import SavedNewtonEuler
from bcid.models.saved_parts import check_arrays, parse_saved
from bcid.physics.car import STEP_MARGIN, Car, advance_cars, advance_period, rk4_step, with_brake


@njit
def _scan_newton_euler(carry: Floats, parts: Floats, p: Car, longest: float) -> Floats:
    """Twists (N, 3) of one Newton-Euler car (rigid body with tyres) after N periods of commands `parts` (N, W, 4).

    `carry` (4,) is the state [v_x, v_y, yaw rate, delta]: the first on entry, the last on return.  A part is
    [duration (s), u_s (rad), u_m, brake share]; one beyond `longest` (s) is integrated in two RK4 steps, others in one.
    """
    twists = np.empty((len(parts), 3))
    state = (carry[0], carry[1], carry[2], carry[3])
    for k in range(len(parts)):
        for j in range(parts.shape[1]):
            duration, u_s, u_m = parts[k, j, 0], parts[k, j, 1], parts[k, j, 2]
            q = with_brake(p, parts[k, j, 3])
            if duration > longest:
                state = advance_period(state, u_s, u_m, q, duration)
            elif duration > 0.0:
                state = rk4_step(state, u_s, u_m, q, duration)
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
    if p.sets_force:
        motor, brake = "F_m = K_t (u_m - u_0) - K_v v_w for u_m > u_0", "u_m K_b v_w for u_m < 0"
    else:
        motor = "F_m = clip(K_t (u_m - v_w), 0, F_m_max) for u_m >= 0"
        brake = "clip(u_m K_b v_w, +-F_m_max) for u_m < 0"
    motor = motor if p.reverses else f"{motor}, {brake}"
    return [
        "v_x' = F_x/m + w v_y,  v_y' = F_y/m - w v_x,  w' = M_z/I_z",
        "delta' = sat((u_s - delta)/T_s) within +-d",
        "F_x = cos(delta) (F_m - F_d) - sin(delta) F_af",
        "F_y = sin(delta) (F_m - F_d) + cos(delta) F_af + F_ar",
        "M_z = l_f (sin(delta) (F_m - F_d) + cos(delta) F_af) - l_r F_ar",
        f"{motor},  F_d = R_1 v_w + R_2 v_w |v_w|",
        *(["backward the motor is as forward: F_m(u_m, v_w) = -F_m(-u_m, -v_w) for u_m < 0"] if p.reverses else []),
        "F_ai = clip(-C_i a_i, +-F_i_max),  a_i = arctan(v_iy / max(|v_ix|, v_0)),  i = f, r",
        f"w: yaw rate; v_w: rolling speed of the driven wheel; front share {p.front_share:g}",
    ]


@dataclass(frozen=True)
class NewtonEuler(CompiledModel):
    """The fitted Newton-Euler model; its carry is [v_x, v_y, w, delta]."""

    car: Car
    period_s: float
    facts: Mapping[str, Any]  # how it was fitted: optimiser, objective, parameters at a bound
    kernels: ClassVar[ScanKernels] = build_scan_kernels(_scan_newton_euler)
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
        """The car and the longest RK4 step, as the compiled scans take them."""
        return (self.car, (0.5 + STEP_MARGIN) * self.period_s)

    def scan_many(self, carries: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """Advance B vehicles (B, n) under `commands`, (B, N, 2) or parts (B, N, W, 4): last carries, twists (B, N, 3).

        Where each command holds for a whole period, the cars advance side by side in vector registers.
        """
        if commands.ndim == 4 and (commands.shape[2] > 1 or commands[..., 3].any()):
            return super().scan_many(carries, commands)
        after = np.array(carries, dtype=np.float64, order="C")
        held = np.ascontiguousarray(commands if commands.ndim == 3 else commands[:, :, 0, 1:3], dtype=np.float64)
        return after, _scan_newton_euler_batch(after, held, self.car, self.period_s)

    def describe(self) -> str:
        """The equations and the table of constants, fitted ones marked with *."""
        return "\n".join([*equation_lines(self.car), *constant_lines(self.car, self.facts)])

    def to_saved(self) -> tuple[dict[str, Any], Arrays]:
        """The JSON object from which `from_saved` restores the model; no arrays."""
        return {"car": self.car._asdict(), "period_s": self.period_s, "facts": dict(self.facts)}, {}

    @classmethod
    def from_saved(cls, data: Mapping[str, Any], arrays: Arrays) -> Self:
        """The model that `to_saved` gave `data` of.

        Raises:
            ValueError: it holds anything that no such model has.
        """
        check_arrays(arrays, {})
        saved = parse_saved(SavedNewtonEuler, data)
        return cls(saved.car.to_car(), saved.period_s, saved.facts.as_mapping())
