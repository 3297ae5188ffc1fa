"""MCAP files read from end to end: checksums, salvage, bombs, and the format's own conformance suite."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from faults.counting import bomb, conformance, costs, small_bombs, with_chunk
from mcap.reader import NonSeekingReader
from mcap.records import Channel, Message, Schema
from mcap.writer import CompressionType, Writer
from typer.testing import CliRunner

from bcid.cli.app import app
from bcid.errors import InputRefused, PartLost
from bcid.recording.formats.detect import MCAP_MAGIC
from bcid.recording.formats.mcap_chunks import DamagedRecord
from bcid.recording.formats.mcap_contents import read_contents
from bcid.recording.formats.mcap_records import iterate_records
from bcid.recording.read import read_raw_take
from bcid.vehicle import Vehicle

WAYS: dict[str, dict[str, Any]] = {
    "zstd": {"compression": CompressionType.ZSTD}, "lz4": {"compression": CompressionType.LZ4},
    "none": {"compression": CompressionType.NONE},
    "unchunked": {"use_chunking": False, "enable_data_crcs": True},
    "without index": {"use_summary_offsets": False, "use_statistics": False, "index_types": 0},
}  # fmt: skip


def rewritten(source: Path, path: Path, seconds: float = 600.0, **ways: Any) -> Path:
    """The take's first seconds written anew."""
    if "index_types" in ways:
        from mcap.writer import IndexType

        ways["index_types"] = IndexType(ways["index_types"])
    with source.open("rb") as file, path.open("wb") as out:
        writer, ids, first = Writer(out, chunk_size=20_000, **ways), dict[int, int](), None
        writer.start()
        for schema, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
            first = message.log_time if first is None else first
            if message.log_time > first + seconds * 1e9:
                continue
            if channel.id not in ids:
                assert schema is not None
                new = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, new)
            writer.add_message(ids[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


@pytest.mark.parametrize("way", list(WAYS))
def test_every_way_of_writing_reads_the_same(
    way: str, takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path
) -> None:
    whole = read_raw_take(takes["mcap"], vehicle)
    again = read_raw_take(rewritten(takes["mcap"], tmp_path / "t.mcap", **WAYS[way]), vehicle)
    np.testing.assert_array_equal(again.pose, whole.pose)
    np.testing.assert_array_equal(again.command, whole.command)
    assert again.irregularities == ()


def test_a_file_without_checksums_is_read_and_told(takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    path = rewritten(takes["mcap"], tmp_path / "t.mcap", enable_crcs=False)
    (odd,) = read_raw_take(path, vehicle).irregularities
    assert (odd.kind, odd.action) == ("integrity", "warning")
    assert "not verifiable" in odd.detail


@pytest.mark.parametrize("way", list(WAYS))
def test_no_flipped_bit_and_no_cut_is_silent(way: str, takes: dict[str, Path], tmp_path: Path) -> None:
    """Refused, told as a broken chunk, or the same messages; an index is not followed and may say what it likes."""

    def used() -> list[Any]:
        return [
            r.record for r in iterate_records(path) if isinstance(r.record, Schema | Channel | Message | DamagedRecord)
        ]

    path = rewritten(takes["mcap"], tmp_path / "t.mcap", seconds=3.0, **WAYS[way])
    whole, good = path.read_bytes(), used()
    rng = np.random.default_rng(1)
    for at in rng.integers(0, len(whole), 250):
        flipped = bytearray(whole)
        flipped[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(flipped)
        try:
            found = used()
        except DamagedRecord:
            continue
        assert found == good or any(isinstance(r, DamagedRecord) for r in found), at
    for end in rng.integers(0, len(whole), 60):
        path.write_bytes(whole[:end])
        with pytest.raises(DamagedRecord):
            list(iterate_records(path))


def broken_at(share: float, source: Path, path: Path, **ways: Any) -> Path:
    """One chunk's content changed, so far into the file; its checksum stands."""
    rewritten(source, path, compression=CompressionType.NONE, **ways)
    data = bytearray(path.read_bytes())
    at = data.index(b'"position"', int(share * len(data)))
    data[at : at + 10] = b'"positiom"'
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_a_broken_chunk_is_refused_or_left_out_as_told(
    share: float, takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path
) -> None:
    """Also the first one, where the channels are declared: the summary repeats them."""
    path = broken_at(share, takes["mcap"], tmp_path / "t.mcap")
    with pytest.raises(InputRefused, match=r"byte \d+: a chunk's checksum does not match") as told:
        read_raw_take(path, vehicle)
    assert "--allow-partial" in str(told.value)
    part, whole = read_raw_take(path, vehicle, allow_partial=True), read_raw_take(takes["mcap"], vehicle)
    (odd,) = part.irregularities
    assert (odd.kind, odd.action) == ("lost", "excluded")
    assert "checksum" in odd.detail
    assert 0 < len(whole.pose) - len(part.pose) < 0.1 * len(whole.pose)
    assert set(map(tuple, part.pose)) < set(map(tuple, whole.pose))


def test_messages_whose_channels_are_lost_are_told(takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    path = broken_at(0.0, takes["mcap"], tmp_path / "t.mcap", repeat_channels=False)
    with pytest.raises(InputRefused, match="which has no channels"):
        read_raw_take(path, vehicle, allow_partial=True)
    found = read_contents(path, ("/mocap/bumper_car/pose",), allow_partial=True)
    assert len(found.lost) == 2
    assert "messages are of channels that are declared nowhere" in found.lost[1].detail
    assert len(found.messages) == 0


def test_channels_that_are_declared_twice_and_not_alike_are_refused(
    takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path
) -> None:
    path = rewritten(takes["mcap"], tmp_path / "t.mcap", compression=CompressionType.NONE, enable_crcs=False)
    data = path.read_bytes()
    at = data.index(b"/bumper_car/command")  # in the first chunk; the summary says it again
    assert data.count(b"/bumper_car/command") > 1
    path.write_bytes(data[:at] + b"/bumper_car/commanD" + data[at + 19 :])
    for partial in (False, True):
        with pytest.raises(InputRefused, match=r"channel \d+: is declared twice, not alike"):
            read_raw_take(path, vehicle, partial)


def test_a_cut_file_is_refused_or_read_to_the_cut(takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    path = rewritten(takes["mcap"], tmp_path / "t.mcap")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(InputRefused, match="is cut"):
        read_raw_take(path, vehicle)
    part, whole = read_raw_take(path, vehicle, allow_partial=True), read_raw_take(takes["mcap"], vehicle)
    assert [i.kind for i in part.irregularities] == ["lost"]
    assert 0.2 * len(whole.pose) < len(part.pose) < 0.8 * len(whole.pose)
    np.testing.assert_array_equal(part.pose, whole.pose[: len(part.pose)])
    path.write_bytes(MCAP_MAGIC)
    with pytest.raises(InputRefused):
        read_raw_take(path, vehicle, allow_partial=True)


def test_what_is_lost_ends_with_exit_code_3(takes: dict[str, Path], vehicle_file: Path, tmp_path: Path) -> None:
    path = broken_at(0.5, takes["mcap"], tmp_path / "t.mcap")
    words = ["ingest", str(path), "--vehicle", str(vehicle_file), "--out", str(tmp_path / "w"), "--format", "json"]
    refused = CliRunner().invoke(app, words)
    assert isinstance(refused.exception, InputRefused)
    done = CliRunner().invoke(app, [*words, "--allow-partial"])
    assert isinstance(done.exception, PartLost)
    assert done.exception.exit_code == 3
    kinds = [i["kind"] for i in json.loads(done.stdout)["recordings"][0]["irregularities"]]
    assert "lost" in kinds


@pytest.mark.parametrize("kind", ["says so", "lies", "small ones"])
def test_a_bomb_is_refused_before_it_goes_off(kind: str, vehicle: Vehicle, tmp_path: Path) -> None:
    """A few kilobytes that expand to gibibytes, whether the chunk says so or lies, or many small chunks together."""
    pytest.importorskip("resource", reason="memory is measured as POSIX does")
    path = tmp_path / "bomb.mcap"
    small_bombs(path) if kind == "small ones" else bomb(path, 3 << 30 if kind == "says so" else 1000)
    with pytest.raises(InputRefused, match="declare"):
        read_raw_take(path, vehicle, allow_partial=kind == "small ones")
    found = costs(path)
    assert found["bytes"] < 200_000
    assert found["refused"]
    assert found["seconds"] < 1.0
    assert found["mib"] < 300.0


def test_what_no_one_can_decompress_is_named(vehicle: Vehicle, tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match="compression 'brotli' is not known"):
        read_raw_take(with_chunk(tmp_path / "t.mcap", b"x", 1, "brotli"), vehicle)


def test_counts_that_do_not_add_up_are_told(takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    path = rewritten(takes["mcap"], tmp_path / "t.mcap", enable_crcs=False)
    data = bytearray(path.read_bytes())
    counted = sum(1 for r in iterate_records(path) if type(r.record).__name__ == "Message")
    at = data.rindex(struct.pack("<Q", counted))
    data[at : at + 8] = struct.pack("<Q", counted + 5)
    single = data.rindex(struct.pack("<Q", len(read_raw_take(takes["mcap"], vehicle).pose)))
    data[single : single + 8] = struct.pack("<Q", 99_999)
    path.write_bytes(data)
    told = {i.kind: i.detail for i in read_raw_take(path, vehicle).irregularities}
    assert "message counts" in told


def test_the_conformance_suite_reads_as_described(recordings_folder: Path) -> None:
    assert conformance(recordings_folder / "mcap" / "conformance") == {"files": 416, "as_described": 416}
