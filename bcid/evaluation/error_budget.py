"""What a prediction error is made of: parts that sum to the whole, each with an interval by block bootstrap.

Say n things may be added to a model, and v(S) is its mean squared error with those of the set S.  What thing i takes
off the error depends on which others are there already; on average over all orders in which they may be added it is
its Shapley value (Shapley, A value for n-person games, 1953)

    phi_i = sum over S without i of  |S|! (n - 1 - |S|)! / n!  (v(S) - v(S + i)),

and phi_1 + … + phi_n = v(none) - v(all), whatever the order.  With the error f that a perfect model would have, since
its measurements are noisy, the whole error is v(none) = phi_1 + … + phi_n + f + (v(all) - f): what each thing explains,
what noise makes, and what stays unexplained.  Divided by v(none) these are shares, whose sum is one.

A set is written as a number, whose bit i says whether thing i is in it.
"""

from collections.abc import Callable
from math import factorial
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.bootstrap import draw_block_counts, quantile_interval

RESAMPLES = 1999
SEED, FLOOR_SEED = 0, 1
"""Seeds of the random numbers by which measured blocks are drawn, and simulated ones."""


class ErrorPart(NamedTuple):
    """One part of an error, as a share of the whole, and the 95 % interval of that share."""

    share: float
    ci95: tuple[float, float]


class ErrorParts(NamedTuple):
    """The whole of an error and its parts, whose shares sum to one."""

    error: float  # v(none)
    explained: tuple[ErrorPart, ...]  # by each of the n things
    floor: tuple[ErrorPart, ...]  # each part of what a perfect model would miss
    unexplained: ErrorPart  # where no floor is known, with the noise in it


def shapley_weights(things: int) -> Floats:
    """Weights W (n, 2^n) with which W v is what each of n `things` takes off the error v (2^n,) of their sets.

    >>> shapley_weights(2).tolist()
    [[0.5, -0.5, 0.5, -0.5], [0.5, 0.5, -0.5, -0.5]]
    """
    n, weights = things, np.zeros((things, 2**things))
    for i in range(n):
        for s in range(2**n):
            if not s >> i & 1:
                size = s.bit_count()
                weight = factorial(size) * factorial(n - 1 - size) / factorial(n)
                weights[i, s] += weight
                weights[i, s | 1 << i] -= weight
    return weights


def apportion_error(squares: Floats, block: Ints, floor: Floats, floor_block: Ints) -> ErrorParts:
    """Apportion the mean squared error of a model to what n things explain, to noise, and to what is unexplained.

    Args:
        squares: squared errors (2^n, K) of the model with each set of the things; a row of time at which one is not
            finite is left out of all.
        block: number (K,) of the block of consecutive rows that each row belongs to; blocks are resampled whole.
        floor: squared errors (m, K') that a perfect model would have, in m parts; they come from a simulation, so that
            its rows are drawn apart from those of `squares`.
        floor_block: number (K',) of the block of each of its rows.

    Raises:
        ValueError: no row is finite for all sets, or all of them predict without any error.
    """
    errors, drawn = _mean_and_draws(squares, block, SEED)
    noise, drawn_noise = _mean_and_draws(floor, floor_block, FLOOR_SEED)
    weights = shapley_weights(len(squares).bit_length() - 1)
    if not errors[0] > 0.0:
        raise ValueError("predictions without any error have no parts")

    def shares(v: Floats, f: Floats) -> Floats:
        """Shares (..., n + m + 1) of v(none) from errors v (..., 2^n) of the sets and f (..., m) of a perfect model."""
        rest = v[..., -1] - f.sum(axis=-1)
        parts = np.concatenate([v @ weights.T, f, rest[..., None]], axis=-1)
        return np.asarray(parts / v[..., :1])

    low, high = quantile_interval(shares(drawn, drawn_noise))
    parts = [
        ErrorPart(float(share), (float(a), float(b)))
        for share, a, b in zip(shares(errors, noise), low, high, strict=True)
    ]
    n = len(weights)
    return ErrorParts(float(errors[0]), tuple(parts[:n]), tuple(parts[n:-1]), parts[-1])


def _mean_and_draws(squares: Floats, block: Ints, seed: int) -> tuple[Floats, Floats]:
    """Means (n,) of squared errors (n, K) over rows at which all are finite, and their bootstrap means (RESAMPLES, n).

    Raises:
        ValueError: there is no such row.
    """
    finite = np.asarray(np.isfinite(squares).all(axis=0))
    if not finite.any():
        raise ValueError("predictions are nowhere finite")
    _, place = np.unique(block[finite], return_inverse=True)
    count = np.bincount(place).astype(float)
    sums = np.array([np.bincount(place, row) for row in squares[:, finite]]).reshape(-1, len(count)).T
    times = draw_block_counts(len(count), RESAMPLES, seed)
    return sums.sum(axis=0) / count.sum(), (times @ sums) / (times @ count)[:, None]


Predictor = Callable[[frozenset[str]], Floats]
"""Squared errors (K,) of the model with a set of things, by their names."""


def errors_of_sets(names: tuple[str, ...], squared_errors: Predictor) -> Floats:
    """Squared errors (2^n, K) of a model with each set of the things called `names`, sets in their order as numbers."""
    n = len(names)
    return np.stack([squared_errors(frozenset(names[i] for i in range(n) if s >> i & 1)) for s in range(2**n)])
