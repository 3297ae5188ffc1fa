"""The contents of an MCAP file on the wanted topics, and how far they are complete and covered by checksums."""

import json
from collections.abc import Collection, Iterator
from contextlib import redirect_stderr
from dataclasses import dataclass, field, replace
from io import StringIO
from pathlib import Path
from typing import Any

from mcap import records as kinds

from bcid.errors import InputRefused
from bcid.recording.formats.detect import describe_missing_parts, recording_files
from bcid.recording.formats.mcap_records import DamagedRecord, McapEntry, iterate_records
from bcid.recording.types import Irregularity

RECORD_AGAIN = "record again, or keep what is whole with --allow-partial"
SHOWN_CAUSE_LENGTH = 300  # characters of a parser's error in a message
CHANNELS_PER_FILE = 1 << 16  # channels are numbered below it
MESSAGE_ENCODINGS = ("json", "cdr", "protobuf")


@dataclass
class McapContents:
    """What is read from an MCAP file, or from all parts of a split bag."""

    path: Path
    topics: Collection[str]  # that are wanted
    allow_partial: bool  # whether parts may be lost
    schemas: dict[int, kinds.Schema] = field(default_factory=dict)
    channels: dict[int, kinds.Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)  # messages found, by channel
    messages: list[tuple[int, int, bytes]] = field(default_factory=list)  # channel, log time (ns), data; in file order
    unindexed: bool = False  # chunks that no index names, or no summary at all
    miscounted: str | None = None  # where a summary counts other messages than there are
    lost: list[Irregularity] = field(default_factory=list)  # parts that cannot be read
    contradicted: list[str] = field(default_factory=list)  # schemas and channels with two different declarations
    unverified: int = 0  # messages that no checksum covers
    last_ns: int | None = None

    def schema_name(self, schema_id: int) -> str:
        """The name of the schema with this number, in ROS 2 without its middle part: geometry_msgs/PoseStamped."""
        schema = self.schemas.get(schema_id)
        return schema.name.replace("/msg/", "/") if schema else "no schema"

    def decode_messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """The log time (ns) and the decoded content of each of a topic's messages."""
        channels = self.published_channels(topic)
        decoders = {c.id: _message_decoder(c, self.schemas.get(c.schema_id), self.path) for c in channels}
        for channel, log_ns, data in self.messages:
            if channel in decoders:
                yield log_ns, decoders[channel](data)

    def published_channels(self, topic: str) -> list[kinds.Channel]:
        """The channels of a topic that hold messages."""
        return [c for c in self.channels.values() if c.topic == topic and self.counts.get(c.id)]

    def note_lost_part(
        self, path: Path, place: str, cause: str, begin_ns: int | None = None, end_ns: int | None = None
    ) -> None:
        """Note a part with these log times as lost; `InputRefused` at this place of the file where no part may be."""
        if not self.allow_partial:
            raise InputRefused(path, place, cause.removeprefix(f"{place}: "), RECORD_AGAIN)
        begin = "" if begin_ns is None else f"from {begin_ns / 1e9:.3f} s "
        length = "to the end" if begin_ns is None or end_ns is None else f"for {(end_ns - begin_ns) / 1e9:.3f} s"
        self.lost.append(Irregularity("lost", "excluded", 1, begin + length, cause))

    def irregularities(self) -> list[Irregularity]:
        """Warnings of missing checksums, index, counts and parts of a bag, and the parts that are lost."""
        odd, name = [], self.path.name
        if self.unverified:
            text = "not verifiable: no checksum covers the messages"
            odd.append(Irregularity("integrity", "warning", self.unverified, name, text))
        if self.unindexed and not self.lost:
            text = "no index, or no summary at all: read from the first byte to the last"
            odd.append(Irregularity("index", "warning", 1, name, text))
        if self.miscounted and not self.lost:
            odd.append(Irregularity("message counts", "warning", 1, name, self.miscounted))
        lacking = describe_missing_parts(self.path)
        if lacking:
            odd.append(Irregularity("split bag", "warning", 1, name, lacking))
        return [*odd, *self.lost]


def _message_decoder(channel: kinds.Channel, schema: kinds.Schema | None, path: Path) -> Any:
    """The decoder of a channel's messages (JSON, CDR, protobuf) from bytes; `InputRefused` for another encoding."""
    from mcap_protobuf.decoder import DecoderFactory as Protobuf
    from mcap_ros2.decoder import DecoderFactory as Ros2

    encoding, place = channel.message_encoding, f"topic {channel.topic}"
    remedy = "record as JSON, CDR (ros2msg) or protobuf"
    if encoding not in MESSAGE_ENCODINGS:
        raise InputRefused(path, place, f"encoding {encoding!r} is not read", remedy)
    if encoding == "json":
        return json.loads
    try:
        with redirect_stderr(StringIO()):
            decode = (Ros2() if encoding == "cdr" else Protobuf()).decoder_for(encoding, schema)
    except Exception as error:  # parsers of definitions, which print and raise what they like
        cause = f"its type's definition cannot be read: {type(error).__name__}: {error}"
        raise InputRefused(path, place, cause[:SHOWN_CAUSE_LENGTH], remedy) from None
    if decode is None:
        with_schema = f"a schema in {schema.encoding!r}" if schema else "no schema"
        raise InputRefused(path, place, f"encoding {encoding!r} with {with_schema} is not read", remedy)
    return decode


