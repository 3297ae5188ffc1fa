"""The fast ways of readers: what they read, refuse and say is what the slow ways do, to the last bit."""

from __future__ import annotations

import csv
import json
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import savgol_filter
from test_readers import START_NS, as_ros2, json_mcap

from bcid.errors import InputRefused
from bcid.recording.checks import lagged_sums, turning, yaw_jumps
from bcid.recording.checks.agreement import Feature
from bcid.recording.checks.turning_terms import terms_at
from bcid.recording.formats import csv_plain, csv_text, mcap_contents
from bcid.recording.formats.csv_table import read_csv_columns
from bcid.recording.formats.fixed_layout import RosLayout
from bcid.recording.formats.message_store import StoredMessages
from bcid.recording.formats.motive import read_motive_poses
from bcid.recording.formats.number_tables import NumberFields, read_number_tables
from bcid.recording.formats.ros_encoding import compile_ros_reader
from bcid.recording.read import read_raw_take
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle, read_vehicle

COLUMNS = {
    "t": lambda k: f"{k / 100:.2f}",
    "frame": str,
    "ns": lambda k: str(1_767_225_600_000_000_000 + 10_000_000 * k),
    "full": lambda k: repr(float(np.sin(k)) * 10.0 ** (k % 7 - 3)),
    "short": lambda k: f"{np.cos(k):g}",
    "mixed": lambda k: "-0" if k % 11 == 0 else str(k % 3) if k < 500 else f"{k % 3}.5",
    "gaps": lambda k: "" if k % 13 == 5 or 200 < k < 600 else f"{-k / 7:.6f}",
    "blank": lambda k: "",
    "long": lambda k: "9" * (k % 25 + 1) + ".25",
    "power": lambda k: f"{k + 1}e-{k % 30}",
}


def write_table(path: Path, count: int, separator: str = ",", decimal: str = ".", end: str = "\n") -> Path:
    """A table of `count` rows of numbers in the notations of COLUMNS."""
    rows = [separator.join(COLUMNS)]
    rows += [separator.join(cell(k).replace(".", decimal) for cell in COLUMNS.values()) for k in range(count)]
    path.write_bytes(end.join([*rows, ""]).encode())
    return path


def test_plain_rows_are_read_to_the_last_bit_as_a_whole_text_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(csv_plain, "PARSED_BYTES", 5000)
    monkeypatch.setattr(csv_plain, "PROOF_BYTES", 3000)
    for separator, decimal, end in ((",", ".", "\n"), (";", ",", "\r\n"), (";", ".", "\n"), ("\t", ".", "\r\n")):
        path = write_table(tmp_path / "table.csv", 1000, separator, decimal, end)
        fast, slow = csv_text.read_csv_text(path), csv_text.read_whole_text(path)
        assert fast.rows is not None
        assert slow.rows is None
        assert (fast.separator, fast.decimal, fast.irregularities) == (separator, decimal, slow.irregularities)
        one, other = (read_csv_columns(text, list(COLUMNS)) for text in (fast, slow))
        assert (one.names, one.units, one.irregularities) == (other.names, other.units, other.irregularities)
        for name, column in other.columns.items():
            assert one.columns[name].dtype == column.dtype, name
            assert one.columns[name].to_numpy().tobytes() == column.to_numpy().tobytes(), name


ODD_ROWS = (
    b"nan", b'"1"', b"# 1", b"1,2", b"", b"1-2", b"x", b"\0", b"\xff", b"1\r2", b"1;2", b"--1", b" 1 ", b"1.2.3",
    b"1\n", b"true", b"0x10", b"1e999", b"99999999999999999999", b"+1", b".5", b"5.", b"\xe2\x88\x921", b"1_0", b"1 2",
)  # fmt: skip


def outcome(read: Callable[[], Any]) -> str:
    """What is read, or the refusal, in full."""
    try:
        found = read()
    except InputRefused as refusal:
        return repr([(str(p.source), p.place, p.cause, p.next_step) for p in refusal.problems] or str(refusal))
    arrays = {k: (v.dtype.str, v.shape, v.tobytes()) for k, v in vars(found).items() if isinstance(v, np.ndarray)}
    return repr((arrays, found.irregularities, {k: v[1].tobytes() for k, v in found.channels.items()}))


