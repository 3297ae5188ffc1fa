"""Every example of MCAP messages in docs/formats.md is what a program sends of a drive, and is read as that drive."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_formats_doc import CAR, DOC, GAS, QW, QZ, STEER, T_C, YAW, T, X, Y
from test_readers import START_NS, json_mcap

from bcid.recording.formats.ros_messages import COMMAND_PATHS, FLOOR_POSES, POSE_LISTS, SINGLE_POSES
from bcid.recording.formats.transforms import TREE_SCHEMAS
from bcid.recording.read import read_raw_take
from bcid.vehicle import Vehicle

SHOWN = 100
"""The message that the docs show: at 1 s."""

Make = Callable[[int], dict[str, Any]]


def header(ns: int) -> dict[str, Any]:
    return {"header": {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}}}


def posed(k: int) -> dict[str, Any]:
    return header(START_NS + round(T[k] * 1e9))


def commanded(k: int) -> dict[str, Any]:
    return header(START_NS + round(T_C[k] * 1e9))


def short(value: float) -> float:
    return round(float(value), 6)


def pose(k: int, x: float = 0.0) -> dict[str, Any]:
    where = {"x": short(X[k] + x), "y": short(Y[k]), "z": 0.3}
    return {"position": where, "orientation": {"x": 0.0, "y": 0.0, "z": short(QZ[k]), "w": short(QW[k])}}


def y_up_mm(k: int) -> dict[str, Any]:
    where = {"x": short(1e3 * X[k]), "y": 300.0, "z": short(-1e3 * Y[k])}
    return {"position": where, "orientation": {"x": 0.0, "y": short(QZ[k]), "z": 0.0, "w": short(QW[k])}}


def moved(parent: str, child: str, k: int, x: float, y: float) -> dict[str, Any]:
    at = {"translation": {"x": short(x), "y": short(y), "z": 0.3}, "rotation": pose(k)["orientation"]}
    stamp = posed(k)["header"]["stamp"]
    return {"header": {"stamp": stamp, "frame_id": parent}, "child_frame_id": child, "transform": at}


ACKERMANN = ("ackermann_msgs/msg/AckermannDriveStamped", lambda k: {
    **commanded(k), "drive": {"steering_angle": short(STEER[k]), "speed": GAS}})  # fmt: skip
OWN = ("bcid.Command", lambda k: {
    "timestamp": commanded(k)["header"]["stamp"], "steering_rad": short(STEER[k]), "throttle_mps": GAS})  # fmt: skip
STAMPED = ("geometry_msgs/msg/PoseStamped", lambda k: {**posed(k), "pose": pose(k)})

EXAMPLES: dict[str, dict[str, tuple[str, Make]]] = {
    "A stamped pose and an Ackermann command": {"/car/pose": STAMPED, "/drive": ACKERMANN},
    "Positions in mm with Y up": {
        "/car/pose": ("geometry_msgs/msg/PoseStamped", lambda k: {**posed(k), "pose": y_up_mm(k)}), "/drive": ACKERMANN,
    },
    "A list of bodies with names": {
        "/bodies": ("mocap4r2_msgs/msg/RigidBodies", lambda k: {**posed(k), "rigidbodies": [
            {"rigid_body_name": "lamp", "pose": pose(k, 3.0)}, {"rigid_body_name": "car", "pose": pose(k)}]}),
        "/drive": ACKERMANN,
    },
    "A list of bodies without names": {
        "/bodies": ("geometry_msgs/msg/PoseArray", lambda k: {**posed(k), "poses": [pose(k, 3.0), pose(k)]}),
        "/drive": ACKERMANN,
    },
    "A type of one's own": {
        "/tracker": ("my_msgs/msg/Bodies", lambda k: {"time_ms": START_NS // 10**6 + round(T[k] * 1e3), "bodies": [
            {"name": "lamp", "at": [0.0, 0.0, 0.0], "yaw_deg": 0.0},
            {"name": "car", "at": [short(1e3 * X[k]), short(1e3 * Y[k]), 0.3], "yaw_deg": short(np.degrees(YAW[k]))}]}),
        "/drive": ACKERMANN,
    },
    "A tree of transforms": {
        "/tf_static": ("tf2_msgs/msg/TFMessage", lambda k: {"transforms": [moved("map", "odom", 0, 1.0, 0.5)]}),
        "/tf": ("tf2_msgs/msg/TFMessage", lambda k: {"transforms": [moved("odom", "car", k, X[k] - 1.0, Y[k] - 0.5)]}),
        "/drive": ACKERMANN,
    },
    "Steering and throttle on two topics": {
        "/car/pose": STAMPED,
        "/servo": ("std_msgs/msg/Float64", lambda k: {"data": short(STEER[k])}),
        "/motor": ("std_msgs/msg/Float64", lambda k: {"data": GAS}),
    },
    "A joystick, or a Twist whose angular.z is an angle": {
        "/car/pose": STAMPED,
        "/joy": ("sensor_msgs/msg/Joy", lambda k: {**commanded(k), "axes": [short(STEER[k] / 2.0), GAS / 3.0]}),
    },
    "JSON of bcid's own": {"/car/pose": ("foxglove.PoseInFrame", lambda k: {
        "timestamp": posed(k)["header"]["stamp"], "pose": pose(k)}), "/command": OWN},
}  # fmt: skip


def examples() -> dict[str, tuple[str, str]]:
    """The vehicle file's part and the messages of each example, by its title."""
    found = {}
    for part in DOC.read_text(encoding="utf-8").partition("\n## MCAP and ROS")[2].split("\n### ")[1:]:
        title, _, body = part.partition("\n")
        blocks = dict(re.findall(r"```(toml|text)\n(.*?)```", body, re.DOTALL))
        if "text" in blocks:
            found[title] = (blocks["toml"], blocks["text"])
    return found


