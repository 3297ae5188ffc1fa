"""Stage `evaluate`: one fitted model on the validation take."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bcid.estimate.saving import load_estimate
from bcid.evaluation.judge import judge
from bcid.evaluation.limits import load_limits
from bcid.models.saving import load_model


def make(folder: Path, model: Path, validation: Path, training: Sequence[Path], restart_s: float) -> None:
    """Closed-loop figures and the rows for plots."""
    takes = [load_estimate(f) for f in training]
    judge(load_model(model), load_estimate(validation), takes, restart_s, folder, load_limits(model))
