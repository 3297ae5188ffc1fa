"""One contract for all readers: the same drive read from any format is the same `Recording`."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from making import circling_take
from mcap.writer import CompressionType, Writer
from mcap_ros2.writer import Writer as Ros2Writer

from bcid.errors import InputRefused
from bcid.recording.read import read_recording
from bcid.recording.saving import load_recording, save_recording
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

BODY = "bumper_car"
START_NS = 1_700_000_000_000_000_000

# --- the same drive in other formats -----------------------------------------------------------------------------


def _table(recording: Recording) -> pd.DataFrame:
    t, pose = recording.poses.time_s, recording.poses.values
    rows = np.searchsorted(recording.commands.time_s, t, side="right") - 1
    u_s, u_m = recording.commands.values[np.maximum(rows, 0)].T
    return pd.DataFrame({"t": t, "px": pose[:, 0], "py": pose[:, 1], "psi": pose[:, 2], "steer": u_s, "gas": u_m})


COLUMNS = {
    "time_s": "t", "x_m": "px", "y_m": "py", "yaw_rad": "psi", "steering_rad": "steer", "throttle_mps": "gas",
}  # fmt: skip


def as_csv(recording: Recording, folder: Path) -> Path:
    _table(recording).to_csv(folder / "drive.csv", index=False)
    return folder / "drive.csv"


def as_parquet(recording: Recording, folder: Path) -> Path:
    _table(recording).to_parquet(folder / "drive.parquet")
    return folder / "drive.parquet"


def _quaternion(yaw: float) -> dict[str, float]:
    return {"x": 0.0, "y": 0.0, "z": float(np.sin(yaw / 2)), "w": float(np.cos(yaw / 2))}


def _point(pose: np.ndarray) -> dict[str, float]:
    return {"x": float(pose[0]), "y": float(pose[1]), "z": 0.3}


def _stamp(t: float) -> dict[str, int]:
    ns = START_NS + round(t * 1e9)
    return {"sec": ns // 10**9, "nanosec": ns % 10**9}


HEADER = "std_msgs/Header header\n"
STAMP = "builtin_interfaces/Time stamp\nstring frame_id\n================\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
POSE = (
    "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n================\nMSG: geometry_msgs/Point\n"
    "float64 x\nfloat64 y\nfloat64 z\n================\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
)
SEP = "================\n"
TRANSFORM = (
    "geometry_msgs/Vector3 translation\ngeometry_msgs/Quaternion rotation\n================\nMSG: geometry_msgs/Vector3\n"
    "float64 x\nfloat64 y\nfloat64 z\n================\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
)
_STAMPED = f"{SEP}MSG: std_msgs/Header\n{STAMP}"
ROS2_POSES: dict[str, tuple[str, Callable[[float, np.ndarray], dict[str, Any]]]] = {
    "geometry_msgs/msg/PoseStamped": (
        f"{HEADER}geometry_msgs/Pose pose\n{_STAMPED}{SEP}MSG: geometry_msgs/Pose\n{POSE}",
        lambda t, p: {"header": {"stamp": _stamp(t), "frame_id": "floor"}, "pose": {"position": _point(p), "orientation": _quaternion(p[2])}},
    ),
    "geometry_msgs/msg/PoseWithCovarianceStamped": (
        f"{HEADER}geometry_msgs/PoseWithCovariance pose\n{_STAMPED}{SEP}MSG: geometry_msgs/PoseWithCovariance\n"
        f"geometry_msgs/Pose pose\nfloat64[36] covariance\n{SEP}MSG: geometry_msgs/Pose\n{POSE}",
        lambda t, p: {
            "header": {"stamp": _stamp(t), "frame_id": "floor"},
            "pose": {"pose": {"position": _point(p), "orientation": _quaternion(p[2])}, "covariance": [0.0] * 36},
        },
    ),
    "geometry_msgs/msg/TransformStamped": (
        f"{HEADER}string child_frame_id\ngeometry_msgs/Transform transform\n{_STAMPED}{SEP}MSG: geometry_msgs/Transform\n{TRANSFORM}",
        lambda t, p: {
            "header": {"stamp": _stamp(t), "frame_id": "floor"}, "child_frame_id": BODY,
            "transform": {"translation": _point(p), "rotation": _quaternion(p[2])},
        },
    ),
    "tf2_msgs/msg/TFMessage": (
        f"geometry_msgs/TransformStamped[] transforms\n{SEP}MSG: geometry_msgs/TransformStamped\n{HEADER}string child_frame_id\n"
        f"geometry_msgs/Transform transform\n{_STAMPED}{SEP}MSG: geometry_msgs/Transform\n{TRANSFORM}",
        lambda t, p: {
            "transforms": [
                {
                    "header": {"stamp": _stamp(t), "frame_id": "floor"}, "child_frame_id": name,
                    "transform": {"translation": _point(p + shift), "rotation": _quaternion(p[2])},
                }
                for name, shift in (("another", 5.0), (BODY, 0.0))
            ]
        },
    ),
    "nav_msgs/msg/Odometry": (
        f"{HEADER}string child_frame_id\ngeometry_msgs/PoseWithCovariance pose\n{_STAMPED}{SEP}MSG: geometry_msgs/PoseWithCovariance\n"
        f"geometry_msgs/Pose pose\nfloat64[36] covariance\n{SEP}MSG: geometry_msgs/Pose\n{POSE}",
        lambda t, p: {
            "header": {"stamp": _stamp(t), "frame_id": "floor"}, "child_frame_id": BODY,
            "pose": {"pose": {"position": _point(p), "orientation": _quaternion(p[2])}, "covariance": [0.0] * 36},
        },
    ),
    "mocap4r2_msgs/msg/RigidBodies": (
        f"{HEADER}uint32 frame_number\nmocap4r2_msgs/RigidBody[] rigidbodies\n{_STAMPED}{SEP}MSG: mocap4r2_msgs/RigidBody\n"
        f"string rigid_body_name\ngeometry_msgs/Pose pose\n{SEP}MSG: geometry_msgs/Pose\n{POSE}",
        lambda t, p: {
            "header": {"stamp": _stamp(t), "frame_id": "floor"}, "frame_number": 1,
            "rigidbodies": [
                {"rigid_body_name": name, "pose": {"position": _point(p + shift), "orientation": _quaternion(p[2])}}
                for name, shift in (("another", 5.0), (BODY, 0.0))
            ],
        },
    ),
}  # fmt: skip
ACKERMANN = (
    f"{HEADER}ackermann_msgs/AckermannDrive drive\n{_STAMPED}{SEP}MSG: ackermann_msgs/AckermannDrive\nfloat32 steering_angle\n"
    "float32 steering_angle_velocity\nfloat32 speed\nfloat32 acceleration\nfloat32 jerk\n"
)


def as_ros2(recording: Recording, folder: Path, kind: str, **options: Any) -> Path:
    path = folder / "ros2.mcap"
    definition, message = ROS2_POSES[kind]
    with path.open("wb") as file:
        writer = Ros2Writer(file, **options)
        schema = writer.register_msgdef(kind, definition)
        command = writer.register_msgdef("ackermann_msgs/msg/AckermannDriveStamped", ACKERMANN)
        for t, pose in zip(recording.poses.time_s, recording.poses.values, strict=True):
            log = START_NS + round(t * 1e9) + 9_000_000
            writer.write_message("/pose", schema, message(t, pose), log_time=log, publish_time=log)
        for t, (u_s, u_m) in zip(recording.commands.time_s, recording.commands.values, strict=True):
            drive = {
                "steering_angle": u_s,
                "steering_angle_velocity": 0.0,
                "speed": max(u_m, 0.0),
                "acceleration": 0.0,
                "jerk": 0.0,
            }
            log = START_NS + round(t * 1e9) + 70_000_000
            stamped = {"header": {"stamp": _stamp(t), "frame_id": ""}, "drive": drive}
            writer.write_message("/command", command, stamped, log_time=log, publish_time=log)
        writer.finish()
    return path


def json_mcap(
    path: Path, topics: dict[str, tuple[str, list[tuple[float, dict[str, Any]]]]], encoding: str = "json"
) -> Path:
    """An MCAP file of JSON messages: topic -> (schema name, [(log time in s, message)])."""
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start()
        for topic, (schema, rows) in topics.items():
            channel = writer.register_channel(topic, encoding, writer.register_schema(schema, "jsonschema", b"{}"))
            for t, message in rows:
                ns = START_NS + round(t * 1e9)
                writer.add_message(channel, ns, json.dumps(message).encode(), ns)
        writer.finish()
    return path


def same(one: Recording, other: Recording, atol: float = 1e-6, brakes: bool = True) -> None:
    """Within `atol`: poses where both have one, and commands."""
    t = np.intersect1d(np.round(one.poses.time_s, 6), np.round(other.poses.time_s, 6))
    assert len(t) > 0.97 * max(len(one.poses), len(other.poses))
    rows = [np.isin(np.round(r.poses.time_s, 6), t) for r in (one, other)]
    pose = [r.poses.values[k] for r, k in zip((one, other), rows, strict=True)]
    turns = np.round((pose[0][0, 2] - pose[1][0, 2]) / (2 * np.pi)) * 2 * np.pi
    np.testing.assert_allclose(pose[0], pose[1] + [0.0, 0.0, turns], atol=atol)
    commands = [r.commands.values[:100] for r in (one, other)]
    if not brakes:
        commands = [np.column_stack([c[:, 0], np.maximum(c[:, 1], 0.0)]) for c in commands]
    np.testing.assert_allclose(*commands, atol=1e-6)


def tabled(vehicle: Vehicle) -> Vehicle:
    return Vehicle.model_validate({**vehicle.model_dump(by_alias=True), "columns": COLUMNS})


def topical(vehicle: Vehicle, **topics: Any) -> Vehicle:
    both = {"pose": "/pose", "command": "/command", **topics}
    return Vehicle.model_validate({**vehicle.model_dump(by_alias=True), "topics": both})


def test_motive_and_mcap_of_one_drive_agree(takes: dict[str, Path], vehicle: Vehicle) -> None:
    one, other = (read_recording(takes[n], vehicle) for n in ("motive", "mcap"))
    same(one, other, atol=1.2e-2)  # the Motive take carries a simulated tilt of the chassis
    np.testing.assert_allclose(one.poses.values[:, :2], _common(other, one)[:, :2], atol=1.1e-6)


def _common(one: Recording, other: Recording) -> np.ndarray:
    rows = np.isin(np.round(one.poses.time_s, 6), np.round(other.poses.time_s, 6))
    return one.poses.values[rows]


@pytest.mark.parametrize("write", [as_csv, as_parquet])
def test_tables_agree(
    write: Callable[[Recording, Path], Path], recording: Recording, vehicle: Vehicle, tmp_path: Path
) -> None:
    again = read_recording(write(recording, tmp_path), tabled(vehicle))
    np.testing.assert_allclose(again.poses.values, recording.poses.values, atol=1e-9)


@pytest.mark.parametrize("kind", list(ROS2_POSES))
def test_ros2_messages_agree(kind: str, recording: Recording, vehicle: Vehicle, tmp_path: Path) -> None:
    """CDR poses of every listed type with Ackermann commands; header stamps stand, log times are late."""
    same(recording, read_recording(as_ros2(recording, tmp_path, kind), topical(vehicle)), brakes=False)


def test_commands_of_every_kind(recording: Recording, vehicle: Vehicle, tmp_path: Path) -> None:
    poses = [
        (t, {"timestamp": {"sec": 0, "nsec": round(t * 1e9) % 10**9} | {"sec": int(round(t * 1e9) // 10**9)},
             "pose": {"position": _point(p), "orientation": _quaternion(p[2])}})
        for t, p in zip(recording.poses.time_s, recording.poses.values, strict=True)
    ]  # fmt: skip
    commands = list(zip(recording.commands.time_s, recording.commands.values, strict=True))
    twist = [
        (
            t,
            {
                "header": {"stamp": {"sec": int(t), "nanosec": round(t % 1 * 1e9)}},
                "twist": {"linear": {"x": m}, "angular": {"z": s}},
            },
        )
        for t, (s, m) in commands
    ]
    path = json_mcap(
        tmp_path / "t.mcap",
        {"/pose": ("foxglove.PoseInFrame", poses), "/command": ("geometry_msgs/TwistStamped", twist)},
    )
    with pytest.raises(InputRefused, match=r"angular\.z"):
        read_recording(path, topical(vehicle))
    fields = {"steering_rad": "twist.angular.z", "throttle_mps": "twist.linear.x"}
    same(recording, read_recording(path, topical(vehicle, command_fields=fields)))


def test_log_times_stand_for_both_where_one_topic_has_no_stamps(
    recording: Recording, vehicle: Vehicle, tmp_path: Path
) -> None:
    late = 0.25
    poses = [
        (
            t + late,
            {
                "timestamp": {"sec": int(t), "nsec": round(t % 1 * 1e9)},
                "pose": {"position": _point(p), "orientation": _quaternion(p[2])},
            },
        )
        for t, p in zip(recording.poses.time_s, recording.poses.values, strict=True)
    ]
    commands = [
        (t + late, {"steering_rad": s, "throttle_mps": m})
        for t, (s, m) in zip(recording.commands.time_s, recording.commands.values, strict=True)
    ]
    path = json_mcap(tmp_path / "t.mcap", {"/pose": ("foxglove.PoseInFrame", poses), "/command": ("own", commands)})
    again = read_recording(path, topical(vehicle))
    assert any(i.kind == "time base" for i in again.irregularities)
    same(recording, again)
    with pytest.raises(InputRefused, match="carries none"):
        read_recording(path, topical(vehicle, time="header"))


# --- Motive's variants -------------------------------------------------------------------------------------------


def rewritten(path: Path, target: Path, change: Callable[[list[list[str]]], list[list[str]]]) -> Path:
    """A copy of a Motive export (with its commands) whose rows went through `change`."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = change(list(csv.reader(file)))
    with target.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)
    target.with_suffix(".commands.csv").write_bytes(path.with_suffix(".commands.csv").read_bytes())
    return target


