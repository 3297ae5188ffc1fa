"""Fitting the Newton-Euler model's constants: one-step or multi-step predictions of the twist (paper, lossv)."""

from __future__ import annotations

from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.models.fitting import genetic, levenberg_marquardt
from bcid.models.fitting.block_covariance import blocks_of, covariance
from bcid.models.fitting.genetic import Optimum
from bcid.models.fitting.levenberg_marquardt import Normal
from bcid.models.fitting.windows import scale, steps_of, windows
from bcid.models.interface import FitTask
from bcid.models.newton_euler.objective import Stretches, costs, normal_equations, predictions
from bcid.models.newton_euler.parameters import LIMITS, Box, correlated
from bcid.models.settings import NewtonEulerSettings
from bcid.physics.car import Car

BLOCK_S = 5.0  # within which residuals are alike
NO_END = 1e6  # cost of a car that leaves the finite numbers
STEP = 1e-5  # of the box, for differences
FEWEST = 100  # stretches on which starts are compared
ENOUGH = 2000  # stretches on which it is seen whether limits are reached
SURELY = 1.645  # standard errors: 95 % on one side
INNER = (0.2, 0.8)  # of the box, where starts are drawn


class Objective:
    """The mean squared weighted miss of the twist over stretches of the takes, at points of the box."""

    def __init__(self, box: Box, stretches: Stretches, weight: Floats, period_s: float) -> None:
        self.box, self.stretches, self.weight, self.period_s = box, stretches, weight, period_s

    def costs(self, points: Floats) -> Floats:
        """The NMSE at each of the points (P, n)."""
        found = costs([self.box.car(x) for x in points], self.stretches, self.weight, self.period_s)
        return np.where(np.isfinite(found), found, NO_END)

    def misses(self, points: Floats) -> Floats:
        """Residuals (P, N) whose squares sum to the NMSE."""
        of = self.stretches
        predicted = predictions([self.box.car(x) for x in points], of, self.period_s)
        found = self.weight[:, None] * (predicted - of.after) / np.sqrt(of.after.size)
        return np.asarray(found.reshape(len(points), -1))

    def normal(self, x: Floats) -> Normal:
        """The normal equations at a point."""
        steps = inward(x)
        cars = np.array([self.box.car(p) for p in np.vstack([x, x + np.diag(steps)])])
        return normal_equations(cars, steps, self.stretches, self.weight, self.period_s)

    def slopes(self, x: Floats) -> Floats:
        """D misses / d x (N, n)."""
        steps = inward(x)
        found = self.misses(np.vstack([x, x + np.diag(steps)]))
        return np.asarray(((found[1:] - found[0]) / steps[:, None]).T)

    def blocks(self, values: Floats, block: int) -> Floats:
        """Sums (B, n) over so many neighbouring stretches of `values` (N, n), which are one for each miss."""
        each = values.reshape(-1, self.stretches.start.shape[1], values.shape[1]).sum(axis=0)
        return blocks_of(each, block)

    def without(self, j: int, x: Floats) -> Floats:
        """The best point near `x` whose coordinate `j` stands at its upper end."""

        def normal(at: Floats) -> Normal:
            JJ, Jr, rr = self.normal(at)
            JJ[j], JJ[:, j], Jr[j] = 0.0, 0.0, 0.0
            return Normal(JJ, Jr, rr)

        start = x.copy()
        start[j] = 1.0
        return levenberg_marquardt.minimise(normal, normal, [start], lambda *_: None).x

    def part(self, share: float, seed: int) -> Objective:
        """The same over a share of the stretches."""
        count = self.stretches.start.shape[1]
        chosen = np.sort(np.random.default_rng(seed).permutation(count)[: max(FEWEST, round(share * count))])
        return Objective(self.box, self.stretches.part(chosen), self.weight, self.period_s)


def inward(x: Floats) -> Floats:
    """Steps for differences, towards the middle of the box."""
    return np.where(x < 0.5, STEP, -STEP)


