"""All records of an MCAP file in file order: every checksum checked, memory bounded, nothing lost in silence.

The mcap library's own reader follows the index, which a file may have or not, and checks what it meets on that way;
here the file is read from its first byte to its last, and only the layout of records is the library's.
"""

from __future__ import annotations

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

MAX_RECORD = 1 << 28  # bytes, of a record and of a chunk's content
SMALL, RATIO = 1 << 24, 300  # bytes that chunks may always unpack to, and by how much larger ones may grow
BLOCK = 1 << 20
HEAD = struct.Struct("<BQ")  # opcode and length
CHUNK_HEAD = struct.Struct("<QQQ")  # of a chunk: from, to, and how many bytes it unpacks to
KINDS = {
    1: kinds.Header, 2: kinds.Footer, 3: kinds.Schema, 4: kinds.Channel, 5: kinds.Message, 6: kinds.Chunk,
    7: kinds.MessageIndex, 8: kinds.ChunkIndex, 9: kinds.Attachment, 10: kinds.AttachmentIndex, 11: kinds.Statistics,
    12: kinds.Metadata, 13: kinds.MetadataIndex, 14: kinds.SummaryOffset, 15: kinds.DataEnd,
}  # fmt: skip
FOOTER, CHUNK, ATTACHMENT = 2, 6, 9
IN_CHUNK = (3, 4, 5)
EMPTY = (1, 11)  # kinds that may have no content


class Broken(Exception):
    """What is wrong at a byte of the file; `chunk` is the one that cannot be read, where the file goes on behind it."""

    def __init__(self, offset: int, cause: str, chunk: kinds.Chunk | None = None) -> None:
        super().__init__(f"byte {offset}: {cause}")
        self.offset, self.cause, self.chunk = offset, cause, chunk


class Read(NamedTuple):
    """A record, or in its place a chunk that cannot be read; and whether a checksum covers it."""

    record: kinds.McapRecord | Broken
    checked: bool


class _Body(ReadDataStream):
    """A record's body: the library's stream returns short reads as if they were whole."""

    def read(self, length: int) -> bytes:
        data: bytes = super().read(length)
        if len(data) != length:
            raise EOFError
        return data


def _record(opcode: int, body: bytes, offset: int) -> kinds.McapRecord:
    """The record in `body`; bytes behind its last field are allowed."""
    kind: Any = KINDS[opcode]
    try:
        stream = _Body(io.BytesIO(body))
        record: kinds.McapRecord = kind.read(stream, len(body)) if kind is kinds.Message else kind.read(stream)
        return record
    except (McapError, EOFError, struct.error, ValueError, OverflowError) as error:
        raise Broken(offset, f"a {kind.__name__} record cannot be read: {type(error).__name__}") from None


def _unpacked(chunk: kinds.Chunk, offset: int) -> bytes:
    """The chunk's content, never more than it declares and one byte."""
    size = chunk.uncompressed_size
    most = min(MAX_RECORD, max(SMALL, RATIO * len(chunk.data)))
    if size > most:
        raise Broken(offset, f"a chunk of {len(chunk.data)} bytes declares {size}: {most} are the most of so few")
    try:
        data = _decompressed(chunk, size + 1, offset)
    except (RuntimeError, EOFError, ValueError) as error:  # lz4 knows no better than RuntimeError
        raise Broken(offset, f"a chunk cannot be decompressed: {error}", chunk) from None
    if len(data) != size:
        holds = "more" if len(data) > size else str(len(data))
        raise Broken(offset, f"a chunk declares {size} bytes and holds {holds}", chunk)
    if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        raise Broken(offset, "a chunk's checksum does not match", chunk)
    return data


def _check_expansion(file: IO[bytes], end: int) -> None:
    """Raise `Broken` where chunks that may be small each declare more together than so short a file may hold."""
    most, total, offset = max(SMALL, RATIO * end), 0, len(MCAP_MAGIC)
    while offset + HEAD.size <= end:
        file.seek(offset)
        opcode, length = HEAD.unpack(file.read(HEAD.size))
        if opcode == CHUNK and length >= CHUNK_HEAD.size and offset + HEAD.size + length <= end:
            total += CHUNK_HEAD.unpack(file.read(CHUNK_HEAD.size))[2]
        if total > most:
            raise Broken(offset, f"chunks up to here declare {total} bytes: {most} are the most of a file of {end}")
        offset += HEAD.size + length


