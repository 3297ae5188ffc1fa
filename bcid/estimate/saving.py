"""Estimates, tunings and checks on disk, as Parquet and JSON."""

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from bcid.aliases import Floats
from bcid.documents.document import Document, NotNegative
from bcid.errors import InputRefused
from bcid.estimate.command_parts import SAME_TIME_S, braked_share, variance_lost
from bcid.estimate.consistency import Truth
from bcid.estimate.limits import LIMITS
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
COMMAND_COLUMNS = {"row": "1", "duration": "s", "u_s": "rad", "u_m": "m/s or brake share", "brake_share": "1"}
NEXT_STEP = "estimate the take again"
TRUTH_COLUMNS = {"time": "s", "v_x": "m/s", "v_y": "m/s", "yaw_rate": "rad/s", "delta": "rad"}


class EstimateSummary(Document):
    """An estimate's name, grid, tuning and filter (estimate.json); its rows stand in estimate.parquet beside it."""

    name: str
    period_s: Annotated[float, Field(ge=LIMITS.min_period_s, le=LIMITS.max_period_s)]
    tuning: Tuning
    filter: FilterSummary
    variance_lost: tuple[NotNegative, NotNegative] = (0.0, 0.0)  # shares of steering and throttle within periods
    braked_share: NotNegative = 0.0  # of the time, by a brake of its own

    def describe_resampling(self) -> str:
        """What models of a fixed period are not told of the commands, in words; empty where it is next to nothing."""
        names = ("steering", "throttle")
        told = [
            f"{100.0 * share:.2g} % of the variance of the {name} commands"
            for name, share in zip(names, self.variance_lost, strict=True)
            if share >= LIMITS.told_variance_lost
        ]
        lies = "lies" if len(told) == 1 else "lie"
        texts = [f"{' and '.join(told)} {lies} within the periods, whose means learnt models are given"] if told else []
        if self.braked_share > 0.0:
            texts.append(f"the brake is on {self.braked_share:.0%} of the time, of which learnt models are not told")
        return "; ".join(texts)


def save_estimate(estimate: Estimate, folder: Path) -> None:
    """Write an estimated motion into `folder`: estimate.parquet, commands.parquet, and estimate.json.

    Rows of estimate.parquet are those of the grid, with the mean command of the period after each; commands.parquet
    holds the parts of these periods; estimate.json the tuning and the filter's summary.

    Raises:
        ValueError: the motion has no tuning, since no filter estimated it.
    """
    e = estimate
    if e.tuning is None or e.filter is None:
        raise ValueError(f"{e.name}: no filter estimated this motion")
    table = np.column_stack([e.time_s, e.segment, e.pose, e.twist, e.kinematic, e.command, e.twist_sd, e.kinematic_sd])
    write_columns(folder / "estimate.parquet", table, COLUMNS)
    row, column = np.nonzero(e.parts[:, :, 0] > 0.0)
    write_columns(folder / "commands.parquet", np.column_stack([row, e.parts[row, column]]), COMMAND_COLUMNS)
    summary = EstimateSummary(
        name=e.name,
        period_s=e.period_s,
        tuning=e.tuning,
        filter=e.filter,
        variance_lost=variance_lost(e.parts),
        braked_share=braked_share(e.parts),
    )
    summary.write(folder / "estimate.json")


def load_estimate(folder: Path) -> Estimate:
    """Read the estimated motion that `save_estimate` wrote as three files into `folder`.

    Raises:
        InputRefused: a file is damaged, or holds what no estimate does: rows out of order or off the grid.
    """
    summary = EstimateSummary.read(folder / "estimate.json")
    table = read_columns(folder / "estimate.parquet", COLUMNS)
    _check_grid(folder / "estimate.parquet", table[:, 0], table[:, 1], summary.period_s)
    time_s, segment, pose, twist, kinematic, _, twist_sd, kinematic_sd = np.split(
        table, np.cumsum([1, 1, 3, 3, 4, 2, 3]), axis=1
    )
    return Estimate(
        summary.name, summary.period_s, time_s[:, 0], segment[:, 0].astype(np.int64), pose, twist, kinematic,
        _load_parts(folder / "commands.parquet", len(table), summary.period_s), twist_sd, kinematic_sd,
        summary.tuning, summary.filter,
    )  # fmt: skip


def _check_grid(path: Path, time_s: Floats, segment: Floats, period_s: float) -> None:
    """Raise `InputRefused` unless the grid rows' times (K,) rise, by `period_s` (s) within a segment.

    `segment` (K,) are whole numbers that rise from one uninterrupted run of rows to the next; `path` is the file that
    both are from.
    """
    steps, new = np.diff(time_s), np.diff(segment)
    if np.any(new < 0.0) or np.any(segment % 1.0 != 0.0) or np.abs(segment).max() > LIMITS.max_segment:
        raise InputRefused(path, "column segment", "does not count up by whole numbers", NEXT_STEP)
    if np.any(steps <= 0.0) or np.any(np.abs(steps[new == 0.0] - period_s) > SAME_TIME_S):
        raise InputRefused(path, "column time", f"does not rise by {period_s:g} s within a segment", NEXT_STEP)


def _load_parts(path: Path, rows: int, period_s: float) -> Floats:
    """Parts (K, W, 4) of the periods of `period_s` (s) after K = `rows` grid rows, from the table of all at `path`.

    Raises:
        InputRefused: a row has no part or too many, their durations do not make a period, or rows are not in order.
    """
    table = read_columns(path, COMMAND_COLUMNS)
    row, first = table[:, 0], np.flatnonzero(np.diff(table[:, 0], prepend=-1.0))
    if not np.array_equal(row[first], np.arange(rows)):
        raise InputRefused(path, "column row", f"does not hold the {rows} rows in order", NEXT_STEP)
    column = np.arange(len(row)) - np.repeat(first, np.diff(first, append=len(row)))
    if column.max() >= LIMITS.max_command_parts:
        cause = f"has {column.max() + 1} parts of a period, {LIMITS.max_command_parts} are the most"
        raise InputRefused(path, "column row", cause, NEXT_STEP)
    lasting = np.add.reduceat(table[:, 1], first)
    if table[:, 1].min() <= 0.0 or np.abs(lasting - period_s).max() > SAME_TIME_S:
        raise InputRefused(path, "column duration", f"does not make periods of {period_s:g} s", NEXT_STEP)
    parts = np.zeros((rows, int(column.max()) + 1, 4))
    parts[row.astype(np.int64), column] = table[:, 1:]
    return parts


def read_truth(path: Path, vehicle: Vehicle) -> Truth:
    """True times (K,), twists (K, 3) and kinematic states (K, 4) of a simulated recording, read from a Parquet file."""
    table = read_columns(path, TRUTH_COLUMNS)
    l_f, l_r = vehicle.body.cog_to_front_m, vehicle.body.cog_to_rear_m
    states = [(*kinematic_state(v_x, v_y, omega, delta, l_f, l_r), delta) for _, v_x, v_y, omega, delta in table]
    return Truth(table[:, 0], table[:, 1:4], np.array(states))