def set_key(rows: list[list[str]], key: str, value: str) -> list[list[str]]:
    rows[0][rows[0].index(key) + 1] = value
    return rows


def scaled(factor: float, unit: str) -> Callable[[list[list[str]]], list[list[str]]]:
    def change(rows: list[list[str]]) -> list[list[str]]:
        set_key(rows, "Length Units", unit)
        for row in rows[7:]:
            row[6:9] = [f"{float(c) * factor:.9f}" if c else "" for c in row[6:9]]
        return rows

    return change


def to_euler(rows: list[list[str]], order: str = "XYZ") -> list[list[str]]:
    from scipy.spatial.transform import Rotation

    set_key(rows, "Rotation Type", order)
    for row in rows[2:6]:
        del row[5]
    del rows[6][5]
    for row in rows[7:]:
        turn = [""] * 3
        if row[2]:
            angles = Rotation.from_quat([float(c) for c in row[2:6]]).as_euler(order, degrees=True)
            turn = [f"{angles[order.index(axis)]:.9f}" for axis in "XYZ"]
        row[2:6] = turn
    return rows


def to_z_up(rows: list[list[str]]) -> list[list[str]]:
    """World axes turned about X by 90 degrees: (X, Y, Z) -> (X, -Z, Y), for positions and quaternions alike."""
    for row in rows[7:]:
        if row[2]:
            x, y, z, w = row[2:6]
            p_x, p_y, p_z = row[6:9]
            row[2:6] = [x, _negated(z), y, w]
            row[6:9] = [p_x, _negated(p_z), p_y]
    return rows


