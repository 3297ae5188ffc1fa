"""What every model is: `init(history) -> carry`, `step(carry, command) -> (carry, twist)`.

A fitted model is immutable and `fit` returns a new one, so nothing is ever "not fitted yet".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats, Progress
from bcid.estimate.types import Estimate
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

Arrays = dict[str, npt.NDArray[Any]]


def no_progress(share: float, text: str) -> None:
    """Progress that nobody watches."""


@dataclass(frozen=True)
class History:
    """The motion up to and including t_k, oldest row first; the last row is the start of a rollout.

    `command` holds the commands *before* t_k: one row fewer than the states.  Rows that only repeat the first one,
    since nothing is known before it, have its time.
    """

    twist: Floats  # (n, 3)
    kinematic: Floats  # (n, 4)
    command: Floats  # (n - 1, 2)
    pose: Floats  # (n, 3)
    time_s: Floats  # (n,) since the take began


def history_at(estimate: Estimate, k: int, lags: int) -> History:
    """The `lags` rows before row `k` and the row itself; before a segment's start its first row stands."""
    start = next(s.start for s in estimate.segments() if s.start <= k < s.stop)
    rows = np.maximum(np.arange(k - lags, k + 1), start)
    return History(
        estimate.twist[rows], estimate.kinematic[rows], estimate.command[rows[:-1]], estimate.pose[rows],
        estimate.time_s[rows] - estimate.time_s[0],
    )  # fmt: skip


def at_rest(lags: int) -> History:
    """A car that stands at the origin as long as anyone knows, with nothing commanded."""
    n = lags + 1
    return History(np.zeros((n, 3)), np.zeros((n, 4)), np.zeros((lags, 2)), np.zeros((n, 3)), np.zeros(n))


@dataclass(frozen=True)
class FitTask:
    """Everything a fit may look at."""

    estimates: Sequence[Estimate]
    vehicle: Vehicle
    settings: Mapping[str, Any]
    seed: int
    base: Model | None = None  # the fitted model this one is derived from (`TableRow.base`)
    recordings: Sequence[Recording] = ()  # that the estimates were made of, where the loss asks for their poses
    progress: Progress = no_progress

    @property
    def period_s(self) -> float:
        """The estimates' common grid period (s)."""
        return self.estimates[0].period_s


