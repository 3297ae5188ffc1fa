"""Stage `estimate`: the smoothed motion of one recording."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

from bcid.estimate.run import estimate_motion
from bcid.estimate.saving import save_estimate
from bcid.estimate.tuning import Tuning
from bcid.recording.saving import load_recording
from bcid.vehicle import Vehicle


def make(
    folder: Path,
    recording: Path,
    tuning: Path,
    vehicle: Vehicle,
    period_s: float,
    max_gap_s: float,
    engine: Literal["compiled", "filterpy"],
) -> None:
    """Filter and smooth one ingested recording."""
    tuned = Tuning.from_json(json.loads((tuning / "tuning.json").read_text()))
    estimate = estimate_motion(load_recording(recording), vehicle, tuned, period_s, max_gap_s, engine)
    save_estimate(estimate, folder)
