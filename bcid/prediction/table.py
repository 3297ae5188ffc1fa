"""A prediction as a table, in CSV or Parquet, with the units in the names of the columns."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from bcid.aliases import Floats
from bcid.errors import UsageError
from bcid.files.parquet import write_columns

UNITS = {"x": "m", "y": "m", "yaw": "rad", "v_x": "m/s", "v_y": "m/s", "yaw_rate": "rad/s"}
"""Units of the pose, then of the twist."""
ENDINGS = (".csv", ".parquet")


def _suffix(unit: str) -> str:
    """The unit as part of a name: "mps" of "m/s"."""
    return unit.replace("/", "p")


PAIRS = tuple(itertools.combinations(UNITS, 2))
COLUMNS = {
    "t_s": "s",
    **{f"{name}_{_suffix(unit)}": unit for name, unit in UNITS.items()},
    **{f"{name}_sd_{_suffix(unit)}": unit for name, unit in UNITS.items()},
    **{f"{name}_{end}_{_suffix(unit)}": unit for end in ("low", "high") for name, unit in UNITS.items()},
    **{f"cov_{a}_{b}_{_suffix(UNITS[a])}_{_suffix(UNITS[b])}": f"{UNITS[a]} {UNITS[b]}" for a, b in PAIRS},
}
"""Columns by name with their units: time, motion, standard deviations, ends of 95 % intervals, covariances."""


def check_ending(path: Path) -> None:
    """Raise `UsageError` unless a table can be written to the path: its name ends with .csv or .parquet."""
    if path.suffix.lower() not in ENDINGS:
        raise UsageError(
            f"{path}: a prediction is written as {' or '.join(ENDINGS)}\n  next: give the file such a name"
        )


def write_prediction_table(
    path: Path, time_s: Floats, pose: Floats, twist: Floats, covariance: Floats, interval: tuple[Floats, Floats]
) -> None:
    """Write times (T,), poses and twists (T, 3), covariances (T, 6, 6) and ends of intervals (T, 6) as COLUMNS.

    In CSV numbers have as many digits as tell them apart; what is not known is `nan` in both formats.

    Raises:
        UsageError: the path ends neither with .csv nor with .parquet.
    """
    check_ending(path)
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    upper = np.triu_indices(len(UNITS), k=1)
    table = np.column_stack([time_s, pose, twist, sd, *interval, covariance[:, *upper]])
    if path.suffix.lower() == ".parquet":
        write_columns(path, table, COLUMNS)
        return
    rows = [",".join(COLUMNS), *(",".join(map(repr, row)) for row in table.tolist())]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
