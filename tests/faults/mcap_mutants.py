"""Mutants of MCAP files whose checksums are right: a check of them tells nothing, so what is behind it must hold.

`in_records` changes a record, or the content of a chunk, and mends sizes and checksums; `in_messages` and
`in_definitions` change what a message or a type's definition says, and write the file anew.
"""

from __future__ import annotations

import io
import json
import struct
import zlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import lz4.frame
import zstandard
from mcap.reader import NonSeekingReader
from mcap.records import Channel, Message, Schema
from mcap.writer import CompressionType, Writer

from bcid.recording.formats.detect import MCAP_MAGIC
from faults.mutants import BYTES, EXTREMES, NASTY, Mutator, Rng

HEAD = struct.Struct("<BQ")
FOOTER, CHUNK, DATA_END = 2, 6, 15
NASTY_JSON: tuple[Any, ...] = (
    None, True, False, "0_1.5", "nan", "", [], {}, -1, 1e308, -1e308, 2**63, 10**400, "1e400", "12:30", "\x1b[31m",
    [[[[0]]]], {"x": {"x": 1}}, "2026-13-40T99:99:99Z", 1e-320,
)  # fmt: skip
NASTY_LINES = (
    "geometry_msgs/Pose again", "wstring w", "float64[1000000000] huge", "uint8[] bytes", "string[4294967295] s",
    "geometry_msgs/Point[100000] points", "float64[0] none", "Nothing here", "float64", "float64 x 1.0", "int8 A=1",
    "geometry_msgs/Pose[<=3] few", "MSG: geometry_msgs/Pose", "=" * 80, "# note", "\x00", "float64 \x1b[31m",
)  # fmt: skip
YAML_LINES = (
    "    - ../../etc/passwd", "    - a.mcap.zstd", "    - b.db3", "  relative_file_paths: []", "  relative_file_paths:",
    "relative_file_paths: [", "    - '", "\t- x", "    - " + "y" * 5000, "x" * 80_000, "[" * 3000, "    - bag_0.mcap",
    "&a [*a, *a]", "    - \x1b[31m.mcap", "    - .", "    -", "---",
)  # fmt: skip


def split_records(data: bytes) -> list[tuple[int, bytes]]:
    """Opcode and body of each record of a whole MCAP file."""
    records, at = [], len(MCAP_MAGIC)
    while at < len(data) - len(MCAP_MAGIC):
        opcode, length = HEAD.unpack_from(data, at)
        records.append((opcode, data[at + HEAD.size : at + HEAD.size + length]))
        at += HEAD.size + length
    return records


def join_records(records: list[tuple[int, bytes]]) -> bytes:
    """The file of these records, with the checksums of its data section and its summary as they must be."""
    out, begin = bytearray(MCAP_MAGIC), 0
    for opcode, whole in records:
        body = whole
        if opcode == DATA_END and len(whole) == 4 and whole != bytes(4):
            body = struct.pack("<I", zlib.crc32(out))
        if opcode == FOOTER and len(whole) == 20:
            start, offsets, crc = struct.unpack("<QQI", whole)
            body = struct.pack("<QQ", begin if start else 0, offsets)
            head = HEAD.pack(opcode, 20)
            body += struct.pack("<I", zlib.crc32(bytes(out[begin:]) + head + body) if crc else 0)
        out += HEAD.pack(opcode, len(body)) + body
        if opcode == DATA_END:
            begin = len(out)
    return bytes(out + MCAP_MAGIC)


