"""Questions that withhold something from a drive's simulation, or nothing: the diagnosis must name it, or nothing."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any, NamedTuple

from bcid.diagnosis.diagnose import Diagnosis, diagnose_recordings, fit_base_model
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.effects.table import EFFECTS, ENTRIES, effect_ids
from bcid.estimate.types import Estimate
from bcid.likelihood.hypothesis import DRAG, TYRES, motor_parameters
from bcid.proof.real.misfit import error_ratios, prediction_rmse, whole_misfit
from bcid.proof.real.oracle import find_equivalents, fit_true_structure
from bcid.proof.real.question_files import QuestionInputs, reference_from_row
from bcid.proof.real.questions import WithheldQuestion, Withholding
from bcid.proof.real.variations import AS_ASKED, QuestionVariation, move_start
from bcid.proof.rows import diagnosis_row
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle


class _AskedDrive(NamedTuple):
    """A drive, what the vehicle file says of it, and the simulation that it is compared with."""

    recording: Recording
    estimate: Estimate
    vehicle: Vehicle
    simulation: ReferenceModel | None

    def diagnose(self, reference: ReferenceModel | None) -> tuple[Diagnosis, dict[str, Any]]:
        """Diagnose the drive against a `reference`; return diagnosis and row.

        Beside `diagnosis_row` the row has "has", the effects of the reference, and "cpu_s_per_minute", CPU seconds a
        minute of drive.
        """
        begin = time.process_time()
        diagnosis = diagnose_recordings([self.recording], [self.estimate], self.vehicle, reference)
        spent = (time.process_time() - begin) / (self.recording.duration_s / 60.0)
        has = {"has": list(effect_ids(reference.effects)) if reference else []}
        return diagnosis, {**diagnosis_row(diagnosis), **has, "cpu_s_per_minute": round(spent, 1)}


def answer_whole_question(recording: str, inputs: QuestionInputs, day: Mapping[str, Any]) -> dict[str, Any]:
    """Diagnose a recording against its day's simulation with nothing withheld; return the row.

    `day` is the row of `calibrate_simulation`.  Beside `diagnosis_row` the row has "misfit" (`whole_misfit`), and
    "fellows" and "added", what the day's simulation comes from.
    """
    drive = _read_drive(recording, inputs, day, {}, AS_ASKED)
    diagnosis, row = drive.diagnose(drive.simulation)
    misfit = whole_misfit(drive.simulation, diagnosis.naming.base, drive.vehicle, drive.recording, drive.estimate)
    return {**row, "misfit": misfit, "fellows": day["fellows"], "added": day["added"]}


def answer_withheld_question(
    question: WithheldQuestion, variation: QuestionVariation, inputs: QuestionInputs, day: Mapping[str, Any]
) -> dict[str, Any]:
    """Take something out of the simulation of a drive, and diagnose the drive against the rest; return the row.

    `day` is the row of `calibrate_simulation`.  The "gate" in its row is that of the effects.  Of the
    question AS_ASKED the row has, beside `diagnosis_row`:

    - "worth", the nats by which the drive is likelier with what is withheld (`fit_true_structure`);
    - "equivalents", names that it cannot be told from (`find_equivalents`), where it is worth more than its "gate";
    - "published" and "true", its parameters by field in the simulation and in the refit;
    - "ratios", by how much the errors of predictions grow without it (`error_ratios`).
    """
    withholding = question.withholding
    drive = _read_drive(question.recording, inputs, day, withholding.vehicle, variation)
    less = _withhold(drive.simulation, withholding)
    reference = move_start(less, variation, [drive.estimate], drive.vehicle)
    diagnosis, row = drive.diagnose(reference)
    row = {**row, "gate": round(diagnosis.naming.gate_of(*withholding.effects), 1)}
    if variation != AS_ASKED:
        return row
    return {**row, **_find_truth(drive, withholding, diagnosis, row), "ratios": _ratios(question, drive, less, inputs)}


def _find_truth(
    drive: _AskedDrive, withholding: Withholding, diagnosis: Diagnosis, row: Mapping[str, Any]
) -> dict[str, Any]:
    """What is withheld from the diagnosis of a drive: its worth, its parameters, and what cannot be told from it."""
    whole, effects = drive.simulation, withholding.effects
    published = {f: v for f, v in (whole.effects if whole else {}).items() if f.partition("__")[0] in effects}
    sizes = {f"{e}__{s}": v for e, values in withholding.sizes.items() for s, v in values.items()} | published
    without, take = diagnosis.naming.base, diagnosis.take
    structure, whole_fit = without.hypothesis, None
    if whole is not None and withholding.parameters:
        rest = _withhold(whole, withholding.model_copy(update={"parameters": {}}))
        structure = fit_base_model([drive.recording], [drive.estimate], drive.vehicle, rest).fit.hypothesis
    if published:
        whole_fit = fit_base_model([drive.recording], [drive.estimate], drive.vehicle, whole).fit
    true = fit_true_structure(without, structure, take, effects, sizes, whole_fit)
    answered = {f["effect"]: _by_field(f["effect"], f["values"]) for f in row["findings"] if f["effect"] in EFFECTS}
    twins: dict[str, dict[str, float]] = {twin: {} for f in row["findings"] for twin in f["twins"] if twin in EFFECTS}
    shows = true.nats > row["gate"]
    estimates = true.fit.effect_estimates()
    return {
        "worth": round(true.nats, 1), "published": published,
        "true": {f: list(v) for f, v in estimates.items() if f.partition("__")[0] in effects},
        "equivalents": find_equivalents(true, take, effects, {**twins, **answered}, row["gate"]) if shows else {},
    }  # fmt: skip


def _by_field(effect: str, values: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Parameters of an effect by field, from a finding's values with standard errors by symbol."""
    entry = ENTRIES[effect]
    return {field: values[p.symbol][0] for field, p in zip(entry.fields, entry.parameters, strict=True)}


