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
    """Identify the estimator's noise, and steering constants not in the vehicle file; write tuning.json to `folder`.

    `recordings` are folders of ingested training takes, `noise` values that are kept as given; `period_s` is the
    grid's period and `max_gap_s` the longest bridged gap (s).
    """
    tuning = tune_estimator([load_recording(f) for f in recordings], vehicle, period_s, max_gap_s, noise)
    tuning.write(folder / "tuning.json")
