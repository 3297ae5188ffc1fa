"""The clocks of an MCAP file, and the tree of its transforms."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from mcap.writer import Writer
from test_readers import json_mcap

from bcid.errors import InputRefused
from bcid.recording.formats.mcap_contents import read_contents
from bcid.recording.formats.mcap_times import MessageTrack, common_times
from bcid.recording.formats.transforms import (
    FrameTransforms,
    compose_transforms,
    edges_to_world,
    find_rare_frames,
    read_transform_tree,
    read_transforms,
)
from bcid.recording.read import read_recording
from bcid.recording.types import Recording
from bcid.vehicle import Topics, Vehicle

TOPICS = Topics(pose="/pose", command="/command")
NS = 1_000_000_000
START = 1_700_000_000 * NS
PATH = Path("take.mcap")


def track(stamps: np.ndarray | None, logged: np.ndarray, topic: str = "/pose") -> MessageTrack:
    values = np.zeros((len(logged), 2))
    ns = [START + round(t * NS) for t in logged]
    stamp_ns = [None] * len(ns) if stamps is None else [START + round(t * NS) for t in stamps]
    return MessageTrack(ns, stamp_ns, values, topic=topic)


def test_a_stamp_clock_that_steps_is_split_there_and_a_late_message_is_not() -> None:
    t = np.arange(600) / 60.0
    late = t.copy()
    late[200] += 0.5  # arrives late
    stepped = t + 3.0 * (np.arange(600) >= 300)
    command = track(t, t)
    assert common_times(track(t, late), [command], TOPICS, PATH).splits_s == ()
    found = common_times(track(stepped, t), [command], TOPICS, PATH)
    assert found.splits_s == (pytest.approx(t[300] + 3.0),)
    assert found.irregularities[0].kind == "clock jump"


def test_a_gap_in_the_recording_is_no_clock_jump() -> None:
    t = np.arange(600) / 60.0 + 2.0 * (np.arange(600) >= 300)
    assert common_times(track(t, t), [track(t, t)], TOPICS, PATH).splits_s == ()


@pytest.mark.parametrize("ns", [0, 1 << 63, (1 << 64) - 1])
def test_a_log_time_that_is_none_is_refused_for_its_topic_or_not_needed(ns: int) -> None:
    t = np.arange(600) / 60.0
    pose, command = track(None, t), track(None, t, "/command")
    command.log_ns[100] = ns
    with pytest.raises(InputRefused, match=f"topic /command: 1 of 600 log times .*message 101: {ns} ns"):
        common_times(pose, [command], TOPICS, PATH)
    stamped, late = track(t, t), track(t, t)
    stamped.log_ns[100] = late.log_ns[100] = ns
    np.testing.assert_allclose(common_times(stamped, [late], TOPICS, PATH).command_s[0], t, atol=1e-9)


def test_bursts_are_put_on_an_even_grid() -> None:
    t = np.arange(600) / 60.0
    arrives = np.ceil((np.arange(600) + 1) / 5.0) * 5.0 / 60.0 + 1e-4 * (np.arange(600) % 5)
    found = common_times(track(None, arrives), [track(None, t)], TOPICS, PATH)
    steps = np.diff(found.pose_s)
    np.testing.assert_allclose(steps, 1.0 / 60.0, rtol=1e-2)
    assert [i.kind for i in found.irregularities] == ["time base", "bursts"]
    even = common_times(track(None, t), [track(None, t)], TOPICS, PATH)
    assert [i.kind for i in even.irregularities] == ["time base"]


def in_bursts(t: np.ndarray, size: int) -> np.ndarray:
    """Times of arrival of messages that are sent at `t` and wait for the last of `size`."""
    last = np.minimum((np.arange(len(t)) // size + 1) * size, len(t)) - 1
    return t[last] + 1e-4 * (np.arange(len(t)) % size)


def test_stamps_in_bursts_give_way_to_even_log_times() -> None:
    t = np.arange(600) / 60.0
    pose, command = track(in_bursts(t, 6), t), track(t, t, "/command")
    found = common_times(pose, [command], TOPICS, PATH)
    np.testing.assert_allclose(found.pose_s, t, atol=1e-9)
    np.testing.assert_allclose(found.command_s[0], t, atol=1e-9)
    (told,) = found.irregularities
    assert (told.kind, told.action) == ("time base", "warning")
    assert "the stamps of /pose come in bursts" in told.detail
    # stamps that the vehicle file asks for stay
    asked = common_times(pose, [command], Topics(pose="/pose", command="/command", time="header"), PATH)
    assert "bursts" in [i.kind for i in asked.irregularities]
    # and even stamps stand beside log times in bursts
    even = common_times(track(t, in_bursts(t, 6)), [command], TOPICS, PATH)
    np.testing.assert_allclose(even.pose_s, t, atol=1e-9)
    assert even.irregularities == ()


@pytest.mark.parametrize("size", [3, 6, 20])
def test_bursts_by_both_clocks_are_put_back_to_when_they_were_sent(size: int) -> None:
    """The last message of a burst waits for none: commands at their time show that nothing is shifted."""
    t = np.arange(1200) / 100.0
    pose, command = track(in_bursts(t, size), in_bursts(t, size)), track(t, t, "/command")
    found = common_times(pose, [command], TOPICS, PATH)
    assert [i.kind for i in found.irregularities] == ["bursts"]
    np.testing.assert_allclose(found.pose_s - found.command_s[0], 0.0, atol=1e-4 * size + 1e-3)


def test_messages_that_a_network_held_back_are_put_back() -> None:
    """For up to 0.4 s nothing arrives, then all at once; the others come with jitter, and some are lost."""
    rng = np.random.default_rng(3)
    t = np.delete(np.arange(3000) / 100.0, [690, 691, 692, 2000])
    late = t + rng.uniform(0.0, 1e-3, len(t))
    for begin in np.arange(1.5, 29.0, 1.1):
        held = (t > begin) & (t < begin + rng.uniform(0.1, 0.4))
        late[held] = np.maximum(late[held], t[held].max(initial=0.0)) + 2e-5 * np.arange(held.sum())
    late = np.maximum.accumulate(late)
    found = common_times(track(None, late), [track(None, t)], TOPICS, PATH)
    assert [i.kind for i in found.irregularities] == ["time base", "bursts"]
    assert "put back" in found.irregularities[1].detail
    shift = found.pose_s - found.command_s[0]
    assert np.abs(shift - np.median(shift)).max() < 2e-3


def test_a_pause_is_no_burst_and_rounded_stamps_are_none() -> None:
    t = np.arange(600) / 60.0
    paused = t + 600.0 * (np.arange(600) >= 300)
    assert common_times(track(paused, paused), [track(t, t)], TOPICS, PATH).irregularities == ()
    rounded = np.floor(t * 10.0) / 10.0
    found = common_times(track(rounded, rounded), [track(t, t)], TOPICS, PATH)
    np.testing.assert_allclose(found.pose_s, rounded, atol=1e-9)


@pytest.mark.parametrize("stamp", [0, -1, 1 << 63])
def test_stamps_that_are_none_are_refused(stamp: int) -> None:
    t = np.arange(60) / 60.0
    good = track(t, t)
    every = good._replace(stamp_ns=[stamp] * 60)
    one = good._replace(stamp_ns=[stamp, *good.stamp_ns[1:]])
    for bad in (every, one):
        with pytest.raises(InputRefused, match="are no times"):
            common_times(bad, [good], TOPICS, PATH)


def transforms(*edges: tuple[str, str]) -> dict[str, dict[str, FrameTransforms]]:
    row = {"translation": {"x": 1.0, "y": 0.0, "z": 0.0}, "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}}
    items = [{"header": {"frame_id": p}, "child_frame_id": c, "transform": row} for p, c in edges]
    return read_transform_tree([(0, read_transforms({"transforms": items}))])


def test_a_body_is_where_all_its_frames_put_it() -> None:
    turn = np.pi / 2
    tree: dict[str, dict[str, FrameTransforms]] = {
        "odom": {"map": FrameTransforms([0], [None], [[1.0, 2.0, 0.0, 0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2)]])},
        "car": {"odom": FrameTransforms([5, 6], [None, None], [[3.0, *[0.0] * 5, 1.0], [4.0, *[0.0] * 5, 1.0]])},
    }  # fmt: skip
    rows = compose_transforms(edges_to_world(tree, "car", None, PATH), [5, 6])
    np.testing.assert_allclose(rows[:, :2], [[1.0, 5.0], [1.0, 6.0]], atol=1e-12)
    np.testing.assert_allclose(rows[:, 5:], [[np.sin(turn / 2), np.cos(turn / 2)]] * 2, atol=1e-12)
    only = compose_transforms(edges_to_world(tree, "car", "odom", PATH), [5, 6])
    np.testing.assert_allclose(only[:, 0], [3.0, 4.0])


def test_where_a_frame_is_not_yet_known_there_is_no_pose() -> None:
    row = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    tree = {
        "odom": {"map": FrameTransforms([6], [None], [row])},
        "car": {"odom": FrameTransforms([5, 7], [None, None], [row, row])},
    }
    rows = compose_transforms(edges_to_world(tree, "car", None, PATH), [5, 7])
    assert np.isnan(rows[0]).all()
    assert np.isfinite(rows[1]).all()


@pytest.mark.parametrize(
    ("edges", "world", "says"),
    [
        ([("a", "car"), ("car", "a")], None, "cycle: car -> a"), ([("a", "car"), ("b", "car")], None, "parents: a, b"),
        ([("odom", "car")], "map", "odom has no parent"), ([("map", "cat")], None, "only cat"),
    ],
)  # fmt: skip
def test_a_broken_tree_is_refused_by_its_edge(edges: list[tuple[str, str]], world: str | None, says: str) -> None:
    with pytest.raises(InputRefused, match=says):
        edges_to_world(transforms(*edges), "car", world, PATH)


def test_a_frame_that_hardly_ever_comes_is_told() -> None:
    """The last transform's child may be the body, misspelt: without a checksum nothing else says so."""
    row = [0.0] * 6 + [1.0]
    own = FrameTransforms(list(range(1, 201)), [None] * 200, [row] * 200)
    tree = {
        "car": {"map": own},
        "cat": {"map": FrameTransforms([201], [None], [row])},
        "lamp": {"map": FrameTransforms([0], [None], [row])},
    }
    (told,) = find_rare_frames(tree, own)
    assert (told.kind, told.count) == ("rare frames", 1)
    assert "'cat'" in told.detail
    assert "lamp" not in told.detail  # it stands still, and is said once
    assert find_rare_frames({"car": {"map": own}, "other": {"map": own}}, own) == []


