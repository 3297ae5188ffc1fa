"""How well Newton-Euler cars predict: the multi-step error of the twist, for many cars at once (paper, lossv).

The states of all stretches advance together, step after step; the inner loop over the stretches holds nothing but
arithmetic, so that the compiler makes vector instructions of the equations in `bcid.physics.car`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit, njit_parallel, njit_sums
from bcid.models.fitting.windows import Windows
from bcid.physics.car import STEP_MARGIN, Car, step_cars

CARS_PER_CHUNK = 256
"""Cars whose states advance together: few enough for them to stay in the nearest cache."""


class TransposedWindows(NamedTuple):
    """`Windows` without lags, transposed so that the B stretches of S steps lie side by side in memory."""

    start: Floats  # (4, B) v_x, v_y, yaw rate, delta
    steps: Floats  # (S, V, 4, B) length (s), commands and brake of each of V integration steps in a period
    after: Floats  # (S, 3, B) the twist measured after each period

    @classmethod
    def from_windows(cls, w: Windows, period_s: float) -> TransposedWindows:
        """Transpose the stretches `w`, which have no lags, their periods (s) cut into integration steps."""
        start = np.vstack([w.twist[:, 0].T, w.kinematic[:, 0, 3]])
        steps = _cut_into_steps(w.parts[:, :-1], (0.5 + STEP_MARGIN) * period_s).transpose(1, 2, 3, 0)
        after = w.twist[:, 1:].transpose(1, 2, 0)
        return cls(*(np.ascontiguousarray(a) for a in (start, steps, after)))


def _cut_into_steps(parts: Floats, longest: float) -> Floats:
    """Integration steps (B, S, V, 4), [length (s), u_s, u_m, brake share], of periods of commands `parts` (B, S, W, 4).

    A part beyond `longest` (s) makes two steps, any other one.  V is the largest number of steps in a period; steps of
    length 0 fill others up.
    """
    B, S, W, _ = parts.shape
    twice = np.repeat(parts, 2, axis=2)
    long = parts[..., 0] > longest
    lengths = np.stack([np.where(long, 0.5, 1.0) * parts[..., 0], np.where(long, 0.5, 0.0) * parts[..., 0]], axis=-1)
    twice[..., 0] = lengths.reshape(B, S, 2 * W)
    empty = twice[..., 0] <= 0.0
    order = np.argsort(empty, axis=2, kind="stable")[:, :, : int((~empty).sum(axis=2).max(initial=1))]
    return np.take_along_axis(twice, order[..., None], axis=2)


@njit_sums
def _sum_weighted_squares(state: Floats, after: Floats, weight: Floats) -> float:
    """Sum of squares of weight times error of B predicted states against B measured twists, at one step.

    `state` (4, B) is [v_x, v_y, yaw rate, delta], `after` (3, B) the twists; `weight` (3,) is 1/sigma.
    """
    total = 0.0
    for c in range(3):
        predicted, measured = state[c], after[c]
        for b in range(len(predicted)):
            error = weight[c] * (predicted[b] - measured[b])
            total += error * error
    return total


@njit
def _fill_twists(p: Car, s: TransposedWindows, out: Floats) -> None:
    """Fill `out` (S, 3, B) with the twists that the car `p` predicts after each of S periods over B stretches."""
    state = s.start.copy()
    for k in range(len(s.steps)):
        for j in range(s.steps.shape[1]):
            step_cars(state, s.steps[k, j], p)
        out[k] = state[:3]


@njit
def _car_from_row(row: Floats) -> Car:
    """The car whose 22 constants stand in `row` (22,), in the order of the fields of `Car`."""
    return Car(
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10], row[11], row[12],
        row[13], row[14], row[15], row[16], row[17], row[18], row[19], row[20], row[21],
    )  # fmt: skip


@njit_parallel
def _fill_twists_of_cars(cars: Floats, s: TransposedWindows, out: Floats) -> None:
    """Fill `out` (P, S, 3, B) with the twists that P cars predict after each of S periods over B stretches.

    A row of `cars` (P, 22) holds the constants of one car in the order of the fields of `Car`.
    """
    for i in numba.prange(len(cars)):
        _fill_twists(_car_from_row(cars[i]), s, out[i])


@njit_parallel
def twist_nmse(cars: Floats, s: TransposedWindows, weight: Floats) -> Floats:
    """NMSE (P,) of the twists that P cars predict over stretches: the mean square of weight times error (paper, lossv).

    A row of `cars` (P, 22) holds one car's constants; `weight` (3,) is 1/sigma (docs/errata.md row 12).
    """
    out = np.empty(len(cars))
    for i in numba.prange(len(cars)):
        car, state, total = _car_from_row(cars[i]), s.start.copy(), 0.0
        for k in range(len(s.steps)):
            for j in range(s.steps.shape[1]):
                step_cars(state, s.steps[k, j], car)
            total += _sum_weighted_squares(state, s.after[k], weight)
        out[i] = total / s.after.size
    return out


@njit_parallel
def chunk_normal_equations(
    cars: Floats, differences: Floats, s: TransposedWindows, weight: Floats
) -> tuple[Floats, Floats, Floats]:
    """J^T J (C, n, n), J^T r (C, n) and r^T r (C,) of a car's weighted twist errors r, for C chunks of stretches.

    J is a finite-difference Jacobian by n constants: column i is the difference of the twists of car i + 1 from car 0
    of `cars` (n + 1, 22), divided by `differences[i]`.  By chunks, so that the whole Jacobian, a hundred thousand rows
    in an hour, is never stored.
    """
    n, (S, _, B) = len(differences), s.after.shape
    chunks = (B + CARS_PER_CHUNK - 1) // CARS_PER_CHUNK
    JJ, Jr, rr = np.empty((chunks, n, n)), np.empty((chunks, n)), np.empty(chunks)
    for chunk in numba.prange(chunks):
        a, b = chunk * CARS_PER_CHUNK, min((chunk + 1) * CARS_PER_CHUNK, B)
        r, J, out = np.empty((S, 3, b - a)), np.empty((n, S * 3 * (b - a))), np.empty((S, 3, b - a))
        own = TransposedWindows(s.start[:, a:b].copy(), s.steps[:, :, :, a:b].copy(), s.after[:, :, a:b].copy())
        _fill_twists(_car_from_row(cars[0]), own, r)
        for i in range(n):
            _fill_twists(_car_from_row(cars[i + 1]), own, out)
            for c in range(3):
                out[:, c] = (weight[c] / differences[i]) * (out[:, c] - r[:, c])
            J[i] = out.ravel()
        for c in range(3):
            r[:, c] = weight[c] * (r[:, c] - own.after[:, c])
        JJ[chunk], Jr[chunk], rr[chunk] = np.dot(J, J.T), np.dot(J, r.ravel()), np.sum(r * r)
    return JJ, Jr, rr


def predict_twists(cars: Sequence[Car], s: TransposedWindows) -> Floats:
    """Twists (P, S, 3, B), m/s and rad/s, that P cars predict after each of S periods over B stretches."""
    out = np.empty((len(cars), *s.after.shape))
    _fill_twists_of_cars(np.array(cars, dtype=float), s, out)
    return out
