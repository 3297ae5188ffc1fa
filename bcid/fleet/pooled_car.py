"""One car in many recordings: the constants that it has in all of them, and its load, motor and grip in each.

A load f multiplies m and I_z.  As m is held in a fit, that divides all forces by f: their logarithms, which a fit
estimates, and R_1 and R_2 go down alike, and nothing else does.  So recordings say of each other what none says alone.
That holds for tyres and bearings whose forces do not grow with the load ("mass").  Where grip and drag are in
proportion to it ("load") they stay what they were per mass, and motor and brake alone seem weaker: as with an empty
battery.  `Alternative` says what the recordings say of the one against the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.errors import UsageError
from bcid.fleet.pooling import Pooled, SpreadPrior, Summary, pool
from bcid.likelihood.hypothesis import DRAG
from bcid.likelihood.refit import Fit
from bcid.likelihood.without_prior import take_away_prior
from bcid.physics.car import Car

FORCES = ("F_m_max", "K_t", "K_b", "K_v", "C_f", "C_r", "F_f_max", "F_r_max", *DRAG)
OWN = {
    "mass": dict.fromkeys(FORCES, -1.0),
    "load": dict.fromkeys(("F_m_max", "K_t", "K_b", "K_v"), -1.0),
    "motor": dict.fromkeys(("F_m_max", "K_t"), 1.0),
    "grip": dict.fromkeys(("C_f", "C_r", "F_f_max", "F_r_max"), 1.0),
    "drag": dict.fromkeys(DRAG, 1.0),
}
"""What may differ from recording to recording, as a factor, by name: the power with which it enters each constant."""

USUAL_SPREAD = 0.2
"""Standard deviation, relative, that is expected of what differs by name: a passenger, a battery, a floor."""
USUAL_SCATTER = 0.05
"""That of a constant by itself: what a fit that lacks physics makes of another drive."""
WITHIN_A_FACTOR = math.e
"""By which factor, as one standard deviation, a spread is another than expected, or one constant's scatter another than
that which all have in common."""
COMMON_WITHIN_A_FACTOR = math.e**2
"""By which one the common scatter is another than expected: models lack little or much."""
TINY = 1e-9
"""Drag (SI) below which a car is taken to have none, where a share of it is meant."""


class CarSummary(NamedTuple):
    """What one recording says of a car: logarithms of the constants, then R_1 (N s/m) and R_2 (N s^2/m^2)."""

    symbols: tuple[str, ...]
    summary: Summary
    car: Car  # fitted to this recording alone


class Alternative(NamedTuple):
    """By how many nats recordings are likelier if something else differs between them in the place of what is named."""

    named: str
    other: str
    nats: float


@dataclass(frozen=True)
class PooledCar:
    """The car that recordings have in common, and what is each one's own."""

    symbols: tuple[str, ...]  # of the shared constants
    nominal: Car  # has what is not fitted
    names: tuple[str, ...]  # of what differs, keys of OWN
    pooled: Pooled
    directions: Floats  # (n, k + n) C: what differs by name, then each constant by itself

    def car(self) -> Car:
        """The car of a recording in which nothing differs from the mean of all."""
        return self.as_car(self.pooled.shared)

    def car_of(self, recording: int) -> Car:
        """The car as it was in one recording; the mass is that of the vehicle file, and a load is in all forces."""
        return self.as_car(self.pooled.constants_of(recording, self.directions))

    def factors(self, beside: Sequence[int]) -> tuple[Floats, Floats]:
        """Factors (I, k) by which each recording differs from the mean of those `beside` it, and their relative sd."""
        k = len(self.names)
        own = self.pooled.own[:, :k]
        apart = own - own[list(beside)].mean(axis=0)
        sd = np.array([self.pooled.difference_sd([i], beside)[:k] for i in range(len(own))])
        return np.exp(apart), sd

    def as_car(self, phi: Floats) -> Car:
        """The car with the constants phi."""
        values = {s: x if s in DRAG else math.exp(x) for s, x in zip(self.symbols, phi.tolist(), strict=True)}
        return self.nominal._replace(**values)


