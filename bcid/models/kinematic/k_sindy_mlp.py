"""K-SINDy-MLP: K-SINDy and a smaller perceptron on what it leaves.

x_{k+1} = f_SINDy(x_k, u_k) + f_RES-MLP(x_k, u_k)        (paper, grey-box modeling)

The dissipative variant (the paper's future work) is guaranteed not to gain kinetic energy while the throttle is at
zero or brakes: v_f is lowered where the sum would.
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
from bcid.models.kinematic.frame import INPUTS, Frame, State, fill, moved, twist_of, without_gain
from bcid.models.kinematic.k_sindy import KSindy
from bcid.models.kinematic.sparse_sum import Sparse, Terms, f_sindy, terms_of
from bcid.models.kinematic.torch_rollout import sparse_sums, unrolled, with_servo
from bcid.models.network import mlp
from bcid.models.network.mlp import Buffers, Weights, buffers, evaluate
from bcid.models.network.training import parts_of, stretches_of, train
from bcid.models.settings import ResidualTrainingSettings


@njit_inline
def advance(
    state: State, u_s: float, u_m: float, t: Terms, w: Weights, c: Frame, dissipative: bool, at: Buffers
) -> State:
    """[v_f, alpha_f, alpha_r, delta] one period later."""
    f_sindy(state, u_s, u_m, t, c)
    fill(at.x, state, u_s, u_m)
    evaluate(at, w)
    for i in range(3):
        t.after[i] += at.y[i]
    after = moved(t.after, state[3], u_s, c)
    return without_gain(state, after, c) if dissipative and u_m <= 0.0 else after


@njit
def _scan(carry: Floats, commands: Floats, s: Sparse, w: Weights, c: Frame, dissipative: bool) -> Floats:
    twists, terms, at = np.empty((len(commands), 3)), terms_of(s), buffers(w)
    state = (carry[0], carry[1], carry[2], carry[3])
    for k in range(len(commands)):
        state = advance(state, commands[k, 0], commands[k, 1], terms, w, c, dissipative, at)
        twists[k, 0], twists[k, 1], twists[k, 2] = twist_of(*state, c)
    carry[0], carry[1], carry[2], carry[3] = state
    return twists


@njit_parallel
def _scan_many(carries: Floats, commands: Floats, s: Sparse, w: Weights, c: Frame, dissipative: bool) -> Floats:
    twists = np.empty((len(carries), commands.shape[1], 3))
    for b in numba.prange(len(carries)):
        twists[b] = _scan(carries[b], commands[b], s, w, c, dissipative)
    return twists


@njit
def _sindy_table(x: Floats, s: Sparse, c: Frame) -> Floats:
    out, terms = np.empty((len(x), 3)), terms_of(s)
    for k in range(len(x)):
        f_sindy((x[k, 0], x[k, 1], x[k, 2], x[k, 3]), x[k, 4], x[k, 5], terms, c)
        out[k] = terms.after
    return out


@dataclass(frozen=True)
class KSindyMlp(Scanned):
    """A fitted K-SINDy-MLP: its sparse part is the fitted K-SINDy."""

    sindy: KSindy
    weights: Weights
    facts: Mapping[str, Any]
    dissipative: bool = False
    kernels: ClassVar[Kernels] = Kernels(_scan, _scan_many)
    name: ClassVar[str] = "k-sindy-mlp"
    lags: ClassVar[int] = 0

    @property
    def period_s(self) -> float:
        """The time a step advances (s)."""
        return self.sindy.period_s

    @property
    def parameter_count(self) -> int:
        """Coefficients, weights and biases."""
        return self.sindy.parameter_count + mlp.count(self.weights)

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """Train the perceptron on the one-step residual of the fitted K-SINDy, or over rollouts as well."""
        if not isinstance(task.base, KSindy):
            raise TypeError("k-sindy-mlp is derived from a fitted k-sindy model")
        sindy, settings = task.base, ResidualTrainingSettings.model_validate(task.settings)
        used, held = parts_of(task, settings)
        s = transitions(used)
        x = np.ascontiguousarray(np.column_stack([s.kinematic, s.command[:, 0]]))
        residual = s.next_kinematic[:, :3] - _sindy_table(x, sindy.sparse, sindy.frame)
        dissipative = settings.residual == "dissipative"
        sparse = sparse_sums(sindy.sparse, sindy.frame)
        ahead = unrolled(sindy.frame, lambda network, at: sparse(at) + network(at), dissipative)
        stretches = stretches_of(used, held, settings, ahead, prepared=lambda taken: with_servo(taken, sindy.frame))
        weights, facts = train(x, residual, settings, task.seed, task.progress, stretches)
        return cls(sindy, weights, facts, dissipative)

    def init(self, history: History) -> Floats:
        """[v_f, alpha_f, alpha_r, delta]."""
        return np.array(history.kinematic[-1])

    @property
    def arguments(self) -> tuple[Any, ...]:
        """See `Scanned`."""
        return (self.sindy.sparse, self.weights, self.sindy.frame, self.dissipative)

    def describe(self) -> str:
        """The sparse equations and the perceptron's structure."""
        a, b = self.weights.W2.shape
        residual = f"plus MLP(v_f, α_f, α_r, δ, u_s, u_m): hidden {a} and {b}, ReLU, {mlp.count(self.weights)} weights"
        lines = [self.sindy.describe(), residual]
        if self.dissipative:
            lines.append("v_f lowered where v_x² + v_y² + l_f l_r w² would grow while u_m ≤ 0 (as if I_z = m l_f l_r)")
        return "\n".join(lines)

    def state(self) -> tuple[dict[str, Any], Arrays]:
        """See `Model.state`."""
        data, arrays = self.sindy.state()
        return {"sindy": data, "facts": dict(self.facts), "dissipative": self.dissipative}, arrays | mlp.to_arrays(
            self.weights
        )

    @classmethod
    def from_state(cls, data: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> Self:
        """See `Model.from_state`."""
        return cls(
            KSindy.from_state(data["sindy"], arrays),
            mlp.from_arrays(arrays, INPUTS),
            data["facts"],
            bool(data.get("dissipative", False)),
        )
