"""NARX-MLP: the next twist from the last three twists and commands, with no kinematics in between.

v_{k+1} = f(v_k, v_{k-1}, v_{k-2}, u_k, u_{k-1}, u_{k-2})        (paper, n_y = n_u = 2)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numba
import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_inline, njit_parallel
from bcid.models.fitting.windows import transitions
from bcid.models.interface import Arrays, FitTask, History, Kernels, Scanned
from bcid.models.network import mlp
from bcid.models.network.mlp import Buffers, Weights, buffers, evaluate
from bcid.models.network.training import Network, parts_of, stretches_of, train
from bcid.models.settings import TrainingSettings

if TYPE_CHECKING:
    from torch import Tensor

LAGS = 2
N_TWIST = 3 * (LAGS + 1)
INPUTS = N_TWIST + 2 * (LAGS + 1)


@njit_inline
def advance(carry: Floats, u_s: float, u_m: float, w: Weights, at: Buffers) -> None:
    """The carry [v_k, v_{k-1}, v_{k-2}, u_{k-1}, u_{k-2}] one period on, in place."""
    at.x[N_TWIST], at.x[N_TWIST + 1] = u_s, u_m
    for i in range(len(carry)):
        at.x[i if i < N_TWIST else i + 2] = carry[i]
    evaluate(at, w)
    for i in range(N_TWIST):
        carry[i] = at.y[i] if i < 3 else at.x[i - 3]
    for i in range(N_TWIST, len(carry)):
        carry[i] = at.x[i]


@njit
def _scan(carry: Floats, commands: Floats, w: Weights) -> Floats:
    twists, at = np.empty((len(commands), 3)), buffers(w)
    for k in range(len(commands)):
        advance(carry, commands[k, 0], commands[k, 1], w, at)
        twists[k] = carry[:3]
    return twists


@njit_parallel
def _scan_many(carries: Floats, commands: Floats, w: Weights) -> Floats:
    twists = np.empty((len(carries), commands.shape[1], 3))
    for b in numba.prange(len(carries)):
        twists[b] = _scan(carries[b], commands[b], w)
    return twists


def _unrolled(network: Network, twist: Tensor, kinematic: Tensor, command: Tensor) -> Tensor:
    """The rollout in torch, for training; rows newest first, as `advance` has them."""
    import torch

    past, out = twist[:, : LAGS + 1].flip(1).flatten(1), []
    for k in range(LAGS, twist.shape[1] - 1):
        driven = command[:, k - LAGS : k + 1].flip(1).flatten(1)
        following = network(torch.cat([past, driven], dim=1))
        past = torch.cat([following, past[:, : N_TWIST - 3]], dim=1)
        out.append(following)
    return torch.stack(out, dim=1)


@dataclass(frozen=True)
class NarxMlp(Scanned):
    """A fitted NARX-MLP."""

    weights: Weights
    period_s: float
    facts: Mapping[str, Any]
    kernels: ClassVar[Kernels] = Kernels(_scan, _scan_many)
    name: ClassVar[str] = "narx-mlp"
    lags: ClassVar[int] = LAGS

    @property
    def parameter_count(self) -> int:
        """Weights and biases."""
        return mlp.count(self.weights)

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """Train on the one-step NMSE of the twist, or over rollouts as well."""
        settings = TrainingSettings.model_validate(task.settings)
        used, held = parts_of(task, settings, LAGS)
        s = transitions(used, LAGS)
        n = len(s.twist)
        x = np.column_stack([s.twist.reshape(n, -1), s.command.reshape(n, -1)])
        stretches = stretches_of(used, held, settings, _unrolled, LAGS)
        weights, facts = train(x, s.next_twist, settings, task.seed, task.progress, stretches)
        return cls(weights, task.period_s, facts)

    def init(self, history: History) -> Floats:
        """The last three twists, newest first, then the two commands before t_k."""
        return np.concatenate([history.twist[::-1].ravel(), history.command[::-1].ravel()])

    @property
    def arguments(self) -> tuple[Any, ...]:
        """See `Scanned`."""
        return (self.weights,)

    def describe(self) -> str:
        """The structure."""
        a, b = self.weights.W2.shape
        return (
            "[v_x v_y w](k+1) = MLP(v(k), v(k-1), v(k-2), u(k), u(k-1), u(k-2))\n"
            f"MLP: {len(self.weights.x_mean)} inputs, hidden {a} and {b}, ReLU, {self.parameter_count} weights"
        )

    def state(self) -> tuple[dict[str, Any], Arrays]:
        """See `Model.state`."""
        return {"period_s": self.period_s, "facts": dict(self.facts)}, mlp.to_arrays(self.weights)

    @classmethod
    def from_state(cls, data: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> Self:
        """See `Model.from_state`."""
        return cls(mlp.from_arrays(arrays, INPUTS), data["period_s"], data["facts"])
