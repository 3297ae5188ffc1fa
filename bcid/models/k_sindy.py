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
from bcid.models.kinematic import Frame, State, frame_of, moved, twist_of
from bcid.models.library import ONE, fill_factors
from bcid.models.scanned import Kernels, Scanned


class Sparse(NamedTuple):
    """Coefficients and exponents of the three equations."""

    xi_v: Floats  # (n,)
    xi_f: Floats  # (m,)
    xi_r: Floats  # (m,)
    speed: npt.NDArray[np.int64]  # (n, 10)
    slip: npt.NDArray[np.int64]  # (m, 10)


class Terms(NamedTuple):
    """The terms whose coefficient is not zero, as a rollout takes them."""

    xi: Floats  # (T,)
    equation: npt.NDArray[np.int64]  # (T,) 0, 1, 2: of v_f, alpha_f, alpha_r
    factors: npt.NDArray[np.int64]  # (T, most) whose product a term is, filled up with ones
    q: Floats  # (11,) to work on: the values of the factors
    after: Floats  # (3,) and of the sums


@njit
def terms_of(s: Sparse) -> Terms:
    """The terms of the three equations."""
    most, count = 1, 0
    equations = ((s.xi_v, s.speed), (s.xi_f, s.slip), (s.xi_r, s.slip))
    for xi, exponents in equations:
        for i in range(len(xi)):
            if xi[i] != 0.0:
                count += 1
                most = max(most, exponents[i].sum())
    out = Terms(np.empty(count), np.empty(count, np.int64), np.full((count, most), ONE), np.empty(ONE + 1), np.empty(3))
    n = 0
    for e in range(3):
        xi, exponents = equations[e]
        for i in range(len(xi)):
            if xi[i] != 0.0:
                out.xi[n], out.equation[n], at = xi[i], e, 0
                for j in range(exponents.shape[1]):
                    for _ in range(exponents[i, j]):
                        out.factors[n, at] = j
                        at += 1
                n += 1
    return out


@njit
def f_sindy(state: State, u_s: float, u_m: float, t: Terms, c: Frame) -> None:
    """Fills `t.after` with [v_f, alpha_f, alpha_r] one period later."""
    fill_factors(t.q, state, u_s, u_m, c)
    for n in range(len(t.after)):
        t.after[n] = 0.0
    for i in range(len(t.xi)):
        product = t.xi[i]
        for j in range(t.factors.shape[1]):
            product *= t.q[t.factors[i, j]]
        t.after[t.equation[i]] += product


@njit
def advance(state: State, u_s: float, u_m: float, t: Terms, c: Frame) -> State:
    """[v_f, alpha_f, alpha_r, delta] one period later."""
    f_sindy(state, u_s, u_m, t, c)
    return moved(t.after, state[3], u_s, c)


@njit
def _scan(carry: Floats, commands: Floats, s: Sparse, c: Frame) -> Floats:
    twists, terms = np.empty((len(commands), 3)), terms_of(s)
    state = (carry[0], carry[1], carry[2], carry[3])
    for k in range(len(commands)):
        state = advance(state, commands[k, 0], commands[k, 1], terms, c)
        twists[k, 0], twists[k, 1], twists[k, 2] = twist_of(*state, c)
    carry[0], carry[1], carry[2], carry[3] = state
    return twists


@njit_parallel
def scan_many(carries: Floats, commands: Floats, s: Sparse, c: Frame) -> Floats:
    """See `Model.scan_many`."""
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
class KSindy(Scanned):
    """A fitted K-SINDy."""

    sparse: Sparse
    frame: Frame
    facts: Mapping[str, Any]
    kernels: ClassVar[Kernels] = Kernels(_scan, scan_many)
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

    @property
    def arguments(self) -> tuple[Any, ...]:
        """See `Scanned`."""
        return (self.sparse, self.frame)

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
