"""The files that questions to one vehicle's recordings are asked with, and the estimated motion of a recording."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from bcid.diagnosis.reference import reference_from_parameters
from bcid.diagnosis.reference_model import ReferenceModel
from bcid.effects.harmonics import ANGLE_COLUMNS, FACTORS, AnglePlan
from bcid.effects.remainder_table import COLUMNS
from bcid.estimate.run import estimate_motion
from bcid.estimate.tune import tune_estimator
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.files.toml import validate_settings
from bcid.likelihood.tracking_functions import TRACKING_COLUMNS
from bcid.likelihood.unnamed_functions import UnnamedFunctions
from bcid.physics.car import Car
from bcid.proof.real.questions import QuestionFile, RecordedDrive
from bcid.proof.real.variations import AS_ASKED, QuestionVariation, cut_recording
from bcid.recording.read import read_recording
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle, read_vehicle

# as a pipeline file has them where it says nothing else
PERIOD_S, MAX_GAP_S = 0.1, 0.3


class QuestionInputs(NamedTuple):
    """Vehicle, drives by recording, the file of the simulation, and the recordings' folder."""

    vehicle: Vehicle
    drives: Mapping[str, RecordedDrive]
    simulation: Path | None
    recordings: Path

    @classmethod
    def of_questions(cls, questions: QuestionFile, recordings: Path) -> QuestionInputs:
        """The vehicle, drives and simulation of `questions` about the recordings in a folder.

        Raises:
            InputRefused: the vehicle file is invalid.
        """
        drives = {drive.recording: drive for drive in questions.drives}
        return cls(read_vehicle(questions.vehicle), drives, questions.simulation, recordings)

    def vehicle_for(self, recording: str, tables: Mapping[str, Any] = MappingProxyType({})) -> Vehicle:
        """The vehicle as it was in a recording, with `tables` in place of its own."""
        return Vehicle.model_validate(self._vehicle_tables(recording, tables))

    def check_vehicles(self, questions: QuestionFile, file: Path) -> None:
        """Raise `InputRefused` where a drive or a question of `file` makes no valid vehicle."""
        for name in self.drives:
            for asked, tables in {"": {}, **{n: w.vehicle for n, w in questions.withheld.items()}}.items():
                place = f"vehicle of {name!r}" + (f" or of {asked!r}" if asked else "")
                validate_settings(file, Vehicle, self._vehicle_tables(name, tables), place, "see the vehicle file")

    def estimate_recording(
        self, name: str, vehicle: Vehicle, variation: QuestionVariation = AS_ASKED
    ) -> tuple[Recording, Estimate, Tuning]:
        """Read a recording, or the part of it that a `variation` keeps; return it, its motion and the filter's tuning.

        The tuning is that to the whole recording.
        """
        recording = read_recording(self.recordings / name, vehicle)
        tuning = tune_estimator([recording], vehicle, PERIOD_S, MAX_GAP_S, {})
        recording = cut_recording(recording, *variation.part)
        return recording, estimate_motion(recording, vehicle, tuning), tuning

    def published_model(self, estimates: list[Estimate], vehicle: Vehicle) -> ReferenceModel | None:
        """The published simulation as a reference model for drives of these `estimates`; None where there is none."""
        return None if self.simulation is None else reference_from_parameters(self.simulation, estimates, vehicle)

    def _vehicle_tables(self, recording: str, tables: Mapping[str, Any]) -> dict[str, Any]:
        """Tables of the vehicle file with a recording's own and then `tables` in place of its own."""
        drive = self.drives.get(recording)
        own = _merge_tables(drive.vehicle if drive else {}, tables)
        return _merge_tables(self.vehicle.model_dump(by_alias=True), own)


def _merge_tables(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Merge nested dicts recursively: where both have a key, the value of `above` replaces that of `below`."""
    merged = dict(below)
    for key, value in above.items():
        under = merged.get(key)
        nested = isinstance(under, Mapping) and isinstance(value, Mapping)
        merged[key] = _merge_tables(merged[key], value) if nested else value
    return merged


def reference_as_row(reference: ReferenceModel | None) -> dict[str, Any] | None:
    """A reference model as JSON holds it: each of its fields, mappings as objects; None where there is none."""
    if reference is None:
        return None
    known = reference.known
    plan = known.plan and {name: array.tolist() for name, array in known.plan._asdict().items()}
    functions = {"on_body": known.on_body.tolist(), "tracking": known.tracking.tolist(), "plan": plan}
    fields = {**reference._asdict(), "car": reference.car._asdict(), "known": functions}
    return {name: dict(value) if isinstance(value, Mapping) else value for name, value in fields.items()}


def reference_from_row(row: Mapping[str, Any] | None) -> ReferenceModel | None:
    """The reference model that `reference_as_row` made a row of."""
    if row is None:
        return None
    known = row["known"]
    tables = (np.reshape(known["on_body"], (-1, COLUMNS)), np.reshape(known["tracking"], (-1, TRACKING_COLUMNS)))
    functions = UnnamedFunctions(*tables, known["plan"] and _plan_from_row(known["plan"]))
    return ReferenceModel(**{**row, "car": Car(**row["car"]), "known": functions})


def _plan_from_row(row: Mapping[str, Any]) -> AnglePlan:
    """The plan of functions of which a row holds the lists; those that are empty have lost their shapes."""
    factors, order = (np.array(row[name], dtype=np.int64) for name in ("factors", "order"))
    return AnglePlan(
        np.reshape(row["angles"], (-1, ANGLE_COLUMNS)), factors.reshape(-1, 1 + FACTORS), np.array(row["behind"]), order
    )