def _ratios(
    question: WithheldQuestion, drive: _AskedDrive, less: ReferenceModel | None, inputs: QuestionInputs
) -> dict[str, float | None]:
    """By how much errors of open-loop predictions grow without what is withheld, `less` being the rest."""
    without = prediction_rmse(less, drive.vehicle, drive.recording, drive.estimate)
    vehicle, recording, estimate = drive.vehicle, drive.recording, drive.estimate
    if question.withholding.vehicle:
        vehicle = inputs.vehicle_for(question.recording)
        recording, estimate, _ = inputs.estimate_recording(question.recording, vehicle)
    simulation = _as_vehicle_says(drive.simulation, inputs.published_model([estimate], vehicle))
    return error_ratios(without, prediction_rmse(simulation, vehicle, recording, estimate))


def _read_drive(
    name: str, inputs: QuestionInputs, day: Mapping[str, Any], tables: Mapping[str, Any], variation: QuestionVariation
) -> _AskedDrive:
    """A drive with its day's simulation, the vehicle being as the file says, but for `tables` in place of its own."""
    vehicle = inputs.vehicle_for(name, tables)
    recording, estimate, _ = inputs.estimate_recording(name, vehicle, variation)
    simulation = reference_from_row(day["simulation"])
    if tables:
        simulation = _as_vehicle_says(simulation, inputs.published_model([estimate], vehicle))
    return _AskedDrive(recording, estimate, vehicle, simulation)


def _as_vehicle_says(simulation: ReferenceModel | None, published: ReferenceModel | None) -> ReferenceModel | None:
    """The simulation with what is no parameter of a refit (levers, servo) as in the `published` one for a vehicle."""
    if simulation is None or published is None:
        return None
    symbols = (*motor_parameters(published.car), *TYRES, *DRAG)
    refitted = {symbol: getattr(simulation.car, symbol) for symbol in symbols}
    return simulation._replace(car=published.car._replace(**refitted))


def _withhold(simulation: ReferenceModel | None, withholding: Withholding) -> ReferenceModel | None:
    """The simulation less the effects that are withheld, and with other parameters; None where there is none."""
    if simulation is None:
        return None
    for effect in withholding.effects:
        simulation = simulation.without(effect)
    return simulation._replace(car=simulation.car._replace(**withholding.parameters))
