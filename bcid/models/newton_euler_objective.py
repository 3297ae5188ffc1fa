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
from bcid.physics.car import Car, advance_all

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
def _squares(state: Floats, after: Floats, weight: Floats) -> float:
    """Sum of squared weighted misses of all stretches at one step."""
    total = 0.0
    for c in range(3):
        predicted, measured = state[c], after[c]
        for b in range(len(predicted)):
            miss = weight[c] * (predicted[b] - measured[b])
            total += miss * miss
    return total


@njit
def _predict(p: Car, s: Stretches, period: float, out: Floats) -> None:
    """Fills `out` (S, 3, B) with the predicted twists."""
    state = s.start.copy()
    for k in range(len(s.command)):
        advance_all(state, s.command[k], p, period)
        out[k] = state[:3]


@njit_parallel
def _predict_each(cars: list[Car], s: Stretches, period: float, out: Floats) -> None:
    for i in numba.prange(len(cars)):
        _predict(cars[np.int64(i)], s, period, out[i])


@njit_parallel
def _costs(cars: list[Car], s: Stretches, weight: Floats, period: float) -> Floats:
    out = np.empty(len(cars))
    for i in numba.prange(len(cars)):
        state, total = s.start.copy(), 0.0
        for k in range(len(s.command)):
            advance_all(state, s.command[k], cars[np.int64(i)], period)
            total += _squares(state, s.after[k], weight)
        out[i] = total / s.after.size
    return out


def costs(cars: Sequence[Car], s: Stretches, weight: Floats, period: float) -> Floats:
    """Mean squared weighted miss of each car (P,): the NMSE of its predictions (errata 12)."""
    return np.asarray(_costs(numba.typed.List(cars), s, weight, period))


def predictions(cars: Sequence[Car], s: Stretches, period: float) -> Floats:
    """The twists (P, S, 3, B) that each car predicts."""
    out = np.empty((len(cars), *s.after.shape))
    _predict_each(numba.typed.List(cars), s, period, out)
    return out