def test_motive_exports_that_are_damaged_anywhere_are_judged_as_a_whole(
    takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines, rng = takes["motive"].read_bytes().split(b"\r\n"), np.random.default_rng(3)
    for k, odd in enumerate((*ODD_ROWS, *ODD_ROWS[:8])):
        damaged, row = list(lines), int(rng.integers(10 if k % 3 else 0, len(lines) - 2))
        cells = damaged[row].split(b",")
        cells[int(rng.integers(len(cells)))] = odd
        damaged[row] = b",".join(cells)
        path = tmp_path / "drive.csv"
        path.write_bytes(b"\r\n".join(damaged))
        one = outcome(lambda path=path: read_motive_poses(path, vehicle))
        with monkeypatch.context() as patch:
            patch.setattr(csv_text, "_read_plain_text", lambda path, comment: None)
            assert one == outcome(lambda path=path: read_motive_poses(path, vehicle)), (row, odd)
    assert csv_text.read_csv_text(takes["motive"]).rows is not None


def test_a_text_that_is_no_number_in_plain_characters_is_refused_with_its_line(
    takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path
) -> None:
    lines = takes["motive"].read_bytes().split(b"\r\n")
    cells = lines[3000].split(b",")
    cells[2] = b"1-2"
    lines[3000] = b",".join(cells)
    path = tmp_path / "drive.csv"
    path.write_bytes(b"\r\n".join(lines))
    with pytest.raises(InputRefused, match="'1-2' is no number") as error:
        read_motive_poses(path, vehicle)
    assert error.value.place == "line 3001, column 3"


def pose_message(k: int, body: str = "car", **changes: Any) -> dict[str, Any]:
    """A pose on a circle in the JSON of a foxglove.FrameTransform."""
    yaw = 0.02 * k
    place = {"x": np.sin(yaw), "y": 1.0 - np.cos(yaw), "z": 0} | changes
    turn = {"x": 0.0, "y": 0.0, "z": np.sin(yaw / 2), "w": np.cos(yaw / 2)}
    ns = START_NS + 20_000_000 * k
    stamp = {"sec": ns // 1_000_000_000, "nsec": ns % 1_000_000_000}
    return {"timestamp": stamp, "child_frame_id": body, "translation": place, "rotation": turn}


def odd_messages(odd: str) -> list[tuple[float, dict[str, Any]]]:
    """The poses of a drive with something `odd` in some of them."""
    rows = []
    for k in range(300):
        message = pose_message(k)
        at = k % 50 == 17 or (odd in ("bodies", "whole numbers") and k % 2 == 1)
        if at and odd == "bodies":
            message["child_frame_id"] = "truck"
        elif at and odd == "whole numbers":
            message["translation"] |= {"x": 3 * k, "y": -k}
        elif at and odd == "order":
            message = dict(reversed(message.items()))
        elif at and odd in ("null", "true", "text", "none", "list", "large"):
            value = {"null": None, "true": True, "text": "1.5", "none": "nan", "list": [1.0], "large": 10**400}[odd]
            message["translation"]["x"] = value
        elif at and odd == "missing":
            del message["rotation"]["w"]
        elif at and odd == "late part":
            message["timestamp"]["nsec"] = 1_000_000_000
        elif odd == "nanoseconds":
            message["timestamp"] = START_NS + 20_000_000 * k + 123
        elif at and odd == "plain stamp":
            message["timestamp"] = START_NS / 1e9 + 0.02 * k
        rows.append((0.02 * k, message))
    return rows


def count_decoded(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """A list to which the number of messages that are decoded one by one is added at each reading."""
    decoded: list[int] = []
    rows_read = mcap_contents.McapContents.read_rows

    def counted(self: Any, topic: str, stored: Any, rows: np.ndarray, read: Any) -> Any:
        decoded.append(len(rows))
        return rows_read(self, topic, stored, rows, read)

    monkeypatch.setattr(mcap_contents.McapContents, "read_rows", counted)
    return decoded


def test_a_layout_is_that_of_one_channel() -> None:
    """Another channel of the topic may have its fields in another order, in messages of as many bytes."""
    texts = [b"\0\1\0\0" + struct.pack("<2d", 2 * k, 2 * k + 1) for k in range(6)]
    ends = 20 * np.arange(1, 7)
    stored = StoredMessages(
        np.array([1, 2, 1, 2, 1, 2]), np.arange(6, dtype=np.uint64), ends - 20, ends, memoryview(b"".join(texts))
    )
    readers = {
        1: compile_ros_reader("p", "float64 x\nfloat64 y"), 2: compile_ros_reader("p", "float64 y\nfloat64 x")
    }  # fmt: skip
    contents: Any = SimpleNamespace(
        stored_messages=lambda topic: stored, read_rows=lambda *given: iter(()),
        fixed_layout=lambda topic, messages, row: RosLayout(
            messages.data(row), readers[int(messages.channels[row])], False
        ),
    )  # fmt: skip
    fields: Any = NumberFields(["x", "y"], stamped=False)
    table = read_number_tables(contents, "/p", fields, lambda message: None)[""]  # type: ignore[arg-type,return-value]
    assert table.rows.tolist() == [[0, 1], [3, 2], [4, 5], [7, 6], [8, 9], [11, 10]]


@pytest.mark.parametrize(
    "odd",
    ["nothing", "bodies", "whole numbers", "order", "null", "true", "text", "none", "list", "large", "missing",
     "late part", "nanoseconds", "plain stamp", "-0", "1e999", "NaN", "01", "+1", "1."],
)  # fmt: skip
def test_json_messages_of_one_layout_are_read_as_each_by_itself(
    odd: str, vehicle: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    car = vehicle.model_copy(update={
        "topics": vehicle.topics.model_copy(update={"pose": "/pose", "command": "/command", "child_frame": "car"})
    })  # fmt: skip
    commands = [
        (0.1 * k, {"time_s": START_NS / 1e9 + 0.1 * k, "steering_rad": 0.1, "throttle_mps": k}) for k in range(60)
    ]
    path = tmp_path / "drive.mcap"
    poses = odd_messages(odd)
    if odd in ("-0", "1e999", "NaN", "01", "+1", "1."):
        # as no writer of JSON writes it
        monkeypatch.setattr(json, "dumps", lambda x, dump=json.dumps, **o: dump(x, **o).replace('"odd"', odd))
        for k in range(17, 300, 50):
            poses[k][1]["translation"]["x"] = "odd"
    json_mcap(path, {"/pose": ("foxglove.FrameTransform", poses), "/command": ("bcid.Command", commands)})
    decoded = count_decoded(monkeypatch)
    for partial in (False, True):
        decoded.clear()
        one = outcome(lambda partial=partial: read_raw_take(path, car, allow_partial=partial))
        if odd in ("nothing", "nanoseconds"):
            # commands are decoded to see what they hold; no pose is
            assert max(decoded) == len(commands)
        with monkeypatch.context() as patch:
            patch.setattr(mcap_contents, "fixed_layout", lambda channel, schema, data: None)
            assert one == outcome(lambda partial=partial: read_raw_take(path, car, allow_partial=partial))


@pytest.mark.parametrize("kind", ["geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry"])
def test_messages_of_ros_of_one_layout_are_read_as_each_by_itself(
    kind: str, recording: Recording, vehicle: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = as_ros2(recording, tmp_path, kind)
    car = vehicle.model_copy(update={
        "topics": vehicle.topics.model_copy(update={"pose": "/pose", "command": "/command"})
    })  # fmt: skip
    decoded = count_decoded(monkeypatch)
    one = outcome(lambda: read_raw_take(path, car))
    # the first command is decoded to see what it holds; nothing else is
    assert [n for n in decoded if n] == [len(recording.commands)]
    monkeypatch.setattr(mcap_contents, "fixed_layout", lambda channel, schema, data: None)
    assert one == outcome(lambda: read_raw_take(path, car))


READ_AND_MEASURE = """
import resource, sys
from pathlib import Path
from bcid.recording.formats.fixed_layout import RosLayout
from bcid.recording.formats.message_store import StoredMessages
from bcid.recording.formats.motive import read_motive_poses
from bcid.recording.formats.number_tables import NumberFields, read_number_tables
from bcid.recording.formats.ros_encoding import compile_ros_reader
from bcid.vehicle import read_vehicle
small, large, vehicle = Path(sys.argv[1]), Path(sys.argv[2]), read_vehicle(Path(sys.argv[3]))
read_motive_poses(small, vehicle)
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
read_motive_poses(large, vehicle)
print(1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / large.stat().st_size)
"""


def test_a_long_export_is_read_in_four_bytes_a_byte(takes: dict[str, Path], vehicle_file: Path, tmp_path: Path) -> None:
    pytest.importorskip("resource", reason="memory is measured as POSIX does")
    with takes["motive"].open(newline="") as file:
        rows = list(csv.reader(file))
    head = next(k for k, row in enumerate(rows) if row and row[0] == "Frame") + 1
    assert read_vehicle(vehicle_file).mocap.rigid_body == rows[head - 4][2]
    body = [row[2:] for row in rows[head:]]
    path = tmp_path / "long.csv"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerows(rows[:head])
        writer.writerows([str(k), f"{k / 60:.6f}", *body[k % len(body)]] for k in range(60 * len(body)))
    command = [sys.executable, "-c", READ_AND_MEASURE, *map(str, (takes["motive"], path, vehicle_file))]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert float(done.stdout) < 4.0


def test_lagged_sums_are_those_of_each_lag() -> None:
    rng = np.random.default_rng(2)
    n, reach = 900, 40
    known, use = rng.random(n) > 0.1, rng.random(n) > 0.3
    use[300:420] = False
    y, features = rng.normal(size=n), [Feature(rng.normal(size=n), None), Feature(*rng.normal(size=(2, n)))]
    rows = np.flatnonzero(use)
    edges = np.array([0, 100, 180, 400, len(rows)])
    sums = lagged_sums.LaggedSums(y, known, features, rows, edges, reach)
    part = sums.between(np.array([1]), np.array([3]), 0.0)
    own = rows[100:400]
    for k, lag in enumerate(range(-reach, reach + 1)):
        X, under = terms_at(features, known, own, lag)
        np.testing.assert_allclose(part.gram[0, k], X.T @ X, atol=1e-11)
        np.testing.assert_allclose(part.cross[0, k], X.T @ y[own], atol=1e-11)
        np.testing.assert_allclose(part.square[0, k], float(under @ y[own] ** 2), atol=1e-11)
        assert part.counted[0, k] == under.sum()


def test_rates_are_those_of_the_filter_of_savitzky_and_golay() -> None:
    yaw = np.cumsum(np.random.default_rng(4).normal(size=500))
    for half in (2, 5, 20, 249):
        found = turning.filtered_rate(yaw, half, 0.01)
        np.testing.assert_allclose(found, savgol_filter(yaw, 2 * half + 1, 2, deriv=1, delta=0.01), atol=1e-10)


def test_stretches_begin_anew_after_a_while_and_at_gaps() -> None:
    usable = np.ones(4000, dtype=bool)
    usable[1000:1050] = usable[:7] = usable[2500] = False
    restart, rows = turning._stretches(usable, 100.0, 3)
    start, since, length = usable & ~np.r_[False, usable[:-1]], 0, round(turning.LIMITS.stretch_s * 100.0)
    expected = start.copy()
    for k in range(len(usable)):
        since = 0 if start[k] or since >= length else since + 1
        expected[k] |= since == 0
    np.testing.assert_array_equal(restart, expected)
    assert len(rows)


def test_levels_of_a_yaw_that_jumps_thousands_of_times_are_found_at_once() -> None:
    rng = np.random.default_rng(5)
    rows = np.sort(rng.choice(np.arange(10, 200_000), 8000, replace=False))
    sizes = np.where(np.arange(8000) % 2, -1.0, 1.0) * rng.uniform(0.2, 0.4, 8000)
    jumps = yaw_jumps.YawJumps(rows, sizes, np.full(8000, 0.01))
    time_s = np.arange(200_000) / 100.0
    levels = yaw_jumps.label_levels(jumps, time_s)
    heights, lasts, height, expected = [0.0], [True], 0.0, np.zeros(len(time_s), dtype=int)
    for row, end, size in zip(rows[:500], rows[1:501], sizes[:500], strict=True):
        height += size
        stays = bool(time_s[end - 1] - time_s[row] > yaw_jumps.LIMITS.min_mounting_s)
        apart = np.where(lasts, np.abs(yaw_jumps.wrap_angles(np.array(heights) - height)), np.inf)
        at = int(np.argmin(apart))
        if apart[at] > min(yaw_jumps.LIMITS.same_level_slacks * 0.01, 0.5 * abs(size)):
            heights.append(height)
            lasts.append(stays)
            at = len(heights) - 1
        height = heights[at] if stays else height
        expected[row:end] = at
    np.testing.assert_array_equal(levels[: rows[500]], expected[: rows[500]])
