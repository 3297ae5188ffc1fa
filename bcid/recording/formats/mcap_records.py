"""All records of an MCAP file in file order: every checksum checked, memory bounded, nothing lost in silence.

The mcap library's own reader follows the index, which a file may have or not, and checks what it meets on that way;
here the file is read from its first byte to its last.
"""

import struct
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import IO, NamedTuple

from mcap import records as kinds

from bcid.recording.formats.detect import MCAP_MAGIC
from bcid.recording.formats.limits import MCAP as LIMITS
from bcid.recording.formats.mcap_chunks import (
    ATTACHMENT,
    CHUNK,
    CHUNK_HEAD,
    FOOTER,
    MESSAGE,
    MESSAGE_INDEX,
    RECORD_HEAD,
    RECORD_TYPES,
    DamagedRecord,
    MessageBatch,
    largest_expansion,
    parse_record,
    scan_chunk,
    unpack_chunk,
)

SKIP_BLOCK_BYTES = 1 << 20


class McapEntry(NamedTuple):
    """A record of an MCAP file, some messages of a chunk, or the damage of a chunk in its place.

    Also, whether a chunk's checksum covers it.
    """

    record: kinds.McapRecord | MessageBatch | DamagedRecord
    checksummed: bool


def _check_declared_sizes(file: IO[bytes], end: int) -> None:
    """Raise `DamagedRecord` where an MCAP file of `end` bytes declares more decompressed content than is allowed."""
    most, total, offset = largest_expansion(end), 0, len(MCAP_MAGIC)
    while offset + RECORD_HEAD.size <= end:
        file.seek(offset)
        opcode, length = RECORD_HEAD.unpack(file.read(RECORD_HEAD.size))
        if opcode == CHUNK and length >= CHUNK_HEAD.size and offset + RECORD_HEAD.size + length <= end:
            total += CHUNK_HEAD.unpack(file.read(CHUNK_HEAD.size))[2]
        if total > most:
            cause = f"chunks up to here declare {total} bytes: {most} are the most of a file of {end}"
            raise DamagedRecord(offset, cause)
        offset += RECORD_HEAD.size + length


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
    """The records of an MCAP file as `iterate_entries` has them, but all messages one by one."""
    for entry in iterate_entries(path, attachments):
        if isinstance(entry.record, MessageBatch):
            yield from (McapEntry(message, entry.checksummed) for message in entry.record.messages())
        else:
            yield entry


def iterate_entries(path: Path, attachments: bool = False) -> Iterator[McapEntry]:
    """The records of an MCAP file in file order, also those in chunks; for an unreadable chunk its `DamagedRecord`.

    Attachments, which may be large, are skipped unless wanted, and so is the index of messages, which is not followed.

    Raises:
        DamagedRecord: the file cannot be read any further; the records before are good.
    """
    end = path.stat().st_size
    with path.open("rb") as file:
        if file.read(len(MCAP_MAGIC)) != MCAP_MAGIC:
            raise DamagedRecord(0, "is no MCAP file")
        _check_declared_sizes(file, end)
        file.seek(len(MCAP_MAGIC))
        running, offset, footer, messages = zlib.crc32(MCAP_MAGIC), len(MCAP_MAGIC), False, 0
        while not footer:
            head = _read_exactly(file, RECORD_HEAD.size, offset)
            opcode, length = RECORD_HEAD.unpack(head)
            if offset + RECORD_HEAD.size + length > end - len(MCAP_MAGIC):
                raise DamagedRecord(offset, "is cut: a record reaches beyond the file's end")
            before, crc = running, zlib.crc32(head, running)
            unread = opcode == MESSAGE_INDEX or (opcode == ATTACHMENT and not attachments)
            if opcode not in RECORD_TYPES or unread:
                running, body = _skip_with_checksum(file, length, offset, crc), b""
            elif length > (most := _most_bytes(opcode)):
                raise DamagedRecord(offset, f"a record of {length} bytes is longer than {most}")
            else:
                body = _read_exactly(file, length, offset)
                running = zlib.crc32(body, crc)
                stated = zlib.crc32(body[:16], crc) if opcode == FOOTER else before
                content, n = _open_record(opcode, body, offset, stated)
                messages += n
                if messages > max(LIMITS.free_messages, end):
                    raise DamagedRecord(offset, f"{messages} messages up to here are more than the file has bytes")
                for read in content:
                    yield read
                    footer = footer or isinstance(read.record, kinds.Footer)
                # after the data section, the summary has a checksum of its own
                running = 0 if RECORD_TYPES[opcode] is kinds.DataEnd else running
            offset += RECORD_HEAD.size + length
        if file.read() != MCAP_MAGIC:
            raise DamagedRecord(offset, "is cut, or something follows its end: the closing magic is not the last")


def _most_bytes(opcode: int) -> int:
    """The most bytes of an MCAP record of this kind: only chunks, messages and attachments are ever long."""
    return LIMITS.max_record_bytes if opcode in (CHUNK, MESSAGE, ATTACHMENT) else LIMITS.max_declaration_bytes


def _open_record(opcode: int, body: bytes, offset: int, crc: int) -> tuple[Iterable[McapEntry], int]:
    """The MCAP record in `body`, or those in it if it is a chunk, or its `DamagedRecord`; and the number of messages.

    `crc` is the CRC-32 of the file's section so far, with which that of a data end or a footer is compared.

    Raises:
        DamagedRecord: a record outside chunks cannot be read, or a checksum does not match.
    """
    record = parse_record(opcode, body, offset)
    if isinstance(record, kinds.Chunk):
        checksummed = bool(record.uncompressed_crc)
        try:
            content = scan_chunk(unpack_chunk(record, offset), offset)
        except DamagedRecord as error:
            return [McapEntry(DamagedRecord(offset, error.cause, record), checksummed)], 0
        messages = sum(len(part) for part in content if isinstance(part, MessageBatch))
        return [McapEntry(part, checksummed) for part in content], messages
    if isinstance(record, kinds.Attachment):
        n = 24 + len(record.name.encode()) + len(record.media_type.encode()) + 8 + len(record.data)
        (stated,) = struct.unpack_from("<I", body, n)
        if stated not in (0, zlib.crc32(body[:n])):
            raise DamagedRecord(offset, "an attachment's checksum does not match")
    if isinstance(record, kinds.DataEnd) and record.data_section_crc not in (0, crc):
        raise DamagedRecord(offset, "the data section's checksum does not match")
    if isinstance(record, kinds.Footer) and record.summary_crc not in (0, crc):
        raise DamagedRecord(offset, "the summary's checksum does not match")
    return [McapEntry(record, False)], int(opcode == MESSAGE)
