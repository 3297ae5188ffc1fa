"""K-MLP: the kinematic state's evolution as a perceptron.

[v_f alpha_f alpha_r]_{k+1} = f_MLP(v_f, alpha_f, alpha_r, delta, u_s, u_m)        (paper, f_k_mlp)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numba
import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_inline, njit_parallel
from bcid.models.fitting.windows import transitions
from bcid.models.interface import Arrays, FitTask, History, Kernels, Scanned
from bcid.models.kinematic.frame import INPUTS, Frame, State, fill, frame_of, moved, twist_of
from bcid.models.kinematic.torch_rollout import unrolled, with_servo
from bcid.models.network import mlp
from bcid.models.network.mlp import Buffers, Weights, buffers, evaluate
from bcid.models.network.training import parts_of, stretches_of, train
from bcid.models.settings import TrainingSettings


@njit_inline
def advance(state: State, u_s: float, u_m: float, w: Weights, c: Frame, at: Buffers) -> State:
    """[v_f, alpha_f, alpha_r, delta] one period later."""
    fill(at.x, state, u_s, u_m)
    evaluate(at, w)
    return moved(at.y, state[3], u_s, c)


@njit
def _scan(carry: Floats, commands: Floats, w: Weights, c: Frame) -> Floats:
    twists, at = np.empty((len(commands), 3)), buffers(w)
    state = (carry[0], carry[1], carry[2], carry[3])
    for k in range(len(commands)):
        state = advance(state, commands[k, 0], commands[k, 1], w, c, at)
        twists[k, 0], twists[k, 1], twists[k, 2] = twist_of(*state, c)
    carry[0], carry[1], carry[2], carry[3] = state
    return twists


@njit_parallel
def _scan_many(carries: Floats, commands: Floats, w: Weights, c: Frame) -> Floats:
    twists = np.empty((len(carries), commands.shape[1], 3))
    for b in numba.prange(len(carries)):
        twists[b] = _scan(carries[b], commands[b], w, c)
    return twists


@dataclass(frozen=True)
class KMlp(Scanned):
    """A fitted K-MLP."""

    weights: Weights
    frame: Frame
    facts: Mapping[str, Any]
    kernels: ClassVar[Kernels] = Kernels(_scan, _scan_many)
    name: ClassVar[str] = "k-mlp"
    lags: ClassVar[int] = 0

    @property
    def period_s(self) -> float:
        """The time a step advances (s)."""
        return self.frame.period

    @property
    def parameter_count(self) -> int:
        """Weights and biases."""
        return mlp.count(self.weights)

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """Train on the one-step NMSE of the kinematic state, or of the twist over rollouts as well."""
        settings, frame = TrainingSettings.model_validate(task.settings), frame_of(task)
        used, held = parts_of(task, settings)
        s = transitions(used)
        x = np.column_stack([s.kinematic, s.command[:, 0]])
        ahead = unrolled(frame, lambda network, at: network(at))
        stretches = stretches_of(used, held, settings, ahead, prepared=lambda taken: with_servo(taken, frame))
        weights, facts = train(x, s.next_kinematic[:, :3], settings, task.seed, task.progress, stretches)
        return cls(weights, frame, facts)

    def init(self, history: History) -> Floats:
        """[v_f, alpha_f, alpha_r, delta]."""
        return np.array(history.kinematic[-1])

    @property
    def arguments(self) -> tuple[Any, ...]:
        """See `Scanned`."""
        return (self.weights, self.frame)

    def describe(self) -> str:
        """The structure."""
        a, b = self.weights.W2.shape
        return (
            "[v_f α_f α_r](k+1) = MLP(v_f, α_f, α_r, δ, u_s, u_m);  δ' = sat((u_s − δ)/T_s)\n"
            f"MLP: {len(self.weights.x_mean)} inputs, hidden {a} and {b}, ReLU, {self.parameter_count} weights"
        )

    def state(self) -> tuple[dict[str, Any], Arrays]:
        """See `Model.state`."""
        return {"frame": self.frame._asdict(), "facts": dict(self.facts)}, mlp.to_arrays(self.weights)

    @classmethod
    def from_state(cls, data: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> Self:
        """See `Model.from_state`."""
        return cls(mlp.from_arrays(arrays, INPUTS), Frame(**data["frame"]), data["facts"])
