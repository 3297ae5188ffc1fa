"""K-MLP: the kinematic state's evolution as a perceptron.

[v_f alpha_f alpha_r]_{k+1} = f_MLP(v_f, alpha_f, alpha_r, delta, u_s, u_m)        (paper, f_k_mlp)
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.models.interface import Arrays, FitTask, ScanKernels, build_scan_kernels, mean_command
from bcid.models.kinematic.saved_kinematics import SavedKMlp
from bcid.models.kinematic.state import KinematicCar, KinematicModel, fill_input, kinematic_twist, next_state
from bcid.models.kinematic.torch_rollout import build_kinematic_rollout, simulate_steering
from bcid.models.network import mlp
from bcid.models.network.mlp import MlpWeights, allocate_buffers, evaluate_mlp
from bcid.models.network.training import train_perceptron
from bcid.models.saved_parts import parse_saved
from bcid.models.settings import TrainingSettings


@njit
def _scan_k_mlp(carry: Floats, parts: Floats, w: MlpWeights, c: KinematicCar) -> Floats:
    """Twists (N, 3) of one K-MLP (a perceptron of the kinematic state) in N periods of commands `parts` (N, W, 4).

    `carry` (4,) is the state [v_f (m/s), alpha_f, alpha_r, delta (rad)]: the first on entry, the last on return. Parts
    are [duration (s), u_s (rad), u_m, brake share]; `w` are the weights, `c` lever arms, steering constants and period.
    """
    twists, buffers = np.empty((len(parts), 3)), allocate_buffers(w)
    state = (carry[0], carry[1], carry[2], carry[3])
    for k in range(len(parts)):
        u_s, u_m = mean_command(parts, k)
        fill_input(buffers.x, state, u_s, u_m)
        evaluate_mlp(buffers, w)
        state = next_state(buffers.y, state[3], parts, k, c)
        twists[k, 0], twists[k, 1], twists[k, 2] = kinematic_twist(state, c)
    carry[0], carry[1], carry[2], carry[3] = state
    return twists


@dataclass(frozen=True)
class KMlp(KinematicModel):
    """A fitted K-MLP."""

    weights: MlpWeights
    car: KinematicCar
    facts: Mapping[str, Any]
    kernels: ClassVar[ScanKernels] = build_scan_kernels(_scan_k_mlp)
    name: ClassVar[str] = "k-mlp"

    @property
    def parameter_count(self) -> int:
        """The number of weights and biases."""
        return mlp.count_weights(self.weights)

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """Train the perceptron on the one-step error of the state, and on rollouts if the settings ask for it."""
        settings, car = TrainingSettings.model_validate(task.settings), KinematicCar.from_task(task)
        rollout = build_kinematic_rollout(car, lambda network, x: network(x))
        steer = partial(simulate_steering, c=car)
        weights, facts = train_perceptron(
            task, settings, lambda s: (s.kinematic_inputs, s.next_kinematic[:, :3]), rollout, prepare=steer
        )
        return cls(weights, car, facts)

    @property
    def kernel_arguments(self) -> tuple[Any, ...]:
        """The weights and the car, as the compiled scan takes them."""
        return (self.weights, self.car)

    def describe(self) -> str:
        """The structure of the model: inputs, outputs and layers."""
        return (
            "[v_f α_f α_r](k+1) = MLP(v_f, α_f, α_r, δ, u_s, u_m);  δ' = sat((u_s − δ)/T_s)\n"
            f"MLP: {self.input_count} inputs, {mlp.describe_layers(self.weights)}"
        )

    def to_saved(self) -> tuple[dict[str, Any], Arrays]:
        """The JSON object and the weights from which `from_saved` restores the model."""
        return {"frame": self.car._asdict(), "facts": dict(self.facts)}, mlp.weights_to_arrays(self.weights)

    @classmethod
    def from_saved(cls, data: Mapping[str, Any], arrays: Arrays) -> Self:
        """The model whose `to_saved` gave `data` and `arrays`.

        Raises:
            ValueError: they hold anything that no such model has.
        """
        saved = parse_saved(SavedKMlp, data)
        return cls(mlp.weights_from_arrays(arrays, cls.input_count), saved.frame.to_car(), saved.facts)
