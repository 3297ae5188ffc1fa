"""MCAP recordings: the pose and command topics that the vehicle file names."""

import struct
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError

from bcid.aliases import Floats
from bcid.errors import InputRefused, Problems
from bcid.recording.checks.attitude import checked_yaw, find_lifted_samples
from bcid.recording.formats import ros_messages as ros
from bcid.recording.formats.detect import recording_files
from bcid.recording.formats.mcap_contents import CHANNELS_PER_FILE, McapContents, read_contents
from bcid.recording.formats.mcap_times import MessageTrack, common_times
from bcid.recording.formats.raw import RawTake, identify_file, map_field, nearest_hint, raw_field_names
from bcid.recording.types import Irregularity
from bcid.vehicle import OPTIONAL_CHANNELS, CommandFields, FieldMapping, Topics, Vehicle

DECODING_ERRORS = (struct.error, EOFError, OverflowError, AssertionError, TypeError, ValueError, IndexError, McapError)
"""What decoders raise on content that does not agree with its schema."""


@contextmanager
def _refuse_undecodable(path: Path, topic: str) -> Iterator[None]:
    """Context that turns errors of decoding messages of `topic`, and fields that they lack, into `InputRefused`."""
    place = f"topic {topic}"
    try:
        yield
    except ros.SeveralBodies as error:
        cause = f"its messages hold several bodies: {error}"
        raise InputRefused(path, place, cause, "set topics.child_frame in the vehicle file") from None
    except KeyError as error:
        step = "name the fields in [topics.pose_fields] or [topics.command_fields]"
        raise InputRefused(path, place, f"a field is missing: {error}", step) from None
    except DECODING_ERRORS as error:
        cause = f"a message cannot be decoded: {type(error).__name__}: {error}"
        raise InputRefused(path, place, cause, "check its schema, or record it anew") from None


def _topic_schema_name(contents: McapContents, topic: str) -> str:
    """The name of the type of a topic's messages; `InputRefused` where it has none, is absent, or has several types."""
    every, path, place = contents.channels.values(), contents.path, f"topic {topic}"
    if not every:
        raise InputRefused(path, place, "is not in the file, which has no channels", "record the topics")
    if topic not in {c.topic for c in every}:
        listing = ", ".join(f"{c.topic} ({contents.schema_name(c.schema_id)})" for c in every)
        cause = f"is not in the file, which has {listing}{nearest_hint(topic, (c.topic for c in every))}"
        raise InputRefused(path, place, cause, "correct [topics] in the vehicle file")
    channels = contents.published_channels(topic)
    if not channels:
        raise InputRefused(path, place, "has no messages", "check that it was published during the take")
    schemas = {c.id: contents.schemas.get(c.schema_id) for c in channels}
    types = {(c.message_encoding, *((s.name, s.encoding, s.data) if (s := schemas[c.id]) else ())) for c in channels}
    if len(types) > 1:
        names = sorted({f"{contents.schema_name(c.schema_id)} in {c.message_encoding}" for c in channels})
        same = " (two definitions of it)" if len(names) == 1 else ""
        cause = f"carries several schemas: {', '.join(names)}{same}"
        raise InputRefused(path, place, cause, "record one type a topic")
    return contents.schema_name(channels[0].schema_id)


