"""Messages and definitions that nobody vouches for: refused in one sentence with their place, and bounded before."""

from __future__ import annotations

import json
import struct
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from faults.mcap_specimens import as_protobuf
from mcap.writer import Writer
from test_pose_messages import COMMANDS, TIME, car, header, pose, written
from test_readers import START_NS, json_mcap, topical

import bcid.recording.read
from bcid.errors import BcidError, InputRefused, UsageError
from bcid.recording.formats.limits import MESSAGE
from bcid.recording.formats.message_fields import MissingField, NotANumber, get_field, number_at, parse_number
from bcid.recording.formats.names import list_names, printable_name
from bcid.recording.formats.ros_encoding import BadDefinition, BadMessage, compile_ros_decoder
from bcid.recording.read import UnforeseenContent, read_raw_take
from bcid.recording.types import Recording, Stream
from bcid.vehicle import Vehicle

# --- one guard around every reader -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "error", [ZeroDivisionError("x"), KeyError("y"), RecursionError("z"), UnicodeError("\x1b[31m")]
)
def test_whatever_a_reader_raises_is_a_refusal_with_its_cause(
    error: Exception, vehicle: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: Any) -> Any:
        raise error

    monkeypatch.setattr(bcid.recording.read, "detect_format", fails)
    with pytest.raises(UnforeseenContent, match="this file is broken, or of a kind") as told:
        read_raw_take(tmp_path / "t.csv", vehicle)
    assert told.value.__cause__ is error
    assert told.value.exit_code == 4
    assert "\x1b" not in str(told.value)


@pytest.mark.parametrize("error", [UsageError("no"), MemoryError(), KeyboardInterrupt()])
def test_refusals_and_interrupts_pass_the_guard(
    error: BaseException, vehicle: Vehicle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: Any) -> Any:
        raise error

    monkeypatch.setattr(bcid.recording.read, "detect_format", fails)
    with pytest.raises(type(error)) as told:
        read_raw_take(tmp_path / "t.csv", vehicle)
    assert told.value is error


# --- single messages ---------------------------------------------------------------------------------------------


def drive(seconds: float = 10.0) -> Recording:
    t = np.arange(int(60 * seconds)) / 60.0
    yaw = 0.6 * t
    poses = np.column_stack([np.sin(yaw) / 0.6, (1.0 - np.cos(yaw)) / 0.6, yaw])
    commands = Stream(np.arange(int(20 * seconds)) / 20.0, np.tile([0.5, 1.2], (int(20 * seconds), 1)))
    return Recording("drive", (), Stream(t, poses), commands, 60.0, 0.5)


def replaced(path: Path, at: int, data: bytes) -> Path:
    """The file with other bytes in the pose message of this number, and its checksums right."""
    from mcap.reader import NonSeekingReader

    with path.open("rb") as file:
        found = list(NonSeekingReader(file).iter_messages(log_time_order=False))
    with path.open("wb") as out:
        writer, ids, number = Writer(out), dict[str, int](), 0
        writer.start()
        for schema, channel, message in found:
            if channel.topic not in ids:
                assert schema is not None
                new = writer.register_schema(schema.name, schema.encoding, schema.data)
                ids[channel.topic] = writer.register_channel(channel.topic, channel.message_encoding, new)
            number += channel.topic == "/pose"
            content = data if channel.topic == "/pose" and number == at else message.data
            writer.add_message(ids[channel.topic], message.log_time, content, message.publish_time)
        writer.finish()  # type: ignore[no-untyped-call]
    return path


BROKEN = {
    "protobuf": b"\x1a\xff\xff\xff\xff\x0f", "nested": b"[" * 100_000 + b"]" * 100_000, "no JSON": b"\xff\xfe{",
    "cut": b'{"header": {"stamp"', "list": b"[]", "long": b'{"a": "' + bytes(300_000) + b'"}', "empty": b"",
    "digits": b'{"header": ' + b"9" * 5000 + b"}",
}  # fmt: skip


