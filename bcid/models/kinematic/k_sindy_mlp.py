"""K-SINDy-MLP: K-SINDy and a smaller perceptron on what it leaves.

x_{k+1} = f_SINDy(x_k, u_k) + f_RES-MLP(x_k, u_k)        (paper, grey-box modeling)

The dissipative variant (the paper's future work) is guaranteed not to gain kinetic energy while the throttle is at
zero or brakes: v_f is lowered where the sum would.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, Self

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit
from bcid.errors import UsageError
from bcid.models.fitting.windows import SingleSteps
from bcid.models.interface import Arrays, FitTask, ScanKernels, build_scan_kernels, mean_command
from bcid.models.kinematic import state as kinematics
from bcid.models.kinematic.k_sindy import KSindy
from bcid.models.kinematic.saved_sparse import SPARSE_ARRAYS, SavedKSindyMlp
from bcid.models.kinematic.sparse_sum import SparseEquations, active_terms, f_sindy
from bcid.models.kinematic.torch_rollout import build_f_sindy, build_kinematic_rollout, simulate_steering
from bcid.models.network import mlp
from bcid.models.network.mlp import MlpWeights, allocate_buffers, evaluate_mlp
from bcid.models.network.training import train_perceptron
from bcid.models.saved_parts import parse_saved
from bcid.models.settings import ResidualSettings


@njit
def _scan_k_sindy_mlp(
    carry: Floats, parts: Floats, s: SparseEquations, w: MlpWeights, c: kinematics.KinematicCar, dissipative: bool
) -> Floats:
    """Twists (N, 3) of one K-SINDy-MLP (equations `s` plus a perceptron `w`) in N periods of `parts` (N, W, 4).

    `carry` (4,) is the state [v_f (m/s), alpha_f, alpha_r, delta (rad)]: the first on entry, the last on return.  If
    `dissipative`, v_f is lowered where a step with u_m <= 0 would gain kinetic energy.
    """
    twists, terms, buffers = np.empty((len(parts), 3)), active_terms(s), allocate_buffers(w)
    state = (carry[0], carry[1], carry[2], carry[3])
    for k in range(len(parts)):
        u_s, u_m = mean_command(parts, k)
        f_sindy(state, u_s, u_m, terms, c)
        kinematics.fill_input(buffers.x, state, u_s, u_m)
        evaluate_mlp(buffers, w)
        for i in range(3):
            terms.after[i] += buffers.y[i]
        after = kinematics.next_state(terms.after, state[3], parts, k, c)
        state = kinematics.cap_energy(state, after, c) if dissipative and u_m <= 0.0 else after
        twists[k, 0], twists[k, 1], twists[k, 2] = kinematics.kinematic_twist(state, c)
    carry[0], carry[1], carry[2], carry[3] = state
    return twists


@njit
def _predict_by_f_sindy(x: Floats, s: SparseEquations, c: kinematics.KinematicCar) -> Floats:
    """K-SINDy's [v_f, alpha_f, alpha_r] (N, 3) one period after x = [v_f, alpha_f, alpha_r, delta, u_s, u_m] (N, 6)."""
    out, terms = np.empty((len(x), 3)), active_terms(s)
    for k in range(len(x)):
        f_sindy((x[k, 0], x[k, 1], x[k, 2], x[k, 3]), x[k, 4], x[k, 5], terms, c)
        out[k] = terms.after
    return out


@dataclass(frozen=True)
class KSindyMlp(kinematics.KinematicModel):
    """A fitted K-SINDy-MLP, whose sparse part is the fitted K-SINDy."""

    sindy: KSindy
    weights: MlpWeights
    facts: Mapping[str, Any]
    dissipative: bool = False
    kernels: ClassVar[ScanKernels] = build_scan_kernels(_scan_k_sindy_mlp)
    name: ClassVar[str] = "k-sindy-mlp"

    @property
    def car(self) -> kinematics.KinematicCar:  # type: ignore[override]  # never written
        """The car of the sparse part."""
        return self.sindy.car

    @property
    def parameter_count(self) -> int:
        """How many coefficients are not zero, plus the number of weights and biases."""
        return self.sindy.parameter_count + mlp.count_weights(self.weights)

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """Train the perceptron on what the fitted K-SINDy leaves of a step, and on rollouts if the settings say so."""
        if not isinstance(task.base, KSindy):
            raise TypeError("k-sindy-mlp is derived from a fitted k-sindy model")
        sindy, settings = task.base, ResidualSettings.model_validate(task.settings)

        def mapping(s: SingleSteps) -> tuple[Floats, Floats]:
            x = s.kinematic_inputs
            return x, s.next_kinematic[:, :3] - _predict_by_f_sindy(x, sindy.sparse, sindy.car)

        dissipative = settings.residual == "dissipative"
        if dissipative and task.vehicle.motor.reverses:
            raise UsageError(
                "a dissipative k-sindy-mlp gains no energy while the throttle is below zero, where this car drives\n"
                '  next: set residual = "plain" in [fit.k-sindy-mlp]'
            )
        f_sindy_in_torch = build_f_sindy(sindy.sparse, sindy.car)
        rollout = build_kinematic_rollout(sindy.car, lambda network, x: f_sindy_in_torch(x) + network(x), dissipative)
        steer = partial(simulate_steering, c=sindy.car)
        weights, facts = train_perceptron(task, settings, mapping, rollout, prepare=steer)
        return cls(sindy, weights, facts, dissipative)

    @property
    def kernel_arguments(self) -> tuple[Any, ...]:
        """The equations, the weights, the car and whether it is dissipative, as the compiled scan takes them."""
        return (self.sindy.sparse, self.weights, self.sindy.car, self.dissipative)

    def describe(self) -> str:
        """The sparse equations and the structure of the perceptron."""
        lines = [self.sindy.describe(), f"plus MLP(v_f, α_f, α_r, δ, u_s, u_m): {mlp.describe_layers(self.weights)}"]
        if self.dissipative:
            lines.append("v_f lowered where v_x² + v_y² + l_f l_r w² would grow while u_m ≤ 0 (as if I_z = m l_f l_r)")
        return "\n".join(lines)

    def to_saved(self) -> tuple[dict[str, Any], Arrays]:
        """The JSON object, the coefficients and the weights from which `from_saved` restores the model."""
        data, arrays = self.sindy.to_saved()
        about = {"sindy": data, "facts": dict(self.facts), "dissipative": self.dissipative}
        return about, arrays | mlp.weights_to_arrays(self.weights)

    @classmethod
    def from_saved(cls, data: Mapping[str, Any], arrays: Arrays) -> Self:
        """The model whose `to_saved` gave `data` and `arrays`.

        Raises:
            ValueError: they hold anything that no such model has.
        """
        saved = parse_saved(SavedKSindyMlp, data)
        sparse = {name: arrays[name] for name in SPARSE_ARRAYS if name in arrays}
        others = {name: array for name, array in arrays.items() if name not in sparse}
        sindy = KSindy.from_saved(data["sindy"], sparse)
        return cls(sindy, mlp.weights_from_arrays(others, cls.input_count), saved.facts, saved.dissipative)
