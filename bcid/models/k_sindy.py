"""K-SINDy: the kinematic state's evolution as a sparse sum of physically motivated terms.

[v_f alpha_f alpha_r]_{k+1} = Xi Theta(x_k, u_k)        (paper, f_SINDy and App. sindy)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

import numba
import numpy as np
import numpy.typing as npt

from bcid.compiled import njit, njit_parallel
from bcid.models import library
from bcid.models.interface import Arrays, FitTask, Floats, History
from bcid.models.kinematic import Frame, frame_of, joined, twist_of
from bcid.models.library import theta
from bcid.physics.steering import steering_step


class Sparse(NamedTuple):
    """Coefficients and exponents of the three equations."""

    xi_v: Floats  # (n,)
    xi_f: Floats  # (m,)
    xi_r: Floats  # (m,)
    speed: npt.NDArray[np.int64]  # (n, 10)
    slip: npt.NDArray[np.int64]  # (m, 10)


@njit
def f_sindy(x: Floats, s: Sparse, c: Frame) -> Floats:
    """[v_f, alpha_f, alpha_r] one period later at x = [v_f, alpha_f, alpha_r, delta, u_s, u_m]."""
    slip = theta(x, s.slip, c)
    after = np.empty(3)
    after[0] = np.dot(s.xi_v, theta(x, s.speed, c))
    after[1] = np.dot(s.xi_f, slip)
    after[2] = np.dot(s.xi_r, slip)
    return after


@njit
def advance(state: Floats, command: Floats, s: Sparse, c: Frame) -> Floats:
    """[v_f, alpha_f, alpha_r, delta] one period later."""
    after = np.empty(4)
    after[:3] = f_sindy(joined(state, command), s, c)
    after[0] = max(after[0], 0.0)
    after[3] = steering_step(state[3], command[0], c.T_s, c.d, c.period)
    return after


@njit
def _scan(state: Floats, commands: Floats, s: Sparse, c: Frame) -> Floats:
    twists = np.empty((len(commands), 3))
    for k in range(len(commands)):
        state = advance(state, commands[k], s, c)
        twists[k, 0], twists[k, 1], twists[k, 2] = twist_of(state, c)
    return twists


@njit_parallel
def _scan_many(carries: Floats, commands: Floats, s: Sparse, c: Frame) -> Floats:
    twists = np.empty((len(carries), commands.shape[1], 3))
    for b in numba.prange(len(carries)):
        twists[b] = _scan(carries[b], commands[b], s, c)
    return twists


def _sure_lines(sure: Mapping[str, Mapping[str, Sequence[float]]]) -> list[str]:
    """How sure each term is."""
    lines = ["terms, the share of resamples that keep them, and their coefficients' 95 % intervals:"] if sure else []
    return [*lines, *(
        f"  {name:4} {term:14} {100.0 * kept:3.0f} %  {low:+.3g} … {high:+.3g}"
        for name, terms in sure.items() for term, (kept, low, high) in terms.items()
    )]  # fmt: skip


@dataclass(frozen=True)
class KSindy:
    """A fitted K-SINDy."""

    sparse: Sparse
    frame: Frame
    facts: Mapping[str, Any]
    name: ClassVar[str] = "k-sindy"
    lags: ClassVar[int] = 0

    @property
    def period_s(self) -> float:
        """The time a step advances (s)."""
        return self.frame.period

    @property
    def parameter_count(self) -> int:
        """Coefficients that are not zero."""
        s = self.sparse
        return int(sum(np.count_nonzero(xi) for xi in (s.xi_v, s.xi_f, s.xi_r)))

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """Sequentially thresholded least squares on one-step predictions (`SparseSettings`)."""
        from bcid.models.k_sindy_fit import fit_sparse

        frame = frame_of(task)
        sparse, facts = fit_sparse(task, frame)
        return cls(sparse, frame, facts)

    def init(self, history: History) -> Floats:
        """[v_f, alpha_f, alpha_r, delta]."""
        return np.array(history.kinematic[-1])

    def step(self, carry: Floats, command: Floats) -> tuple[Floats, Floats]:
        """See `Model.step`."""
        after = advance(carry, command, self.sparse, self.frame)
        return after, np.array(twist_of(after, self.frame))

    def scan(self, carry: Floats, commands: Floats) -> Floats:
        """See `Model.scan`."""
        twists: Floats = _scan(carry, commands, self.sparse, self.frame)
        return twists

    def scan_many(self, carries: Floats, commands: Floats) -> Floats:
        """See `Model.scan_many`."""
        twists: Floats = _scan_many(carries, commands, self.sparse, self.frame)
        return twists

    def describe(self) -> str:
        """The three equations (SI: v m/s, angles rad, δ̇ rad/s; u_m m/s, or a brake share below zero)."""
        s = self.sparse
        text = "\n".join(
            [
                "v = v_f in m/s, angles in rad, rates in rad/s; u_m in m/s (a brake share below zero); k is the period",
                library.equation("v_f(k+1)", s.xi_v, s.speed),
                library.equation("α_f(k+1)", s.xi_f, s.slip),
                library.equation("α_r(k+1)", s.xi_r, s.slip),
                f"δ' = sat((u_s − δ)/{self.frame.T_s:g} s) within ±{self.frame.d:g} rad/s;  period {self.period_s:g} s",
                *_sure_lines(self.facts.get("sure", {})),
            ]
        )
        return text if self.frame.follow else text.replace("max(0,u_m−v)", "max(0,u_m)")

    def state(self) -> tuple[dict[str, Any], Arrays]:
        """See `Model.state`."""
        return {"frame": self.frame._asdict(), "facts": dict(self.facts)}, dict(self.sparse._asdict())

    @classmethod
    def from_state(cls, data: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]) -> Self:
        """See `Model.from_state`."""
        sparse = Sparse(*(np.ascontiguousarray(arrays[name]) for name in Sparse._fields))
        return cls(sparse, Frame(**data["frame"]), data["facts"])
