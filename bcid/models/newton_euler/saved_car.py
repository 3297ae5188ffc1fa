"""The constants of a saved Newton-Euler car, and what is stated of them, within bounds that make sense."""

from collections.abc import Sequence
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from bcid.aliases import Floats
from bcid.models.saved_parts import (
    NotNegative,
    Period,
    Positive,
    SavedFacts,
    SavedPart,
    Share,
    Signed,
    Switch,
    Undetermined,
)  # fmt: skip
from bcid.physics.car import Car

ROUNDING = 1e-6
"""How far a saved correlation matrix may be from one."""


def correlation_fact(symbols: Sequence[str], covariance: Floats) -> dict[str, Any]:
    """What a saved model states of the correlations of errors with a `covariance` (n, n), as a `Correlation`.

    Symbols whose variance is not a finite number above zero are left out.
    """
    variance = np.diag(covariance)
    known = np.flatnonzero(np.isfinite(variance) & (variance > 0.0))
    sd = np.sqrt(variance[known])
    rho = covariance[np.ix_(known, known)] / np.outer(sd, sd)
    np.fill_diagonal(rho, 1.0)
    return {"symbols": [symbols[k] for k in known.tolist()], "matrix": as_correlation(0.5 * (rho + rho.T)).tolist()}


def as_correlation(matrix: Floats) -> Floats:
    """The correlation matrix (n, n) of the positive eigenvalues of a symmetric one with a diagonal of ones.

    A matrix that is one of correlations stays, up to rounding.
    """
    if not len(matrix):
        return matrix
    values, vectors = np.linalg.eigh(matrix)
    positive = (vectors * np.maximum(values, 0.0)) @ vectors.T
    sd = np.sqrt(np.diag(positive))
    rho = np.clip(positive / np.outer(sd, sd), -1.0, 1.0)
    np.fill_diagonal(rho, 1.0)
    return np.asarray(0.5 * (rho + rho.T))


class SavedCar(SavedPart):
    """All constants of a `Car`: those that are divided by are above zero, forces and stiffnesses not below."""

    m: Positive
    I_z: Positive
    l_f: Positive
    l_r: Positive
    T_s: Positive
    d: Positive
    F_m_max: NotNegative
    K_t: NotNegative
    K_b: NotNegative
    C_f: NotNegative
    C_r: NotNegative
    F_f_max: NotNegative
    F_r_max: NotNegative
    R_1: Signed
    R_2: Signed
    v_0: Positive
    front_share: Share = 1.0
    sets_force: Switch = 0.0
    u_0: Signed = 0.0
    K_v: NotNegative = 0.0
    reverses: Switch = 0.0
    follows_wheel: Switch = 0.0

    def to_car(self) -> Car:
        """The car with these constants."""
        return Car(**self.model_dump())


class FittedConstantFacts(SavedFacts):
    """What is stated of one fitted constant."""

    unit: str
    meaning: str
    relative_se: Annotated[float, Field(ge=0.0)] | None  # null where the takes do not identify it


class Correlation(SavedPart):
    """How the errors of constants depend on each other: a correlation matrix, and what its rows are of."""

    symbols: tuple[str, ...]
    matrix: tuple[tuple[Annotated[float, Field(ge=-1.0, le=1.0)], ...], ...]

    @model_validator(mode="after")
    def _check_matrix(self) -> Self:
        """Refuse what is no correlation matrix of the symbols."""
        n = len(self.symbols)
        if len(set(self.symbols)) != n:
            raise ValueError("a symbol stands twice")
        if len(self.matrix) != n or any(len(row) != n for row in self.matrix):
            raise ValueError(f"the matrix has not one row and one column for each of {n} symbols")
        rho = np.array(self.matrix).reshape(n, n)
        if np.abs(np.diag(rho) - 1.0).max(initial=0.0) > ROUNDING or np.abs(rho - rho.T).max(initial=0.0) > ROUNDING:
            raise ValueError("the matrix is not symmetric, with ones on its diagonal")
        if n and np.linalg.eigvalsh(rho)[0] < -ROUNDING * n:
            raise ValueError("the matrix has an eigenvalue below zero, which no correlations have")
        return self


class FitFacts(SavedFacts):
    """What is stated of the fit of a car."""

    fitted: dict[str, FittedConstantFacts] = Field(default_factory=dict)
    correlation: Correlation | None = None  # of relative errors; missing in models of earlier versions
    correlated: tuple[tuple[str, str, float], ...] = ()
    at_bound: tuple[str, ...] = ()
    top_speed_mps: Signed = 0.0
    mass_given: bool = True
    optimiser: str = ""
    fit_quality: str = ""

    @model_validator(mode="after")
    def _check_symbols(self) -> Self:
        """Refuse what no car has among the fitted constants."""
        unknown = set(self.fitted) - {*Car._fields, "R_v"}
        if unknown:
            raise ValueError(f"a car has no constant {', '.join(sorted(unknown))}")
        return self


class SavedNewtonEuler(SavedPart):
    """The JSON part of a saved Newton-Euler model."""

    car: SavedCar
    period_s: Period
    facts: FitFacts


class EffectFacts(SavedFacts):
    """What a diagnosis states of its car with effects: what it refitted, and standard errors by constant and field."""

    fitted: tuple[str, ...] = ()
    se: dict[str, Undetermined | None] = Field(default_factory=dict)
    correlation: Correlation | None = None  # of errors; missing in models of earlier versions
