"""Stage `estimate`: the smoothed motion of one recording."""

from pathlib import Path
from typing import Literal

from bcid.estimate.run import estimate_motion
from bcid.estimate.saving import save_estimate
from bcid.estimate.tuning import Tuning
from bcid.recording.saving import load_recording
from bcid.vehicle import Vehicle


def run_estimate_stage(
    folder: Path,
    recording: Path,
    tuning: Path,
    vehicle: Vehicle,
    period_s: float,
    max_gap_s: float,
    engine: Literal["compiled", "filterpy"],
) -> None:
    """Filter and smooth one ingested recording, by the artifact `tuning`, and save the motion in `folder`.

    `period_s` (s) is the grid's period, `max_gap_s` (s) the longest gap that is bridged.
    """
    tuned = Tuning.read(tuning / "tuning.json")
    estimate = estimate_motion(load_recording(recording), vehicle, tuned, period_s, max_gap_s, engine)
    save_estimate(estimate, folder)
