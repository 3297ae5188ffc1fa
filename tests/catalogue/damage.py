"""Rows 37 to 42 of the catalogue of bad input: damaged MCAP files."""

from __future__ import annotations

import os
import struct

from mcap.writer import CompressionType, IndexType, Writer

from catalogue.lab import NS0, Lab, Tries
from catalogue.rows import row


@row(37)
def _(lab: Lab) -> Tries:
    whole = lab.mcap().read_bytes()
    for share in (0.5, 0.99):
        (lab.folder / "cut.mcap").write_bytes(whole[: int(share * len(whole))])
        yield f"mcap: cut at {share:.0%}", lab.folder / "cut.mcap"
    (lab.folder / "cut.mcap").write_bytes(whole[:-8])
    yield "mcap: only the closing magic missing", lab.folder / "cut.mcap"
    (lab.folder / "cut.mcap").write_bytes(whole + b"\0" * 100)
    yield "mcap: 100 zero bytes after the end", lab.folder / "cut.mcap"
    (lab.folder / "cut.mcap").write_bytes(whole[: len(whole) // 2] + whole[-8:])
    yield "mcap: cut, but a magic at the end", lab.folder / "cut.mcap"


def chunks(data: bytes) -> list[tuple[int, int]]:

    o, found = 8, []
    while o < len(data) - 8:
        n = struct.unpack_from("<Q", data, o + 1)[0]
        if data[o] == 6:
            found.append((o, n))
        o += 9 + n
    return found


@row(38)
def _(lab: Lab) -> Tries:
    for compression in (CompressionType.ZSTD, CompressionType.NONE, CompressionType.LZ4):
        data = bytearray(lab.mcap(compression=compression).read_bytes())
        o, n = chunks(data)[len(chunks(data)) // 2]
        data[o + 9 + n // 2] ^= 0x10
        (lab.folder / "flip.mcap").write_bytes(data)
        yield f"mcap: 1 bit in a chunk, {compression.name}", lab.folder / "flip.mcap"
    data = bytearray(lab.mcap(use_chunking=False, enable_data_crcs=True).read_bytes())
    i = data.index(b".", data.index(b'"x": ', len(data) // 2)) + 1
    data[i : i + 1] = b"%d" % ((data[i] - 48 + 5) % 10)
    (lab.folder / "flip.mcap").write_bytes(data)
    yield "mcap: 1 digit, not chunked, data CRC there", lab.folder / "flip.mcap"
    data = bytearray(lab.mcap(index_types=IndexType.NONE, compression=CompressionType.NONE).read_bytes())
    i = data.index(b".", data.index(b'"x": ', len(data) // 2)) + 1
    data[i : i + 1] = b"%d" % ((data[i] - 48 + 5) % 10)
    (lab.folder / "flip.mcap").write_bytes(data)
    yield "mcap: digit changed, no chunk index, chunk CRC", lab.folder / "flip.mcap"
    data = bytearray(lab.mcap().read_bytes())

    summary = struct.unpack_from("<Q", data, len(data) - 8 - 20)[0]
    data[summary + 40] ^= 1
    (lab.folder / "flip.mcap").write_bytes(data)
    yield "mcap: 1 bit in the summary (summary CRC)", lab.folder / "flip.mcap"


@row(39)
def _(lab: Lab) -> Tries:
    yield "mcap: no CRCs", lab.mcap(enable_crcs=False)
    data = bytearray(lab.mcap(enable_crcs=False, compression=CompressionType.NONE).read_bytes())
    i = data.index(b".", data.index(b'"x": ', len(data) // 2)) + 1
    data[i : i + 1] = b"%d" % ((data[i] - 48 + 5) % 10)
    (lab.folder / "flip.mcap").write_bytes(data)
    yield "mcap: no CRCs, one digit changed", lab.folder / "flip.mcap"


@row(40)
def _(lab: Lab) -> Tries:

    data = bytearray(lab.mcap().read_bytes())
    summary = struct.unpack_from("<Q", data, len(data) - 8 - 20)[0]
    o = summary
    places: dict[int, list[int]] = {}
    while o < len(data) - 8:
        places.setdefault(data[o], []).append(o)
        o += 9 + struct.unpack_from("<Q", data, o + 1)[0]
    wrong = bytearray(data)
    struct.pack_into("<Q", wrong, places[11][0] + 9, 99999)
    (lab.folder / "stat.mcap").write_bytes(wrong)
    yield "mcap: Statistics say 99999 messages", lab.folder / "stat.mcap"
    wrong = bytearray(data)
    for k in places[8][2:4]:
        wrong[k] = 0x7F  # an unknown record: these chunks are in no index
    (lab.folder / "stat.mcap").write_bytes(wrong)
    yield f"mcap: 2 of {len(places[8])} chunks missing in the index", lab.folder / "stat.mcap"
    wrong = bytearray(data)
    struct.pack_into("<Q", wrong, places[8][2] + 25, struct.unpack_from("<Q", data, places[8][1] + 25)[0])
    (lab.folder / "stat.mcap").write_bytes(wrong)
    yield "mcap: an index entry points to another chunk", lab.folder / "stat.mcap"
    wrong = bytearray(data)
    struct.pack_into("<Q", wrong, places[8][2] + 25, 17)
    (lab.folder / "stat.mcap").write_bytes(wrong)
    yield "mcap: an index entry points nowhere", lab.folder / "stat.mcap"
    yield "mcap: no index", lab.mcap(index_types=IndexType.NONE)
    yield "mcap: no repeated channels", lab.mcap(repeat_channels=False, repeat_schemas=False)
    yield "mcap: no repeated schemas", lab.mcap(repeat_schemas=False)
    yield "mcap: no statistics", lab.mcap(use_statistics=False)
    yield "mcap: no summary offsets", lab.mcap(use_summary_offsets=False)
    yield "mcap: not chunked", lab.mcap(use_chunking=False)
    yield (
        "mcap: nothing of the summary",
        lab.mcap(
            index_types=IndexType.NONE,
            repeat_channels=False,
            repeat_schemas=False,
            use_statistics=False,
            use_summary_offsets=False,
        ),
    )


@row(41)
def _(lab: Lab) -> Tries:

    for label, size in (("too small", 10), ("too large", 2**40)):
        data = bytearray(lab.mcap().read_bytes())
        for o, _n in chunks(data):
            struct.pack_into("<Q", data, o + 9 + 16, size)
        (lab.folder / "lie.mcap").write_bytes(data)
        yield f"mcap: uncompressed_size {label} (zstd)", lab.folder / "lie.mcap"
    data = bytearray(lab.mcap(compression=CompressionType.LZ4).read_bytes())
    for o, _n in chunks(data):
        struct.pack_into("<Q", data, o + 9 + 16, 10)
    (lab.folder / "lie.mcap").write_bytes(data)
    yield "mcap: uncompressed_size 10 (lz4)", lab.folder / "lie.mcap"
    data = bytearray(lab.mcap().read_bytes())
    o, _n = chunks(data)[0]
    struct.pack_into("<Q", data, o + 1, 2**62)
    (lab.folder / "lie.mcap").write_bytes(data)
    yield "mcap: a chunk's record length 2^62", lab.folder / "lie.mcap"


@row(42)
def _(lab: Lab) -> Tries:
    big = bytes(60_000_000)

    def attach(w: Writer) -> None:
        w.add_attachment(NS0, NS0, "movie.mp4", "video/mp4", big)

    for label, how in (
        ("indexed", {}),
        ("no index", {"index_types": IndexType.NONE, "use_statistics": False, "repeat_channels": False}),
    ):
        path = lab.mcap(extra=attach, name="big", **how)
        yield f"mcap: 60 MB attachment, {label}", path
    image = [(NS0 + round(s * 1e9), os.urandom(200_000)) for s in lab.T[::12]]
    for label, how in (
        ("chunked with the rest", {"chunk_size": 1_000_000}),
        ("no index", {"index_types": IndexType.NONE, "use_statistics": False}),
    ):
        path = lab.mcap(
            others=(("/camera", "cdr", "sensor_msgs/msg/Image", b"", image),),
            name="big",
            compression=CompressionType.NONE,
            **how,
        )
        yield f"mcap: 30 MB of images, {label}", path
    (lab.folder / "big.mcap").unlink()
