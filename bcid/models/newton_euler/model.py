"""Newton-Euler, fitted: the car of `bcid.physics.car` with the constants that predict best."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

import numba
import numpy as np

from bcid.aliases import Floats
from bcid.compiled.lanes import where
from bcid.compiled.njit import njit, njit_parallel
from bcid.compiled.rebuild import rebuild
from bcid.estimate.command_parts import hold_for_periods
from bcid.models.interface import Arrays, CompiledModel, FitTask, History, ScanKernels, build_scan_kernels
from bcid.models.newton_euler.parameters import constant_lines
from bcid.models.newton_euler.saved_car import SavedNewtonEuler
from bcid.models.saved_parts import check_arrays, parse_saved
from bcid.physics.car import STEP_MARGIN, Car, integration_step, rk4_step, step_cars, with_brake
from bcid.physics.elementary import arctan_ratio, arctan_ratio_by_jumps, sincos
from bcid.physics.elementary_single import arctan_ratio_single, sincos_single

CARS_ABREAST = 256
"""Cars whose states advance together: enough for long loops, and few enough for all of them to stay in the cache."""
REGISTER_BYTES = 64
"""Size of the largest vector register."""

rk4_step_by_jumps = rebuild(rk4_step, {arctan_ratio: arctan_ratio_by_jumps}, __name__)
"""`rk4_step`, to the last bit, for a rollout of one car."""


@njit
def _scan_newton_euler(carry: Floats, parts: Floats, p: Car, longest: float) -> Floats:
    """Twists (N, 3) of one Newton-Euler car (rigid body with tyres) after N periods of commands `parts` (N, W, 4).

    `carry` (4,) is the state [v_x, v_y, yaw rate, delta]: the first on entry, the last on return.  A part is
    [duration (s), u_s (rad), u_m, brake share], integrated in the fewest equal RK4 steps of at most `longest` (s).
    """
    twists = np.empty((len(parts), 3))
    state = (carry[0], carry[1], carry[2], carry[3])
    for k in range(len(parts)):
        for j in range(parts.shape[1]):
            h, u_s, u_m, brake = parts[k, j, 0], parts[k, j, 1], parts[k, j, 2], parts[k, j, 3]
            count = math.ceil(h / longest)
            h /= max(count, 1)
            for _ in range(count):
                state = rk4_step_by_jumps(state, u_s, u_m, with_brake(p, brake), h)
        twists[k, 0], twists[k, 1], twists[k, 2] = state[0], state[1], state[2]
    carry[0], carry[1], carry[2], carry[3] = state
    return twists


@njit
def _fill_steps(parts: Floats, k: int, j: int, period: float, first: Floats, second: Floats) -> bool:
    """Fill in the integration steps `first` and `second` (4, B) that part `j` of period `k` makes for B cars.

    A step is [length (s), u_s (rad), u_m, brake share].  `parts` are (B, N, W, 4), or (B, N, 1, 2) of commands that
    hold for a whole `period` (s).  A part of more than half a period makes two equal steps, any other one, and a
    second of length 0.  Returns whether any car has a second one.
    """
    longest = (0.5 + STEP_MARGIN) * period
    twice: bool = parts.shape[3] == 2
    for b in range(len(parts)):
        if parts.shape[3] == 2:
            first[0, b], first[1, b], first[2, b], first[3, b] = 0.5 * period, parts[b, k, j, 0], parts[b, k, j, 1], 0.0
        else:
            duration = parts[b, k, j, 0]
            first[1, b], first[2, b], first[3, b] = parts[b, k, j, 1], parts[b, k, j, 2], parts[b, k, j, 3]
            first[0, b] = where(duration > longest, 0.5 * duration, duration)
            second[0, b] = where(duration > longest, 0.5 * duration, 0.0)
            second[1, b], second[2, b], second[3, b] = first[1, b], first[2, b], first[3, b]
            twice = bool(twice or duration > longest)
    return twice


@njit_parallel
def _scan_newton_euler_batch(carries: Floats, parts: Floats, p: Car, period: float) -> Floats:
    """Twists (B, N, 3) of B Newton-Euler cars after N periods of commands `parts`, in chunks on all cores.

    `carries` (B, 4) are their states [v_x, v_y, yaw rate, delta]: the first on entry, the last on return; `parts` are
    those of `_fill_steps`.  The cars of a chunk advance side by side, in the precision of their states and constants.
    """
    B, N, W = parts.shape[:3]
    twists = np.empty((B, N, 3))
    for chunk in numba.prange((B + CARS_ABREAST - 1) // CARS_ABREAST):
        begin, end = chunk * CARS_ABREAST, min((chunk + 1) * CARS_ABREAST, B)
        # cars at rest fill up the last vector registers
        abreast = REGISTER_BYTES // carries.itemsize
        state = np.zeros((4, (end - begin + abreast - 1) // abreast * abreast), carries.dtype)
        first, second, own = np.zeros_like(state), np.zeros_like(state), twists[begin:end]
        for b in range(begin, end):
            for i in range(4):
                state[i, b - begin] = carries[b, i]
        for k in range(N):
            for j in range(W):
                twice = _fill_steps(parts[begin:end], k, j, period, first, second)
                step_cars(state, first, p)
                if twice:
                    step_cars(state, first if parts.shape[3] == 2 else second, p)
            v_x, v_y, omega = state[0], state[1], state[2]
            for b in range(end - begin):
                own[b, k, 0], own[b, k, 1], own[b, k, 2] = v_x[b], v_y[b], omega[b]
        for b in range(begin, end):
            for i in range(4):
                carries[b, i] = state[i, b - begin]
    return twists


_scan_newton_euler_batch_single = rebuild(
    _scan_newton_euler_batch, {sincos: sincos_single, arctan_ratio: arctan_ratio_single}, __name__, single=True
)
"""The batch in single precision, `carries` and the constants of the car included: off by 1e-6 (m/s, rad/s)."""


def _as_parts(commands: Floats) -> Floats:
    """`commands`, (B, N, 2) or parts (B, N, W, 4), as `_fill_steps` takes them."""
    return np.ascontiguousarray(commands if commands.ndim == 4 else commands[:, :, None], dtype=np.float64)


def _stable_step(p: Car) -> float:
    """The longest stable RK4 step (s) of a car that stiffly follows its wheel's speed; any step of another car.

    Cars under a motor that is told what to do are integrated in two steps a period, as in the paper.
    """
    return integration_step(p) if p.follows_wheel > 0.0 else math.inf


def equation_lines(p: Car) -> list[str]:
    """The equations of a Newton-Euler car in print, one a line, with the motor's for its law (speed or force)."""
    if p.sets_force:
        motor, brake = "F_m = K_t (u_m - u_0) - K_v v_w for u_m > u_0", "u_m K_b v_w for u_m < 0"
    else:
        motor = "F_m = clip(K_t (u_m - v_w), 0, F_m_max) for u_m >= 0"
        brake = "clip(u_m K_b v_w, +-F_m_max) for u_m < 0"
    motor = motor if p.reverses else f"{motor}, {brake}"
    if p.follows_wheel:
        motor = "F_m = K_t (u_m - v_w), u_m the driven wheel's measured speed"
    told_back = p.reverses and not p.follows_wheel
    return [
        "v_x' = F_x/m + w v_y,  v_y' = F_y/m - w v_x,  w' = M_z/I_z",
        "delta' = sat((u_s - delta)/T_s) within +-d",
        "F_x = cos(delta) (F_m - F_d) - sin(delta) F_af",
        "F_y = sin(delta) (F_m - F_d) + cos(delta) F_af + F_ar",
        "M_z = l_f (sin(delta) (F_m - F_d) + cos(delta) F_af) - l_r F_ar",
        f"{motor},  F_d = v_w max(R_1 + R_2 |v_w|, 0)",
        *(["backward the motor is as forward: F_m(u_m, v_w) = -F_m(-u_m, -v_w) for u_m < 0"] if told_back else []),
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
        return (self.car, min((0.5 + STEP_MARGIN) * self.period_s, _stable_step(self.car)))

    def scan_many(self, carries: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """Advance B vehicles (B, n) under `commands`, (B, N, 2) or parts (B, N, W, 4): last carries, twists (B, N, 3).

        The cars advance side by side in vector registers.
        """
        after, parts = np.array(carries, dtype=np.float64, order="C"), self._stable_parts(commands)
        return after, _scan_newton_euler_batch(after, parts, self.car, self.period_s)

    def scan_many_single(self, carries: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """What `scan_many` is, computed in single precision: twice as many cars fit into a vector register."""
        # numba, not mypy, tells the precisions apart
        after: Any = np.array(carries, dtype=np.float32, order="C")
        car = Car(*np.array(self.car, dtype=np.float32))
        twists = _scan_newton_euler_batch_single(after, self._stable_parts(commands), car, self.period_s)
        return after.astype(np.float64), twists

    def _stable_parts(self, commands: Floats) -> Floats:
        """The `commands`, (B, N, 2) or parts (B, N, W, 4), in parts of which each makes a stable step of this car."""
        stable = _stable_step(self.car)
        if 0.5 * self.period_s <= stable:
            return _as_parts(commands)
        parts = hold_for_periods(commands, self.period_s) if commands.ndim == 3 else np.asarray(commands)
        count = math.ceil(self.period_s / stable)
        fine = np.repeat(parts, count, axis=2)
        fine[..., 0] /= count
        return np.ascontiguousarray(fine, dtype=np.float64)

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
