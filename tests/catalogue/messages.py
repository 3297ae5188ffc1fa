"""Rows 71 to 76 of the catalogue: messages as other programs write them, behind checksums that hold; a bag's folder."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
from faults.mcap_mutants import rewritten
from test_pose_messages import two_topics

from catalogue.lab import COMMAND, NS0, POSE, Lab, Message, Tries
from catalogue.rows import row

RULE = "=" * 80
POINTS = f"\n{RULE}\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z"
TURNS = f"\n{RULE}\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w"
PLAIN_POSE = f"Point position\nQuaternion orientation{POINTS}{TURNS}"
BARE = ("foxglove.PoseInFrame", "bcid.Command")


def restamped(messages: list[Message], write: Any) -> list[Message]:
    """The messages with stamps in another notation, by `write` of ns."""
    found = []
    for log, message in messages:
        ns = message["timestamp"]["sec"] * 10**9 + message["timestamp"]["nsec"]
        found.append((log, {**message, "timestamp": write(ns)}))
    return found


STAMPS: dict[str, Any] = {
    "ROS 1: {secs, nsecs}": lambda ns: {"secs": ns // 10**9, "nsecs": ns % 10**9},
    "RFC 3339": lambda ns: str(np.datetime64(ns, "ns")) + "Z",
    "s": lambda ns: ns / 1e9, "ms": lambda ns: ns / 1e6, "ns": lambda ns: ns, "text of s": lambda ns: f"{ns / 1e9:.6f}",
    "a clock time without a date": lambda ns: str(np.datetime64(ns, "ms"))[11:], "true": lambda ns: True,
    "1e400": lambda ns: 10**400,
}  # fmt: skip


@row(71)
def _(lab: Lab) -> Tries:
    for name, write in STAMPS.items():
        yield f"mcap: stamps as {name}", lab.mcap(restamped(lab.poses(), write), restamped(lab.commands(), write))


@row(72)
def _(lab: Lab) -> Tries:
    last = np.minimum((np.arange(len(lab.T)) // 6 + 1) * 6, len(lab.T)) - 1
    bursts = lab.T[last] + 1e-4 * (np.arange(len(lab.T)) % 6)
    stamped = lab.poses(bursts)
    even = [(NS0 + round(t * 1e9), m) for t, (_, m) in zip(lab.T, stamped, strict=True)]
    yield "mcap: stamps in bursts, log times even", lab.mcap(even)
    yield "mcap: both in bursts", lab.mcap(stamped)
    held = lab.T.copy()
    for begin in np.arange(1.0, 29.0, 1.0):
        part = lab.mid(begin, begin + 0.4)
        held[part] = lab.T[part].max() + 1e-5 * np.arange(part.sum())
    yield "mcap: held back for 0.4 s each second", lab.mcap(lab.poses(held))


@row(73)
def _(lab: Lab) -> Tries:
    def posed(change: Any) -> list[Message]:
        return [(log, change(m["pose"]["position"], m["pose"]["orientation"], m)) for log, m in lab.poses()]

    def y_up(at: dict[str, float], turn: dict[str, float], m: Any) -> Any:
        where = {"x": at["x"], "y": at["z"], "z": -at["y"]}
        return {**m, "pose": {"position": where, "orientation": {**turn, "y": turn["z"], "z": 0.0}}}

    yield "mcap: Y-up", lab.mcap(posed(y_up))
    yield "   up_axis = Z", lab.folder / "b.mcap", lab.veh(mocap={"up_axis": "Z"})
    mirrored = posed(lambda at, turn, m: {**m, "pose": {"position": {**at, "y": -at["y"]}, "orientation": turn}})
    yield "mcap: left-handed axes", lab.mcap(mirrored)
    for unit, k in (("mm", 1e3), ("cm", 1e2)):
        scaled = posed(
            lambda at, turn, m, k=k: {**m, "pose": {"position": {c: k * v for c, v in at.items()}, "orientation": turn}}
        )
        yield f"mcap: {unit}", lab.mcap(scaled)
        yield f"   length_unit = {unit}", lab.folder / "b.mcap", lab.veh(mocap={"length_unit": unit})
    listed = [(log, {"timestamp": m["timestamp"], "poses": [m["pose"], m["pose"]]}) for log, m in lab.poses()]
    yield "mcap: foxglove.PosesInFrame of two bodies", lab.mcap(listed, types=("foxglove.PosesInFrame", BARE[1]))
    fields = {f"{c}_m": f"poses[1].position.{c}" for c in "xyz"}
    fields |= {f"q{c}": f"poses[1].orientation.{c}" for c in "xyzw"}
    yield "   poses[1] mapped", lab.folder / "b.mcap", lab.veh(topics={"pose_fields": fields})
    yield (
        "   yaw_rad = poses[1].orientation.z",
        lab.folder / "b.mcap",
        lab.veh(topics={"pose_fields": {"x_m": fields["x_m"], "y_m": fields["y_m"], "yaw_rad": fields["qz"]}}),
    )
    named = [
        (log, {"header": {"stamp": m["timestamp"]}, "rigidbodies": [{"rigid_body_name": "cart", "pose": m["pose"]}]})
        for log, m in lab.poses()
    ]
    yield "mcap: RigidBodies without the body", lab.mcap(named, types=("mocap4r2_msgs/RigidBodies", BARE[1]))


@row(74)
def _(lab: Lab) -> Tries:
    single = two_topics(lab.folder, "Float64")
    yield "mcap: one topic of one number", single, lab.veh(topics={"pose": "/pose", "command": "/servo"})
    limit = lab.vehicle.steering.max_angle_rad
    lock = np.column_stack([np.float64(np.float32(np.where(lab.C[:, 0] > 0, limit, -limit))), lab.C[:, 1]])
    lock[:, 0] = np.where(np.abs(lab.C[:, 0]) > 0.9 * limit, lock[:, 0], lab.C[:, 0])
    yield "mcap: full lock in float32", lab.mcap(None, lab.commands(None, lock))
    beyond = np.where(np.abs(lab.C[:, :1]) > 0.9 * limit, 1.2 * lab.C[:, :1], lab.C[:, :1])
    yield "mcap: asked beyond the stop", lab.mcap(None, lab.commands(None, np.column_stack([beyond, lab.C[:, 1]])))
    fine = np.repeat(lab.C, 2, axis=0) + np.where(np.arange(2 * len(lab.C)) % 2, 0.2, -0.2)[:, None] * [1.0, 0.0]
    fine_s = np.sort(np.r_[lab.TC, lab.TC + 0.5 * np.median(np.diff(lab.TC))])
    yield "mcap: a controller that chatters", lab.mcap(None, lab.commands(fine_s, fine))


def ros(lab: Lab, definition: str, data: bytes = b"\0\1\0\0" + bytes(200)) -> Path:
    """A file whose pose topic holds CDR messages of this definition."""
    messages = [(log, data) for log, _ in lab.poses()]
    path = lab.mcap(messages, types=("geometry_msgs/msg/Pose", BARE[1]), encoding=("cdr", "json"))

    def define(item: Any) -> Any:
        schema, channel, message = item
        if channel.topic == POSE:
            schema.encoding, schema.data = "ros2msg", definition.encode()
        return schema, channel, message

    path.write_bytes(rewritten(path.read_bytes(), define, np.random.default_rng(1), 1.0))
    return path


@row(75)
def _(lab: Lab) -> Tries:
    def one(content: Any) -> Path:
        poses = lab.poses()
        poses[700] = (poses[700][0], content(poses[700][1]) if callable(content) else content)
        return lab.mcap(poses)

    yield "mcap: one message nested 100,000 deep", one(b"[" * 100_000)
    yield "mcap: one message is no JSON", one(b"\xff\xfe")
    yield "mcap: a position true", one(lambda m: {**m, "pose": {**m["pose"], "position": {"x": True, "y": 0, "z": 0}}})
    yield (
        'mcap: a position "0_1.5"',
        one(lambda m: {**m, "pose": {**m["pose"], "position": {"x": "0_1.5", "y": 0, "z": 0}}}),
    )
    yield "mcap: one message of 1 MB", one(b'"' + b"x" * 1_000_000 + b'"')
    yield "mcap: a type that holds itself", ros(lab, f"Pose again\n{PLAIN_POSE}")
    yield "mcap: a wstring", ros(lab, f"wstring w\n{PLAIN_POSE}")
    yield "mcap: an array of a billion", ros(lab, f"float64[1000000000] x\n{PLAIN_POSE}")
    yield "mcap: a message that states a list beyond its end", ros(lab, "uint8[] x", b"\0\1\0\0\xff\xff\xff\xff")
    bad = "\x1b[31m"
    yield "mcap: a topic with control characters", lab.mcap(name="c"), lab.veh(topics={"command": f"{COMMAND}{bad}"})


def bag(lab: Lab, name: str, files: list[str], listed: list[str] | None) -> Path:
    """A folder with the drive under these names, and a metadata.yaml that lists these, or none."""
    folder = lab.folder / name
    folder.mkdir()
    for file in files:
        shutil.copy(lab.mcap_file, folder / file)
    if listed is not None:
        lines = "".join(f"    - {file}\n" for file in listed)
        (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  relative_file_paths:\n{lines}")
    return folder


@row(76)
def _(lab: Lab) -> Tries:
    yield "bag: a file that is not named", bag(lab, "foreign", ["a_0.mcap", "z_7.mcap"], ["a_0.mcap"])
    yield "bag: names with spaces and a folder", bag(lab, "spaces", ["my a_0.mcap"], ["bag/my a_0.mcap"])
    yield "bag: a name that leads out", bag(lab, "out", [], ["../../secret.mcap"])
    yield "bag: no metadata.yaml", bag(lab, "bare", ["a_0.mcap"], None)
    yield "bag: no metadata.yaml, two takes", bag(lab, "mixed", ["a_0.mcap", "b_0.mcap"], None)
    yield "bag: metadata.yaml names nothing", bag(lab, "nothing", ["a_0.mcap"], [])
    packed = bag(lab, "packed", [], ["a_0.mcap.zstd"])
    (packed / "a_0.mcap.zstd").write_bytes(b"\x28\xb5\x2f\xfd" + bytes(20))
    yield "bag: compressed whole", packed
    sqlite = bag(lab, "sqlite", [], ["a_0.db3"])
    (sqlite / "a_0.db3").write_bytes(b"SQLite format 3\0" + bytes(100))
    yield "bag: in SQLite", sqlite
