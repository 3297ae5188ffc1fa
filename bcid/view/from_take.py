"""The view of a recording by itself: its motion is estimated here, and predicted where a model is given."""

from pathlib import Path

from bcid.errors import UsageError
from bcid.estimate.limits import LIMITS
from bcid.estimate.run import estimate_motion
from bcid.estimate.tune import tune_estimator
from bcid.estimate.types import Estimate
from bcid.evaluation.closed_loop import RestartedPrediction
from bcid.models.saving import load_model, model_digest
from bcid.recording.cuts import read_named_recording
from bcid.recording.types import Recording
from bcid.store.artifact import file_sha256
from bcid.vehicle import Vehicle, read_vehicle
from bcid.view.content import Attachment, ViewContent, predict_windows
from bcid.view.stamps import zero_stamp_ns

PERIOD_S, MAX_GAP_S = 0.1, 0.3
"""Period (s) of the estimated motion where no model has one, and the longest pose gap (s) that is bridged."""


def view_of_take(
    path: Path, vehicle_path: Path, model: Path | None = None, commands: Path | None = None, allow_partial: bool = False
) -> ViewContent:
    """The view of the recording at `path`, or of a cut of it, read by the vehicle file at `vehicle_path`.

    The noise of the motion's estimate is that of greatest likelihood for this recording.  The saved `model`, if any,
    predicts from the measured state anew every two seconds.

    Raises:
        InputRefused: recording, vehicle file or model cannot be used.
    """
    vehicle = read_vehicle(vehicle_path)
    recording = read_named_recording(path, vehicle, commands, allow_partial)
    predictor = load_model(model) if model is not None else None
    period_s = PERIOD_S if predictor is None else predictor.period_s
    if not LIMITS.min_period_s <= period_s <= LIMITS.max_period_s:
        raise UsageError(f"{model} steps by {period_s:g} s, at which no motion is estimated\n  next: fit another")
    estimate = estimate_alone(recording, vehicle, period_s)
    predictions = dict[str, RestartedPrediction]()
    facts = {"vehicle sha256": file_sha256(vehicle_path)}
    if model is not None and predictor is not None:
        predictions["predicted"] = predict_windows(predictor, estimate)
        facts |= {"predicted by": predictor.name, "predicted model sha256": model_digest(model)}
    return ViewContent(
        recording, estimate, vehicle, zero_stamp_ns(path, vehicle, recording, allow_partial), predictions,
        attachments=(Attachment(vehicle_path.name, "application/toml", vehicle_path.read_bytes()),), facts=facts,
    )  # fmt: skip


def estimate_alone(recording: Recording, vehicle: Vehicle, period_s: float) -> Estimate:
    """The motion of a recording on a grid of `period_s` (s), with the estimator tuned to this recording alone."""
    tuning = tune_estimator([recording], vehicle, period_s, MAX_GAP_S, {})
    return estimate_motion(recording, vehicle, tuning, period_s, MAX_GAP_S)
