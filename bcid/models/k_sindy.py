"""K-SINDy: the kinematic state's evolution as a sparse sum of physically motivated terms.

[v_f alpha_f alpha_r]_{k+1} = Xi Theta(x_k, u_k)        (paper, f_SINDy and App. sindy)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from bcid.compiled import njit
from bcid.models import library
from bcid.models.interface import Arrays, FitTask, Floats, History
from bcid.models.kinematic import Frame, frame_of, joined, twist_of
from bcid.models.library import theta, theta_table
from bcid.models.samples import transitions
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


def _regress(terms: Floats, target: Floats, threshold: float, ridge: float) -> Floats:
    """Sparse coefficients of `target` (N,) over `terms` (N, n), both scaled to unit RMS before the threshold."""
    from pysindy.optimizers import STLSQ

    scale, size = np.sqrt((terms**2).mean(axis=0)), float(np.sqrt((target**2).mean()))
    scale = np.where(scale > 1e-12, scale, 1.0)
    regression = STLSQ(threshold=threshold, alpha=ridge, max_iter=50)
    regression.fit(terms / scale, (target / size)[:, None])
    coefficients: Floats = regression.coef_[0] * size / scale
    return coefficients


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
        """Sequentially thresholded least squares on the one-step predictions.

        Settings: `SparseSettings`.
        """
        s, frame = transitions(task.estimates), frame_of(task)
        speed = library.SPEED_PUBLISHED if task.settings["library"] == "published" else library.SPEED
        x = np.ascontiguousarray(np.column_stack([s.kinematic, s.command[:, 0]]))
        threshold, ridge = float(task.settings["threshold"]), float(task.settings["ridge"])
        speed_terms, slip_terms = theta_table(x, speed, frame), theta_table(x, library.SLIP, frame)
        # v_f and the angles change little within a period: sparsity is asked of the change
        v_unit = (speed == library._terms((library.V,))[0]).all(axis=1)
        xi_v = _regress(speed_terms, s.next_kinematic[:, 0] - s.kinematic[:, 0], threshold, ridge) + v_unit
        xi_f = _regress(slip_terms, s.next_kinematic[:, 1], threshold, ridge)
        xi_r = _regress(slip_terms, s.next_kinematic[:, 2], threshold, ridge)
        facts = {"threshold": threshold, "ridge": ridge, "library": task.settings["library"]}
        return cls(Sparse(xi_v, xi_f, xi_r, speed, library.SLIP), frame, facts)

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
