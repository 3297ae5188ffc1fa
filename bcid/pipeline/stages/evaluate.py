"""Stage `evaluate`: one fitted model on the validation take."""

from collections.abc import Sequence
from pathlib import Path

from bcid.estimate.saving import load_estimate
from bcid.evaluation.evaluate import evaluate_model
from bcid.evaluation.validity import load_validity
from bcid.models.saving import load_model


def run_evaluate_stage(folder: Path, model: Path, validation: Path, training: Sequence[Path], restart_s: float) -> None:
    """Predict the validation recording with a saved model in closed loop; save errors and predictions in `folder`.

    All paths are folders of artifacts; predictions restart from the measured state every `restart_s` seconds.
    """
    takes = [load_estimate(f) for f in training]
    evaluate_model(load_model(model), load_estimate(validation), takes, restart_s, folder, load_validity(model))
