"""Fits as models that predict step by step, refits to halves of a take, and the errors of predictions."""

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.diagnosis.judge.held_out import refit_on_half
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.errors import UsageError
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import RestartedPrediction
from bcid.likelihood.divergence import none_if_diverged
from bcid.likelihood.hypothesis import DRAG
from bcid.likelihood.prepare import effect_constants
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take
from bcid.likelihood.unnamed_functions import UnnamedFunctions
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.saved_car import correlation_fact
from bcid.vehicle import Vehicle


def model_from_fit(fit: Fit, T: float, period_s: float) -> AugmentedNewtonEuler:
    """The fitted car with its effects as a model that predicts the twist step by step, in steps of `period_s` (s).

    `T` (s) is the recording's length, which the effect `motor_sag` needs: its motor force falls as 1 - s t / T.
    """
    hypothesis = fit.hypothesis
    _require_names(hypothesis.known)
    se = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    car = fit.car()
    fitted = [*hypothesis.log_parameters, *DRAG]
    values = [*(getattr(car, s) for s in hypothesis.log_parameters), *hypothesis.drag_units]
    errors = {s: float(value * e) for s, value, e in zip(fitted, values, se, strict=False)}
    errors |= {field: e for field, (_, e) in fit.effect_estimates().items()}
    named = slice(hypothesis.named_size)
    facts = {
        "fitted": fitted, "se": errors, "log_likelihood": fit.log_likelihood,
        "correlation": correlation_fact(list(errors), fit.covariance[named, named]),
        "noise": {name: scale.tolist() for name, scale in fit.scales._asdict().items()},
    }  # fmt: skip
    return AugmentedNewtonEuler(
        car, hypothesis.effect_values(fit.phi), hypothesis.constants, hypothesis.angle_limit, T, period_s, facts
    )


def model_from_reference(
    reference: ReferenceModel, vehicle: Vehicle, T: float, period_s: float
) -> AugmentedNewtonEuler:
    """The reference model with its effects, not refitted, as a model that predicts the twist step by step.

    A step is `period_s` (s).  `T` (s) is the recording's length, which the effect `motor_sag` needs: its motor force
    falls as 1 - s t / T.
    """
    _require_names(reference.known)
    return AugmentedNewtonEuler(
        reference.car, reference.effects, effect_constants(vehicle), vehicle.steering.max_angle_rad, T, period_s, {}
    )


def _require_names(known: UnnamedFunctions) -> None:
    """Raise `UsageError` where a simulation has functions without a name, which no model can be saved with."""
    if known.size:
        raise UsageError("a model has no functions without a name\n  next: use a simulation of names alone")


def refit_on_half_or_keep(fit: Fit, take: Take, half: Ints) -> Fit:
    """The fit refitted to the segments with indices `half` only; the whole take's `fit` itself if that diverges."""
    return none_if_diverged(refit_on_half, fit, take, half) or fit


def squared_errors(predicted: RestartedPrediction, estimate: Estimate, weights: Floats) -> Floats:
    """Mean over v_x, v_y and omega of squared errors of the predicted twist (K,), each error times its weight (3,).

    Rows at which predictions are not finite are NaN, and so is the row at which such a prediction starts: there the
    predicted twist is the estimated one, so that an error of 0 would count.
    """
    off = ((weights * (predicted.twist - estimate.twist)) ** 2).mean(axis=1)
    off[:-1][predicted.start[:-1] & np.isnan(off[1:])] = np.nan
    return np.asarray(off)
