"""Stage `fit`: one model fitted to the training takes.  The model's own module is a further root of its key."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bcid.aliases import Progress
from bcid.estimate.saving import load_estimate
from bcid.evaluation.limits import Limits
from bcid.models.fitting.windows import check_excited
from bcid.models.interface import FitTask
from bcid.models.saving import load_model, save_model
from bcid.models.table import row_of
from bcid.recording.saving import load_recording
from bcid.vehicle import Vehicle


def make(
    folder: Path,
    name: str,
    estimates: Sequence[Path],
    vehicle: Vehicle,
    settings: Mapping[str, Any],
    seed: int,
    base: Path | None,
    recordings: Sequence[Path],
    progress: Progress,
) -> None:
    """Fit and save; the description goes beside the model for people, and how far it may be off."""
    task = FitTask(
        [load_estimate(f) for f in estimates], vehicle, settings, seed, load_model(base) if base else None,
        [load_recording(f) for f in recordings], progress,
    )  # fmt: skip
    check_excited(task.estimates)
    model = row_of(name).load().fit(task)
    save_model(model, folder)
    progress(1.0, "process noise")
    Limits.of(model, task.estimates, seed).save(folder)
    (folder / "description.txt").write_text(model.describe() + "\n", encoding="utf-8")