class Model(Protocol):
    """One fitted vehicle model."""

    name: ClassVar[str]
    lags: ClassVar[int]
    motion: ClassVar[slice]  # the three numbers of the carry that are its motion: a twist, or v_f, alpha_f, alpha_r

    @property
    def period_s(self) -> float:
        """The time a step advances (s)."""

    @property
    def parameter_count(self) -> int:
        """How many numbers the fit chose."""

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """A new model of this kind fitted to `task`."""

    def init(self, history: History) -> Floats:
        """The carry at the history's last row."""

    def step(self, carry: Floats, command: Floats) -> tuple[Floats, Floats]:
        """The carry one period later under `command` = [u_s, u_m], and the twist there (3,)."""

    def scan(self, carry: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """The carry after the last of `commands` (N, 2) and the twists (N, 3) after each: `step` in a compiled loop."""

    def scan_many(self, carries: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """Of B vehicles, the carries (B, n) after the last of `commands` (B, N, 2) and the twists (B, N, 3)."""

    def describe(self) -> str:
        """The fitted equations with values and units."""

    def state(self) -> tuple[dict[str, Any], Arrays]:
        """What `save` writes: a JSON object and named arrays."""

    @classmethod
    def from_state(cls, data: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> Self:
        """The inverse of `state`."""


@runtime_checkable
class Continuous(Protocol):
    """A model whose equations hold for steps of any length."""

    def in_steps_of(self, period_s: float) -> Model:
        """The same car in steps of `period_s`."""


class Scans(Protocol):
    """All that a rollout needs of a model."""

    @property
    def name(self) -> str:
        """What an error calls it."""

    @property
    def lags(self) -> int:
        """Rows of history before the start that it wants."""

    def init(self, history: History) -> Any:
        """See `Model.init`."""

    def scan(self, carry: Any, commands: Floats) -> tuple[Any, Floats]:
        """See `Model.scan`."""


BEYOND = (150.0, 150.0, 100.0)
"""m/s, m/s, rad/s: no ground vehicle is as fast, and polynomials that run away grow far before they overflow."""


class Diverged(ArithmeticError):
    """A rollout left what a ground vehicle can do (BEYOND), or the finite numbers; `step` says where."""

    def __init__(self, name: str, step: int) -> None:
        super().__init__(f"the rollout of {name} diverged at step {step}")
        self.step = step


def rollout(model: Scans, history: History, commands: Floats) -> Floats:
    """Closed-loop twists (N + 1, 3): the start, then one row after each of `commands` (N, 2).

    Raises:
        Diverged: when a value is BEYOND, or no longer finite.
    """
    carry = model.init(history)
    twists = np.vstack([history.twist[-1], model.scan(carry, commands)[1]])
    lost = _lost(twists)
    if lost.any():
        raise Diverged(model.name, int(np.argmax(lost)))
    return twists


def _lost(twist: Floats) -> npt.NDArray[np.bool_]:
    """Which twists (..., 3) no vehicle has."""
    return np.asarray(~(np.abs(twist) <= BEYOND).all(axis=-1))


class Rollouts(NamedTuple):
    """Closed-loop twists of many vehicles at once."""

    twist: Floats  # (B, N, 3) after each command; of one that diverged the last one before stands
    diverged_at: npt.NDArray[np.int64]  # (B,) after which command, from 0, it did (see `Diverged`); -1 where never


def rollouts(model: Model, carries: Floats, commands: Floats) -> Rollouts:
    """Rollouts of B vehicles from `carries` (B, n) under `commands` (B, N, 2); divergence is told, never NaN.

    Of one whose carry itself is not finite the twist is zero.
    """
    _, twist = model.scan_many(carries, commands)
    lost = _lost(twist)
    at = np.where(np.any(lost, axis=1), np.argmax(lost, axis=1), -1)
    for b in np.flatnonzero(at >= 0):
        twist[b, at[b] :] = twist[b, at[b] - 1] if at[b] > 0 else 0.0
    return Rollouts(twist, at)


class Kernels(NamedTuple):
    """Both take carries on in place, to behind the last command, and return the twists after each."""

    scan: Callable[..., Floats]  # (carry (n,), commands (N, 2), *arguments) -> (N, 3)
    scan_many: Callable[..., Floats]  # (carries (B, n), commands (B, N, 2), *arguments) -> (B, N, 3), on all cores


class Scanned:
    """`step`, `scan` and `scan_many` of a model that has `kernels` and the `arguments` they take."""

    kernels: ClassVar[Kernels]
    motion: ClassVar[slice] = slice(0, 3)

    @property
    def arguments(self) -> tuple[Any, ...]:
        """What the kernels take beside carries and commands."""
        raise NotImplementedError

    def step(self, carry: Floats, command: Floats) -> tuple[Floats, Floats]:
        """See `Model.step`."""
        after, twists = self.scan(carry, np.asarray(command, dtype=np.float64)[None])
        return after, twists[0]

    def scan(self, carry: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """See `Model.scan`."""
        after = np.array(carry, dtype=np.float64)
        return after, self.kernels.scan(after, np.ascontiguousarray(commands, dtype=np.float64), *self.arguments)

    def scan_many(self, carries: Floats, commands: Floats) -> tuple[Floats, Floats]:
        """See `Model.scan_many`."""
        after = np.array(carries, dtype=np.float64, order="C")
        return after, self.kernels.scan_many(after, np.ascontiguousarray(commands, dtype=np.float64), *self.arguments)
