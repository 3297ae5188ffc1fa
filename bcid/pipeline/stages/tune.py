"""Stage `tune`: the estimator's noise, and the steering's constants where the vehicle file omits them."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from bcid.estimate.tune import tune_estimator
from bcid.recording.saving import load_recording
from bcid.vehicle import Vehicle


def run_tune_stage(
    folder: Path,
    recordings: Sequence[Path],
    vehicle: Vehicle,
    period_s: float,
    max_gap_s: float,
    noise: Mapping[str, float],
) -> None:
    """Tune the estimator to the ingested training recordings and save the tuning; grid period and longest gap in s."""
    tuning = tune_estimator([load_recording(f) for f in recordings], vehicle, period_s, max_gap_s, noise)
    tuning.write(folder / "tuning.json")
