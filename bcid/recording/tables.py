"""CSV and Parquet tables, plain (commands files) and with a column mapping (`read_table`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd

from bcid.errors import InputRefused
from bcid.recording.mapping import mapped
from bcid.recording.raw import RawTake, source_of
from bcid.recording.types import Floats
from bcid.vehicle import CHANNELS, Vehicle


def read_csv(path: Path, comment: str | None = None) -> pd.DataFrame:
    """The CSV file at `path`, with refusals instead of parser errors."""
    try:
        return pd.read_csv(path, comment=comment, encoding="utf-8-sig", skipinitialspace=True, low_memory=False)
    except UnicodeDecodeError as error:
        raise InputRefused(path, f"byte {error.start}", "is not UTF-8", "save the file as UTF-8") from None
    except pd.errors.EmptyDataError:
        raise InputRefused(path, "line 1", "holds no table", "export the take again") from None
    except pd.errors.ParserError as error:
        raise InputRefused(path, "table", f"is no regular CSV: {error}", "mend the row named above") from None


def numbers(table: pd.DataFrame, column: str, path: Path) -> Floats:
    """A column as floats; a cell that holds text is refused with its row."""
    if column not in table.columns:
        raise InputRefused(
            path,
            f"column {column!r}",
            f"is not in the file (found: {', '.join(map(str, table.columns[:12]))} …)",
            "correct [columns] in the vehicle file",
        )
    values = pd.to_numeric(table[column], errors="coerce").to_numpy(float)
    text = np.flatnonzero(np.isnan(values) & table[column].notna().to_numpy())
    if len(text):
        raise InputRefused(
            path,
            f"data row {text[0] + 1}, column {column!r}",
            f"{table[column].iloc[text[0]]!r} is no number",
            "mend or remove that row",
        )
    return values


def _parquet(path: Path) -> pd.DataFrame:
    from pyarrow.lib import ArrowException

    try:
        return pd.read_parquet(path)
    except (ArrowException, OSError, ValueError) as error:
        raise InputRefused(path, "Parquet data", f"cannot be read: {error}", "export the table again") from None


def read_table(path: Path, vehicle: Vehicle) -> RawTake:
    """A CSV or Parquet table whose columns the vehicle file's `[columns]` names.

    Raises:
        InputRefused: no mapping, no such column, or text where a number belongs.
    """
    columns = vehicle.columns
    if columns is None:
        raise InputRefused(
            path,
            "vehicle file",
            "has no [columns], and the file is no Motive export",
            "map the table's columns in the vehicle file, as `bcid init` shows",
        )
    source = source_of(path, "table-" + path.suffix.lstrip(".").lower())
    table = _parquet(path) if path.suffix.lower() == ".parquet" else read_csv(path, columns.comment)
    if table.empty:
        raise InputRefused(path, "table", "holds a header and no rows", "export the take again")

    def column(name: str) -> Floats:
        return numbers(table, name, path)

    time_s = column(columns.time_s)
    zero = time_s[np.isfinite(time_s)][0] if np.isfinite(time_s).any() else 0.0
    time_s = time_s - zero
    pose = np.column_stack([mapped(f, column) for f in (columns.x_m, columns.y_m, columns.yaw_rad)])
    command = np.column_stack([mapped(f, column) for f in (columns.steering_rad, columns.throttle_mps)])
    extra = {
        name: (time_s, mapped(field, column)) for name in CHANNELS if (field := getattr(columns, name)) is not None
    }
    return RawTake(path.stem, (source,), time_s, pose, time_s, command, None, extra)
