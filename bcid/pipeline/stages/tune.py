"""Stage `tune`: the estimator's noise, and the steering's constants where the vehicle file omits them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from bcid.estimate.tuning import tune
from bcid.recording.saving import load_recording
from bcid.vehicle import Vehicle


def make(
    folder: Path,
    recordings: Sequence[Path],
    vehicle: Vehicle,
    period_s: float,
    max_gap_s: float,
    noise: Mapping[str, float],
) -> None:
    """Tune on the training recordings."""
    tuning = tune([load_recording(f) for f in recordings], vehicle, period_s, max_gap_s, noise)
    (folder / "tuning.json").write_text(json.dumps(tuning.as_json(), indent=1))
