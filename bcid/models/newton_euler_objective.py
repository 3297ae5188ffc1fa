"""How well Newton-Euler cars predict: the multi-step error of the twist, for many cars at once (paper, lossv).

The state of all stretches advances together, step after step; the inner loop over the stretches holds nothing but
arithmetic, so that the compiler makes vector instructions of the equations in `bcid.physics.car`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
import numpy.typing as npt

from bcid.compiled import njit, njit_parallel, njit_sums
from bcid.models.windows import Windows
from bcid.physics.car import Car, advance

Floats = npt.NDArray[np.float64]


class Stretches(NamedTuple):
    """`Windows` turned so that the stretches lie side by side in memory; S steps, B stretches."""

    start: Floats  # (4, B) v_x, v_y, yaw rate, delta
    command: Floats  # (S, 2, B)
    after: Floats  # (S, 3, B) the twist measured after each step

    @classmethod
    def of(cls, w: Windows) -> Stretches:
        """Those of `w`, which has no lags."""
        start = np.vstack([w.twist[:, 0].T, w.kinematic[:, 0, 3]])
        command, after = (np.ascontiguousarray(a.transpose(1, 2, 0)) for a in (w.command[:, :-1], w.twist[:, 1:]))
        return cls(np.ascontiguousarray(start), command, after)

    def part(self, chosen: npt.NDArray[np.intp]) -> Stretches:
        """Some of the stretches."""
        return Stretches(*(np.ascontiguousarray(a[..., chosen]) for a in self))


@njit_sums
def _advance_all(state: Floats, command: Floats, after: Floats, weight: Floats, p: Car, period: float) -> float:
    """Every stretch one step on, in place; returns the sum of squared weighted misses."""
    v_x, v_y, omega, delta = state[0], state[1], state[2], state[3]  # unpacking `state` hides that rows are contiguous
    u_s, u_m = command[0], command[1]
    m_x, m_y, m_w = after[0], after[1], after[2]
    total = 0.0
    for b in range(len(v_x)):
        v_x[b], v_y[b], omega[b], delta[b] = advance((v_x[b], v_y[b], omega[b], delta[b]), u_s[b], u_m[b], p, period)
        e_x = weight[0] * (v_x[b] - m_x[b])
        e_y = weight[1] * (v_y[b] - m_y[b])
        e_w = weight[2] * (omega[b] - m_w[b])
        total += e_x * e_x + e_y * e_y + e_w * e_w
    return total


@njit
def _predict(p: Car, s: Stretches, weight: Floats, period: float, out: Floats) -> float:
    """Fills `out` (S, 3, B) with the predicted twists; returns the sum of squared weighted misses."""
    state, total = s.start.copy(), 0.0
    for k in range(len(s.command)):
        total += _advance_all(state, s.command[k], s.after[k], weight, p, period)
        out[k] = state[:3]
    return total


@njit_parallel
def _predict_each(cars: list[Car], s: Stretches, weight: Floats, period: float, out: Floats) -> None:
    for i in numba.prange(len(cars)):
        _predict(cars[np.int64(i)], s, weight, period, out[i])


@njit_parallel
def _costs(cars: list[Car], s: Stretches, weight: Floats, period: float) -> Floats:
    out = np.empty(len(cars))
    for i in numba.prange(len(cars)):
        state, total = s.start.copy(), 0.0
        for k in range(len(s.command)):
            total += _advance_all(state, s.command[k], s.after[k], weight, cars[np.int64(i)], period)
        out[i] = total / s.after.size
    return out


def costs(cars: Sequence[Car], s: Stretches, weight: Floats, period: float) -> Floats:
    """Mean squared weighted miss of each car (P,): the NMSE of its predictions (errata 12)."""
    return np.asarray(_costs(numba.typed.List(cars), s, weight, period))


def predictions(cars: Sequence[Car], s: Stretches, period: float) -> Floats:
    """The twists (P, S, 3, B) that each car predicts."""
    out = np.empty((len(cars), *s.after.shape))
    _predict_each(numba.typed.List(cars), s, np.ones(3), period, out)
    return out