def _negated(cell: str) -> str:
    return cell[1:] if cell.startswith("-") else f"-{cell}"


def as_1_22(rows: list[list[str]]) -> list[list[str]]:
    """No notes, no units, no labels in the second column."""
    first = dict(zip(rows[0][::2], rows[0][1::2], strict=True))
    kept = {
        k: v for k, v in first.items() if k not in ("Take Notes", "Length Units", "Coordinate Space", "Rotation Type")
    }
    rows[0] = [c for pair in ({**kept, "Format Version": "1.22"}).items() for c in pair]
    for row in rows[2:6]:
        row[1] = ""
    return rows


def as_1_25(rows: list[list[str]]) -> list[list[str]]:
    """A Parent row, and another body before ours."""
    set_key(rows, "Format Version", "1.25")
    rows.insert(5, ["", "Parent", *[""] * 8])
    for i, row in enumerate(rows[2:]):
        if not row:
            continue
        filler = {0: "Rigid Body", 1: "wall", 2: "1", 3: "", 4: row[2] if i == 4 else ""}
        extra = [filler[i]] * 8 if i < 4 else (row[2:10] if i in (4, 5) else ["0.1"] * 8)
        row[2:2] = extra
    return rows


def with_timecode(rows: list[list[str]]) -> list[list[str]]:
    for i, row in enumerate(rows[2:]):
        row[2:2] = [{4: "TimeCode"}.get(i, "") if i < 5 else f"00:00:{i:02d}:00"]
    return rows


