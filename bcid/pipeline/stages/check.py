"""Stage `check`: the estimator against a simulated take's truth.  No fit depends on it."""

from pathlib import Path

from bcid.estimate.run import check_against_truth
from bcid.estimate.saving import read_truth
from bcid.estimate.tuning import Tuning
from bcid.recording.saving import load_recording
from bcid.vehicle import Vehicle


def run_check_stage(
    folder: Path, recording: Path, tuning: Path, vehicle: Vehicle, period_s: float, max_gap_s: float, truth: Path
) -> None:
    """Write check.json: the estimator's errors (RMSE, NEES) against the true motion of a simulated recording.

    `folder` receives it; `recording` and `tuning` are folders of artifacts, `truth` is a Parquet file; `period_s` is
    the grid's period, `max_gap_s` the longest bridged gap (s).
    """
    tuned = Tuning.read(tuning / "tuning.json")
    known = read_truth(truth, vehicle)
    check = check_against_truth(load_recording(recording), vehicle, tuned, period_s, max_gap_s, known)
    check.write(folder / "check.json")
