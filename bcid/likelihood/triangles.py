"""Triangular factors of small symmetric matrices, and what is solved with them, in compiled loops over segments."""

import math

import numpy as np

from bcid.aliases import Floats
from bcid.compiled.njit import njit

# share of its diagonal below which a pivot is rounding: some hundred times the smallest difference of numbers
LEAST_PIVOT = 1e-13
MOST_UNSHOWN = 3  # numbers of a segment that poses need not show: its twist; where the car is they always show


@njit
def cholesky_factor(M: Floats) -> Floats:
    """The lower triangular L (n, n) with L L^T = M, a symmetric matrix; NaN where M is not positive semidefinite.

    A pivot that rounding alone decides counts as LEAST_PIVOT of its diagonal, MOST_UNSHOWN times at most: a part of an
    initial state that poses do not show at all (a side slip that is gone before the first of them leaves a shift) is
    then hardly known, instead of nothing being known of the segment.  Written out because LAPACK would raise where M is
    indefinite, and an exception in a parallel loop ends the process.
    """
    n = len(M)
    L, unshown = np.zeros((n, n)), 0
    for i in range(n):
        for j in range(i + 1):
            left = M[i, j]
            for k in range(j):
                left -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = left / L[j, j]
                continue
            unshown += 1 if left < LEAST_PIVOT * M[i, i] else 0
            if -LEAST_PIVOT * M[i, i] < left < np.inf and M[i, i] > 0.0 and unshown <= MOST_UNSHOWN:
                L[i, i] = math.sqrt(max(left, LEAST_PIVOT * M[i, i]))
            else:
                return np.full((n, n), np.nan)
    return L


@njit
def log_determinant(L: Floats) -> float:
    """log|L L^T| of a lower triangular `L` with a positive diagonal."""
    total = 0.0
    for i in range(len(L)):
        total += 2.0 * math.log(L[i, i])
    return total


@njit
def inverse_of_triangle(L: Floats) -> Floats:
    """The inverse (n, n) of a lower triangular `L` (n, n), which is one, too."""
    n = len(L)
    inverse = np.zeros((n, n))
    for i in range(n):
        inverse[i, i] = 1.0 / L[i, i]
        for j in range(i):
            left = 0.0
            for k in range(j, i):
                left -= L[i, k] * inverse[k, j]
            inverse[i, j] = left / L[i, i]
    return inverse


@njit
def solve_triangular(L: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Solutions y = L^-1 b and z = L^-T y (n,), of a lower triangular `L` (n, n); y . y is b . (L L^T)^-1 b.

    Where a part of an initial state is hardly shown, as where a car stands, L L^T is almost singular, and b . z would
    be lost in rounding; y . y is not.
    """
    n = len(b)
    y, z = np.empty(n), np.empty(n)
    for i in range(n):
        left = b[i]
        for k in range(i):
            left -= L[i, k] * y[k]
        y[i] = left / L[i, i]
    for i in range(n - 1, -1, -1):
        left = y[i]
        for k in range(i + 1, n):
            left -= L[k, i] * z[k]
        z[i] = left / L[i, i]
    return y, z