def _in_chunk(body: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """A chunk whose content went through `change`, its size and its checksum mended."""
    first, last, _, crc, n = struct.unpack_from("<QQQII", body)
    name = body[32 : 32 + n]
    packed = body[32 + n + 8 :]
    unpack = {b"": bytes, b"zstd": zstandard.ZstdDecompressor().decompress, b"lz4": lz4.frame.decompress}[name]
    pack = {b"": bytes, b"zstd": zstandard.ZstdCompressor().compress, b"lz4": lz4.frame.compress}[name]
    content = change(unpack(packed))
    again = pack(content)
    stated = zlib.crc32(content) if crc else 0
    return struct.pack("<QQQII", first, last, len(content), stated, n) + name + struct.pack("<Q", len(again)) + again


def in_records(data: bytes, rng: Rng) -> bytes:
    """A record, or a chunk's content, changed as disks change bytes, and all checksums mended."""
    records, mutate = split_records(data), BYTES[int(rng.integers(len(BYTES)))]
    chunks = [k for k, (opcode, _) in enumerate(records) if opcode == CHUNK]
    k = chunks[int(rng.integers(len(chunks)))] if chunks and rng.random() < 0.7 else int(rng.integers(len(records)))
    opcode, body = records[k]
    if opcode == CHUNK:
        body = _in_chunk(body, lambda content: mutate(content, rng))
    elif body:
        body = mutate(body, rng)
    records[k] = (opcode, body)
    return join_records(records)


Content = tuple[Schema | None, Channel, Message]


def rewritten(data: bytes, change: Callable[[Content], Content], rng: Rng, share: float) -> bytes:
    """The file written anew, after `change` of some of its messages with their schemas and channels."""
    out, found = io.BytesIO(), list(NonSeekingReader(io.BytesIO(data)).iter_messages(log_time_order=False))
    chosen = rng.random(len(found)) < share
    chosen[int(rng.integers(len(found)))] = True
    writer, ids = Writer(out, chunk_size=20_000, compression=CompressionType.ZSTD), dict[Any, int]()
    writer.start()
    for item, is_chosen in zip(found, chosen, strict=True):
        schema, channel, message = change(item) if is_chosen else item
        key = (channel.topic, channel.message_encoding, schema and (schema.name, schema.encoding, schema.data))
        if key not in ids:
            number = writer.register_schema(schema.name, schema.encoding, schema.data) if schema else 0
            ids[key] = writer.register_channel(channel.topic, channel.message_encoding, number)
        writer.add_message(ids[key], message.log_time, message.data, message.publish_time, message.sequence)
    writer.finish()  # type: ignore[no-untyped-call]
    return out.getvalue()


def _nasty_json(value: Any, rng: Rng) -> Any:
    """A JSON value of which one part, at any depth, is something nasty."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        key = list(value)[int(rng.integers(len(value)))]
        if rng.random() < 0.1:
            return {k: v for k, v in value.items() if k != key}
        return {**value, key: _nasty_json(value[key], rng)}
    return NASTY_JSON[int(rng.integers(len(NASTY_JSON)))]


def in_messages(data: bytes, rng: Rng) -> bytes:
    """The content, or the time, of a message or of many, changed; JSON also within its syntax."""
    mutate, how = BYTES[int(rng.integers(len(BYTES)))], rng.random()

    def change(item: Content) -> Content:
        schema, channel, message = item
        if how < 0.1:
            times = [int(v) for v in EXTREMES]
            return schema, channel, replace(message, log_time=times[int(rng.integers(len(times)))] & ((1 << 64) - 1))
        if channel.message_encoding == "json" and how < 0.7:
            content = json.dumps(_nasty_json(json.loads(message.data), rng)).encode()
        elif how < 0.75:
            content = NASTY[int(rng.integers(len(NASTY)))] or b"[" * 100_000
        else:
            content = mutate(message.data, rng)
        return schema, channel, replace(message, data=content)

    return rewritten(data, change, rng, float(rng.choice([0.0, 0.01, 1.0])))


def in_definitions(data: bytes, rng: Rng) -> bytes:
    """The definition, the name or the encoding of a type, or the topic, changed for all of a channel's messages."""
    found = list(NonSeekingReader(io.BytesIO(data)).iter_messages(log_time_order=False))
    schema, channel, _ = found[int(rng.integers(len(found)))]
    mutate, how = BYTES[int(rng.integers(len(BYTES)))], rng.random()
    if schema is None:
        return in_messages(data, rng)
    lines = schema.data.split(b"\n")
    if how < 0.4:
        at, line = int(rng.integers(len(lines) + 1)), NASTY_LINES[int(rng.integers(len(NASTY_LINES)))]
        lines.insert(at, line.encode())
        new = replace(schema, data=b"\n".join(lines))
    elif how < 0.55:
        new = replace(schema, data=b"\n".join(lines[i] for i in rng.permutation(len(lines))))
    elif how < 0.9:
        new = replace(schema, data=mutate(schema.data, rng) if schema.data else b"\x00")
    else:
        names = ["", "a/b/c", "geometry_msgs/msg/PoseArray", "tf2_msgs/msg/TFMessage", "nav_msgs/Odometry", "\x1b[31m"]
        new = replace(schema, name=names[int(rng.integers(len(names)))])

    def change(item: Content) -> Content:
        return (new, item[1], item[2]) if item[1].topic == channel.topic else item

    return rewritten(data, change, rng, 1.0)


def in_metadata(data: bytes, rng: Rng) -> bytes:
    """Lines of a bag's metadata.yaml lost, moved, or with something nasty between them."""
    lines = data.split(b"\n")
    for _ in range(int(rng.integers(1, 4))):
        at, how = int(rng.integers(len(lines) + 1)), rng.random()
        if how < 0.6:
            lines.insert(at, YAML_LINES[int(rng.integers(len(YAML_LINES)))].encode())
        elif how < 0.8 and lines:
            del lines[at - 1]
        else:
            lines = [lines[i] for i in rng.permutation(len(lines))]
    return b"\n".join(lines)


REPAIRED: tuple[Mutator, ...] = (in_records, in_messages, in_messages)
DEFINITIONS: tuple[Mutator, ...] = (in_definitions, in_definitions, in_records)
