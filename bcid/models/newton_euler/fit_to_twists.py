"""Fitting the Newton-Euler model's constants: one-step or multi-step predictions of the twist (paper, lossv)."""

from __future__ import annotations

from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.libraries import require_library
from bcid.likelihood.divergence import refuse_divergence
from bcid.models.fitting.block_covariance import BLOCK_S, sandwich_covariance, sum_blocks
from bcid.models.fitting.levenberg_marquardt import NormalEquations, minimise_squares
from bcid.models.fitting.optimum import Optimum
from bcid.models.fitting.windows import cut_windows, inverse_spread, loss_steps, stretch_spacing
from bcid.models.interface import FitTask
from bcid.models.limits import LIMITS
from bcid.models.newton_euler.objective import TransposedWindows, chunk_normal_equations, predict_twists, twist_nmse
from bcid.models.newton_euler.parameters import (
    BIASED_TWISTS,
    SATURATIONS,
    TOP_SPEED_QUANTILE,
    ConstantBox,
    constant_facts,
)
from bcid.models.settings import NewtonEulerSettings
from bcid.physics.car import Car

DIVERGED_COST = 1e6
DIFFERENCE_STEP = 1e-5  # in widths of the box
START_RANGE = (0.2, 0.8)  # of the box, where starts are drawn
# Stretches, at least, on which starts are compared, and on which saturation forces are tested.
MIN_START_STRETCHES, MIN_SATURATION_STRETCHES = 100, 2000


class TwistObjective:
    """The NMSE of predicted twists over stretches of the takes, as a function of points of the unit box."""

    def __init__(self, box: ConstantBox, stretches: TransposedWindows, weight: Floats) -> None:
        self.box, self.stretches = box, stretches
        self.weight = weight  # (3,) of the components of the twist

    def costs(self, points: Floats) -> Floats:
        """The NMSE (P,) at each of the points (P, n); `DIVERGED_COST` where it is not finite."""
        cars = np.array([self.box.car(x) for x in points])
        nmse = twist_nmse(cars, self.stretches, self.weight)
        return np.where(np.isfinite(nmse), nmse, DIVERGED_COST)

    def residuals(self, points: Floats) -> Floats:
        """Residuals (P, N) at the points (P, n) whose squares sum to the NMSE."""
        measured = self.stretches.after
        predicted = predict_twists([self.box.car(x) for x in points], self.stretches)
        errors = self.weight[:, None] * (predicted - measured) / np.sqrt(measured.size)
        return np.asarray(errors.reshape(len(points), -1))

    def normal_equations(self, x: Floats) -> NormalEquations:
        """The normal equations of the NMSE at the point `x` (n,)."""
        steps, points = difference_points(x)
        cars, size = np.array([self.box.car(p) for p in points]), self.stretches.after.size
        JJ, Jr, rr = chunk_normal_equations(cars, steps, self.stretches, self.weight)
        return NormalEquations(JJ.sum(axis=0) / size, Jr.sum(axis=0) / size, float(rr.sum()) / size)

    def jacobian(self, x: Floats) -> Floats:
        """Jacobian (N, n) of the residuals at the point `x` (n,), by differences."""
        steps, points = difference_points(x)
        r = self.residuals(points)
        return np.asarray(((r[1:] - r[0]) / steps[:, None]).T)

    def sum_over_blocks(self, residual_values: Floats, block: int) -> Floats:
        """Sums (B, n) of `residual_values` (N, n), a row for each residual, over blocks of neighbouring stretches."""
        each = residual_values.reshape(-1, self.stretches.start.shape[1], residual_values.shape[1]).sum(axis=0)
        return sum_blocks(each, block)

    def refit_without_saturation(self, j: int, x: Floats) -> Floats:
        """The best point near `x` whose coordinate `j`, a saturation force, stands at its upper end."""

        def normal(at: Floats) -> NormalEquations:
            JJ, Jr, rr = self.normal_equations(at)
            JJ[j], JJ[:, j], Jr[j] = 0.0, 0.0, 0.0
            return NormalEquations(JJ, Jr, rr)

        start = x.copy()
        start[j] = 1.0
        return minimise_squares(normal, normal, [start], lambda share, text: None).x

    def subset(self, share: float, seed: int) -> TwistObjective:
        """The objective over a random `share` of the stretches, at least `MIN_START_STRETCHES`."""
        count = self.stretches.start.shape[1]
        size = max(MIN_START_STRETCHES, round(share * count))
        chosen = np.sort(np.random.default_rng(seed).permutation(count)[:size])
        stretches = TransposedWindows(*(np.ascontiguousarray(a[..., chosen]) for a in self.stretches))
        return TwistObjective(self.box, stretches, self.weight)


def difference_points(x: Floats) -> tuple[Floats, Floats]:
    """Finite-difference steps (n,) for a Jacobian at `x` (n,) in the unit box, and the points (n + 1, n) to evaluate.

    The first is x; point i + 1 differs in coordinate i by +-`DIFFERENCE_STEP`, towards the middle of the box.
    """
    steps = np.where(x < 0.5, DIFFERENCE_STEP, -DIFFERENCE_STEP)
    return steps, np.vstack([x, x + np.diag(steps)])


