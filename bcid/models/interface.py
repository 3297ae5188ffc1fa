"""The interface of all models: `init(history) -> carry`, `step(carry, command) -> (carry, twist)`; rollouts.

Commands of N steps are an array (N, 2) of [u_s (rad), u_m] where each holds for a whole step, or (N, W, 4) of the
*parts* of each step in which they are constant, [duration (s), u_s, u_m, brake share] (`bcid.estimate.command_parts`).
A fitted model is immutable and `fit` returns a new one, so nothing is ever "not fitted yet".
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import FunctionType
from typing import Any, ClassVar, NamedTuple, Protocol, Self, runtime_checkable

import numba
import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats, Ints, Progress
from bcid.compiled.njit import njit, njit_inline, njit_parallel
from bcid.estimate.command_parts import hold_for_periods, mean_commands
from bcid.estimate.types import Estimate
from bcid.models.limits import LIMITS
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

Arrays = dict[str, npt.NDArray[Any]]


@dataclass(frozen=True)
class History:
    """The motion up to and including t_k, oldest row first; the last row is the start of a rollout.

    `parts` holds the commands *before* t_k: one row fewer than the states.  Where nothing is known before the first
    row, rows before it repeat it, with its time.
    """

    twist: Floats  # (n, 3)
    kinematic: Floats  # (n, 4)
    parts: Floats  # (n - 1, W, 4) parts of the periods between the rows, as in `Estimate`
    pose: Floats  # (n, 3)
    time_s: Floats  # (n,) since the take began

    @property
    def command(self) -> Floats:
        """The commands [u_s, u_m] (n - 1, 2), averaged over each period before t_k."""
        return mean_commands(self.parts)


def history_at(estimate: Estimate, k: int, lags: int) -> History:
    """The past motion that a model starts from at grid row `k` of an estimate: row k and the `lags` rows before it.

    Rows before the beginning of k's segment (uninterrupted run of rows) are replaced by the segment's first row.
    """
    start = next(s.start for s in estimate.segments() if s.start <= k < s.stop)
    rows = np.maximum(np.arange(k - lags, k + 1), start)
    return History(
        estimate.twist[rows], estimate.kinematic[rows], estimate.parts[rows[:-1]], estimate.pose[rows],
        estimate.time_s[rows] - estimate.time_s[0],
    )  # fmt: skip


def history_at_rest(lags: int) -> History:
    """The past motion, `lags` + 1 grid rows of zeros, of a car that has always stood at the origin without commands."""
    n = lags + 1
    return History(np.zeros((n, 3)), np.zeros((n, 4)), np.zeros((lags, 1, 4)), np.zeros((n, 3)), np.zeros(n))


@dataclass(frozen=True)
class FitTask:
    """Everything that a fit may use."""

    estimates: Sequence[Estimate]
    vehicle: Vehicle
    settings: Mapping[str, Any]
    seed: int
    base: Model | None = None  # the fitted model that this one is derived from, see `ModelRow.base`
    recordings: Sequence[Recording] = ()  # what the estimates were made of, for losses of recorded poses
    progress: Progress = lambda share, text: None

    @property
    def period_s(self) -> float:
        """The grid period (s) that all estimates have."""
        return self.estimates[0].period_s


class SupportsRollout(Protocol):
    """All that a rollout needs of a model."""

    @property
    def name(self) -> str:
        """The model's name, for errors."""

    @property
    def lags(self) -> int:
        """Rows of history before the start that `init` wants."""

    def init(self, history: History) -> Any:
        """The carry at the last row of `history`: all of the past that later steps depend on."""

    def scan(self, carry: Any, commands: Floats) -> tuple[Any, Floats]:
        """Advance under `commands`, (N, 2) or parts (N, W, 4): the carry after the last, and the twists (N, 3)."""