def _decompressed(chunk: kinds.Chunk, most: int, offset: int) -> bytes:
    if chunk.compression == "":
        return bytes(chunk.data)
    if chunk.compression == "lz4":
        import lz4.frame

        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=most))
    if chunk.compression == "zstd":
        import zstandard

        try:
            with zstandard.ZstdDecompressor(max_window_size=MAX_RECORD).stream_reader(chunk.data) as reader:
                return bytes(reader.read(most))
        except zstandard.ZstdError as error:
            raise ValueError(error) from None
    raise Broken(offset, f"chunk compression {chunk.compression!r} is not known: zstd, lz4 or none are read")


def _inside(data: bytes, offset: int) -> Iterator[kinds.McapRecord]:
    """The records in a chunk's content."""
    at = 0
    while at < len(data):
        opcode, length = HEAD.unpack_from(data, at) if at + HEAD.size <= len(data) else (0, len(data))
        body = data[at + HEAD.size : at + HEAD.size + length]
        if len(body) != length:
            raise Broken(offset, "a chunk ends inside a record")
        if opcode == 0:
            raise Broken(offset, "a chunk holds a record of kind 0")
        if opcode in IN_CHUNK:
            yield _record(opcode, body, offset)
        at += HEAD.size + length


def _exactly(file: IO[bytes], n: int, offset: int) -> bytes:
    data = file.read(n)
    if len(data) != n:
        raise Broken(offset, "the file ends inside a record")
    return data


def _skipped(file: IO[bytes], length: int, offset: int, crc: int) -> int:
    """The checksum behind `length` bytes that nobody keeps."""
    for n in [BLOCK] * (length // BLOCK) + [length % BLOCK]:
        crc = zlib.crc32(_exactly(file, n, offset), crc)
    return crc


def _check_attachment(record: kinds.Attachment, body: bytes, offset: int) -> None:
    n = 24 + len(record.name.encode()) + len(record.media_type.encode()) + 8 + len(record.data)
    (stated,) = struct.unpack_from("<I", body, n)
    if stated not in (0, zlib.crc32(body[:n])):
        raise Broken(offset, "an attachment's checksum does not match")


def records(path: Path, attachments: bool = False) -> Iterator[Read]:
    """Each record in turn, chunks opened; attachments are skipped unless wanted.

    A chunk that cannot be read comes as what is wrong with it, and the file goes on behind it.

    Raises:
        Broken: where the file cannot be followed any further; what came before stands.
    """
    end = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
            raise Broken(0, "is no MCAP file")
        _check_expansion(file, end)
        file.seek(len(MCAP_MAGIC))
        running, offset, footer = zlib.crc32(MCAP_MAGIC), len(MCAP_MAGIC), False
        while not footer:
            head = _exactly(file, HEAD.size, offset)
            opcode, length = HEAD.unpack(head)
            if offset + HEAD.size + length > end - len(MCAP_MAGIC):
                raise Broken(offset, "is cut: a record reaches beyond the file's end")
            before, crc = running, zlib.crc32(head, running)
            if opcode not in KINDS or (opcode == ATTACHMENT and not attachments):
                running, body = _skipped(file, length, offset, crc), b""
            elif length > MAX_RECORD:
                raise Broken(offset, f"a record of {length} bytes is longer than {MAX_RECORD}")
            else:
                body = _exactly(file, length, offset)
                running = zlib.crc32(body, crc)
                stated = zlib.crc32(body[:16], crc) if opcode == FOOTER else before
                for read in _opened(opcode, body, offset, stated):
                    yield read
                    footer = footer or isinstance(read.record, kinds.Footer)
                running = 0 if KINDS[opcode] is kinds.DataEnd else running  # from here on, of the summary
            offset += HEAD.size + length
        if file.read() != MCAP_MAGIC:
            raise Broken(offset, "is cut, or something follows its end: the closing magic is not the last")


def _opened(opcode: int, body: bytes, offset: int, crc: int) -> Iterator[Read]:
    """A record of the file's own level: itself or, of a chunk, what is in it; `crc` is of all that it vouches for."""
    record = _record(opcode, body, offset)
    if isinstance(record, kinds.Chunk):
        try:
            inside = list(_inside(_unpacked(record, offset), offset))
        except Broken as error:
            yield Read(Broken(offset, error.cause, record), bool(record.uncompressed_crc))
            return
        yield from (Read(r, bool(record.uncompressed_crc)) for r in inside)
        return
    if isinstance(record, kinds.Attachment):
        _check_attachment(record, body, offset)
    if isinstance(record, kinds.DataEnd) and record.data_section_crc not in (0, crc):
        raise Broken(offset, "the data section's checksum does not match")
    if isinstance(record, kinds.Footer) and record.summary_crc not in (0, crc):
        raise Broken(offset, "the summary's checksum does not match")
    yield Read(record, False)