def fit_car_to_twists(task: FitTask) -> tuple[Car, dict[str, Any]]:
    """Fit the car whose predicted twists have the least normalised mean squared error; and facts of the fit.

    The error is the paper's lossv.  The settings' loss says how far ahead of each start twists are predicted:
    "one-step" for one period, "rollout" for `horizon_s`.  Facts hold errors, standard errors, correlated pairs and
    constants at a bound.
    """
    settings = NewtonEulerSettings.model_validate(task.settings)
    steps = loss_steps(settings.loss, settings.horizon_s, task.period_s)
    every = stretch_spacing(task.estimates, steps)
    taken = cut_windows(task.estimates, steps, every)
    top_speed = float(np.quantile(taken.kinematic[:, 0, 0], TOP_SPEED_QUANTILE))
    box = ConstantBox(task.vehicle, *task.estimates[0].steering_constants(), settings.v_0_mps, top_speed)
    stretches = TransposedWindows.from_windows(taken, task.period_s)
    objective = TwistObjective(box, stretches, inverse_spread(taken.twist[:, 0]))
    best, how = _optimise(objective, settings, task)
    block = max(1, round(BLOCK_S / task.period_s / every))
    covariance = _covariance_at_optimum(objective, best, block)
    part = objective.subset(max(settings.subset, MIN_SATURATION_STRETCHES / taken.stretch_count), task.seed)
    unreached = _find_unreached_saturations(part, best, block)
    covariance[unreached], covariance[:, unreached] = np.nan, np.nan
    about = {p.symbol: {"unit": p.unit, "low": p.low, "high": p.high, "meaning": p.meaning} for p in box.constants}
    at_bound = [s for s, x in zip(about, best.x, strict=True) if min(x, 1.0 - x) < LIMITS.bound_margin]
    facts = {
        "optimiser": how,
        "loss": settings.loss,
        "nmse": best.cost,
        "fit_quality": f"{settings.loss} NMSE of the training takes {best.cost:.3g}; {BIASED_TWISTS}",
        "history": best.history,
        **constant_facts(about, covariance, np.sqrt(np.diag(covariance)) * box.log_range, at_bound),
        "top_speed_mps": top_speed,
        "mass_given": task.vehicle.body.mass_kg is not None,
    }  # fmt: skip
    return box.car(best.x), facts


def _optimise(objective: TwistObjective, settings: NewtonEulerSettings, task: FitTask) -> tuple[Optimum, str]:
    """Find the point of the unit box of least normalised mean squared error, and describe the optimiser in words.

    By a genetic algorithm or by Levenberg-Marquardt from several starts, as the settings say.
    """
    n = len(objective.box.constants)
    if settings.optimiser == "genetic":
        require_library("deap", 'optimiser = "genetic" of [fit.newton-euler]')
        from bcid.models.fitting.genetic import minimise_genetically

        best = minimise_genetically(
            objective.costs, n, settings.population, settings.generations, task.seed, task.progress
        )
        return best, f"genetic algorithm, {settings.population} individuals, {len(best.history)} generations"
    drawn = np.random.default_rng(task.seed).uniform(*START_RANGE, (settings.starts - 1, n))
    part = objective.subset(settings.subset, task.seed)
    starts = [np.full(n, 0.5), *drawn]
    with refuse_divergence(task.recordings):
        best = minimise_squares(part.normal_equations, objective.normal_equations, starts, task.progress)
    return best, f"Levenberg-Marquardt from {settings.starts} starts"


def _covariance_at_optimum(objective: TwistObjective, best: Optimum, block: int) -> Floats:
    """Sandwich covariance (n, n) of the fitted point `best` in the unit box, residuals being correlated within blocks.

    A block is `block` neighbouring stretches.  Rows and columns are NaN for constants whose column of the Jacobian
    has a norm of at most LIMITS.min_sensitivity: they do not act.
    """
    J = objective.jacobian(best.x)
    r = objective.residuals(best.x[None])[0]
    acting = np.sqrt((J**2).mean(axis=0)) * np.sqrt(len(r)) > LIMITS.min_sensitivity
    J = J[:, acting]
    covariance = np.full((len(best.x), len(best.x)), np.nan)
    covariance[np.ix_(acting, acting)] = sandwich_covariance(J, objective.sum_over_blocks(J * r[:, None], block))
    return covariance


def _find_unreached_saturations(objective: TwistObjective, best: Optimum, block: int) -> list[int]:
    """Coordinates of the saturation forces (motor, front and rear tyres) that the car does not reach in the recordings.

    With the limit at the top of its range and other constants refitted, the squared errors grow by at most
    LIMITS.saturation_z standard errors (one-sided test by the scatter between blocks of `block` stretches).
    """
    squares, unreached = objective.residuals(best.x[None])[0] ** 2, []
    for j, p in enumerate(objective.box.constants):
        if p.symbol in SATURATIONS:
            free = objective.refit_without_saturation(j, best.x)
            worse = objective.sum_over_blocks((objective.residuals(free[None])[0] ** 2 - squares)[:, None], block)[:, 0]
            scatter = worse.std(ddof=1) / np.sqrt(len(worse)) if len(worse) > 1 else np.inf
            if not worse.mean() > LIMITS.saturation_z * scatter:
                unreached.append(j)
    return unreached
