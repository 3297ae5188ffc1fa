"""CSV and Parquet tables with a column mapping, and the commands file beside a Motive export."""

import io
import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bcid.aliases import Floats
from bcid.errors import InputRefused, Problem, Problems
from bcid.recording.formats.csv_text import HEAD_LINES, CsvText, read_csv_text
from bcid.recording.formats.detect import PARQUET_MAGIC
from bcid.recording.formats.raw import RawTake, identify_file, map_field, nearest_hint, raw_field_names
from bcid.recording.limits import TABLE as LIMITS
from bcid.recording.types import COMMANDS_FORMAT, Irregularity
from bcid.vehicle import OPTIONAL_CHANNELS, Vehicle

SHOWN_COLUMNS = 12  # names of columns in a message
HEADER_NAMES = "names"  # key of the file's column names among a table's attributes
COMMAND_COLUMNS = ("time_s", "steering_rad", "throttle_mps")


def read_commands_file(path: Path) -> RawTake:
    """The commands [steering, throttle] (M, 2) and channels of a CSV file beside a Motive export; no poses (N = 0).

    Its columns are `time_s,steering_rad,throttle_mps`, and those of OPTIONAL_CHANNELS that it has.

    Raises:
        InputRefused: the file or a column is missing, or a cell is no number.
    """
    if not path.exists():
        step = "put the commands beside the export as NAME.commands.csv, or name them with --commands"
        raise InputRefused(path, "commands file", "does not exist", step)
    source, text = identify_file(path, COMMANDS_FORMAT), read_csv_text(path)
    table = _parse_csv(text)
    present = [c for c in OPTIONAL_CHANNELS if c in table.columns]
    remedy = f"the header must read {','.join(COMMAND_COLUMNS)}"
    column = _numeric_columns(table, [*COMMAND_COLUMNS, *present], path, remedy)
    if table.empty:
        raise InputRefused(path, "line 2", "holds a header and no commands", "record the commands again")
    command = np.column_stack([column[c] for c in COMMAND_COLUMNS[1:]])
    channels = {c: (column["time_s"], column[c]) for c in present}
    extra = [str(c) for c in table.columns if c not in (*COMMAND_COLUMNS, *OPTIONAL_CHANNELS)]
    odd = list(text.irregularities)
    if extra:
        odd.append(Irregularity("unknown column", "warning", len(extra), f"{path.name} line 1", ", ".join(extra)))
    no_poses = (np.empty(0), np.empty((0, 3)))
    return RawTake(path.stem, (source,), *no_poses, column["time_s"], command, None, channels, tuple(odd))


def parse_rows(file: CsvText, **options: Any) -> pd.DataFrame:
    """The rows of a CSV text as a table, read by `pandas.read_csv` with these options.

    Raises:
        pandas.errors.ParserError or ParserWarning: a row has more cells than the header.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        text, separator = io.StringIO(file.text), file.separator
        table: pd.DataFrame = pd.read_csv(
            text, sep=separator, decimal=file.decimal, index_col=False, low_memory=False, **options
        )
    return table


def _parse_csv(file: CsvText, comment: str | None = None) -> pd.DataFrame:
    """The table in a CSV file; `InputRefused` where there is none or its rows are longer than the header."""
    try:
        table = parse_rows(file, comment=comment, skipinitialspace=True)
    except pd.errors.EmptyDataError:
        raise InputRefused(file.path, "line 1", "holds no table", "export the take again") from None
    except (pd.errors.ParserError, pd.errors.ParserWarning) as error:
        cause = f"rows are longer than the header, or is no regular CSV (a decimal comma?): {error}"
        raise InputRefused(file.path, "table", cause, "mend the rows, or export with ; between the cells") from None
    rows = (row for row in file.first_rows(HEAD_LINES) if row and not (comment and row[0].startswith(comment)))
    # pandas renames a column whose name comes twice
    table.attrs[HEADER_NAMES] = [cell.strip() for cell in next(rows, [])]
    return table


def _numeric_columns(table: pd.DataFrame, columns: Iterable[str], path: Path, remedy: str) -> dict[str, Floats]:
    """The named columns as floats (N,), timestamps in s from the first; `remedy` is the advice of a refusal.

    Raises:
        InputRefused: columns that are missing, there twice, or hold text, all of them in one error.
    """
    wanted, names = list(dict.fromkeys(columns)), table.attrs.get(HEADER_NAMES, [str(c) for c in table.columns])
    problems, found = Problems(), {}
    for column in wanted:
        if column not in table.columns:
            listed = ", ".join(names[:SHOWN_COLUMNS]) + (" …" if len(names) > SHOWN_COLUMNS else "")
            cause = f"is not in the file (found: {listed}{nearest_hint(column, names)})"
            problems.append(Problem(f"column {column!r}", cause, remedy))
            continue
        cells = table[column]
        if names.count(column) > 1:
            problems.append(Problem(f"column {column!r}", "is there twice", "name the columns apart"))
        # a timestamp or a time span
        if cells.dtype.kind in "mM":
            cells = (cells - cells.min()).dt.total_seconds() if cells.dtype.kind == "M" else cells.dt.total_seconds()
        values = parse_numbers(cells)
        text = np.flatnonzero(np.isnan(values) & cells.notna().to_numpy())
        if len(text):
            more = f" (and {len(text) - 1} more in this column)" if len(text) > 1 else ""
            place = f"data row {text[0] + 1}, column {column!r}"
            problems.append(Problem(place, f"{cells.iloc[text[0]]!r} is no number{more}", "mend or remove such rows"))
        found[column] = values
    problems.raise_if_any(path)
    return found


def parse_numbers(cells: Any) -> Floats:
    """A table's column as floats (N,): NaN where it holds text, infinite where a number is too large."""
    try:
        return np.asarray(pd.to_numeric(cells, errors="coerce"), dtype=float)
    except OverflowError:  # a number of hundreds of digits
        return np.asarray(pd.to_numeric(cells.astype(str), errors="coerce"), dtype=float)


