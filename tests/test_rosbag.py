"""The folder of a ROS 2 bag: what its metadata.yaml names is the recording, and nothing else."""

from __future__ import annotations

import sqlite3
import time
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from test_pose_messages import COMMANDS, POSE, TIME, car, header, pose
from test_readers import json_mcap

from bcid.errors import InputRefused
from bcid.recording.formats.detect import recording_files
from bcid.recording.formats.limits import MESSAGE
from bcid.recording.formats.rosbag import parse_file_list, read_bag_folder
from bcid.recording.read import read_raw_take
from bcid.vehicle import Vehicle

HEAD = "rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: mcap\n"


def part(path: Path, first: float = 0.0, last: float = 60.0) -> Path:
    """Some seconds of a drive."""
    poses = [(t, {**header(t), "pose": pose(row)}) for t, row in zip(TIME, POSE, strict=True) if first <= t < last]
    commands = [(t, m) for t, m in COMMANDS if first <= t < last]
    return json_mcap(path, {"/pose": ("geometry_msgs/PoseStamped", poses), "/command": ("own", commands)})


def bag(folder: Path, names: list[str], listed: list[str] | None = None) -> Path:
    """A bag of these parts, the drive cut evenly, whose metadata.yaml lists them or others."""
    folder.mkdir()
    for k, name in enumerate(names):
        part(folder / name, 10.0 * k / len(names), 10.0 * (k + 1) / len(names))
    lines = "".join(f"    - {name}\n" for name in (names if listed is None else listed))
    (folder / "metadata.yaml").write_text(f"{HEAD}  relative_file_paths:\n{lines}  files: []\n")
    return folder


def pack(path: Path, suffix: str) -> None:
    """Replace the file by one that is compressed whole."""
    press = {".zstd": zstandard.ZstdCompressor().compress, ".lz4": lz4.frame.compress}[suffix]
    path.with_name(path.name + suffix).write_bytes(press(path.read_bytes()))
    path.unlink()


LISTS = {
    "lines": "  relative_file_paths:\n    - a_0.mcap\n    - a_1.mcap\n  files:\n    - path: b.mcap\n",
    "brackets": "relative_file_paths: [a_0.mcap, 'a_1.mcap']\n",
    "brackets over lines": 'relative_file_paths: [\n  "a_0.mcap",\n  a_1.mcap ]\n',
    "quotes and comments": "  relative_file_paths:\n\n    - 'a_0.mcap'\n    # next\n    - \"a_1.mcap\" # x\nfiles: 1\n",
    "folders": "  relative_file_paths:\n    - bag/a_0.mcap\n    - /home/me/a_1.mcap\n",
    "twice": "  relative_file_paths:\n    - a_0.mcap\n    - a_1.mcap\n    - a_0.mcap\n",
    "not indented": "relative_file_paths:\n- a_0.mcap\n- a_1.mcap\nxxx\n- c.mcap\n",
}  # fmt: skip


@pytest.mark.parametrize("name", list(LISTS))
def test_the_list_is_read_as_yaml_writers_write_it(name: str) -> None:
    assert parse_file_list(HEAD + LISTS[name]) == ["a_0.mcap", "a_1.mcap"]


HOSTILE = {
    "one word": "  relative_file_paths:\n    - a.mcap\n" + "x" * 80_000, "letters": "y" * 80_000,
    "brackets": "relative_file_paths: " + "[" * 80_000, "dashes": "relative_file_paths:\n" + "-" * 80_000,
    "lines": "relative_file_paths:\n" + "    - a\n" * 10_000, "open quotes": "relative_file_paths:\n- " + "'" * 80_000,
    "open brackets": "relative_file_paths: [\n" + "a\n" * 40_000,
}  # fmt: skip


@pytest.mark.parametrize("name", list(HOSTILE))
def test_hostile_metadata_takes_linear_time(name: str) -> None:
    begin = time.process_time()
    parse_file_list(HOSTILE[name] * 4)
    assert time.process_time() - begin < 1.0