def read_contents(path: Path, topics: Collection[str], allow_partial: bool) -> McapContents:
    """The messages on the wanted topics of an MCAP file or of a split bag's folder, with their channels and schemas.

    With `allow_partial`, parts that cannot be read are left out and noted as lost.

    Raises:
        InputRefused: a checksum does not match or the file is cut, with the byte, where no part may be lost.
    """
    contents = McapContents(path, topics, allow_partial)
    for i, part in enumerate(recording_files(path)):
        _read_part(contents, part, i * CHANNELS_PER_FILE)
    return contents


def _read_part(contents: McapContents, path: Path, shift: int) -> None:
    """Add the wanted messages of one MCAP file to `contents`, and note as lost what of the file cannot be read.

    `shift` is added to the file's numbers of channels and schemas, to keep apart those of a bag's other parts.
    """
    before, unverified, statistics, vouched, indexed = dict(contents.counts), contents.unverified, None, False, False
    try:
        for entry in iterate_records(path):
            record = entry.record
            if isinstance(record, DamagedRecord):
                begin_ns, end_ns = (c.message_start_time, c.message_end_time) if (c := record.chunk) else (None, None)
                contents.note_lost_part(path, f"byte {record.offset}", str(record), begin_ns, end_ns)
            elif isinstance(record, kinds.Statistics):
                statistics = record
            elif isinstance(record, kinds.ChunkIndex):
                indexed = True
            elif isinstance(record, kinds.Footer):
                vouched = record.summary_crc != 0
                chunked = statistics is not None and statistics.chunk_count > 0
                contents.unindexed |= record.summary_start == 0 or (chunked and not indexed)
            elif isinstance(record, kinds.DataEnd) and record.data_section_crc:
                # this checksum covers all of the file
                contents.unverified = unverified
            else:
                _add_record(contents, entry, shift)
    except DamagedRecord as error:
        of_all = "data section" in error.cause
        # a wrong checksum of the data section does not show which part is wrong, unless it is that of a lost chunk
        if (of_all and not contents.lost) or not (contents.allow_partial and contents.counts):
            raise InputRefused(path, f"byte {error.offset}", error.cause, RECORD_AGAIN) from None
        if not of_all:
            contents.note_lost_part(path, f"byte {error.offset}", str(error), contents.last_ns)
    else:
        if contents.contradicted:
            cause = "is declared twice, not alike: nothing says what its messages are"
            raise InputRefused(path, contents.contradicted[0], cause, "record again")
    if statistics is not None and statistics.channel_message_counts:
        stated = {k + shift: n for k, n in statistics.channel_message_counts.items() if n}
        held = {k: n for k, n in contents.counts.items() if before.get(k) != n}
        if stated != held:
            text = f"the summary counts {sum(stated.values())} messages, the file holds {sum(held.values())}"
            # only where the summary's own checksum holds are fewer messages than it counts a loss
            if not (vouched and sum(held.values()) < sum(stated.values())):
                contents.miscounted = text
            elif not contents.lost:
                contents.note_lost_part(path, "message counts", text)
    # channels that a lost chunk declared are known by the summary, which repeats them
    undeclared = sum(channel not in contents.channels for channel, _, _ in contents.messages)
    if undeclared:
        text = f"{undeclared} messages are of channels that are declared nowhere"
        contents.note_lost_part(path, "channels", text)
    wanted = {number for number, channel in contents.channels.items() if channel.topic in contents.topics}
    contents.messages = [m for m in contents.messages if m[0] in wanted]


def _enter_declaration(contents: McapContents, known: dict[int, Any], record: Any) -> None:
    """Add an MCAP schema or channel to `known` by its number; note in `contents` if another has that number."""
    if known.setdefault(record.id, record) != record:
        contents.contradicted.append(f"{type(record).__name__.lower()} {record.id % CHANNELS_PER_FILE}")


def _add_record(contents: McapContents, entry: McapEntry, shift: int) -> None:
    """Add an MCAP schema, channel or wanted message to `contents`, `shift` added to its numbers; ignore others."""
    record = entry.record
    if isinstance(record, kinds.Schema):
        _enter_declaration(contents, contents.schemas, replace(record, id=record.id + shift))
    elif isinstance(record, kinds.Channel):
        schema = record.schema_id and record.schema_id + shift  # 0 is none
        _enter_declaration(contents, contents.channels, replace(record, id=record.id + shift, schema_id=schema))
    elif isinstance(record, kinds.Message):
        number = record.channel_id + shift
        contents.counts[number] = contents.counts.get(number, 0) + 1
        contents.unverified += not entry.checksummed
        contents.last_ns = record.log_time
        channel = contents.channels.get(number)
        if channel is None or channel.topic in contents.topics:
            contents.messages.append((number, record.log_time, record.data))
