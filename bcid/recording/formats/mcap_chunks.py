"""Single records of an MCAP file, and the chunks that hold many of them, compressed: sizes and checksums are checked.

Only the layout of records is the mcap library's.
"""

import io
import struct
import zlib
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from mcap import records as kinds
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError

from bcid.aliases import Ints
from bcid.recording.formats.limits import MCAP as LIMITS

RECORD_HEAD = struct.Struct("<BQ")  # opcode and length
CHUNK_HEAD = struct.Struct("<QQQ")  # first time, last time, and bytes of the unpacked content
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence number, log time, publish time
MESSAGE_HEAD_TYPE = np.dtype([("channel", "<u2"), ("sequence", "<u4"), ("log_ns", "<u8"), ("publish_ns", "<u8")])
RECORD_TYPES = {
    1: kinds.Header, 2: kinds.Footer, 3: kinds.Schema, 4: kinds.Channel, 5: kinds.Message, 6: kinds.Chunk,
    7: kinds.MessageIndex, 8: kinds.ChunkIndex, 9: kinds.Attachment, 10: kinds.AttachmentIndex, 11: kinds.Statistics,
    12: kinds.Metadata, 13: kinds.MetadataIndex, 14: kinds.SummaryOffset, 15: kinds.DataEnd,
}  # fmt: skip
FOOTER, MESSAGE, CHUNK, MESSAGE_INDEX, ATTACHMENT = 2, 5, 6, 7, 9
DECLARATIONS = (3, 4)  # schemas and channels


class DamagedRecord(Exception):
    """Damage at a byte of an MCAP file, and its cause; `chunk` is set where the file can be read on after it."""

    def __init__(self, offset: int, cause: str, chunk: kinds.Chunk | None = None) -> None:
        """Damage at the byte `offset`."""
        super().__init__(f"byte {offset}: {cause}")
        self.offset, self.cause, self.chunk = offset, cause, chunk


class _ExactStream(ReadDataStream):
    """The body of a record, which raises `EOFError` where the library's stream returns fewer bytes than asked for."""

    def read(self, length: int) -> bytes:
        """The next `length` bytes."""
        data: bytes = super().read(length)
        if len(data) != length:
            raise EOFError
        return data


def parse_record(opcode: int, body: bytes, offset: int) -> kinds.McapRecord:
    """The MCAP record of kind `opcode` in the bytes `body`; `DamagedRecord` at the byte `offset` if there is none."""
    kind: Any = RECORD_TYPES[opcode]
    try:
        stream = _ExactStream(io.BytesIO(body))
        record: kinds.McapRecord = kind.read(stream, len(body)) if kind is kinds.Message else kind.read(stream)
        return record
    except (McapError, EOFError, struct.error, ValueError, OverflowError) as error:
        raise DamagedRecord(offset, f"a {kind.__name__} record cannot be read: {type(error).__name__}") from None


def unpack_chunk(chunk: kinds.Chunk, offset: int) -> bytes:
    """The decompressed content of the MCAP chunk at the byte `offset`.

    Raises:
        DamagedRecord: its size or checksum is not as declared, it grows beyond the limit, or cannot be decompressed.
    """
    size, packed = chunk.uncompressed_size, len(chunk.data)
    most = min(LIMITS.max_record_bytes, largest_expansion(packed))
    if size > most:
        raise DamagedRecord(offset, f"a chunk of {packed} bytes declares {size}: {most} are the most of so few")
    # one byte more than declared shows a chunk that holds more; lz4 raises RuntimeError
    try:
        data = _decompress(chunk, size + 1, offset)
    except (RuntimeError, EOFError, ValueError) as error:
        raise DamagedRecord(offset, f"a chunk cannot be decompressed: {error}", chunk) from None
    if len(data) != size:
        holds = "more" if len(data) > size else str(len(data))
        raise DamagedRecord(offset, f"a chunk declares {size} bytes and holds {holds}", chunk)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise DamagedRecord(offset, "a chunk's checksum does not match", chunk)
    return data