def test_metadata_has_a_size(tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", ["bag_0.mcap"])
    (folder / "metadata.yaml").write_text("#" * (MESSAGE.max_metadata_bytes + 1))
    with pytest.raises(InputRefused, match="bytes, 1048576 are the most"):
        recording_files(folder)


@pytest.mark.parametrize(
    "names", [["bag_0.mcap", "bag_1.mcap"], ["my bag_0.mcap", "my bag_1.mcap"], ["b_9.mcap", "a_2.mcap"]]
)
def test_the_parts_are_those_of_the_list_in_its_order(names: list[str], vehicle: Vehicle, tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", names)
    assert [p.name for p in recording_files(folder)] == names
    raw = read_raw_take(folder, car(vehicle))
    assert len(raw.pose) == len(POSE)
    assert raw.irregularities == ()


def test_a_file_that_is_not_named_is_not_read_and_told(vehicle: Vehicle, tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", ["bag_0.mcap", "bag_1.mcap"])
    part(folder / "other_take_7.mcap")
    raw = read_raw_take(folder, car(vehicle))
    assert len(raw.pose) == len(POSE)
    (told,) = raw.irregularities
    assert (told.kind, told.action) == ("split bag", "warning")
    assert "not read: other_take_7.mcap" in told.detail
    (alone,) = read_raw_take(folder / "other_take_7.mcap", car(vehicle)).irregularities
    assert "not one of the files" in alone.detail


def test_no_name_leads_out_of_the_folder(vehicle: Vehicle, tmp_path: Path) -> None:
    part(tmp_path / "secret.mcap")
    folder = bag(tmp_path / "bag", ["bag_0.mcap"], ["../secret.mcap"])
    with pytest.raises(InputRefused, match=r"names secret\.mcap, which is not there"):
        read_raw_take(folder, car(vehicle))


def test_a_bag_without_metadata_is_read_by_its_names(vehicle: Vehicle, tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", ["bag_0.mcap", "bag_1.mcap"])
    (folder / "metadata.yaml").unlink()
    raw = read_raw_take(folder, car(vehicle))
    assert len(raw.pose) == len(POSE)
    assert "without metadata.yaml" in raw.irregularities[0].detail
    (folder / "bag_0.mcap").unlink()
    assert any("bag_0.mcap too" in i.detail for i in read_raw_take(folder, car(vehicle)).irregularities)
    part(folder / "other_1.mcap")
    with pytest.raises(
        InputRefused, match=r"may be of several takes: bag_1\.mcap, other_1\.mcap(.|\n)*ros2 bag reindex"
    ):
        read_raw_take(folder, car(vehicle))


@pytest.mark.parametrize("text", ["", HEAD, "relative_file_paths: []", "relative_file_paths:\n  - ''\n", "\x00\xff"])
def test_metadata_that_names_nothing_is_refused(text: str, vehicle: Vehicle, tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", ["bag_0.mcap"])
    (folder / "metadata.yaml").write_text(text)
    with pytest.raises(InputRefused, match="names no files"):
        read_raw_take(folder, car(vehicle))


@pytest.mark.parametrize("suffix", [".zstd", ".lz4"])
def test_parts_compressed_whole_are_named_with_what_unpacks_them(suffix: str, vehicle: Vehicle, tmp_path: Path) -> None:
    names = ["bag_0.mcap", "bag_1.mcap"]
    folder = bag(tmp_path / "bag", names, [f"bag_0.mcap{suffix}", f"bag_1.mcap{suffix}"])
    # unpacked already: nothing to say
    assert len(read_raw_take(folder, car(vehicle)).pose) == len(POSE)
    pack(folder / "bag_0.mcap", suffix)
    tool = {".zstd": "zstd -d", ".lz4": "lz4 -d"}[suffix]
    for path in (folder, folder / f"bag_0.mcap{suffix}"):
        with pytest.raises(InputRefused, match=rf"compressed whole(.|\n)*{tool} 'bag_0\.mcap{suffix}'"):
            read_raw_take(path, car(vehicle))
    half = read_raw_take(folder, car(vehicle), allow_partial=True)
    assert 0 < len(half.pose) < len(POSE)
    assert [i.kind for i in half.irregularities] == ["lost"]
    pack(folder / "bag_1.mcap", suffix)
    with pytest.raises(InputRefused, match="compressed whole"):
        read_raw_take(folder, car(vehicle), allow_partial=True)
    (tmp_path / "hidden.mcap").write_bytes((folder / f"bag_1.mcap{suffix}").read_bytes())
    with pytest.raises(InputRefused, match=rf"name it 'hidden\.mcap\.\w+' and unpack it: {tool}"):
        read_raw_take(tmp_path / "hidden.mcap", car(vehicle))


def test_a_bag_in_sqlite_is_named_with_what_converts_it(vehicle: Vehicle, tmp_path: Path) -> None:
    folder = bag(tmp_path / "bag", [], ["bag_0.db3"])
    with sqlite3.connect(folder / "bag_0.db3") as base:
        base.execute("create table topics (id integer)")
    base.close()
    (tmp_path / "renamed.bin").write_bytes((folder / "bag_0.db3").read_bytes())
    for path in (folder, folder / "bag_0.db3", tmp_path / "renamed.bin"):
        with pytest.raises(InputRefused, match=r"a ROS 2 bag in SQLite(.|\n)*mcap convert"):
            read_raw_take(path, car(vehicle))
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    with pytest.raises(InputRefused, match=r"a ROS 1 bag(.|\n)*mcap convert"):
        read_raw_take(tmp_path / "old.bag", car(vehicle))


def test_a_folder_of_other_things_is_no_bag(tmp_path: Path) -> None:
    assert read_bag_folder(tmp_path).parts == ()
    assert recording_files(tmp_path) == [tmp_path]
