"""Which parameters of a fleet's cars are others on another day, and by how much: each over its logs by a mixed model.

A parameter x of log i, fitted with standard error s_i, is

    x_i = mu(car) + Delta(day) + N(0, tau^2) + N(0, s_i^2),

Delta = 0 on the first day.  tau is what differs from drive to drive beside that, such as what a model that lacks
physics makes of each; it is the likeliest one, mu and Delta integrated out (REML; for such models: Gelman and Hill,
Data Analysis Using Regression and Multilevel/Hierarchical Models, 2007, chapter 12).  As tau is known no better than
few logs say, intervals are Student's, of Satterthwaite's degrees of freedom (1946).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import stdtr, stdtrit

from bcid.aliases import Floats

TAU_RANGE = (1e-4, 1e2)
"""Range of tau, in parts of the spread of the values."""
ESTIMABLE = 1e-6
"""Largest part of a difference of days that lies outside of what the logs compare, by rounding."""


class Contrast(NamedTuple):
    """A mean or a difference of means, as logs show it."""

    day: int
    value: float  # in the unit of the values
    se: float
    freedom: float  # degrees of freedom of `se`

    @property
    def p_value(self) -> float:
        """The p-value of zero."""
        return 2.0 * float(stdtr(self.freedom, -abs(self.value) / self.se))

    def interval(self, level: float = 0.95) -> tuple[float, float]:
        """The interval that holds the true value in a share `level` of cases."""
        half = float(stdtrit(self.freedom, 0.5 + 0.5 * level)) * self.se
        return self.value - half, self.value + half


class DayModel(NamedTuple):
    """A parameter of a fleet over days; days that logs do not compare with the first have neither mean nor change."""

    tau: float
    first_day: int
    means: tuple[Contrast, ...]  # of each day, over the cars
    changes: tuple[Contrast, ...]  # of each later day beside the first


class _Design(NamedTuple):
    """The logs of a parameter: what they show, with which errors, by whom and when."""

    values: Floats  # (I,)
    se: Floats  # (I,)
    X: Floats  # (I, c + d - 1) a column for each car, and one for each day but the first

    def solve(self, tau: float) -> tuple[Floats, Floats, Floats]:
        """The mu of each car, then Delta of each later day; their covariance; the weights of logs."""
        weights = 1.0 / (tau**2 + self.se**2)
        covariance = np.asarray(np.linalg.pinv((self.X.T * weights) @ self.X, rcond=1e-12, hermitian=True))
        return covariance @ (self.X.T @ (weights * self.values)), covariance, weights

    def restricted_log_likelihood(self, tau: float) -> float:
        """The logarithm of the likelihood of tau, mu and Delta integrated out, but for a constant."""
        b, _, weights = self.solve(tau)
        chi2 = float(weights @ (self.values - self.X @ b) ** 2)
        eigenvalues = np.linalg.eigvalsh((self.X.T * weights) @ self.X)
        positive = eigenvalues[eigenvalues > 1e-12 * eigenvalues.max()]
        return 0.5 * float(np.sum(np.log(weights)) - np.sum(np.log(positive)) - chi2)

    def compares(self, contrast: Floats) -> bool:
        """Whether the logs say what a contrast of mu and Delta is: it lies in the space of the rows of X."""
        shown = np.linalg.pinv(self.X) @ self.X @ contrast
        return bool(np.abs(shown - contrast).max() < ESTIMABLE)

    def estimate(self, contrast: Floats, day: int, tau: float, most_freedom: float) -> Contrast:
        """A contrast with its standard error, and Satterthwaite's degrees of freedom of that.

        Those are 2 V^2 / var(V), V being its variance, by the derivative of V by tau^2 and the information of tau^2.
        """
        b, covariance, weights = self.solve(tau)
        by_log = covariance @ (self.X.T * weights)
        V = float(contrast @ covariance @ contrast)
        # of V by tau^2: each log's variance counts by its weight squared
        slope = float(np.sum((contrast @ by_log) ** 2))
        variance_of_tau2 = 2.0 / self._information(covariance, weights)
        freedom = 2.0 * V**2 / (slope**2 * variance_of_tau2)
        return Contrast(day, float(contrast @ b), float(np.sqrt(V)), float(np.clip(freedom, 1.0, most_freedom)))

    def _information(self, covariance: Floats, weights: Floats) -> float:
        """The trace of P^2, P = W - W X C X' W, which is twice the information of tau^2: linear in the number of logs.

        W are the `weights`, C the `covariance` of mu and Delta.
        """
        squared, cubed = (covariance @ (self.X.T * weights**power) @ self.X for power in (2, 3))
        return float(np.sum(weights**2) - 2.0 * np.trace(cubed) + np.sum(squared * squared.T))


def fit_days(values: Floats, se: Floats, days: Sequence[int], cars: Sequence[str]) -> DayModel | None:
    """The model of values (I,) with standard errors (I,) over `days`; None where there are too few for it.

    At least one value more is needed than there are cars and further days.  Cars that are not known, "", are one.
    """
    known_days, known_cars = sorted(set(days)), list(dict.fromkeys(cars))
    X = np.array([
        [float(car == other) for other in known_cars] + [float(day == other) for other in known_days[1:]]
        for day, car in zip(days, cars, strict=True)
    ])  # fmt: skip
    freedom = len(values) - int(np.linalg.matrix_rank(X))
    if freedom < 1 or len(known_days) < 2:
        return None
    logs = _Design(values, se, X)
    scale = float(np.std(values)) or float(np.mean(se)) or 1.0
    likeliest = minimize_scalar(
        lambda log_tau: -logs.restricted_log_likelihood(scale * np.exp(log_tau)),
        bounds=tuple(np.log(TAU_RANGE)), method="bounded",
    )  # fmt: skip
    tau, c, n = scale * float(np.exp(likeliest.x)), len(known_cars), X.shape[1]
    deltas = [np.zeros(n), *np.eye(n)[c:]]  # of each day beside the first
    mean = np.r_[np.full(c, 1.0 / c), np.zeros(n - c)]
    rows = list(zip(known_days, deltas, strict=True))
    means = tuple(logs.estimate(mean + delta, day, tau, freedom) for day, delta in rows if logs.compares(mean + delta))
    changes = tuple(logs.estimate(delta, day, tau, freedom) for day, delta in rows[1:] if logs.compares(delta))
    return DayModel(tau, known_days[0], means, changes)


def reject_at_false_share(p_values: Sequence[float], false_share: float) -> list[bool]:
    """Which hypotheses to reject so that the expected share of false rejections is `false_share` at most.

    By Benjamini and Hochberg (1995).

    >>> reject_at_false_share([0.001, 0.6, 0.03, 0.2], 0.05)
    [True, False, False, False]
    """
    p = np.asarray(p_values, float)
    if not len(p):
        return []
    ordered = np.sort(p)
    below = ordered[ordered <= false_share * np.arange(1, len(p) + 1) / len(p)]
    largest = float(below[-1]) if len(below) else -1.0
    return [bool(x <= largest) for x in p]
