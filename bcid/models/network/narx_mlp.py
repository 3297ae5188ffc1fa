"""NARX-MLP: the next twist from the last three twists and commands, with no kinematics in between.

v_{k+1} = f(v_k, v_{k-1}, v_{k-2}, u_k, u_{k-1}, u_{k-2})        (paper, n_y = n_u = 2)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.models.fitting.windows import SingleSteps
from bcid.models.interface import Arrays, CompiledModel, FitTask, History, ScanKernels, build_scan_kernels, mean_command
from bcid.models.network import mlp
from bcid.models.network.mlp import MlpWeights, allocate_buffers, evaluate_mlp
from bcid.models.network.training import Network, train_perceptron
from bcid.models.saved_parts import Period, SavedPart, parse_saved
from bcid.models.settings import TrainingSettings

if TYPE_CHECKING:
    from torch import Tensor

LAGS = 2
N_TWIST = 3 * (LAGS + 1)
INPUTS = N_TWIST + 2 * (LAGS + 1)


@njit
def _scan_narx_mlp(carry: Floats, parts: Floats, w: MlpWeights) -> Floats:
    """Twists (N, 3) of one NARX-MLP, a perceptron of the last three twists and commands, under `parts` (N, W, 4).

    `carry` (13,) is advanced in place: [v_k, v_{k-1}, v_{k-2}, u_{k-1}, u_{k-2}], twists v and commands u.
    """
    twists, buffers = np.empty((len(parts), 3)), allocate_buffers(w)
    for k in range(len(parts)):
        buffers.x[N_TWIST], buffers.x[N_TWIST + 1] = mean_command(parts, k)
        for i in range(len(carry)):
            buffers.x[i if i < N_TWIST else i + 2] = carry[i]
        evaluate_mlp(buffers, w)
        for i in range(N_TWIST):
            carry[i] = buffers.y[i] if i < 3 else buffers.x[i - 3]
        for i in range(N_TWIST, len(carry)):
            carry[i] = buffers.x[i]
        twists[k] = carry[:3]
    return twists


def _rollout_in_torch(network: Network, twist: Tensor, kinematic: Tensor, command: Tensor) -> Tensor:
    """Twists (B, S, 3) that a NARX-MLP `network` predicts over B stretches of S steps, in torch for training.

    `twist` (B, S + 3, 3) and `command` (B, S + 3, 2) hold two rows before the start, the start and the steps; only the
    first three twists are read, and `kinematic` is not.
    """
    import torch

    past, out = twist[:, : LAGS + 1].flip(1).flatten(1), []
    for k in range(LAGS, twist.shape[1] - 1):
        driven = command[:, k - LAGS : k + 1].flip(1).flatten(1)
        following = network(torch.cat([past, driven], dim=1))
        past = torch.cat([following, past[:, : N_TWIST - 3]], dim=1)
        out.append(following)
    return torch.stack(out, dim=1)


class SavedNarxMlp(SavedPart):
    """The JSON part of a saved NARX-MLP; its weights are arrays."""

    period_s: Period
    facts: dict[str, Any]


@dataclass(frozen=True)
class NarxMlp(CompiledModel):
    """A fitted NARX-MLP; its carry is [v_k, v_{k-1}, v_{k-2}, u_{k-1}, u_{k-2}]."""

    weights: MlpWeights
    period_s: float
    facts: Mapping[str, Any]
    kernels: ClassVar[ScanKernels] = build_scan_kernels(_scan_narx_mlp)
    name: ClassVar[str] = "narx-mlp"
    lags: ClassVar[int] = LAGS

    @property
    def parameter_count(self) -> int:
        """The number of weights and biases."""
        return mlp.count_weights(self.weights)

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """Train the perceptron on the one-step error of the twist, and on its rollouts if the settings ask for it."""
        settings = TrainingSettings.model_validate(task.settings)

        def mapping(s: SingleSteps) -> tuple[Floats, Floats]:
            n = len(s.twist)
            return np.column_stack([s.twist.reshape(n, -1), s.command.reshape(n, -1)]), s.next_twist

        weights, facts = train_perceptron(task, settings, mapping, _rollout_in_torch, LAGS)
        return cls(weights, task.period_s, facts)

    def init(self, history: History) -> Floats:
        """The carry: the last three twists, newest first, then the two commands before t_k."""
        return np.concatenate([history.twist[::-1].ravel(), history.command[::-1].ravel()])

    @property
    def kernel_arguments(self) -> tuple[Any, ...]:
        """The weights, as the compiled scan takes them."""
        return (self.weights,)

    def describe(self) -> str:
        """The structure of the model: inputs, outputs and layers."""
        return (
            "[v_x v_y w](k+1) = MLP(v(k), v(k-1), v(k-2), u(k), u(k-1), u(k-2))\n"
            f"MLP: {INPUTS} inputs, {mlp.describe_layers(self.weights)}"
        )

    def to_saved(self) -> tuple[dict[str, Any], Arrays]:
        """The JSON object and the weights from which `from_saved` restores the model."""
        return {"period_s": self.period_s, "facts": dict(self.facts)}, mlp.weights_to_arrays(self.weights)

    @classmethod
    def from_saved(cls, data: Mapping[str, Any], arrays: Arrays) -> Self:
        """The model whose `to_saved` gave `data` and `arrays`.

        Raises:
            ValueError: they hold anything that no such model has.
        """
        saved = parse_saved(SavedNarxMlp, data)
        return cls(mlp.weights_from_arrays(arrays, INPUTS), saved.period_s, saved.facts)