@pytest.mark.parametrize("kind", list(BROKEN))
def test_a_broken_message_is_refused_by_its_number_and_left_out_if_allowed(
    kind: str, vehicle: Vehicle, tmp_path: Path
) -> None:
    seen = topical(vehicle)
    if kind == "protobuf":
        path = as_protobuf(drive(), tmp_path / "t.mcap")
    else:
        path = written(tmp_path, "geometry_msgs/PoseStamped", lambda t, r: {**header(t), "pose": pose(r)})
    whole = read_raw_take(path, seen)
    replaced(path, 301, BROKEN[kind])
    with pytest.raises(InputRefused, match=r"topic /pose, message 301 \(logged at .* s\)") as told:
        read_raw_take(path, seen)
    assert not isinstance(told.value, UnforeseenContent)
    part = read_raw_take(path, seen, allow_partial=True)
    np.testing.assert_array_equal(part.pose, np.delete(whole.pose, 300, axis=0))
    (lost,) = [i for i in part.irregularities if i.kind == "lost"]
    assert lost.count == 1
    assert "1 of 600 messages" in lost.detail


def test_where_no_message_can_be_read_nothing_is_salvaged(vehicle: Vehicle, tmp_path: Path) -> None:
    path = written(tmp_path, "geometry_msgs/PoseStamped", lambda t, r: header(t))
    with pytest.raises(InputRefused, match=r"message 1 .*a field is missing: 'pose\.position'"):
        read_raw_take(path, topical(vehicle), allow_partial=True)


@pytest.mark.parametrize("value", [True, False, "0_1.5", "", "one", [1.0], {"x": 1}, "\N{ARABIC-INDIC DIGIT ONE}"])
def test_what_is_no_number_is_refused_by_its_field(value: Any, vehicle: Vehicle, tmp_path: Path) -> None:
    def make(t: float, row: np.ndarray) -> dict[str, Any]:
        at = pose(row)
        return {**header(t), "pose": {**at, "position": {**at["position"], "x": value if t > 5.0 else row[0]}}}

    path = written(tmp_path, "geometry_msgs/PoseStamped", make)
    with pytest.raises(InputRefused, match=r"message 302 .*field x holds .*, which is no number"):
        read_raw_take(path, topical(vehicle))
    with pytest.raises(NotANumber):
        parse_number(value)


def test_numbers_in_text_and_blank_ones() -> None:
    assert parse_number(" -1.5e0 ") == -1.5
    assert np.isnan(parse_number(None))
    assert parse_number("nan") == parse_number(10**400) == parse_number(float("nan")) == np.inf


def test_paths_lead_through_lists_and_names() -> None:
    message = {"bodies": [{"name": "a", "x": [1, 2]}, {"name": "my car", "x": [3, 4]}], "axes": [0.5]}
    assert number_at(message, "bodies[name=my car].x[1]") == 4.0
    assert number_at(message, "bodies[0].x.0") == 1.0
    assert number_at(message, "axes.0") == number_at(message, "axes[0]") == 0.5
    assert np.isnan(number_at(message, "bodies[name=b].x[1]"))
    for path in ("bodies[2].x", "bodies.name", "axes[", "axes.x", "axes[-1]"):
        with pytest.raises(MissingField):
            get_field(message, path)


def test_an_unset_message_of_protobuf_is_missing_and_not_zero(vehicle: Vehicle, tmp_path: Path) -> None:
    path = as_protobuf(drive(), tmp_path / "t.mcap")
    replaced(path, 5, b"\x0a\x02\x08\x05")
    with pytest.raises(InputRefused, match=r"message 5 .*missing: 'pose\.position'"):
        read_raw_take(path, topical(vehicle))


# --- definitions -------------------------------------------------------------------------------------------------

RULE = "=" * 80
POINT = f"\n{RULE}\nMSG: a/Point\nfloat64 x\nfloat64 y"
BOMBS = {
    "itself": ("Pose again", "by itself"),
    "in turn": (f"B b\n{RULE}\nMSG: a/B\nC c\n{RULE}\nMSG: a/C\nPose p", "by itself"),
    "wstring": ("wstring w", "wstring"),
    "huge array": ("float64[1000000000] x", "longer than"),
    "array of arrays": (f"B[1000] b\n{RULE}\nMSG: a/B\nC[1000] c\n{RULE}\nMSG: a/C\nfloat64[1000] x", "longer than"),
    "array of nothing": ("float64[0] x", "list of nothing"),
    "deep": ("".join(f"T{k} x\n{RULE}\nMSG: a/T{k}\n" for k in range(50)) + "bool b", "nested deeper"),
    "many types": ("bool b\n" + "\n".join(f"{RULE}\nMSG: a/T{k}\nbool b" for k in range(500)), "more than 200 types"),
    "long": ("float64 x\n" * 50_000, "are the most"),
    "unknown type": ("Nothing x", "does not define"),
    "no field": ("float64", "which is no field"),
    "digits": ("float64[99999999999999999999999] x", "longer than"),
    "binary": ("\x00\x01\x1b[31m", "which is no field"),
}  # fmt: skip


