"""Single records of an MCAP file, and the chunks that hold many of them, compressed: sizes and checksums are checked.

Only the layout of records is the mcap library's.
"""

import io
import struct
import zlib
from collections.abc import Iterator
from typing import Any

from mcap import records as kinds
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError

from bcid.recording.formats.limits import MCAP as LIMITS

RECORD_HEAD = struct.Struct("<BQ")  # opcode and length
CHUNK_HEAD = struct.Struct("<QQQ")  # first time, last time, and bytes of the unpacked content
MESSAGE_HEAD = struct.Struct("<HIQQ")  # channel, sequence number, log time, publish time
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


def _iterate_chunk(data: bytes, offset: int) -> Iterator[tuple[int, int, int]]:
    """Opcode, and first and last byte, of each record in the decompressed bytes of the MCAP chunk at `offset`.

    Raises:
        DamagedRecord: the chunk ends inside a record, or holds a record of kind 0.
    """
    at, end = 0, len(data)
    while at < end:
        if at + RECORD_HEAD.size > end:
            raise DamagedRecord(offset, "a chunk ends inside a record")
        opcode, length = RECORD_HEAD.unpack_from(data, at)
        begin, at = at + RECORD_HEAD.size, at + RECORD_HEAD.size + length
        if at > end:
            raise DamagedRecord(offset, "a chunk ends inside a record")
        if opcode == 0:
            raise DamagedRecord(offset, "a chunk holds a record of kind 0")
        yield opcode, begin, at


def count_chunk_messages(data: bytes, offset: int) -> int:
    """The number of messages in the decompressed bytes of an MCAP chunk, all of whose records were found readable.

    Raises:
        DamagedRecord: a record in the chunk, which begins at the byte `offset`, cannot be read.
    """
    messages = 0
    for opcode, begin, end in _iterate_chunk(data, offset):
        if opcode in DECLARATIONS:
            if end - begin > LIMITS.max_declaration_bytes:
                most = f"{LIMITS.max_declaration_bytes} are the most"
                raise DamagedRecord(offset, f"a chunk declares a schema or channel of {end - begin} bytes: {most}")
            parse_record(opcode, data[begin:end], offset)
        elif opcode == MESSAGE:
            messages += 1
            if end - begin < MESSAGE_HEAD.size:
                raise DamagedRecord(offset, "a Message record cannot be read: it is too short")
    return messages


def parse_chunk_content(data: bytes, offset: int) -> Iterator[kinds.McapRecord]:
    """Yield the schemas, channels and messages in the decompressed bytes of the MCAP chunk at the byte `offset`."""
    for opcode, begin, end in _iterate_chunk(data, offset):
        if opcode == MESSAGE:
            channel, sequence, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(data, begin)
            yield kinds.Message(channel, log_ns, data[begin + MESSAGE_HEAD.size : end], publish_ns, sequence)
        elif opcode in DECLARATIONS:
            yield parse_record(opcode, data[begin:end], offset)
