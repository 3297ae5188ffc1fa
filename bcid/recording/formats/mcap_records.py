"""All records of an MCAP file in file order: every checksum checked, memory bounded, nothing lost in silence.

The mcap library's own reader follows the index, which a file may have or not, and checks what it meets on that way;
here the file is read from its first byte to its last, and only the layout of records is the library's.
"""

import io
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, NamedTuple

from mcap import records as kinds
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError

from bcid.recording.formats.detect import MCAP_MAGIC
from bcid.recording.limits import MCAP as LIMITS

SKIP_BLOCK_BYTES = 1 << 20
RECORD_HEAD = struct.Struct("<BQ")  # opcode and length
CHUNK_HEAD = struct.Struct("<QQQ")  # first time, last time, and bytes of the unpacked content
RECORD_TYPES = {
    1: kinds.Header, 2: kinds.Footer, 3: kinds.Schema, 4: kinds.Channel, 5: kinds.Message, 6: kinds.Chunk,
    7: kinds.MessageIndex, 8: kinds.ChunkIndex, 9: kinds.Attachment, 10: kinds.AttachmentIndex, 11: kinds.Statistics,
    12: kinds.Metadata, 13: kinds.MetadataIndex, 14: kinds.SummaryOffset, 15: kinds.DataEnd,
}  # fmt: skip
FOOTER, CHUNK, ATTACHMENT = 2, 6, 9
CHUNK_OPCODES = (3, 4, 5)


class DamagedRecord(Exception):
    """Damage at a byte of an MCAP file, and its cause; `chunk` is set where the file can be read on after it."""

    def __init__(self, offset: int, cause: str, chunk: kinds.Chunk | None = None) -> None:
        """Damage at the byte `offset`."""
        super().__init__(f"byte {offset}: {cause}")
        self.offset, self.cause, self.chunk = offset, cause, chunk


class McapEntry(NamedTuple):
    """A record of an MCAP file, or the damage of a chunk in its place; and whether a chunk's checksum covers it."""

    record: kinds.McapRecord | DamagedRecord
    checksummed: bool


class _ExactStream(ReadDataStream):
    """The body of a record, which raises `EOFError` where the library's stream returns fewer bytes than asked for."""

    def read(self, length: int) -> bytes:
        """The next `length` bytes."""
        data: bytes = super().read(length)
        if len(data) != length:
            raise EOFError
        return data


def _parse_record(opcode: int, body: bytes, offset: int) -> kinds.McapRecord:
    """The MCAP record of kind `opcode` in the bytes `body`; `DamagedRecord` at the byte `offset` if there is none."""
    kind: Any = RECORD_TYPES[opcode]
    try:
        stream = _ExactStream(io.BytesIO(body))
        record: kinds.McapRecord = kind.read(stream, len(body)) if kind is kinds.Message else kind.read(stream)
        return record
    except (McapError, EOFError, struct.error, ValueError, OverflowError) as error:
        raise DamagedRecord(offset, f"a {kind.__name__} record cannot be read: {type(error).__name__}") from None


def _unpack_chunk(chunk: kinds.Chunk, offset: int) -> bytes:
    """The decompressed content of the MCAP chunk at the byte `offset`.

    Raises:
        DamagedRecord: its size or checksum is not as declared, it grows beyond the limit, or cannot be decompressed.
    """
    size, packed = chunk.uncompressed_size, len(chunk.data)
    most = min(LIMITS.max_record_bytes, _largest_expansion(packed))
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


def _largest_expansion(size: int) -> int:
    """The most bytes that `size` compressed bytes may hold: LIMITS.max_expansion_factor times, or 16 MiB if more."""
    return max(LIMITS.free_expansion_bytes, LIMITS.max_expansion_factor * size)


def _check_declared_sizes(file: IO[bytes], end: int) -> None:
    """Raise `DamagedRecord` where an MCAP file of `end` bytes declares more decompressed content than is allowed."""
    most, total, offset = _largest_expansion(end), 0, len(MCAP_MAGIC)
    while offset + RECORD_HEAD.size <= end:
        file.seek(offset)
        opcode, length = RECORD_HEAD.unpack(file.read(RECORD_HEAD.size))
        if opcode == CHUNK and length >= CHUNK_HEAD.size and offset + RECORD_HEAD.size + length <= end:
            total += CHUNK_HEAD.unpack(file.read(CHUNK_HEAD.size))[2]
        if total > most:
            cause = f"chunks up to here declare {total} bytes: {most} are the most of a file of {end}"
            raise DamagedRecord(offset, cause)
        offset += RECORD_HEAD.size + length


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


