"""Parquet with units in the schema's metadata and page checksums, written and verified the same way everywhere."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from bcid.errors import InputRefused


def write_columns(path: Path, values: npt.NDArray[Any], units: Mapping[str, str]) -> None:
    """Write the columns of `values` (N, n) as a Parquet file of float64; `units` gives names, in order, and units."""
    fields = [pa.field(n, pa.float64(), metadata={"unit": u}) for n, u in units.items()]
    columns = [pa.array(np.ascontiguousarray(c, dtype=float)) for c in values.T]
    table = pa.Table.from_arrays(columns, schema=pa.schema(fields))
    pq.write_table(
        table, path, compression="zstd", use_dictionary=False, write_page_checksum=True,
        column_encoding=dict.fromkeys(units, "BYTE_STREAM_SPLIT"),
    )  # fmt: skip


def read_columns(path: Path, units: Mapping[str, str]) -> npt.NDArray[np.float64]:
    """Columns (N, n) of the Parquet file at `path`: those that `units` names, in its order.

    Raises:
        FileNotFoundError: there is no such file.
        InputRefused: the file is damaged (page checksums are verified) or lacks a column.
    """
    try:
        table = pq.read_table(path, columns=list(units), page_checksum_verification=True)
        return np.column_stack([table[n].to_numpy() for n in units])
    except FileNotFoundError:
        raise
    except (pa.ArrowException, OSError, KeyError, ValueError, TypeError) as error:
        raise InputRefused(path, "Parquet data", f"is damaged: {error!r}"[:300], "make the file again") from None
