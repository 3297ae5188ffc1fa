"""Parquet tables: their columns by name, those inside structures too, as numbers, text or times."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from bcid.errors import InputRefused, Problem, Problems
from bcid.recording.formats.limits import TABLE as LIMITS
from bcid.recording.formats.names import printable_name
from bcid.recording.formats.stamps import find_pair
from bcid.recording.types import Irregularity

NUMBERS_WANTED = "map a column of numbers, or write it as one"
MAX_DEPTH = 8  # of structures inside structures
PAGE_HEADER_BYTES = 64  # more than the first three fields of a page's header have
INT32_FIELD = 0x15  # Thrift's compact protocol: the next field, a number of 32 bits


@contextmanager
def _refuse_unreadable(path: Path) -> Iterator[None]:
    """Context in which whatever the Parquet library raises of a damaged or odd file becomes an `InputRefused`."""
    try:
        yield
    except InputRefused:
        raise
    except Exception as error:  # the library raises errors of many kinds on damaged files
        raise InputRefused(path, "Parquet data", f"cannot be read: {error!r}"[:300], "export the table again") from None


def read_parquet_columns(
    path: Path, wanted: Sequence[str]
) -> tuple[dict[str, pd.Series], list[str], list[Irregularity]]:
    """Those of the `wanted` columns that a Parquet file has, by name; the names of all of its columns; what was odd.

    A column inside a structure is named by its path, such as `position.x`; `#1` is the first column.

    Raises:
        InputRefused: unreadable, beyond LIMITS.max_rows, or a wanted column is there twice or holds no numbers.
    """
    problems, columns = Problems(), dict[str, pd.Series]()
    with _refuse_unreadable(path), pq.ParquetFile(path, page_checksum_verification=True) as file:
        if (rows := file.metadata.num_rows) > LIMITS.max_rows:
            raise InputRefused(path, "rows", f"has {rows}, {LIMITS.max_rows} are the most", "cut it into takes")
        schema = file.schema_arrow
        leaves = [leaf for field in schema for leaf in _leaf_names(field)]
        pairs = [part for name in wanted for part in find_pair(name, leaves) or ()]
        read = dict.fromkeys(name for name in (*wanted, *pairs) if name in leaves)
        twice = [name for name in read if leaves.count(name) > 1]
        problems += [Problem(f"column {n!r}", "is there twice", "name the columns apart") for n in twice]
        problems.raise_if_any(path)
        text = [name for name in read if _is_text(_leaf_type(schema, name))]
        tops = [f.name for f in schema if any(name == f.name or name.startswith(f.name + ".") for name in read)]
        # as dictionaries, long texts are there once
        with pq.ParquetFile(path, page_checksum_verification=True, read_dictionary=text) as again:
            table = _flatten(again.read(tops))
        for name in read:
            with problems.gather_refusals():
                table.column(name).validate(full=True)
                columns[name] = _plain_column(table.column(name), name, path)
        problems.raise_if_any(path)
        odd = [] if _has_page_checksums(path, file.metadata, tops) else [_not_verifiable(path)]
    return columns, leaves, odd


def _leaf_type(schema: pa.Schema, name: str) -> pa.DataType:
    """The type of a column, or of a part of a structure by its path."""
    for field in schema:
        if name == field.name:
            return field.type
        if name.startswith(f"{field.name}.") and pa.types.is_struct(field.type):
            inner = pa.schema([field.type.field(i) for i in range(field.type.num_fields)])
            return _leaf_type(inner, name[len(field.name) + 1 :])
    return pa.null()


def _not_verifiable(path: Path) -> Irregularity:
    """The warning of a file without page checksums, in which a changed byte would not show."""
    text = "not verifiable: the file has no page checksums (pyarrow writes them with write_page_checksum=True)"
    return Irregularity("integrity", "warning", 1, path.name, text)


def _leaf_names(field: pa.Field, depth: int = 0) -> list[str]:
    """The names of a field's columns: its own, or those inside a structure, each with the path to it."""
    if not pa.types.is_struct(field.type) or depth == MAX_DEPTH:
        return [str(field.name)]
    inner = [field.type.field(i) for i in range(field.type.num_fields)]
    return [f"{field.name}.{name}" for part in inner for name in _leaf_names(part, depth + 1)]


