"""Stage `evaluate`: one fitted model on the validation take."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bcid.estimate.saving import load_estimate
from bcid.evaluation.judge import judge
from bcid.models.saving import load_model


def make(folder: Path, model: Path, validation: Path, training: Sequence[Path], restart_s: float) -> None:
    """Closed-loop figures and the rows for plots."""
    judge(load_model(model), load_estimate(validation), [load_estimate(f) for f in training], restart_s, folder)