VARIANTS: dict[str, tuple[Callable[[list[list[str]]], list[list[str]]], dict[str, str]]] = {
    "millimetres": (scaled(1000.0, "Millimeters"), {}),
    "centimetres": (scaled(100.0, "Centimeters"), {}),
    "Euler angles": (to_euler, {}),
    "Z up": (to_z_up, {"up_axis": "Z"}),
    "1.22": (as_1_22, {"length_unit": "m"}),
    "1.25": (as_1_25, {}),
    "time code": (with_timecode, {}),
    **{order: (lambda r, order=order: to_euler(r, order), {}) for order in ("XZY", "YXZ", "YZX", "ZXY", "ZYX")},
    "trailing blank lines": (lambda rows: [*rows, [], []], {}),
    "a take named Rigid Body": (lambda rows: set_key(rows, "Take Name", "Rigid Body"), {}),
    "quaternion signs": (
        lambda rows: [[*r[:2], *(_negated(c) if c else c for c in r[2:6]), *r[6:]] if i % 3 == 0 and i > 7 else r for i, r in enumerate(rows)], {},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(VARIANTS))
def test_motive_variants_give_the_same_trajectory(
    name: str, takes: dict[str, Path], recording: Recording, vehicle: Vehicle, tmp_path: Path
) -> None:
    change, mocap = VARIANTS[name]
    seen = vehicle.model_copy(update={"mocap": vehicle.mocap.model_copy(update=mocap)})
    again = read_recording(rewritten(takes["motive"], tmp_path / "v.csv", change), seen)
    np.testing.assert_allclose(again.poses.values, recording.poses.values, atol=1e-6)
    np.testing.assert_array_equal(again.poses.time_s, recording.poses.time_s)


def test_a_cropped_export_keeps_its_time(
    takes: dict[str, Path], recording: Recording, vehicle: Vehicle, tmp_path: Path
) -> None:
    cropped = read_recording(
        rewritten(takes["motive"], tmp_path / "c.csv", lambda rows: rows[:7] + rows[607:]), vehicle
    )
    assert cropped.poses.time_s[0] == pytest.approx(10.0)
    assert cropped.commands.time_s[0] == 0.0


def test_marker_offset_and_yaw_offset_are_undone(
    takes: dict[str, Path], recording: Recording, vehicle: Vehicle
) -> None:
    mocap = vehicle.mocap.model_copy(update={"marker_offset_m": (0.2, -0.1), "yaw_offset_rad": 0.3})
    moved = read_recording(takes["motive"], vehicle.model_copy(update={"mocap": mocap}))
    yaw = recording.poses.values[:, 2] - 0.3
    lever = np.column_stack([np.cos(yaw) * 0.2 + np.sin(yaw) * 0.1, np.sin(yaw) * 0.2 - np.cos(yaw) * 0.1])
    np.testing.assert_allclose(moved.poses.values[:, 2], yaw, atol=1e-12)
    np.testing.assert_allclose(moved.poses.values[:, :2], recording.poses.values[:, :2] - lever, atol=1e-12)


def test_dropouts_are_counted_and_located(takes: dict[str, Path], recording: Recording) -> None:
    dropouts = [i for i in recording.irregularities if i.kind == "pose dropout"]
    with takes["motive"].open() as file:
        blank = sum(1 for line in file if ",,,,,,,," in line and line[0].isdigit())
    assert sum(i.count for i in dropouts) == blank > 0


def test_a_recording_survives_the_disk(recording: Recording, tmp_path: Path) -> None:
    save_recording(recording, tmp_path)
    again = load_recording(tmp_path)
    np.testing.assert_array_equal(again.poses.values, recording.poses.values)
    np.testing.assert_array_equal(again.commands.values, recording.commands.values)
    assert (again.irregularities, again.clock) == (recording.irregularities, recording.clock)
    assert [source.sha256 for source in again.sources] == [source.sha256 for source in recording.sources]


def test_misread_tables_are_refused(recording: Recording, vehicle: Vehicle, tmp_path: Path) -> None:
    table = _table(recording)
    changes = {
        "degrees": ("degrees", table.assign(psi=np.degrees(np.angle(np.exp(1j * table.psi))))),
        "mirrored": ("mirrored", table.assign(py=-table.py)),
        "clockwise": ("clockwise|turns right", table.assign(psi=-table.psi)),
        "milliseconds": ("in seconds", table.assign(t=1000.0 * table.t)),
        "clock jump": ("clock jump", table.assign(t=table.t + np.where(np.arange(len(table)) > 900, 1e6, 0.0))),
        "text": ("is no number", table.assign(px=["x", *table.px[1:].astype(str)])),
    }
    for name, (match, changed) in changes.items():
        path = tmp_path / f"{name}.csv"
        changed.to_csv(path, index=False)
        refused(path, tabled(vehicle), match)
    (tmp_path / "cut.parquet").write_bytes(as_parquet(recording, tmp_path).read_bytes()[:500])
    refused(tmp_path / "cut.parquet", tabled(vehicle), "Parquet")
    (tmp_path / "wide.csv").write_text("Format Version".encode("utf-16").decode("latin-1"), encoding="latin-1")
    refused(tmp_path / "wide.csv", tabled(vehicle), "version")


def test_further_channels_are_kept(recording: Recording, vehicle: Vehicle, tmp_path: Path) -> None:
    poses = [
        (t, {"pose": {"position": _point(p), "orientation": _quaternion(p[2])}})
        for t, p in zip(recording.poses.time_s, recording.poses.values, strict=True)
    ]
    commands = [
        (t, {"steering_rad": s, "throttle_mps": m, "measured_steering_rad": 0.9 * s})
        for t, (s, m) in zip(recording.commands.time_s, recording.commands.values, strict=True)
    ]
    path = json_mcap(tmp_path / "t.mcap", {"/pose": ("foxglove.PoseInFrame", poses), "/command": ("own", commands)})
    again = read_recording(path, topical(vehicle))
    assert list(again.channels) == ["measured_steering_rad"]
    np.testing.assert_allclose(
        again.channels["measured_steering_rad"].values[:50, 0], 0.9 * recording.commands.values[:50, 0], atol=1e-9
    )


def test_several_bodies_need_a_name(recording: Recording, vehicle: Vehicle, tmp_path: Path) -> None:
    path = as_ros2(recording, tmp_path, "tf2_msgs/msg/TFMessage")
    nameless = vehicle.model_copy(update={"mocap": vehicle.mocap.model_copy(update={"rigid_body": None})})
    refused(path, topical(nameless), f"another, {BODY}")


def test_an_mcap_without_a_summary_is_read(takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    from mcap.reader import make_reader
    from mcap.writer import IndexType

    path = tmp_path / "bare.mcap"
    with takes["mcap"].open("rb") as source, path.open("wb") as target:
        writer = Writer(
            target, index_types=IndexType.NONE, repeat_channels=False, repeat_schemas=False, use_statistics=False
        )
        writer.start()
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(source).iter_messages():
            if channel.id not in channels:
                again = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, again)
            writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
        writer.finish()
    one, other = (read_recording(p, vehicle) for p in (takes["mcap"], path))
    np.testing.assert_array_equal(one.poses.values, other.poses.values)


# --- the clock ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shift_s", [-0.06, 0.05])
def test_a_clock_offset_is_found_and_not_applied(
    shift_s: float, takes: dict[str, Path], recording: Recording, vehicle: Vehicle, tmp_path: Path
) -> None:
    """Commands stamped `shift_s` too early want `shift_s` added, relative to the untouched take's own figure."""
    shifted = tmp_path / "shifted.csv"
    shifted.write_bytes(takes["motive"].read_bytes())
    commands = pd.read_csv(takes["motive"].with_suffix(".commands.csv"))
    commands.assign(time_s=commands.time_s - shift_s).to_csv(shifted.with_suffix(".commands.csv"), index=False)
    again = read_recording(shifted, vehicle)
    assert again.clock.offset_s is not None
    assert recording.clock.offset_s is not None
    assert again.clock.offset_ci95 is not None
    assert again.clock.offset_s - recording.clock.offset_s == pytest.approx(shift_s, abs=0.008)
    low, high = again.clock.offset_ci95
    assert low < shift_s < high + 0.005
    assert again.commands.time_s[0] == pytest.approx(-shift_s)
    applied = read_recording(shifted, vehicle.model_copy(update={"clock": _clock(shift_s)}))
    assert applied.commands.time_s[0] == pytest.approx(0.0)


def _clock(offset_s: float) -> Any:
    from bcid.vehicle import Clock

    return Clock(offset_s=offset_s)


def test_a_short_take_has_no_clock_estimate_and_says_why(vehicle: Vehicle, tmp_path: Path) -> None:
    clock = read_recording(circling_take(tmp_path, seconds=3.0), vehicle).clock
    assert clock.offset_s is None
    assert clock.reason


# --- refusals ----------------------------------------------------------------------------------------------------


def refused(path: Path, vehicle: Vehicle, match: str) -> None:
    with pytest.raises(InputRefused, match=match) as caught:
        read_recording(path, vehicle)
    error = caught.value
    assert error.exit_code == 4
    assert error.source
    assert error.place
    assert error.next_step


MOTIVE_REFUSALS: dict[str, tuple[Callable[[list[list[str]]], list[list[str]]], str]] = {
    "unknown version": (lambda r: set_key(r, "Format Version", "0.9"), "version '0.9'"),
    "unknown unit": (lambda r: set_key(r, "Length Units", "Furlongs"), "Furlongs"),
    "local space": (lambda r: set_key(r, "Coordinate Space", "Local"), "Global"),
    "no assets": (lambda r: [row[:2] for row in r], "no rigid body"),
    "other body": (lambda r: [[c.replace(BODY, "bumper_cart") for c in row] for row in r], "bumper_cart"),
    "no table": (lambda r: r[:6], "Frame"),
    "no frame": (lambda r: r[:7], "no frame follows"),
    "text": (lambda r: [*r[:50], [*r[50][:6], "oops", *r[50][7:]], *r[51:]], "line 51.*oops"),
    "wrong rate": (lambda r: set_key(r, "Export Frame Rate", "30"), "line"),
    "no order of axes": (lambda r: set_key(to_euler(r), "Rotation Type", "XXY"), "XXY"),
    "longer rows": (lambda r: [*r[:50], [*r[50], "1", "2"], *r[51:]], "line 51: holds 12 cells"),
    "no time column": (lambda r: [*r[:6], ["Frame", "Seconds", *r[6][2:]], *r[7:]], "no Time column"),
    "m as mm": (lambda r: set_key(r, "Length Units", "Millimeters"), "wheelbase"),
    "mm as m": (lambda r: set_key(scaled(1000.0, "Meters")(r), "Length Units", "Meters"), "mm or cm"),
}


@pytest.mark.parametrize("name", list(MOTIVE_REFUSALS))
def test_a_broken_motive_export_is_refused(name: str, takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    change, match = MOTIVE_REFUSALS[name]
    refused(rewritten(takes["motive"], tmp_path / "b.csv", change), vehicle, match)


def test_units_that_no_one_states_are_refused(takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    refused(rewritten(takes["motive"], tmp_path / "b.csv", as_1_22), vehicle, "length_unit")


COMMAND_REFUSALS: dict[str, tuple[Callable[[pd.DataFrame], pd.DataFrame], str]] = {
    "degrees": (lambda c: c.assign(steering_rad=np.degrees(c.steering_rad)), "degrees"),
    "inverted": (lambda c: c.assign(steering_rad=-c.steering_rad), "turns right"),
    "no column": (lambda c: c.drop(columns="throttle_mps"), "'throttle_mps': is not in the file"),
    "text": (lambda c: c.assign(throttle_mps=["x", *c.throttle_mps[1:]]), "row 1"),
    "empty": (lambda c: c[:0], "no commands"),
    "percent": (lambda c: c.assign(throttle_mps=100.0 * c.throttle_mps.clip(lower=0)), "percent"),
    "milliseconds": (lambda c: c.assign(time_s=1000.0 * c.time_s), "hold for"),
    "other time": (lambda c: c.assign(time_s=c.time_s + 1e4), "overlap"),
    "brake below -1": (lambda c: c.assign(throttle_mps=c.throttle_mps - 5.0), "brake share"),
}


@pytest.mark.parametrize("name", list(COMMAND_REFUSALS))
def test_broken_commands_are_refused(name: str, takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    change, match = COMMAND_REFUSALS[name]
    path = tmp_path / "c.csv"
    path.write_bytes(takes["motive"].read_bytes())
    change(pd.read_csv(takes["motive"].with_suffix(".commands.csv"))).to_csv(
        path.with_suffix(".commands.csv"), index=False
    )
    refused(path, vehicle, match)


def test_files_that_are_none_are_refused(takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    refused(tmp_path / "missing.csv", vehicle, "does not exist")
    refused(tmp_path, vehicle, "regular file")
    (tmp_path / "empty.csv").touch()
    refused(tmp_path / "empty.csv", vehicle, "is empty")
    (tmp_path / "note.doc").write_text("hello")
    refused(tmp_path / "note.doc", vehicle, "no MCAP file")
    (tmp_path / "plain.csv").write_text("a,b\n1,2\n")
    refused(tmp_path / "plain.csv", vehicle, r"\[columns\]")
    lone = tmp_path / "lone.csv"
    lone.write_bytes(takes["motive"].read_bytes())
    refused(lone, vehicle, r"lone\.commands\.csv")


def test_broken_mcap_files_are_refused(takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    whole = takes["mcap"].read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    refused(tmp_path / "cut.mcap", vehicle, "is cut")
    flipped = bytearray(whole)
    flipped[len(whole) // 3] ^= 0xFF
    (tmp_path / "flipped.mcap").write_bytes(bytes(flipped))
    refused(tmp_path / "flipped.mcap", vehicle, "byte 40: a chunk")
    topics = {
        "/mocap/bumper_car/pos": ("foxglove.PoseInFrame", [(0.0, {})]),
        "/bumper_car/command": ("own", [(0.0, {})]),
    }
    refused(json_mcap(tmp_path / "topic.mcap", topics), vehicle, "nearest: /mocap/bumper_car/pos")
    topics = {"/mocap/bumper_car/pose": ("foxglove.Log", [(0.0, {})]), "/bumper_car/command": ("own", [(0.0, {})])}
    refused(json_mcap(tmp_path / "type.mcap", topics), vehicle, "no known pose")
    topics = {
        "/mocap/bumper_car/pose": ("foxglove.PoseInFrame", [(0.0, {"pose": {}})]),
        "/bumper_car/command": ("own", [(0.0, {})]),
    }
    refused(json_mcap(tmp_path / "field.mcap", topics), vehicle, "missing: 'pose.position'")
    topics = {"/mocap/bumper_car/pose": ("foxglove.PoseInFrame", []), "/bumper_car/command": ("own", [(0.0, {})])}
    refused(json_mcap(tmp_path / "empty.mcap", topics), vehicle, "no messages")
    refused(
        json_mcap(
            tmp_path / "encoding.mcap",
            {
                "/mocap/bumper_car/pose": ("foxglove.PoseInFrame", [(0.0, {})]),
                "/bumper_car/command": ("own", [(0.0, {})]),
            },
            "flatbuffer",
        ),
        vehicle,
        "flatbuffer",
    )
