"""Estimates, tunings and checks on disk, as Parquet and JSON."""

from pathlib import Path

import numpy as np

from bcid.documents.document import Document
from bcid.estimate.consistency import Truth
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate, FilterSummary
from bcid.files.parquet import read_columns, write_columns
from bcid.physics.kinematics import kinematic_state
from bcid.vehicle import Vehicle

COLUMNS = {
    "time": "s", "segment": "1", "x": "m", "y": "m", "yaw": "rad",
    "v_x": "m/s", "v_y": "m/s", "yaw_rate": "rad/s",
    "v_f": "m/s", "alpha_f": "rad", "alpha_r": "rad", "delta": "rad",
    "u_s": "rad", "u_m": "m/s or brake share",
    "v_x_sd": "m/s", "v_y_sd": "m/s", "yaw_rate_sd": "rad/s",
    "v_f_sd": "m/s", "alpha_f_sd": "rad", "alpha_r_sd": "rad", "delta_sd": "rad",
}  # fmt: skip
TRUTH_COLUMNS = {"time": "s", "v_x": "m/s", "v_y": "m/s", "yaw_rate": "rad/s", "delta": "rad"}


class EstimateSummary(Document):
    """An estimate's name, grid, tuning and filter (estimate.json); its rows stand in estimate.parquet beside it."""

    name: str
    period_s: float
    tuning: Tuning
    filter: FilterSummary


def save_estimate(estimate: Estimate, folder: Path) -> None:
    """Write the estimated motion to estimate.parquet, and its tuning and filter summary to estimate.json, in `folder`.

    Raises:
        ValueError: the motion has no tuning, since no filter estimated it.
    """
    e = estimate
    if e.tuning is None or e.filter is None:
        raise ValueError(f"{e.name}: no filter estimated this motion")
    table = np.column_stack([e.time_s, e.segment, e.pose, e.twist, e.kinematic, e.command, e.twist_sd, e.kinematic_sd])
    write_columns(folder / "estimate.parquet", table, COLUMNS)
    summary = EstimateSummary(name=e.name, period_s=e.period_s, tuning=e.tuning, filter=e.filter)
    summary.write(folder / "estimate.json")


def load_estimate(folder: Path) -> Estimate:
    """Read the estimated motion that `save_estimate` wrote as estimate.parquet and estimate.json into `folder`."""
    summary = EstimateSummary.read(folder / "estimate.json")
    table = read_columns(folder / "estimate.parquet", COLUMNS)
    time_s, segment, pose, twist, kinematic, command, twist_sd, kinematic_sd = np.split(
        table, np.cumsum([1, 1, 3, 3, 4, 2, 3]), axis=1
    )
    return Estimate(
        summary.name, summary.period_s, time_s[:, 0], segment[:, 0].astype(np.int64), pose, twist, kinematic,
        command, twist_sd, kinematic_sd, summary.tuning, summary.filter,
    )  # fmt: skip


def read_truth(path: Path, vehicle: Vehicle) -> Truth:
    """True times (K,), twists (K, 3) and kinematic states (K, 4) of a simulated recording, read from a Parquet file."""
    table = read_columns(path, TRUTH_COLUMNS)
    l_f, l_r = vehicle.body.cog_to_front_m, vehicle.body.cog_to_rear_m
    states = [(*kinematic_state(v_x, v_y, omega, delta, l_f, l_r), delta) for _, v_x, v_y, omega, delta in table]
    return Truth(table[:, 0], table[:, 1:4], np.array(states))
