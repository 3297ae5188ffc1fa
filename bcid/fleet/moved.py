"""Which parameters of a fleet's cars are others on another day, and by how much: each over its logs by a mixed model.

A parameter x of log i, fitted with standard error s_i, is

    x_i = mu(car) + Delta(day) + N(0, tau^2) + N(0, s_i^2),

Delta = 0 on the first day.  tau is what differs from drive to drive beside that, such as what a model that lacks
physics makes of each; it is the likeliest one, mu and Delta integrated out (REML; for such models: Gelman and Hill,
Data Analysis Using Regression and Multilevel/Hierarchical Models, 2007, chapter 12).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.stats import t as student_t

from bcid.aliases import Floats

TAU_RANGE = (1e-4, 1e2)
"""Range of tau, in parts of the spread of the values."""


class DayChange(NamedTuple):
    """By how much a parameter differs from that of the first day."""

    day: int
    change: float  # in the unit of the values
    se: float
    half_width: float  # of the 95 % interval
    p_value: float  # of no change


class DayMean(NamedTuple):
    """The mean of a parameter on one day, over the cars."""

    day: int
    mean: float
    se: float


class DayModel(NamedTuple):
    """A parameter of a fleet over days."""

    tau: float
    means: tuple[DayMean, ...]
    changes: tuple[DayChange, ...]  # of each later day


def fit_days(values: Floats, se: Floats, days: Sequence[int], cars: Sequence[str]) -> DayModel | None:
    """The model of values (I,) with standard errors (I,) over `days`; None where there are too few for it.

    At least one value more is needed than there are cars and further days.
    """
    known_days, known_cars = sorted(set(days)), list(dict.fromkeys(cars))
    X = np.array([
        [float(car == other) for other in known_cars] + [float(day == other) for other in known_days[1:]]
        for day, car in zip(days, cars, strict=True)
    ])  # fmt: skip
    free = len(values) - int(np.linalg.matrix_rank(X))
    if free < 1 or len(known_days) < 2:
        return None
    scale = float(np.std(values)) or float(np.mean(se)) or 1.0
    found = minimize_scalar(
        lambda log_tau: -_restricted_log_likelihood(scale * np.exp(log_tau), values, se, X),
        bounds=tuple(np.log(TAU_RANGE)), method="bounded",
    )  # fmt: skip
    tau = scale * float(np.exp(found.x))
    b, covariance = _generalised_least_squares(tau, values, se, X)
    c, half = len(known_cars), float(student_t.ppf(0.975, free))
    means, changes = list[DayMean](), list[DayChange]()
    for j, day in enumerate(known_days):
        mean = np.r_[np.full(c, 1.0 / c), np.zeros(len(b) - c)]
        if j:
            mean[c + j - 1] = 1.0
            error = float(np.sqrt(covariance[c + j - 1, c + j - 1]))
            p = 2.0 * float(student_t.sf(abs(b[c + j - 1]) / error, free))
            changes.append(DayChange(day, float(b[c + j - 1]), error, half * error, p))
        means.append(DayMean(day, float(mean @ b), float(np.sqrt(mean @ covariance @ mean))))
    return DayModel(tau, tuple(means), tuple(changes))


def _generalised_least_squares(tau: float, values: Floats, se: Floats, X: Floats) -> tuple[Floats, Floats]:
    """The mu of each car, then Delta of each later day, and their covariance, for one tau."""
    weights = 1.0 / (tau**2 + se**2)
    covariance = np.asarray(np.linalg.pinv((X.T * weights) @ X))
    return covariance @ (X.T @ (weights * values)), covariance


def _restricted_log_likelihood(tau: float, values: Floats, se: Floats, X: Floats) -> float:
    """The logarithm of the likelihood of tau, mu and Delta integrated out, but for a constant."""
    weights = 1.0 / (tau**2 + se**2)
    b, _ = _generalised_least_squares(tau, values, se, X)
    chi2 = float(weights @ (values - X @ b) ** 2)
    information = np.linalg.eigvalsh((X.T * weights) @ X)
    determined = information[information > 1e-12 * information.max()]
    return 0.5 * float(np.sum(np.log(weights)) - np.sum(np.log(determined)) - chi2)


def reject_at_false_share(p_values: Sequence[float], false_share: float) -> list[bool]:
    """Which hypotheses to reject so that the expected share of false rejections is `false_share` at most.

    By Benjamini and Hochberg (1995).

    >>> reject_at_false_share([0.001, 0.6, 0.03, 0.2], 0.05)
    [True, False, False, False]
    """
    p = np.asarray(p_values, float)
    if not len(p):
        return []
    order = np.argsort(p)
    below = np.flatnonzero(p[order] <= false_share * np.arange(1, len(p) + 1) / len(p))
    last = float(p[order[below[-1]]]) if len(below) else -1.0
    return [bool(x <= last) for x in p]
