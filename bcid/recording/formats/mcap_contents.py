"""What an MCAP file holds of the topics that are wanted, and how far its contents can be vouched for."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator
from contextlib import redirect_stderr
from dataclasses import dataclass, field, replace
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

from mcap import records as kinds

from bcid.errors import InputRefused
from bcid.recording.formats.detect import missing_parts, parts_of
from bcid.recording.formats.mcap_records import Broken, Read, records
from bcid.recording.formats.ros_messages import base_name
from bcid.recording.types import Irregularity

RECORD_AGAIN = "record again, or keep what is whole with --allow-partial"
LONGEST = 300  # characters of what a parser says
PART = 1 << 16  # channels are numbered below it
ENCODINGS = ("json", "cdr", "protobuf")  # of messages that are read


class Message(NamedTuple):
    """One message as it was recorded."""

    channel: int
    log_ns: int
    data: bytes


class Lost(NamedTuple):
    """A part of the file that cannot be read."""

    begin_ns: int | None
    end_ns: int | None
    cause: str


@dataclass
class Contents:
    """All of a file that is used."""

    path: Path
    schemas: dict[int, kinds.Schema] = field(default_factory=dict)
    channels: dict[int, kinds.Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)  # messages found, by channel
    messages: list[Message] = field(default_factory=list)  # of the wanted topics, in file order
    unindexed: bool = False  # chunks that no index names, or no summary at all
    miscounted: str | None = None  # where a summary counts other messages than there are
    lost: list[Lost] = field(default_factory=list)
    contradicted: list[str] = field(default_factory=list)  # schemas and channels that are declared twice, not alike
    unchecked: int = 0  # messages that no checksum covers
    last_ns: int | None = None

    def schema_name(self, schema_id: int) -> str:
        """A schema's name without its namespace's middle part."""
        schema = self.schemas.get(schema_id)
        return base_name(schema.name) if schema else "no schema"

    def decoded(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Log time (ns) and content of each of a topic's messages."""
        decoders = {c.id: _decoder(c, self.schemas.get(c.schema_id), self.path) for c in self.of(topic)}
        for message in self.messages:
            if message.channel in decoders:
                yield message.log_ns, decoders[message.channel](message.data)

    def of(self, topic: str) -> list[kinds.Channel]:
        """A topic's channels that hold messages."""
        return [c for c in self.channels.values() if c.topic == topic and self.counts.get(c.id)]

    def odd(self) -> list[Irregularity]:
        """What is told of the file itself."""
        told, name = [], self.path.name
        if self.unchecked:
            text = "not verifiable: no checksum covers the messages"
            told.append(Irregularity("integrity", "warning", self.unchecked, name, text))
        if self.unindexed and not self.lost:
            text = "no index, or no summary at all: read from the first byte to the last"
            told.append(Irregularity("index", "warning", 1, name, text))
        if self.miscounted and not self.lost:
            told.append(Irregularity("message counts", "warning", 1, name, self.miscounted))
        lacking = missing_parts(self.path)
        if lacking:
            told.append(Irregularity("split bag", "warning", 1, name, lacking))
        for part in self.lost:
            length = None if part.begin_ns is None or part.end_ns is None else (part.end_ns - part.begin_ns) / 1e9
            begin = "" if part.begin_ns is None else f"from {part.begin_ns / 1e9:.3f} s "
            where = begin + ("to the end" if length is None else f"for {length:.3f} s")
            told.append(Irregularity("lost", "excluded", 1, where, part.cause))
        return told


def _decoder(channel: kinds.Channel, schema: kinds.Schema | None, path: Path) -> Any:
    """The function that decodes a channel's messages.

    Raises:
        InputRefused: an encoding, of messages or of their schema, that is not read.
    """
    from mcap_protobuf.decoder import DecoderFactory as Protobuf
    from mcap_ros2.decoder import DecoderFactory as Ros2

    encoding, place = channel.message_encoding, f"topic {channel.topic}"
    remedy = "record as JSON, CDR (ros2msg) or protobuf"
    if encoding not in ENCODINGS:
        raise InputRefused(path, place, f"encoding {encoding!r} is not read", remedy)
    if encoding == "json":
        return json.loads
    try:
        with redirect_stderr(StringIO()):
            decode = (Ros2() if encoding == "cdr" else Protobuf()).decoder_for(encoding, schema)
    except Exception as error:  # parsers of definitions, which print and raise what they like
        cause = f"its type's definition cannot be read: {type(error).__name__}: {error}"
        raise InputRefused(path, place, cause[:LONGEST], remedy) from None
    if decode is None:
        of = f"a schema in {schema.encoding!r}" if schema else "no schema"
        raise InputRefused(path, place, f"encoding {encoding!r} with {of} is not read", remedy)
    return decode