def _flatten(table: pa.Table) -> pa.Table:
    """The table with the columns inside of structures in their place."""
    for _ in range(MAX_DEPTH):
        if not any(pa.types.is_struct(field.type) for field in table.schema):
            break
        table = table.flatten()
    return table


def _plain_column(column: pa.ChunkedArray, name: str, path: Path) -> pd.Series:
    """A column of numbers, text, dates or time spans as pandas has them; clock times as text.

    Raises:
        InputRefused: the column holds anything else, such as lists or true and false.
    """
    kind = column.type
    if pa.types.is_dictionary(kind):
        kind = kind.value_type
        lengths = [pc.max(pc.binary_length(c.dictionary)).as_py() or 0 for c in column.chunks if _is_text(kind)]
        longest = max(lengths, default=0)
        if longest > LIMITS.max_cell_bytes:
            raise InputRefused(path, f"column {name!r}", f"holds text of {longest} bytes", NUMBERS_WANTED)
        column = column.cast(kind)
    if pa.types.is_decimal(kind) or pa.types.is_float16(kind):
        column = column.cast(pa.float64())
    elif pa.types.is_time(kind):
        column = pc.cast(column.cast(pa.time64("ns")), pa.string())
    elif pa.types.is_null(kind):
        column = pa.chunked_array([pa.nulls(len(column), pa.float64())])
    elif not _is_plain(kind):
        shown = "true and false are no numbers" if pa.types.is_boolean(kind) else f"holds {printable_name(kind)}"
        raise InputRefused(path, f"column {name!r}", shown, NUMBERS_WANTED)
    series: pd.Series = column.to_pandas()
    return series


def _is_plain(kind: pa.DataType) -> bool:
    """Whether a type is a number, text, date or time span, which are read as they are."""
    numbers = pa.types.is_integer(kind) or pa.types.is_floating(kind)
    times = pa.types.is_timestamp(kind) or pa.types.is_duration(kind)
    return bool(numbers or times or _is_text(kind))


def _is_text(kind: pa.DataType) -> bool:
    """Whether a type is text of any length."""
    return bool(pa.types.is_string(kind) or pa.types.is_large_string(kind) or pa.types.is_string_view(kind))


def _has_page_checksums(path: Path, metadata: pq.FileMetaData, columns: Sequence[str]) -> bool:
    """Whether the first page of every chunk of these columns has a checksum, which is optional in its header.

    The columns must have been read: the library ends the process where it is asked for a broken chunk's place.
    """
    paths = [metadata.schema.column(k).path for k in range(metadata.num_columns)]
    read = [k for k, name in enumerate(paths) if any(name == c or name.startswith(f"{c}.") for c in columns)]
    with path.open("rb") as file:
        for chunk in (metadata.row_group(i).column(k) for i in range(metadata.num_row_groups) for k in read):
            file.seek(min(o for o in (chunk.dictionary_page_offset, chunk.data_page_offset) if o))
            if not _page_has_checksum(file.read(PAGE_HEADER_BYTES)):
                return False
    return True


def _page_has_checksum(header: bytes) -> bool:
    """Whether a page header, in Thrift's compact protocol, has its fourth field, the checksum.

    The first three (type and two sizes) are always there, each a byte that says so and a number of variable length.
    """
    at = 0
    for _ in range(3):
        if header[at : at + 1] != bytes([INT32_FIELD]):
            return False
        at += 1
        while at < len(header) and header[at] & 0x80:
            at += 1
        at += 1
    return header[at : at + 1] == bytes([INT32_FIELD])
