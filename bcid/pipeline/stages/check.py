"""Stage `check`: the estimator against a simulated take's truth.  No fit depends on it."""

from __future__ import annotations

import json
from pathlib import Path

from bcid.estimate.run import check_against_truth
from bcid.estimate.saving import read_truth
from bcid.estimate.tuning import Tuning
from bcid.recording.saving import load_recording
from bcid.vehicle import Vehicle


def make(
    folder: Path, recording: Path, tuning: Path, vehicle: Vehicle, period_s: float, max_gap_s: float, truth: Path
) -> None:
    """RMSE and NEES of one take."""
    tuned = Tuning.from_json(json.loads((tuning / "tuning.json").read_text()))
    known = read_truth(truth, vehicle)
    facts = check_against_truth(load_recording(recording), vehicle, tuned, period_s, max_gap_s, known)
    (folder / "check.json").write_text(json.dumps(facts, indent=1))
