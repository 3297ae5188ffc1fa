"""How far a simulation is from a drive: errors of its open-loop predictions, and nats beside a freely fitted model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bcid.diagnosis.diagnose import fit_base_model
from bcid.diagnosis.judge.fitted_models import model_from_reference
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.effects.table import ENTRIES
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import predict_with_restarts
from bcid.likelihood.refit import Fit
from bcid.proof.real.limits import LIMITS
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

COMPARED = {"v_x": 0, "yaw_rate": 2}
"""What predictions are compared in, and its column in a twist."""

ALONG_THE_CAR = ("fx", "motor")
"""Channels of effects that show in the forward speed; those of the other channels show in the yaw rate."""


def prediction_rmse(
    simulation: ReferenceModel | None, vehicle: Vehicle, recording: Recording, estimate: Estimate
) -> dict[str, float | None]:
    """RMSE of v_x (m/s) and yaw rate (rad/s) as predicted by a simulation, against the estimated motion, by COMPARED.

    Predictions restart every `LIMITS.rmse_horizon_s` from the estimate.  If `simulation` is None the base model,
    refitted to the recording, predicts.  None where a prediction is not finite; samples with |v_x| of at most
    `LIMITS.min_speed_mps` are left out.
    """
    simulation = simulation or ReferenceModel.from_fit(fit_base_model([recording], [estimate], vehicle).fit)
    model = model_from_reference(simulation, vehicle, float(np.ptp(estimate.time_s)), estimate.period_s)
    error = predict_with_restarts(model, estimate, LIMITS.rmse_horizon_s).twist - estimate.twist
    known = np.isfinite(estimate.twist).all(axis=1) & (np.abs(estimate.twist[:, 0]) > LIMITS.min_speed_mps)
    rmse = {name: float(np.sqrt(np.mean(error[known, k] ** 2))) for name, k in COMPARED.items()}
    return {name: round(value, 5) if np.isfinite(value) else None for name, value in rmse.items()}


def error_ratios(without: Mapping[str, float | None], whole: Mapping[str, float | None]) -> dict[str, float | None]:
    """By how much each error of `prediction_rmse` grows without what is withheld; None where either is not finite."""
    pairs = {name: (without[name], whole[name]) for name in COMPARED}
    return {name: round(less / more, 3) if less is not None and more else None for name, (less, more) in pairs.items()}


def own_quantity(effects: Sequence[str]) -> str:
    """The quantity of COMPARED in which the first of the `effects` shows: its own channel's.

    >>> own_quantity(["motor_dead_zone"]), own_quantity(["steering_lag"])
    ('v_x', 'yaw_rate')
    """
    return "v_x" if ENTRIES[effects[0]].channel in ALONG_THE_CAR else "yaw_rate"


def whole_misfit(
    simulation: ReferenceModel | None, base: Fit, vehicle: Vehicle, recording: Recording, estimate: Estimate
) -> dict[str, Any]:
    """How far a simulation with nothing withheld is from a drive; `base` is its refit to that drive.

    Returns "rmse" (`prediction_rmse`) of the simulation as it is given, and "nats": by how many nats a segment of 1.5 s
    is likelier by its refit than by a base model that is fitted freely; less than none where it is less likely.
    """
    rmse = prediction_rmse(simulation, vehicle, recording, estimate)
    if simulation is None:
        return {"rmse": rmse, "nats": 0.0}
    free = fit_base_model([recording], [estimate], vehicle).fit
    return {"rmse": rmse, "nats": round(float(base.per_segment.mean() - free.per_segment.mean()), 2)}
