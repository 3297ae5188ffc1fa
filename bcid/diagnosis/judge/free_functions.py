"""Free functions beside a fitted car, as large as they do good on blocks that they were not found from.

Functions that make poses of a second and a half likelier need not predict better: pushes make up for what they do
wrong.  So their size is weighed by what they are for (*stacking*: Wolpert 1992): of shares of it, that is taken at
which the twist 2 s ahead is predicted best, on the other half of the take's blocks.
"""

from collections.abc import Sequence

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.diagnosis.judge.fitted_models import model_from_fit, refit_on_half_or_keep, squared_errors
from bcid.diagnosis.judge.held_out import block_length_s, split_halves
from bcid.diagnosis.remainder.beside_names import unnamed_part_beside
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import predict_with_restarts
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take
from bcid.models.fitting.windows import inverse_spread
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.with_remainder import NewtonEulerWithRemainder

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
HORIZON_S = 2.0

CarModel = AugmentedNewtonEuler | NewtonEulerWithRemainder
"""A car with names alone, where there are no functions, or with functions, too."""


def add_free_functions(fit: Fit, take: Take, T: float, period_s: float) -> CarModel:
    """The model of `model_from_fit` with the free functions of the car's state that the `take` shows, if any."""
    named, unnamed = model_from_fit(fit, T, period_s), unnamed_part_beside(fit, take)
    return NewtonEulerWithRemainder(named, unnamed) if unnamed else named


def scale_functions(model: CarModel, share: float) -> CarModel:
    """The model with its functions at a `share` of their size, if it has any; without them at a share of 0."""
    if isinstance(model, AugmentedNewtonEuler):
        return model
    return model.scale_functions(share) if share > 0.0 else model.named


def model_of_half(fit: Fit, take: Take, half: Ints, period_s: float) -> CarModel:
    """The model of a `fit` to a half of the take, or to all of it, with the functions that this half shows."""
    T, part = float(take.length_s[0]), take.part(half)
    if len(fit.start) == take.segments:
        fit, part = fit.part(take, half)
    return add_free_functions(fit, part, T, period_s)


def trained_on_first_half(estimate: Estimate, take: Take, zero_s: float) -> Bools:
    """Rows (K,) of an estimate that are predicted by what was fitted to the first half: those of the second half.

    The take begins at `zero_s`.
    """
    return np.asarray(((estimate.time_s - zero_s) // block_length_s(take)).astype(int) % 2 == 1)


def best_share(halves: Sequence[CarModel], estimate: Estimate, trained_on_first: Bools) -> float:
    """The one of SHARES at which functions predict best what their half of the take has not shown.

    A share at which predictions are lost that are not without functions is not taken.
    """
    weights = inverse_spread(estimate.twist)

    def squares(share: float) -> Floats:
        models = [scale_functions(model, share) for model in halves]
        predicted = [predict_with_restarts(model, estimate, HORIZON_S) for model in models]
        return np.where(trained_on_first, *(squared_errors(p, estimate, weights) for p in predicted))

    alone = squares(0.0)
    there = np.isfinite(alone)
    errors = {share: squares(share)[there].mean() for share in SHARES[1:]} if there.any() else {}
    better = {share: error for share, error in errors.items() if error < alone[there].mean()}  # nan is not
    return min(better, key=lambda share: better[share], default=0.0)


def held_out_share(fit: Fit, take: Take, estimate: Estimate, zero_s: float) -> float:
    """`best_share` of the functions beside a `fit` to the whole take, which begins at `zero_s`."""
    halves = split_halves(take)
    fits = [refit_on_half_or_keep(fit, take, half) for half in halves]
    models = [model_of_half(own, take, half, estimate.period_s) for own, half in zip(fits, halves, strict=True)]
    return best_share(models, estimate, trained_on_first_half(estimate, take, zero_s))
