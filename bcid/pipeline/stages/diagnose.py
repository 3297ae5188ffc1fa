"""Stage `diagnose`: what physics recordings show that the model lacks, its proof, the base and the augmented model."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bcid.aliases import Progress
from bcid.diagnosis import reference
from bcid.diagnosis.diagnose import Diagnosis, diagnose_recordings
from bcid.diagnosis.judge.fitted_models import model_from_fit
from bcid.diagnosis.judge.free_functions import add_free_functions, scale_functions
from bcid.diagnosis.judge.prediction_error import compare_predictions
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.diagnosis.summary import KNOT_UNITS, TRACK_UNITS, knot_columns, summarise_diagnosis, track_columns
from bcid.documents.diagnosis import REFITTED, Floor, NextManoeuvre, Start
from bcid.estimate.run import estimate_motion
from bcid.estimate.saving import load_estimate
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.evaluation.validity import DataRange, ModelValidity
from bcid.files.parquet import write_columns
from bcid.models.interface import Model
from bcid.models.newton_euler.with_remainder import NewtonEulerWithRemainder
from bcid.models.saving import save_model
from bcid.pipeline.error_budget import measure_error_budget
from bcid.pipeline.named_models import WITH_REMAINDER
from bcid.recording.saving import load_recording
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

# quantile of the driven throttles that the next manoeuvre may reach
TOP_THROTTLE_QUANTILE = 0.99
# of the samples from which the process noise of the car with effects is calibrated
NOISE_SEED = 1


def run_diagnose_stage(
    folder: Path, recordings: Sequence[Path], estimates: Sequence[Path], names: Sequence[str], tuning: Path,
    vehicle: Vehicle, simulation: str | None, simulated: Sequence[tuple[Path, Path]], progress: Progress,
) -> None:  # fmt: skip
    """Diagnose which physics a simulation lacks, by recordings together; write document, models and next drive.

    `recordings` and `estimates` are the artifact folders of the ingested takes and of their smoothed motions, `names`
    what tells these takes apart.  The simulation is `simulation` (a saved model's folder, a TOML file of parameters, or
    module:function), or is identified from `simulated`, the ingest and estimate folders of a simulator's recordings;
    with neither, the base model is refitted.
    """
    takes, motions = [load_recording(f) for f in recordings], [load_estimate(f) for f in estimates]
    tuned = Tuning.read(tuning / "tuning.json")
    against = _reference_model(simulation, simulated, takes, motions, vehicle, tuned)
    found = diagnose_recordings(takes, motions, vehicle, against, progress)
    progress(0.85, "held-out proof")
    horizons, tracks, function_share = compare_predictions(
        found.naming.base, found.fit, found.take, takes[0], motions[0], vehicle, tuned, against,
        with_remainder=found.naming.unknown_nats > 0.0,
    )  # fmt: skip
    document = summarise_diagnosis(
        found, horizons, vehicle=vehicle.name, recordings=tuple(names), duration_s=found.take.T,
        simulation=_describe_reference(simulation, simulated),
    )  # fmt: skip
    progress(0.92, "what the error is made of")
    more = {
        "next_manoeuvre": _write_next_manoeuvre(folder, found),
        "error_budget": measure_error_budget(found, takes[0], motions[0], vehicle, tuned),
    }
    document.model_copy(update=more).write(folder / "diagnosis.json")
    write_columns(folder / "knots.parquet", knot_columns(found), KNOT_UNITS)
    write_columns(folder / "tracks.parquet", track_columns(tracks), TRACK_UNITS)
    models = _models_of(found, motions[0].period_s, function_share)
    for name, model in models.items():
        (folder / name).mkdir()
        save_model(model, folder / name)
    progress(0.95, "process noise")
    ModelValidity.measure(models["model"], motions, NOISE_SEED).save(folder / "model")
    if WITH_REMAINDER in models:
        # its process noise would take four times as long to find
        ModelValidity(None, DataRange.from_estimates(motions)).save(folder / WITH_REMAINDER)


def _models_of(found: Diagnosis, period_s: float, function_share: float) -> dict[str, Model]:
    """The car with the names, and the base model, for views that predict with both, by the names of their folders.

    Where free functions of its state do good at a share of their size (`function_share` > 0), that car with them, too.
    """
    T = float(found.take.length_s[0])
    models: dict[str, Model] = {
        name: model_from_fit(fit, T, period_s) for name, fit in (("base", found.naming.base), ("model", found.fit))
    }
    if function_share > 0.0:
        whole = scale_functions(add_free_functions(found.fit, found.take, T, period_s), function_share)
        models |= {WITH_REMAINDER: whole} if isinstance(whole, NewtonEulerWithRemainder) else {}
    return models


def _reference_model(
    simulation: str | None, simulated: Sequence[tuple[Path, Path]], takes: Sequence[Recording],
    motions: Sequence[Estimate], vehicle: Vehicle, tuned: Tuning,
) -> ReferenceModel | None:  # fmt: skip
    """Return the simulation that recordings are compared with; None where the base model is to be refitted instead.

    It is identified from a simulator's recordings (`simulated`, folders of ingest and estimate) or from drives
    simulated by a user's module:function, or read from the saved model's folder or TOML file `simulation`.
    """
    if simulated:
        return reference.identify_reference(
            [load_recording(r) for r, _ in simulated], [load_estimate(e) for _, e in simulated], vehicle
        )
    if simulation is None:
        return None
    if Path(simulation).is_dir():
        return reference.reference_from_model(Path(simulation))
    if simulation.endswith(".toml"):
        return reference.reference_from_parameters(Path(simulation), motions, vehicle)
    model = reference.load_user_model(simulation)
    driven = [reference.simulate_with_model(model, t, m) for t, m in zip(takes, motions, strict=True)]
    return reference.identify_reference(driven, [estimate_motion(d, vehicle, tuned) for d in driven], vehicle)


def _describe_reference(simulation: str | None, simulated: Sequence[tuple[Path, Path]]) -> str:
    """The simulation that recordings are compared with, in words: where it comes from, and whether it was refitted."""
    if simulated:
        names = ", ".join(load_recording(r).name for r, _ in simulated)
        return f"the simulator of {names}, identified first"
    return REFITTED if simulation is None else simulation


def _write_next_manoeuvre(folder: Path, diagnosis: Diagnosis) -> NextManoeuvre | None:
    """Write the commands of the drive that best separates the fitted model from its first rival, and describe it.

    The rival is another combination of effects that explains the recording; the drive stays in the area driven so
    far.  None where nothing was found, nothing rivals it, or no such drive separates the two.
    """
    from bcid.experiment.discrimination import find_discriminating_drive
    from bcid.experiment.manoeuvres import Arena, write_commands

    best, others = diagnosis.fit, diagnosis.naming.rivals
    if not others or not diagnosis.judgement.findings:
        return None
    low, high = diagnosis.take.pose[:, :2].min(axis=0), diagnosis.take.pose[:, :2].max(axis=0)
    middle = 0.5 * (low + high)
    floor = Arena(float(high[0] - low[0]), float(high[1] - low[1]), 0.0, float(middle[0]), float(middle[1]))
    top = float(np.quantile(diagnosis.take.command[:, 1], TOP_THROTTLE_QUANTILE))
    chosen = find_discriminating_drive(best, others[0], top, floor)
    if chosen is None:
        return None
    name = "next_manoeuvre.commands.csv"
    write_commands(folder / name, chosen.command_s, chosen.command)
    x_m, y_m, yaw_rad = (float(v) for v in chosen.start)
    along_x, along_y = ((float(a), float(b)) for a, b in zip(low, high, strict=True))
    return NextManoeuvre(
        name=chosen.name, purpose=chosen.purpose, why=chosen.why, score=chosen.score, repeats=chosen.repeats,
        start=Start(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad), seconds=chosen.seconds,
        floor=Floor(x_m=along_x, y_m=along_y), file=name,
        separates=tuple(sorted(set(best.hypothesis.effects) ^ set(others[0].hypothesis.effects))),
    )  # fmt: skip
