"""A genetic algorithm over the unit box, by deap, with its global random state isolated (paper, App. parameters)."""

import random
from collections.abc import Callable
from typing import Any

import numpy as np
from deap import base, tools

from bcid.aliases import Floats, Progress
from bcid.models.fitting.optimum import Optimum

CROSSOVER, MUTATION = 0.8, 0.3
ETA_CROSSOVER, ETA_MUTATION = 10.0, 20.0
ELITE_SHARE = 0.05  # the default of MATLAB's ga()


class _Cost(base.Fitness):  # type: ignore[misc]  # deap carries no types
    """A cost to be minimised, as deap wants it."""

    weights = (-1.0,)


class _Individual(list[float]):
    """A point of the unit box with its cost."""

    def __init__(self, genes: Any) -> None:
        super().__init__(genes)
        self.fitness = _Cost()


def minimise_genetically(
    costs: Callable[[Floats], Floats], genes: int, population: int, generations: int, seed: int, progress: Progress
) -> Optimum:
    """Minimise a cost over the unit box [0, 1]^genes by a genetic algorithm with real-valued genes.

    `costs` maps a population of points (P, genes) to costs (P,).  Selection by tournament, simulated binary crossover,
    polynomial mutation; the best 5 % pass on unchanged.  The state of Python's `random` is restored afterwards.
    """
    saved = random.getstate()
    random.seed(seed)
    try:
        individuals = [_Individual(random.random() for _ in range(genes)) for _ in range(population)]  # noqa: S311  # no secret
        _assign_costs(individuals, costs)
        elite = max(1, round(ELITE_SHARE * population))
        history = []
        for generation in range(generations):
            best = tools.selBest(individuals, elite)
            children = [_Individual(p) for p in tools.selTournament(individuals, population - elite, tournsize=3)]
            for mother, father in zip(children[::2], children[1::2], strict=False):
                if random.random() < CROSSOVER:  # noqa: S311
                    tools.cxSimulatedBinaryBounded(mother, father, ETA_CROSSOVER, 0.0, 1.0)
            for child in children:
                if random.random() < MUTATION:  # noqa: S311
                    tools.mutPolynomialBounded(child, ETA_MUTATION, 0.0, 1.0, 1.5 / genes)
            _assign_costs(children, costs)
            individuals = [*best, *children]
            history.append(min(p.fitness.values[0] for p in individuals))
            progress((generation + 1) / generations, f"generation {generation + 1}, one-step NMSE {history[-1]:.3e}")
        winner = tools.selBest(individuals, 1)[0]
        return Optimum(np.array(winner), float(winner.fitness.values[0]), history)
    finally:
        random.setstate(saved)


def _assign_costs(individuals: list[_Individual], costs: Callable[[Floats], Floats]) -> None:
    """Evaluate `costs`, (P, n) -> (P,), once for all P individuals, and store each one's cost as its fitness."""
    for individual, cost in zip(individuals, costs(np.array(individuals)), strict=True):
        individual.fitness.values = (float(cost),)