def fit_car(task: FitTask) -> tuple[Car, dict[str, Any]]:
    """The car whose predictions are best, and how it was found."""
    settings = NewtonEulerSettings.model_validate(task.settings)
    steps = steps_of(settings.loss, settings.horizon_s, task.period_s)
    taken = windows(task.estimates, steps, steps)
    steering = task.estimates[0].facts
    top_speed = float(np.quantile(taken.kinematic[:, 0, 0], 0.999))
    box = Box(task.vehicle, steering["T_s"], steering["d"], settings.v_0_mps, top_speed)
    objective = Objective(box, Stretches.of(taken), scale(taken.twist[:, 0]), task.period_s)
    best, how = _optimised(objective, settings, task)
    block = max(1, round(BLOCK_S / task.period_s / steps))
    of_x = _covariance(objective, best, block)
    enough = objective.part(max(settings.subset, ENOUGH / taken.number), task.seed)
    unreached = _unreached(enough, best, block)
    of_x[unreached], of_x[:, unreached] = np.nan, np.nan
    spread = np.sqrt(np.diag(of_x)) * box.log_range
    facts = {
        "optimiser": how,
        "loss": settings.loss,
        "nmse": best.cost,
        "reached": f"{settings.loss} NMSE of the training takes {best.cost:.3g}; ± without the bias of smoothed "
        "velocities: constants are found by --loss poses",
        "history": best.history,
        "fitted": {
            p.symbol: {
                "unit": p.unit, "low": p.low, "high": p.high, "meaning": p.meaning,
                "relative_se": float(s) if np.isfinite(s) else None,
            }
            for p, s in zip(box.table, spread, strict=True)
        },
        "correlated": correlated(of_x, [p.symbol for p in box.table]),
        "at_bound": box.at_bound(best.x),
        "top_speed_mps": top_speed,
        "mass_given": task.vehicle.body.mass_kg is not None,
    }  # fmt: skip
    return box.car(best.x), facts


def _optimised(objective: Objective, settings: NewtonEulerSettings, task: FitTask) -> tuple[Optimum, str]:
    n = len(objective.box.table)
    if settings.optimiser == "genetic":
        best = genetic.minimise(objective.costs, n, settings.population, settings.generations, task.seed, task.progress)
        return best, f"genetic algorithm, {settings.population} individuals, {len(best.history)} generations"
    drawn = np.random.default_rng(task.seed).uniform(*INNER, (settings.starts - 1, n))
    part = objective.part(settings.subset, task.seed)
    best = levenberg_marquardt.minimise(part.normal, objective.normal, [np.full(n, 0.5), *drawn], task.progress)
    return best, f"Levenberg-Marquardt from {settings.starts} starts"


def _covariance(objective: Objective, best: Optimum, block: int) -> Floats:
    """Of the point found, NaN where a constant has no effect."""
    J = objective.slopes(best.x)
    r = objective.misses(best.x[None])[0]
    acting = np.sqrt((J**2).mean(axis=0)) * np.sqrt(len(r)) > 1e-6
    J = J[:, acting]
    found = np.full((len(best.x), len(best.x)), np.nan)
    found[np.ix_(acting, acting)] = covariance(J, objective.blocks(J * r[:, None], block))
    return found


def _unreached(objective: Objective, best: Optimum, block: int) -> list[int]:
    """Limits without which predictions are no worse than blocks of stretches scatter: the takes do not show them.

    A fit may leave one just where a few samples touch it, with a slope there that says nothing; the other constants
    are fitted again without it.
    """
    held, found = objective.misses(best.x[None])[0] ** 2, []
    for j, p in enumerate(objective.box.table):
        if p.symbol in LIMITS:
            free = objective.without(j, best.x)
            worse = objective.blocks((objective.misses(free[None])[0] ** 2 - held)[:, None], block)[:, 0]
            scatter = worse.std(ddof=1) / np.sqrt(len(worse)) if len(worse) > 1 else np.inf
            if not worse.mean() > SURELY * scatter:
                found.append(j)
    return found