def contents(path: Path, topics: Collection[str], allow_partial: bool) -> Contents:
    """The contents of a file, or of all the parts in a split bag's folder; what may be missing is left out and told.

    Raises:
        InputRefused: with the byte, where a checksum does not match or the file is cut, and no part may be missing.
    """
    found = Contents(path)
    for i, part in enumerate(parts_of(path)):
        _read_part(found, part, i * PART, topics, allow_partial)
    return found


def _read_part(found: Contents, path: Path, shift: int, topics: Collection[str], allow_partial: bool) -> None:
    """Add a file's contents; each part numbers its channels anew, so that they are shifted."""
    before, unchecked, statistics, vouched, indexed = dict(found.counts), found.unchecked, None, False, False
    try:
        for read in records(path):
            if isinstance(read.record, Broken):
                _lose(found, path, read.record, allow_partial)
            elif isinstance(read.record, kinds.Statistics):
                statistics = read.record
            elif isinstance(read.record, kinds.ChunkIndex):
                indexed = True
            elif isinstance(read.record, kinds.Footer):
                vouched = read.record.summary_crc != 0
                chunked = statistics is not None and statistics.chunk_count > 0
                found.unindexed |= read.record.summary_start == 0 or (chunked and not indexed)
            elif isinstance(read.record, kinds.DataEnd) and read.record.data_section_crc:
                found.unchecked = unchecked  # it covers all of this file
            else:
                _take(found, read, shift, topics)
    except Broken as error:
        whole = "data section" in error.cause and not found.lost  # nothing says which of it is wrong
        if whole or not (allow_partial and found.counts):
            raise InputRefused(path, f"byte {error.offset}", error.cause, RECORD_AGAIN) from None
        if not found.lost or "data section" not in error.cause:  # whose checksum covers the chunk that is lost
            found.lost.append(Lost(found.last_ns, None, str(error)))
    else:
        if found.contradicted:
            cause = "is declared twice, not alike: nothing says what its messages are"
            raise InputRefused(path, found.contradicted[0], cause, "record again")
    if statistics is not None and statistics.channel_message_counts:
        stated = {k + shift: n for k, n in statistics.channel_message_counts.items() if n}
        held = {k: n for k, n in found.counts.items() if before.get(k) != n}
        if stated != held:
            text = f"the summary counts {sum(stated.values())} messages, the file holds {sum(held.values())}"
            _miscount(found, path, text, vouched and sum(held.values()) < sum(stated.values()), allow_partial)
    _claim(found, path, topics, allow_partial)


def _miscount(found: Contents, path: Path, text: str, missing: bool, allow_partial: bool) -> None:
    """Where the summary's own checksum holds, fewer messages than it counts are a loss."""
    if not missing:
        found.miscounted = text
    elif not allow_partial:
        raise InputRefused(path, "message counts", text, RECORD_AGAIN)
    elif not found.lost:
        found.lost.append(Lost(None, None, text))


def _lose(found: Contents, path: Path, broken: Broken, allow_partial: bool) -> None:
    chunk = broken.chunk
    if not allow_partial or chunk is None:
        raise InputRefused(path, f"byte {broken.offset}", broken.cause, RECORD_AGAIN)
    found.lost.append(Lost(chunk.message_start_time, chunk.message_end_time, str(broken)))


def _claim(found: Contents, path: Path, topics: Collection[str], allow_partial: bool) -> None:
    """Leave out messages of channels that stand only behind them, of other topics, or nowhere, which is told.

    A file's summary repeats its channels: what follows a lost chunk, which had them first, is known by it.
    """
    undeclared = sum(m.channel not in found.channels for m in found.messages)
    if undeclared:
        text = f"{undeclared} messages are of channels that are declared nowhere"
        if not allow_partial:
            raise InputRefused(path, "channels", text, RECORD_AGAIN)
        found.lost.append(Lost(None, None, text))
    known = found.channels
    found.messages = [m for m in found.messages if m.channel in known and known[m.channel].topic in topics]


def _declare(found: Contents, known: dict[int, Any], record: Any) -> None:
    """Enter a schema or a channel; a summary repeats those that came before, and the first one stands."""
    if known.setdefault(record.id, record) != record:
        found.contradicted.append(f"{type(record).__name__.lower()} {record.id % PART}")


def _take(found: Contents, read: Read, shift: int, topics: Collection[str]) -> None:
    record = read.record
    if isinstance(record, kinds.Schema):
        _declare(found, found.schemas, replace(record, id=record.id + shift))
    elif isinstance(record, kinds.Channel):
        schema = record.schema_id and record.schema_id + shift  # 0 is none
        _declare(found, found.channels, replace(record, id=record.id + shift, schema_id=schema))
    elif isinstance(record, kinds.Message):
        number = record.channel_id + shift
        found.counts[number] = found.counts.get(number, 0) + 1
        found.unchecked += not read.checked
        found.last_ns = record.log_time
        channel = found.channels.get(number)
        if channel is None or channel.topic in topics:
            found.messages.append(Message(number, record.log_time, record.data))