@pytest.mark.parametrize("fixed", ["world", "body"])
def test_a_drive_behind_two_frames_is_the_same_drive(
    fixed: str, recording: Recording, vehicle: Vehicle, tmp_path: Path
) -> None:
    """/tf with map -> odom -> car, of which either the first is on /tf_static or the last, as a body's mounting is."""

    def message(parent: str, child: str, t: float, x: float, y: float, yaw: float) -> dict[str, Any]:
        stamp = {"sec": int(t), "nanosec": round(t % 1 * 1e9)}
        rotation = {"x": 0.0, "y": 0.0, "z": float(np.sin(yaw / 2)), "w": float(np.cos(yaw / 2))}
        moved = {"translation": {"x": x, "y": y, "z": 0.3}, "rotation": rotation}
        return {"transforms": [{"header": {"frame_id": parent, "stamp": stamp}, "child_frame_id": child,
                                "transform": moved}]}  # fmt: skip

    t, pose = recording.poses.time_s, recording.poses.values
    if fixed == "world":
        at, still, moving = pose - [1.0, 0.5, 0.0], ("map", "odom", 0.0, 1.0, 0.5, 0.0), ("odom", "car")
    else:  # the car lies 0.2 m ahead of the tracked body
        ahead = np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2]), np.zeros(len(pose))])
        at, still, moving = pose - 0.2 * ahead, ("odom", "car", 0.0, 0.2, 0.0, 0.0), ("map", "odom")
    poses = [(s, message(*moving, s, *map(float, p))) for s, p in zip(t, at, strict=True)]
    commands = [
        (s, {"header": {"stamp": {"sec": int(s), "nanosec": round(s % 1 * 1e9)}}, "steering_rad": u, "throttle_mps": m})
        for s, (u, m) in zip(recording.commands.time_s, recording.commands.values, strict=True)
    ]
    path = json_mcap(tmp_path / "tf.mcap", {
        "/tf_static": ("tf2_msgs/TFMessage", [(0.0, message(*still))]),
        "/tf": ("tf2_msgs/TFMessage", poses), "/command": ("own", commands),
    })  # fmt: skip
    topics = {"pose": "/tf", "command": "/command", "child_frame": "car", "world_frame": "map"}
    seen = Vehicle.model_validate({**vehicle.model_dump(by_alias=True), "topics": topics})
    again = read_recording(path, seen)
    np.testing.assert_allclose(again.poses.values, pose, atol=1e-9)


