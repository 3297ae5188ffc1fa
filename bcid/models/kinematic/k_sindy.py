"""K-SINDy: the kinematic state's evolution as a sparse sum of physically motivated terms.

[v_f alpha_f alpha_r]_{k+1} = Xi Theta(x_k, u_k)        (paper, f_SINDy and App. sindy)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.models.interface import Arrays, FitTask, History, Kernels, Scanned
from bcid.models.kinematic import library
from bcid.models.kinematic.frame import Frame, frame_of
from bcid.models.kinematic.sparse_sum import Sparse, _scan, scan_many


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
        from bcid.models.kinematic.k_sindy_fit import fit_sparse

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
