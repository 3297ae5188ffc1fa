"""Stage `diagnose`: what physics recordings show that the model lacks, with its proof and the augmented model."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from bcid.aliases import Progress
from bcid.diagnosis.compared import Compared
from bcid.diagnosis.diagnose import Diagnosis, diagnosed
from bcid.diagnosis.document import KNOT_UNITS, TRACK_UNITS, as_json, knot_columns, track_columns
from bcid.diagnosis.judge.prediction_error import as_model, compared
from bcid.diagnosis.reference import driven_by, of_model, of_parameters, of_recordings, user_model
from bcid.estimate.run import estimate_motion
from bcid.estimate.saving import load_estimate
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.evaluation.data_range import DataRange
from bcid.evaluation.limits import Limits
from bcid.files.parquet import write_columns
from bcid.models.saving import save_model
from bcid.recording.saving import load_recording
from bcid.recording.types import Recording
from bcid.report.diagnosis_page import write_diagnosis_page
from bcid.vehicle import Vehicle


def make(
    folder: Path, recordings: Sequence[Path], estimates: Sequence[Path], tuning: Path, vehicle: Vehicle,
    simulation: str | None, simulated: Sequence[tuple[Path, Path]], progress: Progress,
) -> None:  # fmt: skip
    """Diagnose ingested and estimated recordings together.

    `simulation` is a saved model's folder, a TOML file of parameters, or module:function; `simulated` are the ingest
    and estimate folders of a simulator's recordings; with neither, the base model is refitted on the recordings.
    """
    takes, motions = [load_recording(f) for f in recordings], [load_estimate(f) for f in estimates]
    tuned = Tuning.from_json(json.loads((tuning / "tuning.json").read_text()))
    against = _simulation(simulation, simulated, takes, motions, vehicle, tuned)
    found = diagnosed(takes, motions, vehicle, against, progress)
    progress(0.85, "held-out proof")
    horizons, tracks = compared(
        found.search.base, found.judgement.fit, found.take, takes[0], motions[0], vehicle, tuned, against
    )  # fmt: skip
    about = {
        "vehicle": vehicle.name,
        "recordings": [t.name for t in takes],
        "duration_s": found.take.T,
        "simulation": _words(simulation, simulated),
    }
    content = as_json(found, horizons, about)
    _manoeuvre(folder, found, content)
    (folder / "diagnosis.json").write_text(json.dumps(content, indent=1, ensure_ascii=False), encoding="utf-8")
    knots, lines = knot_columns(found), track_columns(tracks)
    write_columns(folder / "knots.parquet", knots, KNOT_UNITS)
    write_columns(folder / "tracks.parquet", lines, TRACK_UNITS)
    (folder / "model").mkdir()
    save_model(as_model(found.judgement.fit, float(found.take.length_s[0]), motions[0].period_s), folder / "model")
    Limits(None, DataRange.of(motions)).save(folder / "model")
    write_diagnosis_page(
        content, dict(zip(KNOT_UNITS, knots.T, strict=True)), dict(zip(TRACK_UNITS, lines.T, strict=True)),
        folder / "diagnosis.html",
    )  # fmt: skip


def _simulation(
    simulation: str | None, simulated: Sequence[tuple[Path, Path]], takes: Sequence[Recording],
    motions: Sequence[Estimate], vehicle: Vehicle, tuned: Tuning,
) -> Compared | None:  # fmt: skip
    if simulated:
        return of_recordings(
            [load_recording(r) for r, _ in simulated], [load_estimate(e) for _, e in simulated], vehicle
        )
    if simulation is None:
        return None
    if Path(simulation).is_dir():
        return of_model(Path(simulation))
    if simulation.endswith(".toml"):
        return of_parameters(Path(simulation), motions, vehicle)
    model = user_model(simulation)
    driven = [driven_by(model, t, m) for t, m in zip(takes, motions, strict=True)]
    return of_recordings(driven, [estimate_motion(d, vehicle, tuned) for d in driven], vehicle)


def _words(simulation: str | None, simulated: Sequence[tuple[Path, Path]]) -> str:
    if simulated:
        names = ", ".join(load_recording(r).name for r, _ in simulated)
        return f"the simulator of {names}, identified first"
    return "newton-euler, refitted on this recording" if simulation is None else simulation


def _manoeuvre(folder: Path, found: Diagnosis, content: dict[str, Any]) -> None:
    """The manoeuvre that separates what was found from its nearest rival, on the floor that was driven."""
    from bcid.experiment.discrimination import best_manoeuvre
    from bcid.experiment.manoeuvres import Arena, write_commands

    best, others = found.judgement.fit, found.judgement.search.others
    if not others or not found.judgement.findings:
        return
    low, high = found.take.pose[:, :2].min(axis=0), found.take.pose[:, :2].max(axis=0)
    middle = 0.5 * (low + high)
    floor = Arena(float(high[0] - low[0]), float(high[1] - low[1]), 0.0, float(middle[0]), float(middle[1]))
    top = float(np.quantile(found.take.command[:, 1], 0.99))
    chosen = best_manoeuvre(best, others[0], best.scales, floor, top)
    if chosen is None:
        return
    name = "next_manoeuvre.commands.csv"
    write_commands(folder / name, chosen)
    facts = {k: v for k, v in asdict(chosen).items() if isinstance(v, str | float | int)}
    separates = sorted(set(best.hypothesis.effects) ^ set(others[0].hypothesis.effects))
    start = dict(zip(("x_m", "y_m", "yaw_rad"), (float(v) for v in chosen.start), strict=True))
    content["next_manoeuvre"] = {**facts, "start": start, "separates": separates, "file": name}
