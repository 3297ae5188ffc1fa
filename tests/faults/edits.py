"""Edits of what bcid saves, field by field: of a JSON object, of named arrays, of a Parquet table."""

from __future__ import annotations

import copy
import json
import math
import struct
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

Edited = Callable[[Path], None]
Change = Callable[[Any, Any], None]
"""What is done to the entry of a key in its container."""


class Edit(NamedTuple):
    """One edit of a saved file: what is edited, how, and the function that writes the edited file."""

    field: str  # its last name, which a refusal must name
    how: str
    write: Edited


DEPTH = 3000  # of lists in lists
RAW = {"far too deep": "[" * DEPTH + "]" * DEPTH, "five thousand digits": "9" * 5000, "no JSON": "0_1.5"}
"""Values that are written as they stand, since no JSON writer would."""

VALUES: dict[str, Any] = {
    "null": None, "NaN": math.nan, "infinite": math.inf, "-1": -1, "-0.5": -0.5, "zero": 0, "1e308": 1e308,
    "-1e308": -1e308, "1e-308": 1e-308, "1e15": 1e15, "10**400": 10**400, "text": "text", "a number as text": "0_1.5",
    "true": True, "no text": "", "[]": [], "[1.0]": [1.0], "{}": {}, "an object": {"a": {"b": 1.0}}, "path": "../../x",
    "control characters": "\x1b[31m\x07\u202e", "half a character": "\ud800", "long text": "x" * 100_000,
    "list of a thousand": [1.0] * 1000, "list of odd things": [None, "x", {}, [[]]], "date": "2026-01-01",
}  # fmt: skip


def paths_of(data: Any, path: tuple[Any, ...] = (), most: int = 3) -> Iterator[tuple[Any, ...]]:
    """Paths to all that stands in JSON data, of lists the first `most` entries."""
    if path:
        yield path
    if isinstance(data, dict):
        for key, value in data.items():
            yield from paths_of(value, (*path, key), most)
    elif isinstance(data, list):
        for i, value in enumerate(data[:most]):
            yield from paths_of(value, (*path, i), most)