# --- bags in several parts ---------------------------------------------------------------------------------------


@pytest.fixture
def bag(takes: dict[str, Path], tmp_path: Path) -> Path:
    """The drive of `takes` cut into three parts, whose channels are numbered otherwise in each."""
    messages = [(m.topic, m.log_ns, m.data) for m in drive_messages(takes["mcap"])]
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("relative_file_paths: [bag_0.mcap, bag_1.mcap, bag_2.mcap]\n")
    third = len(messages) // 3
    for i, rows in enumerate((messages[:third], messages[third : 2 * third], messages[2 * third :])):
        with (folder / f"bag_{i}.mcap").open("wb") as file:
            writer = Writer(file)
            writer.start()
            topics = sorted({topic for topic, _, _ in rows}, reverse=bool(i % 2))
            ids = {
                t: writer.register_channel(t, "json", writer.register_schema(SCHEMAS[t], "jsonschema", b"{}"))
                for t in topics
            }
            for topic, ns, data in rows:
                writer.add_message(ids[topic], ns, data, ns)
            writer.finish()
    return folder


SCHEMAS = {"/mocap/bumper_car/pose": "foxglove.PoseInFrame", "/bumper_car/command": "bcid.Command"}


class Logged(NamedTuple):
    topic: str
    log_ns: int
    data: bytes