def _read_parquet(path: Path, wanted: Sequence[str]) -> pd.DataFrame:
    """Those of the `wanted` columns that a Parquet file has; `InputRefused` if unreadable or beyond LIMITS.max_rows."""
    import pyarrow.parquet as pq
    from pyarrow.lib import ArrowException

    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            rows, names = file.metadata.num_rows, file.schema_arrow.names
            if rows > LIMITS.max_rows:
                raise InputRefused(path, "rows", f"has {rows}, {LIMITS.max_rows} are the most", "cut it into takes")
            table: pd.DataFrame = file.read([n for n in names if n in wanted]).to_pandas(ignore_metadata=True)
            table.attrs[HEADER_NAMES] = names
    except (ArrowException, OSError, ValueError, KeyError, TypeError, MemoryError) as error:
        raise InputRefused(path, "Parquet data", f"cannot be read: {error!r}"[:300], "export the table again") from None
    return table


def read_table(path: Path, vehicle: Vehicle) -> RawTake:
    """The unchecked poses, commands and channels of a CSV or Parquet table, in SI by `[columns]` of the vehicle file.

    Raises:
        InputRefused: there is no mapping or no such column, or text where a number belongs.
    """
    columns = vehicle.columns
    if columns is None:
        cause = "has no [columns], and the file is no Motive export"
        step = "map the table's columns in the vehicle file, as `bcid init` shows"
        raise InputRefused(path, "vehicle file", cause, step)
    source = identify_file(path, "table-" + path.suffix.lstrip(".").lower())
    poses, commands = (columns.x_m, columns.y_m, columns.yaw_rad), (columns.steering_rad, columns.throttle_mps)
    extra = {name: field for name in OPTIONAL_CHANNELS if (field := getattr(columns, name)) is not None}
    names = raw_field_names([*poses, *commands, *extra.values()])
    odd: tuple[Irregularity, ...] = ()
    with path.open("rb") as file:
        is_parquet = file.read(len(PARQUET_MAGIC)) == PARQUET_MAGIC
    if is_parquet:
        table = _read_parquet(path, [columns.time_s, *names])
    else:
        text = read_csv_text(path, columns.comment)
        table, odd = _parse_csv(text, columns.comment), text.irregularities
    if table.empty:
        raise InputRefused(path, "table", "holds a header and no rows", "export the take again")
    remedy = "correct [columns] in the vehicle file"
    column = _numeric_columns(table, [columns.time_s, *names], path, remedy).__getitem__
    time_s = column(columns.time_s)
    finite = time_s[np.isfinite(time_s)]
    time_s = time_s - (finite[0] if len(finite) else 0.0)
    pose = np.column_stack([map_field(f, column) for f in poses])
    command = np.column_stack([map_field(f, column) for f in commands])
    channels = {name: (time_s, map_field(field, column)) for name, field in extra.items()}
    return RawTake(path.stem, (source,), time_s, pose, time_s, command, None, channels, odd)
