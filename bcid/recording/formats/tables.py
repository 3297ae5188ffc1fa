"""CSV and Parquet tables, plain (commands files) and with a column mapping (`read_table`)."""

from __future__ import annotations

import difflib
import io
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bcid.aliases import Floats
from bcid.errors import InputRefused, Problem, Problems
from bcid.recording.formats.csv_text import HEAD_LINES, CsvText, read_text
from bcid.recording.formats.detect import is_parquet
from bcid.recording.formats.mapping import field_names, mapped
from bcid.recording.formats.raw import RawTake, source_of
from bcid.recording.types import Irregularity
from bcid.vehicle import CHANNELS, Vehicle

LISTED = 12  # columns that a refusal names
NAMES = "names"  # of the file's columns, among a table's attributes
MAX_ROWS = 5_000_000  # half a day at 120 Hz


def read_csv(file: CsvText, comment: str | None = None) -> pd.DataFrame:
    """The table in a CSV file, with refusals instead of parser errors."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            table = pd.read_csv(
                io.StringIO(file.text), sep=file.separator, decimal=file.decimal, comment=comment,
                index_col=False, skipinitialspace=True, low_memory=False,
            )  # fmt: skip
    except pd.errors.EmptyDataError:
        raise InputRefused(file.path, "line 1", "holds no table", "export the take again") from None
    except (pd.errors.ParserError, pd.errors.ParserWarning) as error:
        cause = f"rows are longer than the header, or is no regular CSV (a decimal comma?): {error}"
        raise InputRefused(file.path, "table", cause, "mend the rows, or export with ; between the cells") from None
    head = next((row for row in file.rows(HEAD_LINES) if row and not (comment and row[0].startswith(comment))), [])
    table.attrs[NAMES] = [cell.strip() for cell in head]  # pandas renames what comes twice
    return table


def numbers(table: pd.DataFrame, columns: Iterable[str], path: Path, remedy: str) -> dict[str, Floats]:
    """The named columns as floats.

    Raises:
        InputRefused: with every column that is missing (and its `remedy`) and every one that holds text.
    """
    wanted, names = list(dict.fromkeys(columns)), table.attrs.get(NAMES, [str(c) for c in table.columns])
    problems, found = Problems(), {}
    for column in wanted:
        if column not in table.columns:
            near = difflib.get_close_matches(column, names, n=1)
            hint = f"; nearest: {near[0]}" if near else ""
            cause = f"is not in the file (found: {_listed(names)}{hint})"
            problems.append(Problem(f"column {column!r}", cause, remedy))
            continue
        cells = table[column]
        if names.count(column) > 1:
            problems.append(Problem(f"column {column!r}", "is there twice", "name the columns apart"))
        if cells.dtype.kind in "mM":  # a timestamp or a time span
            cells = (cells - cells.min()).dt.total_seconds() if cells.dtype.kind == "M" else cells.dt.total_seconds()
        values = as_numbers(cells)
        text = np.flatnonzero(np.isnan(values) & cells.notna().to_numpy())
        if len(text):
            more = f" (and {len(text) - 1} more in this column)" if len(text) > 1 else ""
            place = f"data row {text[0] + 1}, column {column!r}"
            problems.append(Problem(place, f"{cells.iloc[text[0]]!r} is no number{more}", "mend or remove such rows"))
        found[column] = values
    problems.refuse(path)
    return found


def as_numbers(cells: Any) -> Floats:
    """A column as floats: NaN where it holds text, infinite where a number is too large."""
    try:
        return np.asarray(pd.to_numeric(cells, errors="coerce"), dtype=float)
    except OverflowError:  # of hundreds of digits
        return np.asarray(pd.to_numeric(cells.astype(str), errors="coerce"), dtype=float)


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:LISTED]) + (" …" if len(names) > LISTED else "")


def _parquet(path: Path, wanted: Sequence[str]) -> pd.DataFrame:
    """The wanted columns that are there."""
    import pyarrow.parquet as pq
    from pyarrow.lib import ArrowException

    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            rows, names = file.metadata.num_rows, file.schema_arrow.names
            if rows > MAX_ROWS:
                raise InputRefused(path, "rows", f"has {rows}, {MAX_ROWS} are the most", "cut it into takes")
            table: pd.DataFrame = file.read([n for n in names if n in wanted]).to_pandas(ignore_metadata=True)
            table.attrs[NAMES] = names
    except (ArrowException, OSError, ValueError, KeyError, TypeError, MemoryError) as error:
        raise InputRefused(path, "Parquet data", f"cannot be read: {error!r}"[:300], "export the table again") from None
    return table


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
    poses, commands = (columns.x_m, columns.y_m, columns.yaw_rad), (columns.steering_rad, columns.throttle_mps)
    extra = {name: field for name in CHANNELS if (field := getattr(columns, name)) is not None}
    names = field_names([*poses, *commands, *extra.values()])
    odd: tuple[Irregularity, ...] = ()
    if is_parquet(path):
        table = _parquet(path, [columns.time_s, *names])
    else:
        text = read_text(path, columns.comment)
        table, odd = read_csv(text, columns.comment), text.odd
    if table.empty:
        raise InputRefused(path, "table", "holds a header and no rows", "export the take again")

    column = numbers(table, [columns.time_s, *names], path, "correct [columns] in the vehicle file").__getitem__
    time_s = column(columns.time_s)
    finite = time_s[np.isfinite(time_s)]
    time_s = time_s - (finite[0] if len(finite) else 0.0)
    pose = np.column_stack([mapped(f, column) for f in poses])
    command = np.column_stack([mapped(f, column) for f in commands])
    channels = {name: (time_s, mapped(field, column)) for name, field in extra.items()}
    return RawTake(path.stem, (source,), time_s, pose, time_s, command, None, channels, odd)
