"""What models fitted to one drive predict on another of the same car: the augmented model beside other ways.

These figures need nobody's truth.  The base model, the augmented one and the regressions know the first drive alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bcid.diagnosis.judge.fitted_models import model_from_reference
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import position_errors
from bcid.models.interface import FitTask
from bcid.models.newton_euler.augmented import AugmentedNewtonEuler
from bcid.models.newton_euler.unnamed_part import UnnamedPart
from bcid.models.newton_euler.with_remainder import NewtonEulerWithRemainder
from bcid.proof.blind.regressors import fit_boosted_trees, fit_perceptron
from bcid.proof.real.limits import LIMITS
from bcid.proof.real.question_files import QuestionInputs, reference_from_row
from bcid.proof.real.questions import DrivePair
from bcid.proof.real.residual_model import fit_residual_model
from bcid.vehicle import Vehicle

AUGMENTED, NAMED, BASE, PUBLISHED = "augmented", "names alone", "base", "published"
REGRESSIONS = {"residual perceptron": fit_perceptron, "residual gradient boosting": fit_boosted_trees}
SPARSE = "k-sindy"


def predict_other_drive(pair: DrivePair, inputs: QuestionInputs, fitted: Mapping[str, Any]) -> dict[str, Any]:
    """Errors of models fitted to one drive on another, by method; the row of a pair of drives.

    `fitted` is the row of `diagnose_drive` of the pair's first drive, freely diagnosed, with the base model, the names,
    and what has no name: the augmented model has both.  The row has "errors", by method: "median_m" and "mean_m" of the
    distances between predicted and estimated positions `LIMITS.transfer_horizon_s` after each of many starts (None
    where a prediction left the finite numbers: the mean where any did, the median where half did), and "lost", the
    share that did.
    """
    (vehicle, trained), (other_vehicle, other) = (_read(name, inputs) for name in (pair.fit, pair.test))
    named, unnamed = _as_model(fitted["model"], other_vehicle, other), fitted["unnamed"]
    models: dict[str, Any] = {AUGMENTED: named, BASE: _as_model(fitted["base"], other_vehicle, other)}
    if unnamed is not None:
        part = UnnamedPart.from_arrays({name: np.array(array, dtype=float) for name, array in unnamed.items()})
        models |= {AUGMENTED: NewtonEulerWithRemainder(named, part), NAMED: named}
    published = inputs.published_model([other], other_vehicle)
    if published is not None:
        models[PUBLISHED] = model_from_reference(published, other_vehicle, _length_s(other), other.period_s)
    car = _as_model(fitted["base"], vehicle, trained)
    for name, fit in REGRESSIONS.items():
        models[name] = fit_residual_model(car, trained, fit, name)
    models[SPARSE] = _fit_sparse_model(vehicle, trained)
    return {
        "verdict": "predicted", "findings": [], "names": [f["effect"] for f in fitted["findings"]],
        "errors": {name: _summarise_errors(model, other) for name, model in models.items()},
    }  # fmt: skip


def _read(name: str, inputs: QuestionInputs) -> tuple[Vehicle, Estimate]:
    """The vehicle as it was in a recording, and the recording's estimated motion."""
    vehicle = inputs.vehicle_for(name)
    return vehicle, inputs.estimate_recording(name, vehicle)[1]


def _length_s(estimate: Estimate) -> float:
    """The time (s) from the first to the last row of an estimate."""
    return float(np.ptp(estimate.time_s))


def _as_model(row: Mapping[str, Any], vehicle: Vehicle, estimate: Estimate) -> AugmentedNewtonEuler:
    """The model in the row of a reference model, as it drives a vehicle in the time of an estimate."""
    reference = reference_from_row(row)
    assert reference is not None  # noqa: S101  # a diagnosis has one
    return model_from_reference(reference, vehicle, _length_s(estimate), estimate.period_s)


def _fit_sparse_model(vehicle: Vehicle, estimate: Estimate) -> Any:
    """K-SINDy fitted to the estimated motion of one drive with the settings of `bcid fit`."""
    from bcid.models.table import MODELS

    row = MODELS[SPARSE]
    return row.load_class().fit(FitTask([estimate], vehicle, row.defaults, seed=0))


def _summarise_errors(model: Any, estimate: Estimate) -> dict[str, float | None]:
    """Median and mean (m) of a model's position errors on a drive, and the share of predictions that are lost."""
    errors = position_errors(model, estimate, LIMITS.transfer_horizon_s)
    median, mean = float(np.median(errors)), float(np.mean(errors))
    return {
        "median_m": round(median, 5) if np.isfinite(median) else None,
        "mean_m": round(mean, 5) if np.isfinite(mean) else None,
        "lost": round(float(np.mean(~np.isfinite(errors))), 4),
    }  # fmt: skip
