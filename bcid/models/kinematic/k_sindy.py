"""K-SINDy: the kinematic state's evolution as a sparse sum of physically motivated terms.

[v_f alpha_f alpha_r]_{k+1} = Xi Theta(x_k, u_k)        (paper, f_SINDy and App. sindy)
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from bcid.models.interface import Arrays, FitTask, ScanKernels
from bcid.models.kinematic import library
from bcid.models.kinematic.saved_sparse import SavedKSindy, equations_from_arrays
from bcid.models.kinematic.sparse_sum import K_SINDY_KERNELS, SparseEquations
from bcid.models.kinematic.state import KinematicCar, KinematicModel
from bcid.models.saved_parts import parse_saved


@dataclass(frozen=True)
class KSindy(KinematicModel):
    """A fitted K-SINDy."""

    sparse: SparseEquations
    car: KinematicCar
    facts: Mapping[str, Any]
    kernels: ClassVar[ScanKernels] = K_SINDY_KERNELS
    name: ClassVar[str] = "k-sindy"

    @property
    def parameter_count(self) -> int:
        """How many coefficients are not zero."""
        s = self.sparse
        return int(sum(np.count_nonzero(xi) for xi in (s.xi_v, s.xi_f, s.xi_r)))

    @classmethod
    def fit(cls, task: FitTask) -> Self:
        """Fit by sequentially thresholded least squares on single steps, then on rollouts if the settings say so."""
        from bcid.models.kinematic.k_sindy_fit import fit_sparse_equations

        car = KinematicCar.from_task(task)
        sparse, facts = fit_sparse_equations(task, car)
        return cls(sparse, car, facts)

    @property
    def kernel_arguments(self) -> tuple[Any, ...]:
        """The equations and the car, as the compiled scan takes them."""
        return (self.sparse, self.car)

    def describe(self) -> str:
        """The three equations (SI: v m/s, angles rad, δ̇ rad/s; u_m m/s, or a brake share below zero)."""
        s, confidence = self.sparse, self.facts.get("term_confidence", {})
        lines = [
            "v = v_f in m/s, angles in rad, rates in rad/s; u_m in m/s (a brake share below zero); k is the period",
            library.format_equation("v_f(k+1)", s.xi_v, s.speed),
            library.format_equation("α_f(k+1)", s.xi_f, s.slip),
            library.format_equation("α_r(k+1)", s.xi_r, s.slip),
            f"δ' = sat((u_s − δ)/{self.car.T_s:g} s) within ±{self.car.d:g} rad/s;  period {self.period_s:g} s",
        ]
        if confidence:
            lines.append("terms, the share of resamples that keep them, and their coefficients' 95 % intervals:")
        for name, terms in confidence.items():
            for term, (kept, low, high) in terms.items():
                lines.append(f"  {name:4} {term:14} {100.0 * kept:3.0f} %  {low:+.3g} … {high:+.3g}")
        text = "\n".join(lines)
        return text if self.car.follow else text.replace("max(0,u_m−v)", "max(0,u_m)")

    def to_saved(self) -> tuple[dict[str, Any], Arrays]:
        """The JSON object and the coefficients from which `from_saved` restores the model."""
        return {"frame": self.car._asdict(), "facts": dict(self.facts)}, dict(self.sparse._asdict())

    @classmethod
    def from_saved(cls, data: Mapping[str, Any], arrays: Arrays) -> Self:
        """The model whose `to_saved` gave `data` and `arrays`.

        Raises:
            ValueError: they hold anything that no such model has.
        """
        saved = parse_saved(SavedKSindy, data)
        return cls(equations_from_arrays(arrays), saved.frame.to_car(), saved.facts.as_mapping())
