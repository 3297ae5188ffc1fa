"""One vehicle's files, of which real recordings are asked questions, and what the estimator makes of them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning, tune
from bcid.estimate.types import Estimate
from bcid.files.toml import validated
from bcid.proof.real.questions import Cases
from bcid.recording.read import read_recording
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle


class Asked(NamedTuple):
    """One vehicle's files."""

    vehicle: Vehicle
    calibrated: Mapping[str, Mapping[str, Any]]  # what is otherwise in a recording
    simulation: Path | None
    recordings: Path

    def vehicle_of(self, recording: str, tables: Mapping[str, Any] = MappingProxyType({})) -> Vehicle:
        """The recording's vehicle, with these tables over its own."""
        return Vehicle.model_validate(self._tables_of(recording, tables))

    def check(self, cases: Cases, file: Path) -> None:
        """Raise `InputRefused` where a question of `file` makes no vehicle."""
        for case in cases.withheld:
            tables = self._tables_of(case.recording, case.vehicle)
            validated(file, Vehicle, tables, f"vehicle of {case.name!r} or its calibration", "see the vehicle file")
        for name in self.calibrated:
            validated(file, Vehicle, self._tables_of(name, {}), f"calibration of {name}", "see the vehicle file")

    def moved(self, name: str, vehicle: Vehicle) -> tuple[Recording, Estimate, Tuning]:
        """The recording, and its motion."""
        recording = read_recording(self.recordings / name, vehicle)
        tuning = tune([recording], vehicle, 0.1, 0.3, {})
        return recording, estimate_motion(recording, vehicle, tuning), tuning

    def _tables_of(self, recording: str, tables: Mapping[str, Any]) -> dict[str, Any]:
        own = _laid_over(self.calibrated.get(recording, {}), tables)
        return _laid_over(self.vehicle.model_dump(by_alias=True), own)


def _laid_over(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """The tables of `above` over those of `below`."""
    merged = dict(below)
    for key, value in above.items():
        under = merged.get(key)
        merged[key] = _laid_over(under, value) if isinstance(value, Mapping) and isinstance(under, Mapping) else value
    return merged
