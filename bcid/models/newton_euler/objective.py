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

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_parallel, njit_sums
from bcid.models.fitting.levenberg_marquardt import Normal
from bcid.models.fitting.windows import Windows
from bcid.physics.car import Car, advance_all

ABREAST = 256  # stretches that are worked on together: few enough to stay in the nearest cache


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


@njit
def _car(row: Floats) -> Car:
    """The car whose constants stand in a row, in the order of its fields."""
    return Car(
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10], row[11], row[12],
        row[13], row[14], row[15], row[16], row[17], row[18], row[19],
    )  # fmt: skip


@njit_parallel
def _predict_each(cars: Floats, s: Stretches, period: float, out: Floats) -> None:
    for i in numba.prange(len(cars)):
        _predict(_car(cars[i]), s, period, out[i])


@njit_parallel
def _costs(cars: Floats, s: Stretches, weight: Floats, period: float) -> Floats:
    out = np.empty(len(cars))
    for i in numba.prange(len(cars)):
        car, state, total = _car(cars[i]), s.start.copy(), 0.0
        for k in range(len(s.command)):
            advance_all(state, s.command[k], car, period)
            total += _squares(state, s.after[k], weight)
        out[i] = total / s.after.size
    return out


@njit_parallel
def _normal(cars: Floats, steps: Floats, s: Stretches, weight: Floats, period: float) -> tuple[Floats, Floats, Floats]:
    n, (S, _, B) = len(steps), s.after.shape
    chunks = (B + ABREAST - 1) // ABREAST
    JJ, Jr, rr = np.empty((chunks, n, n)), np.empty((chunks, n)), np.empty(chunks)
    for chunk in numba.prange(chunks):
        a, b = chunk * ABREAST, min((chunk + 1) * ABREAST, B)
        r, J, out = np.empty((S, 3, b - a)), np.empty((n, S * 3 * (b - a))), np.empty((S, 3, b - a))
        own = Stretches(s.start[:, a:b].copy(), s.command[:, :, a:b].copy(), s.after[:, :, a:b].copy())
        _predict(_car(cars[0]), own, period, r)
        for i in range(n):
            _predict(_car(cars[i + 1]), own, period, out)
            for c in range(3):
                out[:, c] = (weight[c] / steps[i]) * (out[:, c] - r[:, c])
            J[i] = out.ravel()
        for c in range(3):
            r[:, c] = weight[c] * (r[:, c] - own.after[:, c])
        JJ[chunk], Jr[chunk], rr[chunk] = np.dot(J, J.T), np.dot(J, r.ravel()), np.sum(r * r)
    return JJ, Jr, rr


def normal_equations(cars: Floats, steps: Floats, s: Stretches, weight: Floats, period: float) -> Normal:
    """Of the mean squared weighted miss about the first of `cars`, by differences to the others, each a step away.

    Summed stretch by stretch: the Jacobian of an hour, a hundred thousand rows, is never put together.
    """
    JJ, Jr, rr = _normal(cars, steps, s, weight, period)
    size = s.after.size
    return Normal(JJ.sum(axis=0) / size, Jr.sum(axis=0) / size, float(rr.sum()) / size)


def costs(cars: Sequence[Car] | Floats, s: Stretches, weight: Floats, period: float) -> Floats:
    """Mean squared weighted miss of each car (P,): the NMSE of its predictions (errata 12)."""
    return np.asarray(_costs(np.array(cars, dtype=float), s, weight, period))


def predictions(cars: Sequence[Car] | Floats, s: Stretches, period: float) -> Floats:
    """The twists (P, S, 3, B) that each car predicts; cars may be rows of their constants."""
    out = np.empty((len(cars), *s.after.shape))
    _predict_each(np.array(cars, dtype=float), s, period, out)
    return out