def _parse_chunk_content(data: bytes, offset: int) -> Iterator[kinds.McapRecord]:
    """Yield the schemas, channels and messages in the decompressed bytes of the MCAP chunk at the byte `offset`."""
    at = 0
    while at < len(data):
        opcode, length = RECORD_HEAD.unpack_from(data, at) if at + RECORD_HEAD.size <= len(data) else (0, len(data))
        body = data[at + RECORD_HEAD.size : at + RECORD_HEAD.size + length]
        if len(body) != length:
            raise DamagedRecord(offset, "a chunk ends inside a record")
        if opcode == 0:
            raise DamagedRecord(offset, "a chunk holds a record of kind 0")
        if opcode in CHUNK_OPCODES:
            yield _parse_record(opcode, body, offset)
        at += RECORD_HEAD.size + length


def _read_exactly(file: IO[bytes], n: int, offset: int) -> bytes:
    """The next `n` bytes of the file; `DamagedRecord` at `offset`, where the record begins, if the file ends before."""
    data = file.read(n)
    if len(data) != n:
        raise DamagedRecord(offset, "the file ends inside a record")
    return data


def _skip_with_checksum(file: IO[bytes], length: int, offset: int, crc: int) -> int:
    """Read past the next `length` bytes of the file; returns the CRC-32 `crc` continued over them."""
    for n in [SKIP_BLOCK_BYTES] * (length // SKIP_BLOCK_BYTES) + [length % SKIP_BLOCK_BYTES]:
        crc = zlib.crc32(_read_exactly(file, n, offset), crc)
    return crc


def iterate_records(path: Path, attachments: bool = False) -> Iterator[McapEntry]:
    """The records of an MCAP file in file order, also those in chunks; for an unreadable chunk its `DamagedRecord`.

    Attachments, which may be large, are skipped unless wanted.

    Raises:
        DamagedRecord: the file cannot be read any further; the records before are good.
    """
    end = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
            raise DamagedRecord(0, "is no MCAP file")
        _check_declared_sizes(file, end)
        file.seek(len(MCAP_MAGIC))
        running, offset, footer = zlib.crc32(MCAP_MAGIC), len(MCAP_MAGIC), False
        while not footer:
            head = _read_exactly(file, RECORD_HEAD.size, offset)
            opcode, length = RECORD_HEAD.unpack(head)
            if offset + RECORD_HEAD.size + length > end - len(MCAP_MAGIC):
                raise DamagedRecord(offset, "is cut: a record reaches beyond the file's end")
            before, crc = running, zlib.crc32(head, running)
            if opcode not in RECORD_TYPES or (opcode == ATTACHMENT and not attachments):
                running, body = _skip_with_checksum(file, length, offset, crc), b""
            elif length > LIMITS.max_record_bytes:
                raise DamagedRecord(offset, f"a record of {length} bytes is longer than {LIMITS.max_record_bytes}")
            else:
                body = _read_exactly(file, length, offset)
                running = zlib.crc32(body, crc)
                stated = zlib.crc32(body[:16], crc) if opcode == FOOTER else before
                for read in _open_record(opcode, body, offset, stated):
                    yield read
                    footer = footer or isinstance(read.record, kinds.Footer)
                # after the data section, the summary has a checksum of its own
                running = 0 if RECORD_TYPES[opcode] is kinds.DataEnd else running
            offset += RECORD_HEAD.size + length
        if file.read() != MCAP_MAGIC:
            raise DamagedRecord(offset, "is cut, or something follows its end: the closing magic is not the last")


def _open_record(opcode: int, body: bytes, offset: int, crc: int) -> Iterator[McapEntry]:
    """Yield the MCAP record in `body`; for a chunk the records in it, or its `DamagedRecord` if it is unreadable.

    `crc` is the CRC-32 of the file's section so far, with which that of a data end or a footer is compared.

    Raises:
        DamagedRecord: a record outside chunks cannot be read, or a checksum does not match.
    """
    record = _parse_record(opcode, body, offset)
    if isinstance(record, kinds.Chunk):
        try:
            inside = list(_parse_chunk_content(_unpack_chunk(record, offset), offset))
        except DamagedRecord as error:
            yield McapEntry(DamagedRecord(offset, error.cause, record), bool(record.uncompressed_crc))
            return
        yield from (McapEntry(r, bool(record.uncompressed_crc)) for r in inside)
        return
    if isinstance(record, kinds.Attachment):
        n = 24 + len(record.name.encode()) + len(record.media_type.encode()) + 8 + len(record.data)
        (stated,) = struct.unpack_from("<I", body, n)
        if stated not in (0, zlib.crc32(body[:n])):
            raise DamagedRecord(offset, "an attachment's checksum does not match")
    if isinstance(record, kinds.DataEnd) and record.data_section_crc not in (0, crc):
        raise DamagedRecord(offset, "the data section's checksum does not match")
    if isinstance(record, kinds.Footer) and record.summary_crc not in (0, crc):
        raise DamagedRecord(offset, "the summary's checksum does not match")
    yield McapEntry(record, False)
