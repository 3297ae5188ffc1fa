"""Poses and commands in MCAP messages of every type, notation, axis and unit: the drive that they hold is the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap_ros2.writer import Writer as Ros2Writer
from test_readers import START_NS, json_mcap

from bcid.errors import InputRefused
from bcid.recording.formats.mcap_commands import CommandTrack, merge_commands
from bcid.recording.formats.mcap_times import MessageTrack
from bcid.recording.formats.raw import RawTake
from bcid.recording.read import read_raw_take
from bcid.vehicle import Vehicle

TIME = np.arange(600) / 60.0
YAW = 0.6 * TIME
POSE = np.column_stack([np.sin(YAW) / 0.6, (1.0 - np.cos(YAW)) / 0.6, YAW])
COMMANDS = [(t, {"header": {"stamp": {"sec": int(t), "nanosec": round(t % 1 * 1e9)}}, "steering_rad": 0.5,
                 "throttle_mps": 1.2}) for t in np.arange(200) / 20.0]  # fmt: skip
BARE_COMMANDS = [(t, {"steering_rad": 0.5, "throttle_mps": 1.2}) for t in np.arange(200) / 20.0]


def stamp(t: float) -> dict[str, int]:
    return {"sec": int(t), "nanosec": round(t % 1 * 1e9)}


def pose(row: np.ndarray, up: str = "Z", unit_m: float = 1.0) -> dict[str, Any]:
    """Position and orientation, Z-up or turned about X as Motive has it."""
    (x, y, yaw), s = row, 1.0 / unit_m
    turn = {"x": 0.0, "y": 0.0, "z": float(np.sin(yaw / 2)), "w": float(np.cos(yaw / 2))}
    where = {"x": s * float(x), "y": s * float(y), "z": s * 0.3}
    if up == "Y":
        where, turn = ({**where, "y": where["z"], "z": -where["y"]}, {**turn, "y": turn["z"], "z": 0.0})
    return {"position": where, "orientation": turn}


def car(vehicle: Vehicle, mocap: dict[str, Any] | None = None, **topics: Any) -> Vehicle:
    data = vehicle.model_dump(by_alias=True, exclude_unset=True)
    data["topics"] = {"pose": "/pose", "command": "/command", **topics}
    data["mocap"] = {"rigid_body": "bumper_car", **(mocap or {})}
    return Vehicle.model_validate(data)


def written(folder: Path, kind: str, make: Any, commands: list[Any] = COMMANDS) -> Path:
    rows = [(t, make(t, row)) for t, row in zip(TIME, POSE, strict=True)]
    return json_mcap(folder / "t.mcap", {"/pose": (kind, rows), "/command": ("own", commands)})


def same_drive(raw: RawTake, atol: float = 1e-9) -> None:
    np.testing.assert_allclose(raw.pose_time_s, TIME, atol=1e-6)
    np.testing.assert_allclose(raw.pose[:, :2], POSE[:, :2], atol=atol)
    np.testing.assert_allclose(np.unwrap(raw.pose[:, 2]), YAW, atol=atol)


def header(t: float) -> dict[str, Any]:
    return {"header": {"stamp": stamp(t)}}


def two(row: np.ndarray, name: str, **more: Any) -> list[dict[str, Any]]:
    """Another body, then the car."""
    other = {name: "lamp", "pose": pose(np.add(row, [3.0, 0.0, 0.0]))}
    return [other, {name: "bumper_car", "pose": pose(row), **more}]


KINDS: dict[str, Any] = {
    "motion_capture_tracking_interfaces/msg/NamedPoseArray": lambda t, r: {**header(t), "poses": two(r, "name")},
    "mocap4r2_msgs/msg/RigidBodies": lambda t, r: {**header(t), "rigidbodies": two(r, "rigid_body_name")},
    "geometry_msgs/msg/PoseArray": lambda t, r: {**header(t), "poses": [pose(r)]},
    "foxglove.PosesInFrame": lambda t, r: {"timestamp": stamp(t), "poses": [pose(r)]},
    "foxglove.FrameTransform": lambda t, r: {
        "timestamp": stamp(t), "parent_frame_id": "map", "child_frame_id": "bumper_car",
        "translation": pose(r)["position"], "rotation": pose(r)["orientation"],
    },
    "foxglove.FrameTransforms": lambda t, r: {"transforms": [
        KINDS["foxglove.FrameTransform"](t, r),
        {**KINDS["foxglove.FrameTransform"](t, np.add(r, [3, 0, 0])), "child_frame_id": "lamp"},
    ]},
}  # fmt: skip


@pytest.mark.parametrize("kind", list(KINDS))
def test_lists_of_bodies_and_foxglove_s_types(kind: str, vehicle: Vehicle, tmp_path: Path) -> None:
    same_drive(read_raw_take(written(tmp_path, kind, KINDS[kind]), car(vehicle)))


BARE = {
    "geometry_msgs/msg/Pose": lambda t, r: pose(r),
    "geometry_msgs/msg/Pose2D": lambda t, r: {"x": r[0], "y": r[1], "theta": r[2]},
    "geometry_msgs/msg/Transform": lambda t, r: {
        "translation": pose(r)["position"], "rotation": pose(r)["orientation"],
    },
    "vicon_receiver/msg/Position": lambda t, r: {
        "subject_name": "c", "x_trans": 1e3 * r[0], "y_trans": 1e3 * r[1], "z_trans": 450.0, "x_rot": 0.0, "y_rot": 0.0,
        "z_rot": np.sin(r[2] / 2), "w": np.cos(r[2] / 2),
    },
}  # fmt: skip


@pytest.mark.parametrize("kind", list(BARE))
def test_poses_without_a_header_are_read_by_log_times(kind: str, vehicle: Vehicle, tmp_path: Path) -> None:
    raw = read_raw_take(written(tmp_path, kind, BARE[kind]), car(vehicle))
    same_drive(raw)
    assert [i.kind for i in raw.irregularities] == ["time base"]


def test_a_body_that_is_not_in_the_list_is_refused_with_those_that_are(vehicle: Vehicle, tmp_path: Path) -> None:
    kind = "mocap4r2_msgs/msg/RigidBodies"
    path = written(tmp_path, kind, KINDS[kind])
    with pytest.raises(InputRefused, match=r"no message holds the body 'cart'; there are lamp, bumper_car"):
        read_raw_take(path, car(vehicle, {"rigid_body": "cart"}))
    with pytest.raises(InputRefused, match="several bodies: lamp, bumper_car"):
        read_raw_take(path, car(vehicle, {"rigid_body": None}))


def test_poses_without_names_need_a_place(vehicle: Vehicle, tmp_path: Path) -> None:
    path = written(tmp_path, "geometry_msgs/PoseArray",
                   lambda t, r: {**header(t), "poses": [pose(np.add(r, [2, 0, 0])), pose(r)]})  # fmt: skip
    with pytest.raises(InputRefused, match=r"poses\[0\], poses\[1\](.|\n)*pose_fields"):
        read_raw_take(path, car(vehicle))
    same_drive(read_raw_take(path, car(vehicle, pose_fields=quaternion_fields("poses[1]"))))


def quaternion_fields(at: str) -> dict[str, str]:
    position = {f"{c}_m": f"{at}.position.{c}" for c in "xyz"}
    return {**position, **{f"q{c}": f"{at}.orientation.{c}" for c in "xyzw"}}


@pytest.mark.parametrize("up", ["Z", "Y"])
@pytest.mark.parametrize("unit", ["m", "cm", "mm"])
def test_axes_and_units_hold_for_messages_and_mapped_fields(
    up: str, unit: str, vehicle: Vehicle, tmp_path: Path
) -> None:
    size = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}[unit]
    mocap = {"up_axis": "Y", "length_unit": unit}
    path = written(tmp_path, "geometry_msgs/PoseStamped", lambda t, r: {**header(t), "pose": pose(r, up, size)})
    same_drive(read_raw_take(path, car(vehicle, mocap)))
    path = written(tmp_path, "my/Bodies", lambda t, r: {
        **header(t), "bodies": [{"name": "lamp", "pose": pose(np.add(r, [1, 1, 0]), up, size)},
                                {"name": "the car", "pose": pose(r, up, size)}]})  # fmt: skip
    fields = quaternion_fields("bodies[name=the car].pose")
    same_drive(read_raw_take(path, car(vehicle, mocap, pose_fields=fields)))
    if up == "Y":
        with pytest.raises(InputRefused, match='up_axis = "Y"'):
            read_raw_take(path, car(vehicle, {**mocap, "up_axis": "Z"}, pose_fields=fields))


def test_a_chosen_body_that_is_missing_at_times_is_a_dropout(vehicle: Vehicle, tmp_path: Path) -> None:
    def make(t: float, row: np.ndarray) -> dict[str, Any]:
        return {**header(t), "bodies": [] if 2.0 < t < 3.0 else [{"name": "car", "pose": pose(row)}]}

    path = written(tmp_path, "my/Bodies", make)
    raw = read_raw_take(path, car(vehicle, pose_fields=quaternion_fields("bodies[name=car].pose")))
    assert np.isnan(raw.pose).any(axis=1).sum() == 59
    with pytest.raises(InputRefused, match=r"no message holds bodies\[name=cat\].*there are car"):
        read_raw_take(path, car(vehicle, pose_fields=quaternion_fields("bodies[name=cat].pose")))


def test_a_yaw_mapped_from_a_part_of_a_quaternion_is_refused(vehicle: Vehicle, tmp_path: Path) -> None:
    path = written(tmp_path, "geometry_msgs/Pose", lambda t, r: pose(r))
    fields = {"x_m": "position.x", "y_m": "position.y", "yaw_rad": "orientation.z"}
    with pytest.raises(InputRefused, match=r'part of a quaternion(.|\n)*qw = "orientation\.w"'):
        read_raw_take(path, car(vehicle, pose_fields=fields))


def test_messages_of_several_bodies_on_one_topic(vehicle: Vehicle, tmp_path: Path) -> None:
    def moved(name: str, t: float, row: np.ndarray) -> dict[str, Any]:
        at = pose(row)
        return {**header(t), "child_frame_id": name,
                "transform": {"translation": at["position"], "rotation": at["orientation"]}}  # fmt: skip

    rows = [(t, moved(name, t, row)) for t, row in zip(TIME, POSE, strict=True) for name in ("lamp", "bumper_car")]
    kind = "geometry_msgs/TransformStamped"
    path = json_mcap(tmp_path / "t.mcap", {"/pose": (kind, rows), "/command": ("own", COMMANDS)})
    same_drive(read_raw_take(path, car(vehicle)))
    with pytest.raises(InputRefused, match="hold the bodies lamp, bumper_car, none is 'cart'"):
        read_raw_take(path, car(vehicle, {"rigid_body": "cart"}))


# --- commands on two topics --------------------------------------------------------------------------------------


def two_topics(folder: Path, kind: str, **options: Any) -> Path:
    """Steering at 20 Hz and throttle at 3 Hz, each a message of one number, in CDR."""
    number = "float64" if kind.endswith("64") else "float32"
    with (folder / "t.mcap").open("wb") as file:
        writer = Ros2Writer(file, **options)
        floor = writer.register_msgdef("geometry_msgs/msg/Pose2D", "float64 x\nfloat64 y\nfloat64 theta")
        single = writer.register_msgdef(f"std_msgs/msg/{kind}", f"{number} data")
        for t, (x, y, yaw) in zip(TIME, POSE, strict=True):
            put(writer, "/pose", floor, t, {"x": x, "y": y, "theta": yaw})
        for k, t in enumerate(np.arange(200) / 20.0):
            put(writer, "/servo", single, t, {"data": 0.1 * (k % 5)})
        for k, t in enumerate(0.12 + np.arange(29) / 3.0):
            put(writer, "/motor", single, t, {"data": float(k)})
        writer.finish()
    return folder / "t.mcap"


def put(writer: Ros2Writer, topic: str, schema: Any, t: float, message: dict[str, float]) -> None:
    ns = START_NS + round(t * 1e9)
    writer.write_message(topic, schema, message, log_time=ns, publish_time=ns)


@pytest.mark.parametrize("kind", ["Float64", "Float32"])
def test_steering_and_throttle_on_two_topics_are_merged_exactly(kind: str, vehicle: Vehicle, tmp_path: Path) -> None:
    path = two_topics(tmp_path, kind)
    raw = read_raw_take(path, car(vehicle, command={"steering": "/servo", "throttle": "/motor"}))
    steering_s, throttle_s = np.arange(200) / 20.0, 0.12 + np.arange(29) / 3.0
    wanted = np.unique(np.round(np.r_[steering_s, throttle_s], 9))
    wanted = wanted[wanted >= 0.12]  # before, no throttle was known
    np.testing.assert_allclose(raw.command_time_s, wanted, atol=1e-9)
    for t, (u_s, u_m) in zip(raw.command_time_s, raw.command, strict=True):
        k, m = np.flatnonzero(steering_s <= t + 1e-6)[-1], np.flatnonzero(throttle_s <= t + 1e-6)[-1]
        assert u_s == pytest.approx(0.1 * (k % 5), abs=1e-7)
        assert u_m == m


def test_two_topics_by_fields_of_their_own(vehicle: Vehicle, tmp_path: Path) -> None:
    poses = [(t, {**header(t), "pose": pose(row)}) for t, row in zip(TIME, POSE, strict=True)]
    servo = [(t, {**header(t), "angle": {"deg": 10.0}}) for t in np.arange(200) / 20.0]
    motor = [(t, {**header(t), "erpm": 4600.0}) for t in np.arange(200) / 20.0]
    path = json_mcap(tmp_path / "t.mcap", {
        "/pose": ("geometry_msgs/PoseStamped", poses), "/servo": ("a", servo), "/motor": ("b", motor),
    })  # fmt: skip
    both = {"steering": "/servo", "throttle": "/motor"}
    with pytest.raises(InputRefused, match=r"/servo: type a has no steering_rad: it is no known steering; it has"):
        read_raw_take(path, car(vehicle, command=both))
    fields = {"steering_rad": {"from": "angle.deg", "gain": np.pi / 180},
              "throttle_mps": {"from": "erpm", "gain": 1 / 4600}}  # fmt: skip
    raw = read_raw_take(path, car(vehicle, command=both, command_fields=fields))
    np.testing.assert_allclose(raw.command, [[np.pi / 18, 1.0]] * 200)


def test_a_number_on_one_topic_is_no_command_and_two_topics_are_advised(vehicle: Vehicle, tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match=r"command = \{steering ="):
        read_raw_take(two_topics(tmp_path, "Float64"), car(vehicle, command="/servo"))


def test_messages_of_one_instant_make_one_row() -> None:
    def track(values: list[float], column: str) -> CommandTrack:
        n = len(values)
        return CommandTrack((column,), MessageTrack([0] * n, [None] * n, np.array(values)[:, None]))

    steering, throttle = track([1.0, 2.0, 3.0], "steering_rad"), track([7.0, 8.0], "throttle_mps")
    times = [np.array([0.0, 1.0, 2.0]), np.array([1.0, 1.5])]
    time_s, values = merge_commands([steering, throttle], times, 0.5)
    np.testing.assert_array_equal(time_s, [1.0, 1.5, 2.0])
    np.testing.assert_array_equal(values, [[2.0, 7.0], [2.0, 8.0], [3.0, 8.0]])


def test_speeds_below_zero_are_read_where_the_car_reverses(vehicle: Vehicle, tmp_path: Path) -> None:
    poses = [(t, {**header(t), "pose": pose(row)}) for t, row in zip(TIME, POSE, strict=True)]
    drive = [(t, {**header(t), "drive": {"steering_angle": 0.1, "speed": -0.5}}) for t in np.arange(200) / 20.0]
    path = json_mcap(tmp_path / "t.mcap", {
        "/pose": ("geometry_msgs/PoseStamped", poses), "/command": ("ackermann_msgs/AckermannDriveStamped", drive),
    })  # fmt: skip
    with pytest.raises(InputRefused, match=r"motor\.reverses = true"):
        read_raw_take(path, car(vehicle))
    data = car(vehicle).model_dump(by_alias=True, exclude_unset=True)
    data["motor"] = {**data.get("motor", {}), "reverses": True}
    assert (read_raw_take(path, Vehicle.model_validate(data)).command[:, 1] == -0.5).all()
