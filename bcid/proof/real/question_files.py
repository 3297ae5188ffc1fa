"""The files that questions to one vehicle's recordings are asked with, and the estimated motion of a recording."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from bcid.estimate.run import estimate_motion
from bcid.estimate.tune import tune_estimator
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.files.toml import validate_settings
from bcid.proof.real.questions import QuestionFile
from bcid.recording.read import read_recording
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

# as a pipeline file has them where it says nothing else
PERIOD_S, MAX_GAP_S = 0.1, 0.3


class QuestionInputs(NamedTuple):
    """Vehicle, calibrations of single recordings by name, parameters of the simulation, and the recordings' folder."""

    vehicle: Vehicle
    calibrated: Mapping[str, Mapping[str, Any]]  # what is otherwise in a recording
    simulation: Path | None
    recordings: Path

    def vehicle_for(self, recording: str, tables: Mapping[str, Any] = MappingProxyType({})) -> Vehicle:
        """The vehicle as calibrated for a recording, with `tables` in place of its own."""
        return Vehicle.model_validate(self._vehicle_tables(recording, tables))

    def check_vehicles(self, questions: QuestionFile, file: Path) -> None:
        """Raise `InputRefused` where a calibration or a question of `file` makes no valid vehicle."""
        tables = {f"calibration of {name}": self._vehicle_tables(name, {}) for name in self.calibrated}
        for question in questions.withheld:
            place = f"vehicle of {question.name!r} or its calibration"
            tables[place] = self._vehicle_tables(question.recording, question.vehicle)
        for place, vehicle in tables.items():
            validate_settings(file, Vehicle, vehicle, place, "see the vehicle file")

    def estimate_recording(self, name: str, vehicle: Vehicle) -> tuple[Recording, Estimate, Tuning]:
        """Read a recording and estimate its motion; return both with the estimator's tuning to this recording."""
        recording = read_recording(self.recordings / name, vehicle)
        tuning = tune_estimator([recording], vehicle, PERIOD_S, MAX_GAP_S, {})
        return recording, estimate_motion(recording, vehicle, tuning), tuning

    def _vehicle_tables(self, recording: str, tables: Mapping[str, Any]) -> dict[str, Any]:
        """Tables of the vehicle file with a recording's calibration and then `tables` in place of its own."""
        own = _merge_tables(self.calibrated.get(recording, {}), tables)
        return _merge_tables(self.vehicle.model_dump(by_alias=True), own)


def _merge_tables(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Merge nested dicts recursively: where both have a key, the value of `above` replaces that of `below`."""
    merged = dict(below)
    for key, value in above.items():
        under = merged.get(key)
        nested = isinstance(under, Mapping) and isinstance(value, Mapping)
        merged[key] = _merge_tables(merged[key], value) if nested else value
    return merged
