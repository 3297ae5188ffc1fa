"""deap's genetic algorithm over a box, its global random state isolated (paper, App. parameters)."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from deap import base, tools

from bcid.aliases import Floats, Progress

CROSSOVER, MUTATION = 0.8, 0.3
ETA_CROSSOVER, ETA_MUTATION = 10.0, 20.0
ELITE_SHARE = 0.05  # MATLAB's ga() keeps as many


class Optimum(NamedTuple):
    """The best point found and the best cost of each generation."""

    x: Floats
    cost: float
    history: list[float]


class _Cost(base.Fitness):  # type: ignore[misc]  # deap carries no types
    weights = (-1.0,)


class _Individual(list[float]):
    def __init__(self, genes: Any) -> None:
        super().__init__(genes)
        self.fitness = _Cost()


def minimise(
    costs: Callable[[Floats], Floats], genes: int, population: int, generations: int, seed: int, progress: Progress
) -> Optimum:
    """The smallest of `costs` (P, genes) -> (P,) over the unit box.

    Tournament selection, simulated binary crossover, polynomial mutation, an elite kept.
    """
    saved = random.getstate()
    random.seed(seed)
    try:
        return _evolve(costs, genes, population, generations, progress)
    finally:
        random.setstate(saved)


def _evolve(
    costs: Callable[[Floats], Floats], genes: int, population: int, generations: int, progress: Progress
) -> Optimum:
    people = [_Individual(random.random() for _ in range(genes)) for _ in range(population)]  # noqa: S311  # no secret
    _judge(people, costs)
    elite = max(1, round(ELITE_SHARE * population))
    history = []
    for generation in range(generations):
        best = tools.selBest(people, elite)
        children = [_Individual(p) for p in tools.selTournament(people, population - elite, tournsize=3)]
        for one, other in zip(children[::2], children[1::2], strict=False):
            if random.random() < CROSSOVER:  # noqa: S311
                tools.cxSimulatedBinaryBounded(one, other, ETA_CROSSOVER, 0.0, 1.0)
        for child in children:
            if random.random() < MUTATION:  # noqa: S311
                tools.mutPolynomialBounded(child, ETA_MUTATION, 0.0, 1.0, 1.5 / genes)
        _judge(children, costs)
        people = [*best, *children]
        history.append(min(p.fitness.values[0] for p in people))
        progress((generation + 1) / generations, f"generation {generation + 1}, one-step NMSE {history[-1]:.3e}")
    winner = tools.selBest(people, 1)[0]
    return Optimum(np.array(winner), float(winner.fitness.values[0]), history)


def _judge(people: list[_Individual], costs: Callable[[Floats], Floats]) -> None:
    for person, cost in zip(people, costs(np.array(people)), strict=True):
        person.fitness.values = (float(cost),)
