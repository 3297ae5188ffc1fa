"""The contents of an MCAP file on the wanted topics, and how far they are complete and covered by checksums."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from mcap import records as kinds

from bcid.aliases import Bools, Ints
from bcid.errors import InputRefused
from bcid.recording.formats.detect import recording_files
from bcid.recording.formats.fixed_layout import FixedLayout
from bcid.recording.formats.limits import MCAP, MESSAGE
from bcid.recording.formats.mcap_chunks import DamagedRecord, MessageBatch
from bcid.recording.formats.mcap_part import LoggedPart, TooManyMessages
from bcid.recording.formats.mcap_records import McapEntry, iterate_entries
from bcid.recording.formats.message_decoding import fixed_layout, message_decoder
from bcid.recording.formats.message_fields import MissingField, NotANumber
from bcid.recording.formats.message_stamps import UnreadableStamp
from bcid.recording.formats.message_store import MessageStore, StoredMessages
from bcid.recording.formats.names import describe_error, printable_name
from bcid.recording.formats.rosbag import describe_odd_parts, unread_parts
from bcid.recording.formats.transforms import STATIC_TOPIC
from bcid.recording.types import Irregularity

RECORD_AGAIN = "record again, or keep what is whole with --allow-partial"
CHANNELS_PER_FILE = 1 << 16  # channels are numbered below it
NAME_FIELDS = "name the fields in [topics.pose_fields] or [topics.command_fields]"

T = TypeVar("T")


@dataclass
class McapContents:
    """What is read from an MCAP file, or from all parts of a split bag."""

    path: Path
    topics: Collection[str]  # that are wanted
    allow_partial: bool  # whether parts may be lost
    file_bytes: int  # of all parts
    pose_topic: str = ""
    part: LoggedPart | None = None  # which messages are kept; None for all
    schemas: dict[int, kinds.Schema] = field(default_factory=dict)
    channels: dict[int, kinds.Channel] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)  # messages found, by channel
    messages: MessageStore = field(default_factory=MessageStore)  # of the wanted topics
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

    def read_messages(self, topic: str, read: Callable[[Any], T]) -> Iterator[tuple[int, T]]:
        """The log time (ns) of each of a topic's messages, and what `read` takes from its decoded content.

        Messages that cannot be decoded, or that lack a field, are left out and noted where parts may be lost.

        Raises:
            InputRefused: a message cannot be read, or none can where parts may be lost.
        """
        stored = self.stored_messages(topic)
        log_ns = stored.log_ns
        for row, message in self.read_rows(topic, stored, np.arange(len(log_ns)), read):
            yield int(log_ns[row]), message

    def stored_messages(self, topic: str) -> StoredMessages:
        """A topic's messages in file order, as they were sent."""
        return self.messages.of_channels({c.id for c in self.published_channels(topic)})

    def fixed_layout(self, topic: str, stored: StoredMessages, row: int) -> FixedLayout | None:
        """The layout of one of a topic's messages, if others may share it; None where it cannot be decoded."""
        channel = self.channels[int(stored.channels[row])]
        return fixed_layout(channel, self.schemas.get(channel.schema_id), stored.data(row))

    def read_rows(
        self, topic: str, stored: StoredMessages, rows: Ints, read: Callable[[Any], T]
    ) -> Iterator[tuple[int, T]]:  # fmt: skip
        """The numbers of those of a topic's messages that are in `rows`, in order, and what `read` takes from each.

        All messages of the topic are `stored`, and those that are not in `rows` can be read.

        Raises:
            InputRefused: a message cannot be read, or none can where parts may be lost.
        """
        channels = self.published_channels(topic)
        decoders = {c.id: message_decoder(c, self.schemas.get(c.schema_id), self.path) for c in channels}
        broken, first = 0, None
        for row in rows.tolist():
            channel, log_ns = int(stored.channels[row]), int(stored.log_ns[row])
            try:
                if (size := int(stored.ends[row] - stored.begins[row])) > MESSAGE.max_message_bytes:
                    raise ValueError(f"it has {size} bytes, {MESSAGE.max_message_bytes} are the most")
                message = read(decoders[channel](stored.data(row)))
            except (InputRefused, MemoryError):
                raise
            except Exception as error:  # whatever decoders raise on content that nobody vouches for
                refused = self._refuse_message(topic, row + 1, log_ns, error)
                if not self.allow_partial:
                    raise refused from error
                broken, first = broken + 1, first or refused
                continue
            yield row, message
        number = len(stored.begins)
        if first is not None and broken == number:
            raise first
        if first is not None:
            text = f"{broken} of {number} messages cannot be read; the first, {first.place}: {first.cause}"
            self.lost.append(Irregularity("lost", "excluded", broken, f"topic {printable_name(topic)}", text))

    def _refuse_message(self, topic: str, number: int, log_ns: int, error: Exception) -> InputRefused:
        """The refusal of the message of this number on a topic, whose decoding raised `error`."""
        place = f"topic {printable_name(topic)}, message {number} (logged at {log_ns / 1e9:.3f} s)"
        if isinstance(error, UnreadableStamp):
            return InputRefused(self.path, place, str(error), 'correct the stamps, or set topics.time = "log"')
        if isinstance(error, NotANumber):
            return InputRefused(self.path, place, str(error), "map a field of numbers, or log 0 and 1")
        if isinstance(error, MissingField):
            return InputRefused(self.path, place, str(error), NAME_FIELDS)
        cause = f"cannot be decoded: {describe_error(error)}"
        return InputRefused(self.path, place, cause, f"check the type's definition; {RECORD_AGAIN}")

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
        odd += [Irregularity("split bag", "warning", 1, name, text) for text in describe_odd_parts(self.path)]
        return [*odd, *self.lost]