def shown(topics: dict[str, tuple[str, Make]]) -> str:
    """The messages as the docs show them."""
    rows = []
    for topic, (kind, make) in topics.items():
        k = SHOWN if topic in POSE_TOPICS else SHOWN // 10
        rows.append(f"{topic} {kind}\n  {json.dumps(make(k))}\n")
    return "".join(rows)


POSE_TOPICS = ("/car/pose", "/bodies", "/tracker", "/tf", "/tf_static")


def test_every_example_is_shown_as_it_is_tried() -> None:
    assert {title: text for title, (_, text) in examples().items()} == {t: shown(e) for t, e in EXAMPLES.items()}


@pytest.mark.parametrize("title", list(EXAMPLES))
def test_messages_are_read_as_the_docs_show(title: str, tmp_path: Path) -> None:
    times = {"/tf_static": T[:1], **dict.fromkeys(("/car/pose", "/bodies", "/tracker", "/tf"), T)}
    topics = {
        topic: (kind, [(t, make(k)) for k, t in enumerate(times.get(topic, T_C))])
        for topic, (kind, make) in EXAMPLES[title].items()
    }
    vehicle = Vehicle.model_validate({**CAR, **tomllib.loads(examples()[title][0])})
    take = read_raw_take(json_mcap(tmp_path / "drive.mcap", topics), vehicle)
    np.testing.assert_allclose(take.pose_time_s, T, atol=1e-5)
    np.testing.assert_allclose(take.pose, np.column_stack([X, Y, YAW]), atol=1e-5)
    np.testing.assert_allclose(take.command_time_s, T_C, atol=1e-5)
    np.testing.assert_allclose(take.command, np.column_stack([STEER, np.full_like(STEER, GAS)]), atol=1e-5)


def test_every_type_that_is_read_is_listed() -> None:
    listed = set(re.findall(r"`((?:\w+/|foxglove\.)\w+)`", DOC.read_text(encoding="utf-8").partition("\n## MCAP")[2]))
    assert {*SINGLE_POSES, *POSE_LISTS, *FLOOR_POSES, *TREE_SCHEMAS, *COMMAND_PATHS} <= listed