def drive_messages(path: Path) -> list[Logged]:
    found = read_contents(path, tuple(SCHEMAS), False)
    rows = [Logged(found.channels[channel].topic, log_ns, data) for channel, log_ns, data in found.messages]
    return sorted(rows, key=lambda row: row.log_ns)


def test_a_split_bag_is_read_as_one(bag: Path, takes: dict[str, Path], vehicle: Vehicle) -> None:
    whole, parts = read_recording(takes["mcap"], vehicle), read_recording(bag, vehicle)
    np.testing.assert_array_equal(parts.poses.values, whole.poses.values)
    np.testing.assert_array_equal(parts.commands.values, whole.commands.values)
    assert len(parts.sources) == 3
    assert not {"split bag", "publishers"} & {i.kind for i in parts.irregularities}


def test_a_part_that_is_missing_is_told_and_its_time_is_a_gap(bag: Path, vehicle: Vehicle) -> None:
    (bag / "bag_1.mcap").unlink()
    found = {i.kind: i for i in read_recording(bag, vehicle).irregularities}
    assert "bag_1.mcap too, which is not there" in found["split bag"].detail
    assert float(found["pose gap"].detail.split(" s in all")[0]) > 15.0


def test_a_part_alone_is_told_as_one(bag: Path, vehicle: Vehicle) -> None:
    found = {i.kind: i for i in read_recording(bag / "bag_0.mcap", vehicle).irregularities}
    assert "for bag_1.mcap, bag_2.mcap too" in found["split bag"].detail


def test_a_folder_without_parts_is_refused(tmp_path: Path, vehicle: Vehicle) -> None:
    with pytest.raises(InputRefused, match="regular file"):
        read_recording(tmp_path, vehicle)
