"""A recording as MCAP files of less usual kinds: poses in protobuf, commands as topics of one number each."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from mcap.writer import Writer
from mcap_ros2.writer import Writer as Ros2Writer

from bcid.recording.types import Recording

START_NS = 1_700_000_000_000_000_000


def as_protobuf(recording: Recording, path: Path) -> Path:
    """The recording's poses as foxglove.PoseInFrame in protobuf, its commands as JSON."""
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    files = descriptor_pb2.FileDescriptorSet()
    clock = files.file.add(name="clock.proto", package="google.protobuf", syntax="proto3")
    stamp = clock.message_type.add(name="Timestamp")
    stamp.field.add(name="seconds", number=1, type=3, label=1)
    stamp.field.add(name="nanos", number=2, type=5, label=1)
    pose = files.file.add(name="pose.proto", package="foxglove", syntax="proto3", dependency=["clock.proto"])
    for name, letters in (("Vector3", "xyz"), ("Quaternion", "xyzw")):
        vector = pose.message_type.add(name=name)
        for k, letter in enumerate(letters):
            vector.field.add(name=letter, number=k + 1, type=1, label=1)
    body = pose.message_type.add(name="Pose")
    body.field.add(name="position", number=1, type=11, label=1, type_name=".foxglove.Vector3")
    body.field.add(name="orientation", number=2, type=11, label=1, type_name=".foxglove.Quaternion")
    framed = pose.message_type.add(name="PoseInFrame")
    framed.field.add(name="timestamp", number=1, type=11, label=1, type_name=".google.protobuf.Timestamp")
    framed.field.add(name="frame_id", number=2, type=9, label=1)
    framed.field.add(name="pose", number=3, type=11, label=1, type_name=".foxglove.Pose")
    pool = descriptor_pool.DescriptorPool()
    for file in files.file:
        pool.Add(file)
    kind = message_factory.GetMessageClass(pool.FindMessageTypeByName("foxglove.PoseInFrame"))
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=20_000)
        writer.start()
        schema = writer.register_schema("foxglove.PoseInFrame", "protobuf", files.SerializeToString())
        poses = writer.register_channel("/pose", "protobuf", schema)
        commands = writer.register_channel("/command", "json", writer.register_schema("own", "jsonschema", b"{}"))
        for t, row in zip(recording.poses.time_s, recording.poses.values, strict=True):
            ns = START_NS + round(t * 1e9)
            message = kind(timestamp={"seconds": ns // 10**9, "nanos": ns % 10**9}, frame_id="floor")
            message.pose.position.x, message.pose.position.y, message.pose.position.z = row[0], row[1], 0.3
            message.pose.orientation.z, message.pose.orientation.w = np.sin(row[2] / 2), np.cos(row[2] / 2)
            writer.add_message(poses, ns, message.SerializeToString(), ns)
        for t, (u_s, u_m) in zip(recording.commands.time_s, recording.commands.values, strict=True):
            ns = START_NS + round(t * 1e9)
            stamp = {"sec": ns // 10**9, "nsec": ns % 10**9}
            command = {"timestamp": stamp, "steering_rad": u_s, "throttle_mps": u_m}
            writer.add_message(commands, ns, json.dumps(command).encode(), ns)
        writer.finish()
    return path


def as_single_numbers(recording: Recording, path: Path) -> Path:
    """The recording with poses on the floor, and steering and throttle as topics of one number each, in CDR."""
    with path.open("wb") as file:
        writer = Ros2Writer(file)
        pose = writer.register_msgdef("geometry_msgs/msg/Pose2D", "float64 x\nfloat64 y\nfloat64 theta")
        number = writer.register_msgdef("std_msgs/msg/Float64", "float64 data")
        for t, (x, y, yaw) in zip(recording.poses.time_s, recording.poses.values, strict=True):
            ns = START_NS + round(t * 1e9)
            writer.write_message("/pose", pose, {"x": x, "y": y, "theta": yaw}, log_time=ns, publish_time=ns)
        for t, (u_s, u_m) in zip(recording.commands.time_s, recording.commands.values, strict=True):
            ns = START_NS + round(t * 1e9)
            for topic, value in (("/steering", u_s), ("/throttle", u_m)):
                writer.write_message(topic, number, {"data": value}, log_time=ns, publish_time=ns)
        writer.finish()
    return path