def summarise_fit(fit: Fit) -> CarSummary:
    """What the recording of a fit of the base model says of its constants, without the prior of the fit."""
    hypothesis, n = fit.hypothesis, fit.hypothesis.base_size
    values, vectors = take_away_prior(fit.covariance[:n, :n], hypothesis.prior(fit.phi).stiffness(fit.phi)[:n])
    units = np.r_[np.ones(n - len(DRAG)), hypothesis.drag_units]
    information = (vectors * values) @ vectors.T / np.outer(units, units)
    # a constant that ended at a bound is no optimum, and says nothing
    stuck = hypothesis.is_at_bound(fit.phi)[:n]
    information[stuck] = information[:, stuck] = 0.0
    summary = Summary(fit.phi[:n] * units, information, np.zeros(n))
    return CarSummary((*hypothesis.log_parameters, *DRAG), summary, fit.car())


def refuse_to_pool(recordings: int, names: Sequence[str]) -> None:
    """Raise `UsageError` where there are fewer than two recordings, or what differs has a name that is none of OWN."""
    if unknown := [name for name in names if name not in OWN]:
        raise UsageError(f"nothing that differs is called {', '.join(unknown)}\n  next: name some of {', '.join(OWN)}")
    if recordings < 2:
        raise UsageError("one recording has nothing to be pooled with\n  next: name more recordings of the car")


def pool_car(summaries: Sequence[CarSummary], names: Sequence[str]) -> PooledCar:
    """Pool what recordings of the same car say, in which what is called `names` differs.

    Each constant may differ by itself as well, by as much as the recordings show: a fit's standard errors are those of
    a model that lacks nothing.

    Raises:
        UsageError: a name is none of OWN, there are fewer than two recordings, or they are of different vehicles.
    """
    refuse_to_pool(len(summaries), names)
    names = tuple(dict.fromkeys(names))  # what is said twice differs once
    symbols = summaries[0].symbols
    if any(each.symbols != symbols for each in summaries):
        raise UsageError("the recordings are of vehicles with other motors\n  next: pool those of one vehicle file")
    mean = np.mean([each.summary.phi for each in summaries], axis=0)
    scale = np.array([max(abs(x), TINY) if s in DRAG else 1.0 for s, x in zip(symbols, mean, strict=True)])
    columns = np.column_stack([*(_direction(symbols, name, mean) for name in names), np.diag(scale)])
    pooled = pool([each.summary for each in summaries], columns, expected_spreads(len(names), len(symbols)))
    return PooledCar(symbols, summaries[0].car, names, pooled, columns)


def expected_spreads(names: int, constants: int) -> SpreadPrior:
    """What is known beforehand of the spreads of what differs by name, then of each constant by itself."""
    covariance = math.log(WITHIN_A_FACTOR) ** 2 * np.eye(names + constants)
    covariance[names:, names:] += math.log(COMMON_WITHIN_A_FACTOR) ** 2
    return SpreadPrior(np.log([USUAL_SPREAD] * names + [USUAL_SCATTER] * constants), covariance)


def weigh_alternatives(summaries: Sequence[CarSummary], pooled: PooledCar) -> list[Alternative]:
    """What may differ in the place of each thing that does in `pooled`, the likeliest first."""
    found = []
    for named in pooled.names:
        rest = [name for name in pooled.names if name != named]
        for other in OWN.keys() - {*pooled.names}:
            there = pool_car(summaries, [*rest, other]).pooled.log_likelihood
            found.append(Alternative(named, other, there - pooled.pooled.log_likelihood))
    return sorted(found, key=lambda each: (-each.nats, each.other))


def _direction(symbols: Sequence[str], name: str, phi: Floats) -> Floats:
    """The derivative (n,) of the constants phi by the logarithm of the factor `name`."""
    powers = OWN[name]
    # R_1 and R_2 are no logarithms, as they may have either sign
    return np.array([
        powers.get(s, 0.0) * (x if s in DRAG else 1.0) for s, x in zip(symbols, phi.tolist(), strict=True)
    ])  # fmt: skip