class Model(SupportsRollout, Protocol):
    """A fitted vehicle model."""

    # The three numbers of the carry on which process noise acts: a twist, or v_f, alpha_f, alpha_r.
    motion: ClassVar[slice]

    @property
    def period_s(self) -> float:
        """The time (s) by which a step advances."""

    @property
    def parameter_count(self) -> int:
        """How many numbers the fit chose."""

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """A new model of this class, fitted to the data of `task`."""

    def step(self, carry: Floats, command: Floats) -> tuple[Floats, Floats]:
        """Advance one period under `command` = [u_s, u_m]: the carry after it, and the twist (3,) there."""

    def scan_many(self, carries: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """Advance B vehicles (B, n) under `commands`, (B, N, 2) or parts (B, N, W, 4): last carries, twists."""

    def describe(self) -> str:
        """The fitted equations with values and units, for people."""

    def to_saved(self) -> tuple[dict[str, Any], Arrays]:
        """What `save_model` writes: a JSON object and named arrays."""

    @classmethod
    def from_saved(cls, data: Mapping[str, Any], arrays: Arrays) -> Self:
        """The model whose `to_saved` gave `data` and `arrays`."""


@runtime_checkable
class ContinuousTimeModel(Protocol):
    """A model whose equations hold for steps of any length."""

    def with_period(self, period_s: float) -> Model:
        """This model advancing by `period_s` (s) a step."""


@runtime_checkable
class SinglePrecisionModel(Protocol):
    """A model that can compute the rollouts of many vehicles in single precision, which takes half the time."""

    def scan_many_single(self, carries: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """What `Model.scan_many` is, with twists off by up to LIMITS.single_precision_error."""


class RolloutDiverged(ArithmeticError):
    """A rollout passed `fastest_twist`, or left the finite numbers; `step` is the step after which it did."""

    def __init__(self, name: str, step: int) -> None:
        super().__init__(f"the rollout of {name} diverged at step {step}")
        self.step = step


def rollout(model: SupportsRollout, history: History, commands: Floats) -> Floats:
    """Twists [v_x, v_y, yaw rate] (N + 1, 3) that a model predicts from its own predictions, without measured feedback.

    The first is that of the last row of `history`, then one after each step of `commands`, [u_s (rad), u_m] (N, 2) or
    parts (N, W, 4).

    Raises:
        RolloutDiverged: a component passes LIMITS.fastest_twist (150 m/s, 100 rad/s), or is not finite.
    """
    carry = model.init(history)
    twists = np.vstack([history.twist[-1], model.scan(carry, commands)[1]])
    diverged = ~(np.abs(twists) <= LIMITS.fastest_twist).all(axis=1)
    if diverged.any():
        raise RolloutDiverged(model.name, int(np.argmax(diverged)))
    return twists


class RolloutBatch(NamedTuple):
    """Closed-loop twists of B vehicles, for a sampling controller; a vehicle that diverged keeps its last twist."""

    twist: Floats  # (B, N, 3) after each command; zero where the carry itself is not finite
    diverged_at: Ints  # (B,) index of the command after which a twist passes `fastest_twist`; -1 where none does


def rollout_batch(model: Model, carries: Floats, commands: Floats, tolerance: float = 0.0) -> RolloutBatch:
    """Predict the twists of B vehicles under `commands` (B, N, 2), from the model's states `carries` (B, n).

    Where a `tolerance` of LIMITS.single_precision_error (1e-5 m/s, rad/s) or more is accepted, a model that can
    computes in single precision.

    From the step in which a vehicle's twist passes LIMITS.fastest_twist (150 m/s, 100 rad/s) or is NaN, its last
    valid twist is repeated (zeros if there is none); the step's index is returned too, -1 where no such step occurs.
    """
    if tolerance >= LIMITS.single_precision_error and isinstance(model, SinglePrecisionModel):
        _, twist = model.scan_many_single(carries, commands)
    else:
        _, twist = model.scan_many(carries, commands)
    diverged = np.asarray(~(np.abs(twist) <= LIMITS.fastest_twist).all(axis=-1))
    at = np.where(diverged.any(axis=1), np.argmax(diverged, axis=1), -1)
    for b in np.flatnonzero(at >= 0):
        twist[b, at[b] :] = twist[b, at[b] - 1] if at[b] > 0 else 0.0
    return RolloutBatch(twist, at)


class ScanKernels(NamedTuple):
    """Compiled loops over parts; they leave the carry after the last command in place, and return the twists."""

    scan: Callable[..., Floats]  # (carry (n,), parts (N, W, 4), *arguments) -> (N, 3)
    scan_many: Callable[..., Floats]  # (carries (B, n), parts (B, N, W, 4), *arguments) -> (B, N, 3), on all cores


def scan_one(carry: Floats, parts: Floats, *arguments: Any) -> Floats:
    """Placeholder in the loops over vehicles for a model's compiled `scan`: the twists (N, 3) of one vehicle.

    `build_scan_kernels` copies these loops with the model's own function under this name; calling this one raises
    `NotImplementedError`.
    """
    raise NotImplementedError


# A parallel loop takes no tuple of tuples, and so is written out for each number of arguments.
def _scan_many_with_1(carries: Floats, parts: Floats, a: Any) -> Floats:
    """Twists (B, N, 3) of B vehicles in parallel, by `scan_one(carry, parts, a)`, under commands `parts` (B, N, W, 4).

    `carries` (B, n) are the models' states, updated in place to those after the last command.
    """
    twists = np.empty((len(carries), parts.shape[1], 3))
    for i in numba.prange(len(carries)):
        twists[i] = scan_one(carries[i], parts[i], a)
    return twists


def _scan_many_with_2(carries: Floats, parts: Floats, a: Any, b: Any) -> Floats:
    """Twists (B, N, 3) of B vehicles in parallel, by `scan_one(carry, parts, a, b)`, under `parts` (B, N, W, 4).

    `carries` (B, n) are the models' states, updated in place to those after the last command.
    """
    twists = np.empty((len(carries), parts.shape[1], 3))
    for i in numba.prange(len(carries)):
        twists[i] = scan_one(carries[i], parts[i], a, b)
    return twists


def _scan_many_with_4(carries: Floats, parts: Floats, a: Any, b: Any, c: Any, d: Any) -> Floats:
    """Twists (B, N, 3) of B vehicles in parallel, by `scan_one(carry, parts, a, b, c, d)`.

    Commands are `parts` (B, N, W, 4), `carries` (B, n) the models' states, updated in place to those after the last.
    """
    twists = np.empty((len(carries), parts.shape[1], 3))
    for i in numba.prange(len(carries)):
        twists[i] = scan_one(carries[i], parts[i], a, b, c, d)
    return twists


def build_scan_kernels(scan: Callable[..., Floats], parallel: bool = True) -> ScanKernels:
    """Build a model's compiled kernels, for one vehicle and for B, from its `scan(carry, parts, *arguments)`.

    `scan` is compiled and takes 1, 2 or 4 further arguments; it updates the state `carry` in place and returns
    twists. If `parallel`, the loop over B vehicles runs on all cores.  The loop calls `scan` as a global, since numba
    would compile a closure anew in every process.
    """
    count = len(inspect.signature(scan).parameters) - 2
    loop = {1: _scan_many_with_1, 2: _scan_many_with_2, 4: _scan_many_with_4}[count]
    names = {"np": np, "numba": numba, "scan_one": scan, "__name__": scan.__module__}
    many = FunctionType(loop.__code__, names)
    # under which the compiled loop is cached
    many.__qualname__ = f"{scan.__qualname__}_many"
    return ScanKernels(scan, njit_parallel(many) if parallel else njit(many))


@njit_inline
def mean_command(parts: Floats, k: int) -> tuple[float, float]:
    """The command (u_s, u_m), averaged over the time of period `k`, of the commands `parts` (N, W, 4).

    It is what models of a fixed period are given; `bcid.estimate.command_parts.mean_commands` is the same for arrays.
    """
    u_s, u_m, time, steer, drive = parts[k, 0, 1], parts[k, 0, 2], parts[k, 0, 0], 0.0, 0.0
    if parts.shape[1] == 1:
        return u_s, u_m
    for j in range(1, parts.shape[1]):
        time += parts[k, j, 0]
        steer += parts[k, j, 0] * (parts[k, j, 1] - u_s)
        drive += parts[k, j, 0] * (parts[k, j, 2] - u_m)
    return u_s + steer / time, u_m + drive / time


class CompiledModel:
    """Base class that makes `step`, `scan` and `scan_many` of a model's `kernels` and their `kernel_arguments`."""

    kernels: ClassVar[ScanKernels]
    period_s: float
    lags: ClassVar[int] = 0
    motion: ClassVar[slice] = slice(0, 3)

    @property
    def kernel_arguments(self) -> tuple[Any, ...]:
        """What the compiled kernels take beside carry and commands."""
        raise NotImplementedError

    def step(self, carry: Floats, command: Floats) -> tuple[Floats, Floats]:
        """Advance one period under `command` = [u_s, u_m]: the carry after it, and the twist (3,) there."""
        after, twists = self.scan(carry, np.asarray(command, dtype=np.float64)[None])
        return after, twists[0]

    def _parts(self, commands: Floats) -> Floats:
        """Parts (..., N, W, 4) as the kernels take them, of `commands` that are parts, or (..., N, 2)."""
        parts = commands if commands.shape[-1] == 4 else hold_for_periods(commands, self.period_s)
        return np.ascontiguousarray(parts, dtype=np.float64)

    def scan(self, carry: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """Advance under `commands`, (N, 2) or parts (N, W, 4): the carry after the last, and the twists (N, 3)."""
        after = np.array(carry, dtype=np.float64)
        return after, self.kernels.scan(after, self._parts(commands), *self.kernel_arguments)

    def scan_many(self, carries: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """Advance B vehicles (B, n) under `commands`, (B, N, 2) or parts (B, N, W, 4): last carries, twists."""
        after = np.array(carries, dtype=np.float64, order="C")
        return after, self.kernels.scan_many(after, self._parts(commands), *self.kernel_arguments)