def _at(data: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        data = data[key]
    return data


def _write_changed(
    file: Path, data: Any, path: tuple[Any, ...], change: Change, seal: Callable[[Path, Any], None]
) -> None:
    edited = copy.deepcopy(data)
    change(_at(edited, path[:-1]), path[-1])
    seal(file, edited)


def _put(value: Any) -> Change:
    def change(container: Any, key: Any) -> None:
        container[key] = value

    return change


def _drop(container: Any, key: Any) -> None:
    del container[key]


def edits_of_json(data: Any, seal: Callable[[Path, Any, dict[str, str]], None]) -> list[Edit]:
    """All edits of a JSON object, written by `seal(path, data, raw)`, which makes its digest right.

    `raw` are texts by the placeholders in whose place they are written.
    """
    found: list[Edit] = []

    def add(path: tuple[Any, ...], how: str, change: Change, raw: dict[str, str] | None = None) -> None:
        write = partial(_write_changed, data=data, path=path, change=change, seal=partial(seal, raw=raw or {}))
        found.append(Edit(".".join(map(str, path)), how, write))

    for path in paths_of(data):
        was = _at(data, path)
        add(path, "missing", _drop)
        for how, value in VALUES.items():
            if not (type(value) is type(was) and value == was):
                add(path, how, _put(value))
        for how, text in RAW.items():
            add(path, how, _put("@raw@"), {'"@raw@"': text})
        if isinstance(was, list):
            add(path, "one less", _put(was[:-1]))
            add(path, "one more", _put([*was, *was[-1:]]))
            add(path, "doubled", _put([was, was]))
        if isinstance(was, dict):
            add(path, "further key", _put({**was, "further": 1.0}))
            add(path, "hostile key", _put({**was, "\x1b[31m/../x": 1.0}))
        if isinstance(was, int | float) and not isinstance(was, bool):
            for how, factor in (("negated", -1.0), ("a million times", 1e6), ("a millionth", 1e-6)):
                add(path, how, _put(was * factor))
    add(("further",), "further key", _put(1.0))
    return found


def dump(data: Any, raw: dict[str, str]) -> str:
    """JSON text of `data`, with NaN as JavaScript has it, and `raw` texts in the place of their placeholders."""
    text = json.dumps(data)
    for placeholder, written in raw.items():
        text = text.replace(placeholder, written)
    return text


ARRAY_VALUES = (math.nan, math.inf, -math.inf, -1.0, 0.0, 5e6, -5e6, 1e300, 1e-300, 2.0**62, 11.0)
ARRAY_TYPES = ("float16", "float32", "float64", "int8", "int32", "int64", "uint64", "bool")


def edited_arrays(arrays: dict[str, np.ndarray]) -> Iterator[tuple[str, str, dict[str, np.ndarray]]]:
    """Name, kind and arrays of all edits of named arrays: values, types, shapes, names."""
    for name, array in arrays.items():
        for value in ARRAY_VALUES:
            for place in ("first", "all"):
                edited = array.astype(np.float64)
                edited[(0,) * array.ndim if place == "first" else ...] = value
                with np.errstate(all="ignore"):
                    yield name, f"{place} {value:g}", {**arrays, name: edited.astype(array.dtype)}
        for kind in ARRAY_TYPES:
            if kind != array.dtype:
                yield name, kind, {**arrays, name: array.astype(kind)}
        shapes = {
            "empty": array[:0], "scalar": array.ravel()[:1].reshape(()), "flat": array.ravel(), "transposed": array.T,
            "one less": array[:-1], "one more": np.concatenate([array, array[-1:]]), "a further axis": array[None],
            "a thousand times": np.concatenate([array] * 1000), "huge and empty": np.zeros((0, 1 << 40), array.dtype),
        }  # fmt: skip
        yield from (
            (name, how, {**arrays, name: np.ascontiguousarray(shape)})
            for how, shape in shapes.items()
            if shape.shape != array.shape
        )
        yield name, "missing", {k: v for k, v in arrays.items() if k != name}
        yield name, "renamed", {k if k != name else f"{k}_": v for k, v in arrays.items()}
        yield name, "exchanged", {**arrays, name: next(iter(arrays.values()))}
    yield "further", "further array", {**arrays, "further": np.zeros(3)}


def odd_safetensors(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Kind and bytes of safetensors files whose header is not what the library would write."""
    (size,) = struct.unpack("<Q", content[:8])
    header, body = json.loads(content[8 : 8 + size]), content[8 + size :]
    name = next(k for k in header if k != "__metadata__")

    def built(changed: dict[str, Any], data: bytes = body) -> bytes:
        text = json.dumps(changed).encode()
        return struct.pack("<Q", len(text)) + text + data

    for kind in ("BF16", "F8_E4M3", "F4", "C64", "I4", "X"):
        yield f"type {kind}", built({**header, name: {**header[name], "dtype": kind}})
    for shape in ([-1], [1 << 63], [1 << 40, 1 << 40], [1.5], ["1"], None, [0], [[1]]):
        yield f"shape {shape}", built({**header, name: {**header[name], "shape": shape}})
    for offsets in ([0, 1 << 62], [-8, 8], [8, 0], [0], None, ["0", "8"], [len(body), len(body) + 8]):
        yield f"offsets {offsets}", built({**header, name: {**header[name], "data_offsets": offsets}})
    yield "no header", struct.pack("<Q", 0) + body
    yield "a header of 2^63", struct.pack("<Q", 1 << 63) + content[8:]
    yield "a deep header", struct.pack("<Q", 2 * DEPTH) + b"[" * DEPTH + b"]" * DEPTH
    yield "hostile name", built({**header, "\x1b[31m": header[name]})
    yield "odd metadata", built({**header, "__metadata__": {"a": 1}})
    yield "cut", content[: len(content) // 2]
    yield "nothing", b""


def odd_tables(path: Path, write: Callable[[pa.Table, Path], None]) -> Iterator[tuple[str, str, Edited]]:
    """Column, kind and writing function of tables like the Parquet file at `path` with other values, types and rows."""
    table = pq.read_table(path)

    def put(column: str, values: pa.Array) -> Edited:
        at = table.schema.get_field_index(column)
        return lambda file: write(table.set_column(at, column, values), file)

    for column in table.column_names:
        numbers = table[column].to_numpy()
        for value in (math.nan, math.inf, -1.0, 0.0, 1e308, -1e308, 1e15, 0.5):
            for rows, chosen in (("a row", slice(1, 2)), ("all rows", slice(None))):
                edited = numbers.copy()
                edited[chosen] = value
                yield column, f"{rows} {value:g}", put(column, pa.array(edited))
        yield column, "turned around", put(column, pa.array(numbers[::-1].copy()))
        yield column, "doubled rows", put(column, pa.array(np.repeat(numbers, 2)[: len(numbers)]))
        n = len(numbers)
        odd = {
            "text": pa.array([f"{v}" for v in numbers]), "null": pa.nulls(n, pa.float64()), "nothing": pa.nulls(n),
            "whole": pa.array(np.arange(n)), "single": pa.array(numbers.astype(np.float32)),
            "true": pa.array([True] * n), "lists": pa.array([[v] for v in numbers]),
            "stamps": pa.array(np.arange(n), pa.timestamp("ns")), "bytes": pa.array([b"x"] * n),
            "dictionary": pa.array([f"{v}" for v in numbers]).dictionary_encode(),
            "objects": pa.array([{"a": v} for v in numbers]), "half": pa.array(numbers.astype(np.float16)),
            "decimal": pa.array([1] * n, pa.decimal128(5, 2)),
        }  # fmt: skip
        yield from ((column, how, put(column, values)) for how, values in odd.items())
        yield column, "missing", lambda file, c=column: write(table.drop_columns([c]), file)
        yield column, "twice", lambda file, c=column: write(table.append_column(c, table[c]), file)
    yield "time", "no rows", lambda file: write(table.slice(0, 0), file)
    yield "time", "one row", lambda file: write(table.slice(0, 1), file)
    yield "time", "half the rows", lambda file: write(table.slice(0, len(table) // 2), file)
    yield "time", "twice the rows", lambda file: write(pa.concat_tables([table, table]), file)
