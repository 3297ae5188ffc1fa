"""Questions that withhold something from a published model, which the diagnosis must then name."""

from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.diagnosis.diagnose import diagnose_recordings, fit_base_model
from bcid.diagnosis.judge.prediction_error import model_from_reference
from bcid.diagnosis.reference import reference_from_parameters
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.errors import InputRefused
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import predict_with_restarts
from bcid.proof.real.limits import LIMITS
from bcid.proof.real.question_files import QuestionInputs
from bcid.proof.real.questions import NOT_ASKED, WithheldQuestion
from bcid.proof.rows import diagnosis_row
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle


def answer_withheld_question(question: WithheldQuestion, inputs: QuestionInputs) -> dict[str, Any]:
    """Take something out of a published simulation, and diagnose a real recording against the rest; return the row.

    What is taken out is an effect, parameters, or knowledge of the vehicle file.  Beside `diagnosis_row` the row has
    "ratio", the RMSE of predictions without it over that with it (the larger of v_x and yaw rate), and "published",
    the parameters of the effect.  If the ratio is at most `LIMITS.min_error_ratio`, and the question is no control,
    nothing is diagnosed and the verdict is NOT_ASKED.
    """
    vehicle = inputs.vehicle_for(question.recording, question.vehicle)
    recording, estimate, _ = inputs.estimate_recording(question.recording, vehicle)
    less, published, ratio = None, dict[str, float](), 1.0
    if inputs.simulation is not None:
        whole = reference_from_parameters(inputs.simulation, [estimate], vehicle)
        less = whole.without(question.effect)._replace(car=whole.car._replace(**question.parameters))
        published = {field: value for field, value in whole.effects.items() if field not in less.effects}
    if question.effect or question.parameters or question.vehicle:
        rmse = prediction_rmse(less, vehicle, recording, estimate)
        ratio = float((rmse / _complete_model_rmse(question, inputs)).max())
    row = {"ratio": round(ratio, 3) if np.isfinite(ratio) else None, "published": published}
    if not (question.control or ratio > LIMITS.min_error_ratio):
        return {**row, "verdict": NOT_ASKED, "findings": []}
    return {**row, **diagnosis_row(diagnose_recordings([recording], [estimate], vehicle, less))}


def _complete_model_rmse(question: WithheldQuestion, inputs: QuestionInputs) -> Floats:
    """RMSE (2,) of v_x (m/s) and yaw rate (rad/s) as predicted for a recording by the complete published simulation.

    The prediction restarts every `LIMITS.rmse_horizon_s` from the motion estimated from the recording.  Without a
    simulation the base model, refitted to the recording, predicts.

    Raises:
        InputRefused: a prediction is not finite.
    """
    vehicle = inputs.vehicle_for(question.recording)
    recording, estimate, _ = inputs.estimate_recording(question.recording, vehicle)
    published = None if inputs.simulation is None else reference_from_parameters(inputs.simulation, [estimate], vehicle)
    rmse = prediction_rmse(published, vehicle, recording, estimate)
    if not np.isfinite(rmse).all():
        cause = "with nothing withheld the simulation leaves the finite numbers"
        path = inputs.recordings / question.recording
        raise InputRefused(path, question.name, cause, "ask about a drive that it can follow")
    return rmse


def prediction_rmse(
    simulation: ReferenceModel | None, vehicle: Vehicle, recording: Recording, estimate: Estimate
) -> Floats:
    """RMSE (2,) of v_x (m/s) and yaw rate (rad/s) as predicted by a simulation, against the estimated motion.

    Predictions restart every `LIMITS.rmse_horizon_s` from the estimate.  If `simulation` is None the base model,
    refitted to the recording, predicts.  The RMSE is infinite if a prediction is not finite; samples with |v_x| of at
    most `LIMITS.min_speed_mps` are left out.
    """
    # without pushes: the base model is to predict alone
    simulation = simulation or ReferenceModel.from_fit(fit_base_model([recording], [estimate], vehicle).fit)
    model = model_from_reference(simulation, vehicle, float(np.ptp(estimate.time_s)), estimate.period_s)
    error = (predict_with_restarts(model, estimate, LIMITS.rmse_horizon_s).twist - estimate.twist)[:, [0, 2]]
    known = np.isfinite(estimate.twist).all(axis=1) & (np.abs(estimate.twist[:, 0]) > LIMITS.min_speed_mps)
    return np.asarray(np.sqrt(np.mean(np.nan_to_num(error[known], nan=np.inf) ** 2, axis=0)))