def largest_expansion(size: int) -> int:
    """The most bytes that `size` compressed bytes may hold: LIMITS.max_expansion_factor times, or 16 MiB if more."""
    return max(LIMITS.free_expansion_bytes, LIMITS.max_expansion_factor * size)


def _decompress(chunk: kinds.Chunk, most: int, offset: int) -> bytes:
    """The first `most` bytes of an MCAP chunk, decompressed; `DamagedRecord` if it is neither zstd, lz4 nor plain."""
    if chunk.compression == "":
        return bytes(chunk.data)
    if chunk.compression == "lz4":
        import lz4.frame

        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=most))
    if chunk.compression == "zstd":
        import zstandard

        try:
            unpacker = zstandard.ZstdDecompressor(max_window_size=LIMITS.max_record_bytes)
            with unpacker.stream_reader(chunk.data) as reader:
                return bytes(reader.read(most))
        except zstandard.ZstdError as error:
            raise ValueError(error) from None
    raise DamagedRecord(offset, f"chunk compression {chunk.compression!r} is not known: zstd, lz4 or none are read")


class MessageBatch(NamedTuple):
    """N messages that follow each other in a chunk: their channels, log times (ns) and places in its bytes."""

    data: bytes
    channels: Ints
    log_ns: Ints
    begins: list[int]
    ends: list[int]

    def __len__(self) -> int:
        """The number of messages, N."""
        return len(self.begins)

    def contents(self, rows: Ints | None = None) -> list[bytes]:
        """The bytes of all messages, or of those at `rows`, heads aside."""
        every = range(len(self.begins)) if rows is None else rows.tolist()
        data, begins, ends, head = self.data, self.begins, self.ends, MESSAGE_HEAD.size
        return [data[begins[k] + head : ends[k]] for k in every]

    def messages(self) -> Iterator[kinds.Message]:
        """The messages one by one, as records of the mcap library."""
        for begin, data in zip(self.begins, self.contents(), strict=True):
            channel, sequence, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(self.data, begin)
            yield kinds.Message(channel, log_ns, data, publish_ns, sequence)


def scan_chunk(data: bytes, offset: int) -> list[kinds.McapRecord | MessageBatch]:
    """The schemas and channels in the decompressed bytes of an MCAP chunk, and its messages between them, in order.

    All records are found readable before any is returned.

    Raises:
        DamagedRecord: the chunk, which begins at the byte `offset`, ends inside a record, or a record cannot be read.
    """
    found: list[kinds.McapRecord | MessageBatch] = []
    begins, ends = list[int](), list[int]()
    unpack, head, end, at = RECORD_HEAD.unpack_from, RECORD_HEAD.size, len(data), 0
    while at < end:
        if at + head > end:
            raise DamagedRecord(offset, "a chunk ends inside a record")
        opcode, length = unpack(data, at)
        begin = at + head
        at = begin + length
        if at > end:
            raise DamagedRecord(offset, "a chunk ends inside a record")
        if opcode == MESSAGE:
            if length < MESSAGE_HEAD.size:
                raise DamagedRecord(offset, "a Message record cannot be read: it is too short")
            begins.append(begin)
            ends.append(at)
        elif opcode == 0:
            raise DamagedRecord(offset, "a chunk holds a record of kind 0")
        elif opcode in DECLARATIONS:
            if length > LIMITS.max_declaration_bytes:
                most = f"{LIMITS.max_declaration_bytes} are the most"
                raise DamagedRecord(offset, f"a chunk declares a schema or channel of {length} bytes: {most}")
            if begins:
                found.append(_batch(data, begins, ends))
                begins, ends = [], []
            found.append(parse_record(opcode, data[begin:at], offset))
    return [*found, _batch(data, begins, ends)] if begins else found


def _batch(data: bytes, begins: list[int], ends: list[int]) -> MessageBatch:
    """The messages between these bytes of a chunk, with what their heads say."""
    rows = np.array(begins)
    every = np.frombuffer(data, dtype=np.uint8)
    heads = every[rows[:, None] + np.arange(MESSAGE_HEAD.size)].view(MESSAGE_HEAD_TYPE)[:, 0]
    return MessageBatch(data, heads["channel"].astype(np.int64), heads["log_ns"], begins, ends)