def _find_several_publishers(contents: McapContents, topics: Iterable[str]) -> list[Irregularity]:
    """A warning for each topic on which several channels of one MCAP file hold messages, which are then mixed."""
    warnings = []
    for topic in topics:
        files = Counter(c.id // CHANNELS_PER_FILE for c in contents.published_channels(topic))
        n, text = max(files.values(), default=0), "several publishers: their messages are mixed"
        if n > 1:
            warnings.append(Irregularity("publishers", "warning", n, f"topic {topic}", text))
    return warnings


def _read_mapped_fields(
    contents: McapContents, topic: str, fields: list[FieldMapping], time_field: str | None
) -> MessageTrack:
    """A topic's messages as values (N, n) in SI units, a column for each of the n mapped fields, with their times.

    Stamps are read from `time_field`, or from the usual places in the header where it is None.
    """
    names = raw_field_names(fields)
    log_ns, stamps, rows = [], [], []
    for logged, message in contents.decode_messages(topic):
        log_ns.append(logged)
        stamp = ros.get_field(message, time_field) if time_field else None
        stamps.append(ros.stamp_to_nanoseconds(stamp) if time_field else ros.message_stamp_ns(message))
        rows.append([ros.parse_number(ros.get_field(message, name)) for name in names])
    raw = np.array(rows, dtype=float).reshape(len(rows), len(names))
    columns = dict(zip(names, raw.T, strict=True))
    return MessageTrack(log_ns, stamps, np.column_stack([map_field(f, columns.__getitem__) for f in fields]))


def _read_pose_track(contents: McapContents, schema: str, vehicle: Vehicle, topics: Topics) -> MessageTrack:
    """The pose topic's messages as values (N, 3): x (m), y (m) and yaw (rad) of the vehicle's body, with their times.

    `schema` names the message type: a known pose type, a transform tree, or any if the vehicle file maps its fields.
    """
    path, fields = contents.path, topics.pose_fields
    if fields is not None:
        return _read_mapped_fields(contents, topics.pose, [fields.x_m, fields.y_m, fields.yaw_rad], fields.time_s)
    known = (*ros.POSE_READERS, ros.TF_SCHEMA)
    if schema not in known:
        cause = f"type {schema} is no known pose; known: {', '.join(known)}"
        raise InputRefused(path, f"topic {topics.pose}", cause, "name its fields in [topics.pose_fields]")
    body = topics.child_frame or vehicle.mocap.rigid_body
    if schema == ros.TF_SCHEMA:
        messages = list(contents.decode_messages(topics.pose))
        if topics.pose != ros.STATIC_TOPIC:
            # static transforms hold throughout, whenever they were sent
            messages += [(0, message) for _, message in contents.decode_messages(ros.STATIC_TOPIC)]
        tree = ros.read_transform_tree(messages)
        edges = ros.edges_to_world(tree, body, topics.world_frame, path)
        rare = ros.find_rare_frames(tree, edges[0])
        track = _track_on_floor(edges[0].log_ns, edges[0].stamp_ns, ros.compose_transforms(edges), path)
        return track._replace(irregularities=[*track.irregularities, *rare])
    log_ns, stamps, rows = [], [], []
    for logged, message in contents.decode_messages(topics.pose):
        pose = ros.POSE_READERS[schema](message, body)
        if pose is not None:
            log_ns.append(logged)
            stamps.append(pose.stamp_ns)
            rows.append(pose.row)
    if not rows:
        cause = f"no message holds the body {body!r}"
        raise InputRefused(path, f"topic {topics.pose}", cause, "set topics.child_frame in the vehicle file")
    return _track_on_floor(log_ns, stamps, np.array(rows), path)


def _track_on_floor(log_ns: list[int], stamps: list[int | None], rows: Floats, path: Path) -> MessageTrack:
    """Poses (N, 3), x, y (m) and yaw (rad), from rows (N, 7) of x, y, z (up) and a quaternion x, y, z, w.

    Rows where the car is lifted or tipped over are NaN and noted; `log_ns` and `stamps` are the messages' times in ns.
    """
    time_s = (np.array(log_ns, dtype=float) - log_ns[0]) / 1e9
    yaw, odd = checked_yaw(rows[:, 3:], "Z", time_s, path)
    up, lifts = find_lifted_samples(rows[:, :2], rows[:, 2], time_s)
    values = np.column_stack([rows[:, :2], yaw])
    values[up] = np.nan
    return MessageTrack(log_ns, stamps, values, [*odd, *lifts])


def _choose_command_fields(schema: str, first: Any, topics: Topics, path: Path) -> CommandFields:
    """Which fields of command messages hold steering, throttle and further channels, by the vehicle file or the type.

    `first` is the first message, which shows what channels there are; a Twist without a mapping is refused.
    """
    if topics.command_fields is not None:
        return topics.command_fields
    if schema in ros.TWIST_SCHEMAS:
        inside = "twist." if schema.endswith("Stamped") else ""
        raise InputRefused(
            path, f"topic {topics.command}", f"type {schema} holds a yaw rate, not a steering angle",
            f'if angular.z is an angle here, map it: [topics.command_fields] steering_rad = "{inside}angular.z", '
            f'throttle_mps = "{inside}linear.x"',
        )  # fmt: skip
    steering, throttle = ros.COMMAND_PATHS.get(schema, ros.OWN_COMMAND_PATHS)
    extra = {name: name for name in OPTIONAL_CHANNELS if ros.get_field(first, name, None) is not None}
    return CommandFields.model_validate({"steering_rad": steering, "throttle_mps": throttle, **extra})


def _read_command_track(contents: McapContents, schema: str, topics: Topics) -> tuple[MessageTrack, list[str]]:
    """The command messages as values (M, 2 + n), steering, throttle, n further channels; and the channels' names."""
    place, (_, first) = f"topic {topics.command}", next(contents.decode_messages(topics.command))
    fields = _choose_command_fields(schema, first, topics, contents.path)
    extra = {name: field for name in OPTIONAL_CHANNELS if (field := getattr(fields, name)) is not None}
    wanted = [fields.steering_rad, fields.throttle_mps, *extra.values()]
    missing = [name for name in raw_field_names(wanted) if ros.get_field(first, name, None) is None]
    if missing:
        cause = f"type {schema} has no {', '.join(missing)}: it is no known command"
        raise InputRefused(contents.path, place, cause, "name its fields in [topics.command_fields]")
    track = _read_mapped_fields(contents, topics.command, wanted, fields.time_s)
    if schema in ros.COMMAND_PATHS and topics.command_fields is None and np.nanmin(track.values[:, 1]) < 0.0:
        cause = "holds negative speeds, which would read as brake shares"
        step = "map them in [topics.command_fields], with low = 0.0 where the car only coasts"
        raise InputRefused(contents.path, place, cause, step)
    return track, list(extra)


def read_mcap(path: Path, vehicle: Vehicle, allow_partial: bool = False) -> RawTake:
    """The unchecked pose and command streams of an MCAP file or a split bag's folder, by the vehicle file's topics.

    With `allow_partial`, parts that cannot be read are left out and noted.

    Raises:
        InputRefused: the file cannot be used, with the problems of both topics.
    """
    sources = tuple(identify_file(part, "mcap") for part in recording_files(path))
    topics = vehicle.topics
    if topics is None:
        raise InputRefused(path, "vehicle file", "has no [topics]", "name the pose and command topics there")
    wanted, problems = (topics.pose, topics.command), Problems()
    found = read_contents(path, (*wanted, ros.STATIC_TOPIC), allow_partial)
    with problems.gather_refusals(), _refuse_undecodable(path, topics.pose):
        pose = _read_pose_track(found, _topic_schema_name(found, topics.pose), vehicle, topics)
    with problems.gather_refusals(), _refuse_undecodable(path, topics.command):
        command, extra = _read_command_track(found, _topic_schema_name(found, topics.command), topics)
    problems.raise_if_any(path)
    times = common_times(pose, command, topics, path)
    channels = {name: (times.command_s, command.values[:, 2 + i]) for i, name in enumerate(extra)}
    odd = (*found.irregularities(), *_find_several_publishers(found, wanted), *pose.irregularities)
    return RawTake(
        path.stem, sources, times.pose_s, pose.values, times.command_s, command.values[:, :2], None, channels,
        (*odd, *times.irregularities), times.splits_s,
    )  # fmt: skip
