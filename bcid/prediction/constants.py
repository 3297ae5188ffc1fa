"""How well a model's constants are known, as far as the model states it: pairs of models, one standard error apart.

A Newton-Euler car states relative standard errors and their correlations, a car with effects those of its parameters,
too; what has no name beside them states nothing.  Of earlier versions the first states the pairs alone that are
strongly correlated, the second no correlation.  Other models state nothing of their numbers, whose error is in their
process noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple, cast

import numpy as np

from bcid.aliases import Floats
from bcid.effects.entry import Parameter
from bcid.effects.table import ENTRIES
from bcid.models.interface import Model
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.model import NewtonEuler
from bcid.models.newton_euler.parameters import (
    drag_per_speed,
    is_identified,
    stated_errors,
    values_of_constants,
)
from bcid.models.newton_euler.saved_car import as_correlation
from bcid.models.newton_euler.with_remainder import NewtonEulerWithRemainder
from bcid.physics.car import Car
from bcid.prediction.limits import LIMITS as PREDICTION_LIMITS


class ConstantVariation(NamedTuple):
    """A model with one constant raised, and lowered, and the standard error over half their difference."""

    symbol: str
    raised: Model
    lowered: Model
    factor: float = 1.0


class VariedConstants(NamedTuple):
    """The variations of a model's constants, the correlation of their errors, and the constants that are left out."""

    variations: tuple[ConstantVariation, ...]
    correlation: Floats  # (n, n)
    left_out: tuple[str, ...]  # of which no usable standard error is known


def vary_constants(model: Model) -> VariedConstants:
    """Vary each constant of a model whose standard error is known.

    Correlations that the model does not state count as zero.
    """
    if isinstance(model, NewtonEuler):
        variations = {v.symbol: v for v in _vary_car(model)}
        return VariedConstants(
            tuple(variations.values()),
            _stated_correlation(list(variations), model.facts),
            tuple(s for s in model.facts.get("fitted", {}) if s not in variations),
        )
    if isinstance(model, AugmentedNewtonEuler):
        variations = {v.symbol: v for v in _vary_augmented(model)}
        known = (*model.facts.get("fitted", ()), *model.effects)
        return VariedConstants(
            tuple(variations.values()),
            _stated_correlation(list(variations), model.facts),
            tuple(s for s in known if s not in variations),
        )
    if isinstance(model, NewtonEulerWithRemainder):
        named = vary_constants(model.named)
        return named._replace(variations=tuple(_beside_remainder(v, model) for v in named.variations))
    return VariedConstants((), np.empty((0, 0)), ())


def _beside_remainder(variation: ConstantVariation, model: NewtonEulerWithRemainder) -> ConstantVariation:
    """The variation of a car with effects, with what has no name in `model` beside it."""
    raised, lowered = (
        replace(model, named=cast(AugmentedNewtonEuler, car)) for car in (variation.raised, variation.lowered)
    )
    return variation._replace(raised=raised, lowered=lowered)


def _stated_correlation(symbols: list[str], facts: Mapping[str, Any]) -> Floats:
    """The correlation (n, n) of n constants' errors: as a model's facts state all of it, or strong pairs alone."""
    whole = facts.get("correlation")
    if whole is None:
        return correlation_matrix(symbols, facts.get("correlated", ()))
    rows, matrix = list(whole["symbols"]), whole["matrix"]
    pairs = [(a, b, matrix[rows.index(a)][rows.index(b)]) for a, b in combinations(symbols, 2) if {a, b} <= {*rows}]
    return correlation_matrix(symbols, pairs)


def correlation_matrix(symbols: list[str], pairs: object) -> Floats:
    """The correlation (n, n) of n errors, of `pairs` (symbol, symbol, correlation); of others it is zero.

    Where not all are stated, such a matrix need not be one of correlations: it is replaced by the one of its positive
    eigenvalues, scaled to a diagonal of ones, which changes no matrix that is one.
    """
    stated: list[tuple[str, str, float]] = list(pairs)  # type: ignore[call-overload]
    matrix = np.eye(len(symbols))
    for one, other, rho in stated:
        if one in symbols and other in symbols:
            i, j = symbols.index(one), symbols.index(other)
            matrix[i, j] = matrix[j, i] = rho
    return as_correlation(matrix)


def _vary_car(model: NewtonEuler) -> Iterator[ConstantVariation]:
    """The variations of a fitted car's constants, each raised and lowered by its relative standard error."""
    facts, car = model.facts, model.car
    top_speed = float(facts.get("top_speed_mps", 0.0))
    values = values_of_constants(car, facts)
    for symbol in facts.get("fitted", {}):
        if not is_identified(symbol, facts) or (symbol == "R_v" and top_speed <= 0.0):
            continue
        change = values[symbol] * facts["fitted"][symbol]["relative_se"]
        raised, lowered = (
            replace(model, car=_car_with(car, symbol, values[symbol] + sign * change, top_speed)) for sign in (1, -1)
        )
        yield ConstantVariation(symbol, raised, lowered)


def _car_with(car: Car, symbol: str, value: float, top_speed: float) -> Car:
    """The car with another value of a constant; the drag is known as R_1 and as R_v = R_1 + R_2 v at the top speed."""
    R_v = drag_per_speed(car, top_speed)
    if symbol == "R_v":
        return car._replace(R_2=(value - car.R_1) / top_speed)
    if symbol == "R_1" and top_speed > 0.0:
        return car._replace(R_1=value, R_2=(R_v - value) / top_speed)
    return car._replace(**{symbol: value})


def _vary_augmented(model: AugmentedNewtonEuler) -> Iterator[ConstantVariation]:
    """The variations of a car with effects: its refitted constants, and its effects' parameters within their bounds."""
    errors: Mapping[str, float | None] = model.facts.get("se", {})
    of_car = stated_errors(model.car, {"se": errors})
    bounds = {name: p for e in ENTRIES.values() for name, p in zip(e.fields, e.parameters, strict=True)}
    for symbol, error in errors.items():
        if error is None or not (math.isfinite(error) and error > 0.0):
            continue
        if symbol in model.effects:
            value = model.effects[symbol]
            up, down = _changes_within(bounds[symbol], value, error)
            # what hardly may change shows its rounding alone, which the factor would make large
            if up + down >= PREDICTION_LIMITS.min_change_share * error:
                raised, lowered = (
                    replace(model, effects={**model.effects, symbol: value + change}) for change in (up, -down)
                )
                yield ConstantVariation(symbol, raised, lowered, 2.0 * error / (up + down))
        elif of_car.get(symbol) is not None and symbol in Car._fields:
            value = getattr(model.car, symbol)
            raised, lowered = (
                replace(model, car=model.car._replace(**{symbol: value + sign * error})) for sign in (1, -1)
            )
            yield ConstantVariation(symbol, raised, lowered)


def _changes_within(parameter: Parameter, value: float, error: float) -> tuple[float, float]:
    """How far a parameter's value is raised, and lowered: by its standard error `error`, or to the bound on that side.

    Near a bound the change is one-sided, inward.
    """
    return max(0.0, min(error, parameter.high - value)), max(0.0, min(error, value - parameter.low))