@pytest.mark.parametrize("name", list(BOMBS))
def test_a_definition_is_bounded_before_anything_is_built_of_it(name: str) -> None:
    text, says = BOMBS[name]
    tracemalloc.start()
    with pytest.raises(BadDefinition, match=says):
        compile_ros_decoder("a/msg/Pose", text)
    assert tracemalloc.get_traced_memory()[1] < 20 << 20
    tracemalloc.stop()


def test_shared_types_do_not_multiply() -> None:
    """30 types, each of which holds the next twice, are a billion fields."""
    text = (
        "\n".join(f"{RULE}\nMSG: a/T{k}\nT{k + 1} x\nT{k + 1} y" for k in range(28)) + f"\n{RULE}\nMSG: a/T28\nbool b"
    )
    with pytest.raises(BadDefinition, match="longer than"):
        compile_ros_decoder("a/msg/Pose", "T0 t\n" + text)


def test_definitions_as_they_are_written() -> None:
    """Constants, defaults, bounds, comments, names without a package, and all kinds of lists."""
    text = (
        "# a comment\nint8 A=1\nstring NAME=\"x # y\"\nfloat64 x 1.5 # behind\nstring<=10 name \"none\"\nuint8[2] two\n"
        "int16[<=5] few\nPoint[] points\nPoint[2] pair\nbool yes\nbuiltin_interfaces/Time stamp\nEmpty nothing"
        f"{POINT}\n{RULE}\nMSG: a/Empty\n"
    )  # fmt: skip
    body = struct.pack("<d", 2.5) + struct.pack("<I4s", 4, b"abc\0") + b"\x07\x08" + b"\0\0"
    body += struct.pack("<I2h", 2, 3, -4) + struct.pack("<I", 1) + struct.pack("<2d", 5.0, 6.0)
    body += struct.pack("<4d", 1, 2, 3, 4) + b"\x01\0\0\0" + struct.pack("<iI", 9, 10) + b"\0"
    message = compile_ros_decoder("a/msg/Pose", text)(b"\0\1\0\0" + body)
    assert message == {
        "x": 2.5, "name": "abc", "two": (7, 8), "few": (3, -4), "points": [{"x": 5.0, "y": 6.0}],
        "pair": [{"x": 1.0, "y": 2.0}, {"x": 3.0, "y": 4.0}], "yes": True, "stamp": {"sec": 9, "nanosec": 10},
        "nothing": {"": 0},
    }  # fmt: skip


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "none of plain CDR"), (b"\0\2\0\0", "none of plain CDR"), (b"\0\1\0\0\xff\xff\xff\xff", "longer than"),
        (b"\0\1\0\0\1\0\0\0", "longer than"), (b"\0\1\0\0\0\0\0\0", "ends inside"),
        (b"\0\1\0\0" + struct.pack("<I", 20_000) + bytes(20_000), "10000 are the most"),
        (b"\0\1\0\0" + struct.pack("<I", 0) + b"\xff\xff\xff\x7f", "ends inside a text"),
    ],
)  # fmt: skip
def test_messages_that_do_not_agree_with_their_definition(data: bytes, says: str) -> None:
    decode = compile_ros_decoder("a/msg/Pose", f"B[] b\nstring s\n{RULE}\nMSG: a/B\nbool x")
    with pytest.raises(BadMessage, match=says):
        decode(data)


