"""Stage `fit`: one model fitted to the training takes.  The model's own module is a further root of its key."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from bcid.aliases import Progress
from bcid.estimate.saving import load_estimate
from bcid.evaluation.residuals import measure_residuals, save_residuals
from bcid.evaluation.validity import ModelValidity
from bcid.models.fitting.windows import check_excitation
from bcid.models.interface import FitTask
from bcid.models.saving import load_model, save_model
from bcid.models.table import model_row, require_training_libraries
from bcid.recording.saving import load_recording
from bcid.vehicle import Vehicle

FIT_SHARE = 0.9
"""Share of a fit's time after which the model is fitted, and its process noise begins to be measured.

On rollouts of the sample logs it is 0.8 for newton-euler, and 0.92 for k-sindy-mlp.
"""


def run_fit_stage(
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
    """Fit the model `name` to training motions, and save it in `folder`.

    Beside it are saved its process noise and the range of its data, what its residuals say, and its description.
    `estimates` and `recordings` are the artifact folders of the takes, `base` that of a fitted model on which this
    one builds, if any.

    Raises:
        LibraryMissing: the library that trains the model is not installed.
    """
    require_training_libraries([name])
    task = FitTask(
        [load_estimate(f) for f in estimates], vehicle, settings, seed, load_model(base) if base else None,
        [load_recording(f) for f in recordings], lambda share, text: progress(FIT_SHARE * share, text),
    )  # fmt: skip
    check_excitation(task.estimates)
    model = model_row(name).load_class().fit(task)
    save_model(model, folder)
    progress(FIT_SHARE, "process noise")
    ModelValidity.measure(model, task.estimates, seed).save(folder)
    save_residuals(measure_residuals(model, task.estimates), folder)
    (folder / "description.txt").write_text(model.describe() + "\n", encoding="utf-8")