def read_contents(
    path: Path, topics: Collection[str], allow_partial: bool, pose_topic: str = "", part: LoggedPart | None = None
) -> McapContents:  # fmt: skip
    """The messages on the wanted topics of an MCAP file or of a split bag's folder, with their channels and schemas.

    With `allow_partial`, parts that cannot be read are left out and noted as lost.  Where a `part` is given, all of the
    file is verified and only messages of that part are held; it begins with the first message on the `pose_topic`.

    Raises:
        InputRefused: a checksum does not match or the file is cut, with the byte, where no part may be lost.
        TooManyMessages: there are more than are held at once.
    """
    files = recording_files(path)
    size = sum(file.stat().st_size for file in files)
    contents = McapContents(path, topics, allow_partial, size, pose_topic, part)
    for file, cause, step in unread_parts(path):
        if not allow_partial:
            raise InputRefused(file, "file", cause, step)
        text = f"{printable_name(file.name)} {cause}"
        contents.lost.append(Irregularity("lost", "excluded", 1, printable_name(file.name), text))
    for i, file in enumerate(files):
        _read_part(contents, file, i * CHANNELS_PER_FILE)
    return contents


def _read_part(contents: McapContents, path: Path, shift: int) -> None:
    """Add the wanted messages of one MCAP file to `contents`, and note as lost what of the file cannot be read.

    `shift` is added to the file's numbers of channels and schemas, to keep apart those of a bag's other parts.
    """
    before, unverified, statistics, vouched, indexed = dict(contents.counts), contents.unverified, None, False, False
    try:
        for entry in iterate_entries(path):
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
    undeclared = contents.messages.channels - contents.channels.keys()
    if undeclared:
        text = f"{sum(contents.counts[c] for c in undeclared)} messages are of channels that are declared nowhere"
        contents.note_lost_part(path, "channels", text)
    contents.messages.keep({n for n, channel in contents.channels.items() if channel.topic in contents.topics})


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
        channel = replace(record, id=record.id + shift, schema_id=schema, metadata={})
        _enter_declaration(contents, contents.channels, channel)
    elif isinstance(record, kinds.Message):
        number = record.channel_id + shift
        contents.counts[number] = contents.counts.get(number, 0) + 1
        contents.unverified += not entry.checksummed
        contents.last_ns = record.log_time
        if _may_be_wanted(contents, number) and _of_part(contents, np.array([number]), np.array([record.log_time]))[0]:
            contents.messages.add(number, record.log_time, record.data)
            _check_size(contents)
    elif isinstance(record, MessageBatch):
        numbers = record.channels + shift
        for number, count in zip(*(x.tolist() for x in np.unique(numbers, return_counts=True)), strict=True):
            contents.counts[number] = contents.counts.get(number, 0) + count
        contents.unverified += 0 if entry.checksummed else len(record)
        contents.last_ns = int(record.log_ns[-1])
        wanted = [number for number in np.unique(numbers).tolist() if _may_be_wanted(contents, number)]
        rows = np.flatnonzero(np.isin(numbers, wanted))
        rows = rows[_of_part(contents, numbers[rows], record.log_ns[rows])]
        contents.messages.add_all(numbers[rows], record.log_ns[rows], record.contents(rows))
        _check_size(contents)


def _may_be_wanted(contents: McapContents, number: int) -> bool:
    """Whether messages of the channel of this number are of a wanted topic, as far as that is declared yet."""
    known = contents.channels.get(number)
    return known is None or known.topic in contents.topics


def _of_part(contents: McapContents, numbers: Ints, log_ns: Ints) -> Bools:
    """Mask (N,) of the messages of these channels and log times (ns) that are held: all where no part is asked for.

    Static transforms hold throughout, whenever they were sent.
    """
    if contents.part is None:
        return np.ones(len(numbers), dtype=bool)
    topics = {n: c.topic if (c := contents.channels.get(n)) else "" for n in np.unique(numbers).tolist()}
    is_pose, is_static = (
        np.isin(numbers, [n for n, topic in topics.items() if topic == wanted])
        for wanted in (contents.pose_topic, STATIC_TOPIC)
    )
    return np.asarray(contents.part.keep(log_ns, is_pose) | is_static)


def _check_size(contents: McapContents) -> None:
    """Raise `TooManyMessages` where more is held of the wanted topics than of any recording of that size."""
    most = min(MCAP.max_content_bytes, max(MCAP.free_content_bytes, MCAP.max_content_factor * contents.file_bytes))
    if len(contents.messages) > MCAP.max_messages or contents.messages.content_bytes > most:
        cause = f"hold more than {MCAP.max_messages} messages, or than {most} bytes, the most of such a file"
        step = f"read it in parts, such as {contents.path.name}[0:3600], or cut the recording into takes"
        raise TooManyMessages(contents.path, "topics", cause, step)