def test_a_protobuf_of_very_many_types_is_refused(vehicle: Vehicle, tmp_path: Path) -> None:
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    files = FileDescriptorSet()
    file = files.file.add(name="bomb.proto", package="a", syntax="proto3")
    for k in range(5000):
        file.message_type.add(name=f"T{k}")
    path = tmp_path / "t.mcap"
    with path.open("wb") as out:
        writer = Writer(out)
        writer.start()
        schema = writer.register_schema("a.T0", "protobuf", files.SerializeToString())
        channel = writer.register_channel("/pose", "protobuf", schema)
        writer.add_message(channel, START_NS, b"", START_NS)
        own = writer.register_channel("/command", "json", writer.register_schema("own", "jsonschema", b"{}"))
        writer.add_message(own, START_NS, json.dumps(COMMANDS[0][1]).encode(), START_NS)
        writer.finish()
    fields = {"x_m": "x", "y_m": "y", "yaw_rad": "yaw"}
    with pytest.raises(InputRefused, match="definition cannot be read: more than 200 types"):
        read_raw_take(path, topical(vehicle, pose_fields=fields))


# --- counts and names --------------------------------------------------------------------------------------------


def test_more_messages_than_bytes_are_refused_at_once(vehicle: Vehicle, tmp_path: Path) -> None:
    """Empty messages compress to a tenth of a byte each."""
    path = tmp_path / "t.mcap"
    with path.open("wb") as out:
        writer = Writer(out, chunk_size=8 << 20)
        writer.start()
        channel = writer.register_channel("/other", "json", writer.register_schema("own", "jsonschema", b"{}"))
        for _ in range(400_000):
            writer.add_message(channel, START_NS, b"", START_NS)
        writer.finish()
    # the index would be longer than all messages
    data = path.read_bytes()
    assert len(data) > 400_000
    small = strip_message_indexes(data)
    assert len(small) < 100_000
    path.write_bytes(small)
    for partial in (False, True):
        with pytest.raises(InputRefused, match="messages up to here are more than the file has bytes"):
            read_raw_take(path, topical(vehicle), allow_partial=partial)


def strip_message_indexes(data: bytes) -> bytes:
    from faults.mcap_mutants import join_records, split_records

    return join_records([(opcode, body) for opcode, body in split_records(data) if opcode in (1, 3, 4, 6, 15, 2)])


