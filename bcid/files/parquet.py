"""Parquet with units in the schema's metadata and page checksums, written and verified the same way everywhere."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from bcid.errors import InputRefused
from bcid.files.limits import LIMITS
from bcid.files.regular import check_regular_file

NEXT_STEP = "make the file again"


def write_columns(path: Path, values: npt.NDArray[Any], units: Mapping[str, str]) -> None:
    """Write the columns of `values` (N, n) as a Parquet file of float64; `units` gives names, in order, and units."""
    fields = [pa.field(n, pa.float64(), metadata={"unit": u}) for n, u in units.items()]
    columns = [pa.array(np.ascontiguousarray(c, dtype=float)) for c in values.T]
    table = pa.Table.from_arrays(columns, schema=pa.schema(fields))
    pq.write_table(
        table, path, compression="zstd", use_dictionary=False, write_page_checksum=True,
        column_encoding=dict.fromkeys(units, "BYTE_STREAM_SPLIT"),
    )  # fmt: skip


def read_columns(path: Path, units: Mapping[str, str], undefined: Sequence[str] = ()) -> npt.NDArray[np.float64]:
    """Columns (N, n) of the Parquet file at `path`: those that `units` names, in its order, N at least 1.

    Every number is finite, but for the columns `undefined`, such as predictions that may diverge.

    Raises:
        FileNotFoundError: there is no such file.
        InputRefused: the file is damaged (page checksums are verified), lacks a column, holds other than numbers of
            double precision, none or too many of them, or one that is not finite.
    """
    try:
        check_regular_file(path, 8 * LIMITS.max_table_numbers)
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            _check_schema(file, list(units))
            table = file.read(list(units))
        columns = [_to_numpy(table[name]) for name in units]
    except FileNotFoundError:
        raise
    except (pa.ArrowException, OSError, KeyError, ValueError, TypeError) as error:
        raise InputRefused(path, "Parquet data", f"is damaged: {error!r}"[:300], NEXT_STEP) from None
    for name, column in zip(units, columns, strict=True):
        wrong = ~np.isfinite(column)
        if wrong.any() and name not in undefined:
            cause = f"is {column[int(np.argmax(wrong))]} in row {int(np.argmax(wrong)) + 1}, no finite number"
            raise InputRefused(path, f"column {name}", cause, NEXT_STEP)
    return np.column_stack(columns)


def _to_numpy(column: pa.ChunkedArray) -> npt.NDArray[np.float64]:
    """A column's numbers (N,), NaN where one is absent.  Arrow's own way to them would import pandas."""
    if column.null_count or not column.num_chunks:
        return np.asarray(column.to_numpy())
    return np.concatenate([np.from_dlpack(chunk) for chunk in column.chunks])


def _check_schema(file: pq.ParquetFile, names: Sequence[str]) -> None:
    """Raise `ValueError` unless an open Parquet file has each of `names` once, as numbers, and not too many of them."""
    schema, rows = file.schema_arrow, file.metadata.num_rows
    for name in names:
        if schema.names.count(name) != 1:
            raise ValueError(f"{schema.names.count(name)} columns are named {name}")
        if schema.field(name).type != pa.float64():
            raise ValueError(f"column {name} is of {schema.field(name).type}, not of double")
    if not 0 < rows * len(names) <= LIMITS.max_table_numbers:
        raise ValueError(f"{rows} rows of {len(names)} numbers, 1 to {LIMITS.max_table_numbers} numbers are read")