def test_names_are_printable_wherever_they_are_told(vehicle: Vehicle, tmp_path: Path) -> None:
    bad = "\x1b[31mred\x07"
    names = {"/pose": ("geometry_msgs/PoseArray" + bad, [(0.0, {})]), "/command" + bad: (bad, [(0.0, {})])}
    bodies = [
        (t, {**header(t), "rigidbodies": [{"rigid_body_name": bad, "pose": pose(np.zeros(3))}]}) for t in TIME[:9]
    ]
    listed = {"/pose": ("mocap4r2_msgs/RigidBodies", bodies), "/command": ("own", COMMANDS)}
    at = {"translation": dict.fromkeys("xyz", 0), "rotation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    moved = {"child_frame_id": bad, "header": {"frame_id": bad}, "transform": at}
    tree = {
        "/pose": ("tf2_msgs/TFMessage", [(t, {"transforms": [moved]}) for t in TIME[:9]]),
        "/command": ("own", [(0.0, {bad: 1})]),
    }
    for topics in (names, listed, tree):
        with pytest.raises(BcidError) as told:
            read_raw_take(json_mcap(tmp_path / "t.mcap", topics), car(vehicle))
        text = str(told.value)
        assert all(c.isprintable() or c == "\n" for c in text), text
        assert "�[31m" in text
    assert printable_name("x" * 200) == "x" * 80 + "…"
    assert list_names([]) == "none"
    assert list_names(range(50)).endswith("11, …")


def test_the_most_that_a_message_may_have_is_more_than_real_ones_need() -> None:
    assert MESSAGE.max_message_bytes > 20 * len(json.dumps({"bodies": [pose(np.ones(3))] * 50}))


# --- ROS 1, as `mcap convert` leaves it ---------------------------------------------------------------------------

ROS_1_HEADER = f"\n{RULE}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id"
ROS_1_POSE = f"Header header\ngeometry_msgs/Pose pose{ROS_1_HEADER}\n{RULE}\nMSG: geometry_msgs/Pose\n" + (
    f"Point position\nQuaternion orientation\n{RULE}\nMSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    f"{RULE}\nMSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w"
)


def test_a_converted_ros_1_bag_is_read(vehicle: Vehicle, tmp_path: Path) -> None:
    take, path = drive(), tmp_path / "t.mcap"
    with path.open("wb") as out:
        writer = Writer(out)
        writer.start()
        schema = writer.register_schema("geometry_msgs/PoseStamped", "ros1msg", ROS_1_POSE.encode())
        poses = writer.register_channel("/pose", "ros1", schema)
        schema = writer.register_schema("std_msgs/Float64", "ros1msg", b"float64 data")
        singles = {t: writer.register_channel(t, "ros1", schema) for t in ("/servo", "/motor")}
        for k, (t, (x, y, yaw)) in enumerate(zip(take.poses.time_s, take.poses.values, strict=True)):
            ns = START_NS + round(t * 1e9)
            text = b"floor"  # of a length that would be padded in CDR
            data = struct.pack("<III", k, ns // 10**9, ns % 10**9) + struct.pack("<I", len(text)) + text
            data += struct.pack("<7d", x, y, 0.3, 0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2))
            writer.add_message(poses, ns, data, ns)
        for t, values in zip(take.commands.time_s, take.commands.values, strict=True):
            ns = START_NS + round(t * 1e9)
            for channel, value in zip(singles.values(), values, strict=True):
                writer.add_message(channel, ns, struct.pack("<d", value), ns)
        writer.finish()
    raw = read_raw_take(path, topical(vehicle, command={"steering": "/servo", "throttle": "/motor"}))
    np.testing.assert_allclose(raw.pose[:, :2], take.poses.values[:, :2], atol=1e-9)
    np.testing.assert_array_equal(raw.command, take.commands.values)


def test_messages_of_ros_1_without_fields_take_no_room_and_are_bounded_all_the_same() -> None:
    text = f"Empty e\nbyte b\n{RULE}\nMSG: a/Empty\n"
    assert compile_ros_decoder("a/Pose", text, ros_1=True)(b"\5") == {"e": {}, "b": 5}
    tower = "".join(f"T{k} x\nT{k} y\n{RULE}\nMSG: a/T{k}\n" for k in range(28))
    with pytest.raises(BadDefinition, match="longer than"):
        compile_ros_decoder("a/Pose", tower, ros_1=True)


def test_a_channel_that_says_much_about_itself_is_refused(vehicle: Vehicle, tmp_path: Path) -> None:
    """A dict of millions of entries would be built of it."""
    path = tmp_path / "t.mcap"
    with path.open("wb") as out:
        writer = Writer(out, chunk_size=16 << 20)
        writer.start()
        schema = writer.register_schema("own", "jsonschema", b"{}")
        channel = writer.register_channel("/pose", "json", schema, {str(k): "" for k in range(400_000)})
        writer.add_message(channel, START_NS, b"{}", START_NS)
        writer.finish()
    with pytest.raises(InputRefused, match=r"a schema or channel of .* bytes: 4194304 are the most"):
        read_raw_take(path, topical(vehicle))


def test_a_small_file_of_very_many_bytes_on_a_wanted_topic_is_refused(vehicle: Vehicle, tmp_path: Path) -> None:
    """The same pose again and again, 40 MB of them in a few kilobytes beside an image."""
    path, data = tmp_path / "t.mcap", json.dumps({**header(1.0), "pose": pose(np.ones(3))}).encode()
    with path.open("wb") as out:
        writer = Writer(out, chunk_size=4 << 20)
        writer.start()
        channel = writer.register_channel("/pose", "json", writer.register_schema("own", "jsonschema", b"{}"))
        for _ in range(40_000_000 // len(data)):
            writer.add_message(channel, START_NS, data, START_NS)
        other = writer.register_channel("/image", "json", writer.register_schema("image", "jsonschema", b"{}"))
        writer.add_message(other, START_NS, np.random.default_rng(1).bytes(300_000), START_NS)
        writer.finish()
    path.write_bytes(strip_message_indexes(path.read_bytes()))
    assert path.stat().st_size < 400_000
    with pytest.raises(InputRefused, match="33554432 bytes, the most of such a file"):
        read_raw_take(path, topical(vehicle))
