"""MCAP recordings: pose and command topics named by the vehicle file."""

from __future__ import annotations

import difflib
import json
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
from bcid.recording.checks.attitude import judged_yaw, off_the_floor
from bcid.recording.formats import ros_messages
from bcid.recording.formats.detect import parts_of
from bcid.recording.formats.mapping import field_names, mapped
from bcid.recording.formats.mcap_contents import PART, Contents, contents
from bcid.recording.formats.mcap_times import Track, common_times
from bcid.recording.formats.raw import RawTake, source_of
from bcid.recording.formats.ros_transforms import SCHEMA as TF
from bcid.recording.formats.ros_transforms import STATIC, chain, put_together, read_tree, strangers
from bcid.recording.types import Irregularity
from bcid.vehicle import CHANNELS, CommandFields, Mapped, Topics, Vehicle

BROKEN = (
    struct.error, EOFError, OverflowError, json.JSONDecodeError, UnicodeDecodeError, AssertionError, TypeError,
    ValueError, IndexError, McapError,
)  # fmt: skip
"""What decoders raise on content that is not as its schema says."""


@contextmanager
def _refusing(path: Path, topic: str) -> Iterator[None]:
    """Refusals where decoders fail on messages of `topic`."""
    place = f"topic {topic}"
    try:
        yield
    except ros_messages.SeveralBodies as error:
        cause = f"its messages hold several bodies: {error}"
        raise InputRefused(path, place, cause, "set topics.child_frame in the vehicle file") from None
    except KeyError as error:
        step = "name the fields in [topics.pose_fields] or [topics.command_fields]"
        raise InputRefused(path, place, f"a field is missing: {error}", step) from None
    except BROKEN as error:
        cause = f"a message cannot be decoded: {type(error).__name__}: {error}"
        raise InputRefused(path, place, cause, "check its schema, or record it anew") from None


def _schema_of(found: Contents, topic: str) -> str:
    """The topic's schema name.

    Raises:
        InputRefused: no such topic (with the nearest name), no message, or several types on it.
    """
    every, path, place = found.channels.values(), found.path, f"topic {topic}"
    if not every:
        raise InputRefused(path, place, "is not in the file, which has no channels", "record the topics")
    if topic not in {c.topic for c in every}:
        listing = ", ".join(f"{c.topic} ({found.schema_name(c.schema_id)})" for c in every)
        near = difflib.get_close_matches(topic, [c.topic for c in every], n=1)
        hint = f"; nearest: {near[0]}" if near else ""
        cause = f"is not in the file, which has {listing}{hint}"
        raise InputRefused(path, place, cause, "correct [topics] in the vehicle file")
    channels = found.of(topic)
    if not channels:
        raise InputRefused(path, place, "has no messages", "check that it was published during the take")
    schemas = [found.schemas.get(c.schema_id) for c in channels]
    types = {
        (c.message_encoding, *((s.name, s.encoding, s.data) if s else ()))
        for c, s in zip(channels, schemas, strict=True)
    }
    if len(types) > 1:
        names = sorted({f"{found.schema_name(c.schema_id)} in {c.message_encoding}" for c in channels})
        same = " (two definitions of it)" if len(names) == 1 else ""
        cause = f"carries several schemas: {', '.join(names)}{same}"
        raise InputRefused(path, place, cause, "record one type a topic")
    return found.schema_name(channels[0].schema_id)


def _publishers(found: Contents, topics: Iterable[str]) -> list[Irregularity]:
    """Topics that more than one channel writes to."""
    counts = {topic: max(Counter(c.id // PART for c in found.of(topic)).values(), default=0) for topic in topics}
    return [
        Irregularity("publishers", "warning", n, f"topic {topic}", "several publishers: their messages are mixed")
        for topic, n in counts.items() if n > 1
    ]  # fmt: skip


def _mapped_track(found: Contents, topic: str, fields: list[Mapped], time_field: str | None) -> Track:
    """The mapped `fields` of every message, one column each."""
    names = field_names(fields)
    log_ns, stamps, rows = [], [], []
    for logged, message in found.decoded(topic):
        log_ns.append(logged)
        own = (
            ros_messages.nanoseconds(ros_messages.get(message, time_field))
            if time_field
            else ros_messages.stamp_of(message)
        )
        stamps.append(own)
        rows.append([ros_messages.number(ros_messages.get(message, name)) for name in names])
    raw = np.array(rows, dtype=float).reshape(len(rows), len(names))
    columns = dict(zip(names, raw.T, strict=True))
    return Track(log_ns, stamps, np.column_stack([mapped(f, columns.__getitem__) for f in fields]))


def _pose_track(found: Contents, schema: str, vehicle: Vehicle, topics: Topics) -> Track:
    path = found.path
    fields = topics.pose_fields
    if fields is not None:
        return _mapped_track(found, topics.pose, [fields.x_m, fields.y_m, fields.yaw_rad], fields.time_s)
    if schema not in (*ros_messages.POSES, TF):
        cause = f"type {schema} is no known pose; known: {', '.join((*ros_messages.POSES, TF))}"
        raise InputRefused(path, f"topic {topics.pose}", cause, "name its fields in [topics.pose_fields]")
    body = topics.child_frame or vehicle.mocap.rigid_body
    if schema == TF:
        tree = read_tree([*found.decoded(topics.pose), *_static(found, topics.pose)])
        edges = chain(tree, body, topics.world_frame, path)
        track = _judged(edges[0].log_ns, edges[0].stamp_ns, put_together(edges), path)
        return track._replace(odd=[*track.odd, *strangers(tree, edges[0])])
    log_ns, stamps, rows = [], [], []
    for logged, message in found.decoded(topics.pose):
        pose = ros_messages.POSES[schema](message, body)
        if pose is not None:
            log_ns.append(logged)
            stamps.append(pose.stamp_ns)
            rows.append([*pose.position, *pose.xyzw])
    if not rows:
        cause = f"no message holds the body {body!r}"
        raise InputRefused(path, f"topic {topics.pose}", cause, "set topics.child_frame in the vehicle file")
    return _judged(log_ns, stamps, np.array(rows), path)


def _static(found: Contents, pose_topic: str) -> list[tuple[int, Any]]:
    """Transforms that hold from the first to the last moment."""
    if pose_topic == STATIC or not found.of(STATIC):
        return []
    return [(0, message) for _, message in found.decoded(STATIC)]


def _judged(log_ns: list[int], stamps: list[int | None], rows: Floats, path: Path) -> Track:
    """Positions and quaternions (N, 7) as poses on the floor."""
    time_s = (np.array(log_ns, dtype=float) - log_ns[0]) / 1e9
    yaw, odd = judged_yaw(rows[:, 3:], "Z", time_s, path)
    up, lifts = off_the_floor(rows[:, :2], rows[:, 2], time_s)
    values = np.column_stack([rows[:, :2], yaw])
    values[up] = np.nan
    return Track(log_ns, stamps, values, [*odd, *lifts])


def _command_fields(schema: str, first: Any, topics: Topics, path: Path) -> CommandFields:
    """Where the commands' fields are: as the vehicle file says, or as the message type has them."""
    if topics.command_fields is not None:
        return topics.command_fields
    if schema in ros_messages.TWISTS:
        inside = "twist." if schema.endswith("Stamped") else ""
        raise InputRefused(
            path, f"topic {topics.command}", f"type {schema} holds a yaw rate, not a steering angle",
            f'if angular.z is an angle here, map it: [topics.command_fields] steering_rad = "{inside}angular.z", '
            f'throttle_mps = "{inside}linear.x"',
        )  # fmt: skip
    steering, throttle = ros_messages.COMMANDS.get(schema, ros_messages.OWN_COMMAND)
    extra = {name: name for name in CHANNELS if ros_messages.get(first, name, None) is not None}
    return CommandFields.model_validate({"steering_rad": steering, "throttle_mps": throttle, **extra})


def _command_track(found: Contents, schema: str, topics: Topics) -> tuple[Track, list[str]]:
    """Steering, throttle and what further channels there are, with their names."""
    _, first = next(found.decoded(topics.command))
    fields = _command_fields(schema, first, topics, found.path)
    extra = {name: field for name in CHANNELS if (field := getattr(fields, name)) is not None}
    wanted = [fields.steering_rad, fields.throttle_mps, *extra.values()]
    missing = [name for name in field_names(wanted) if ros_messages.get(first, name, None) is None]
    if missing:
        cause = f"type {schema} has no {', '.join(missing)}: it is no known command"
        raise InputRefused(found.path, f"topic {topics.command}", cause, "name its fields in [topics.command_fields]")
    track = _mapped_track(found, topics.command, wanted, fields.time_s)
    if schema in ros_messages.COMMANDS and topics.command_fields is None and np.nanmin(track.values[:, 1]) < 0.0:
        raise InputRefused(
            found.path, f"topic {topics.command}", "holds negative speeds, which would read as brake shares",
            "map them in [topics.command_fields], with low = 0.0 where the car only coasts",
        )  # fmt: skip
    return track, list(extra)


def read_mcap(path: Path, vehicle: Vehicle, allow_partial: bool = False) -> RawTake:
    """The take in an MCAP file; with `allow_partial` without what cannot be read of it.

    Raises:
        InputRefused: what is wrong with either topic, told at once, where the file cannot be used.
    """
    sources = tuple(source_of(part, "mcap") for part in parts_of(path))
    topics = vehicle.topics
    if topics is None:
        raise InputRefused(path, "vehicle file", "has no [topics]", "name the pose and command topics there")
    wanted, problems = (topics.pose, topics.command), Problems()
    found = contents(path, (*wanted, STATIC), allow_partial)
    with problems.gathered(), _refusing(path, topics.pose):
        pose = _pose_track(found, _schema_of(found, topics.pose), vehicle, topics)
    with problems.gathered(), _refusing(path, topics.command):
        command, extra = _command_track(found, _schema_of(found, topics.command), topics)
    problems.refuse(path)
    times = common_times(pose, command, topics, path)
    channels = {name: (times.command_s, command.values[:, 2 + i]) for i, name in enumerate(extra)}
    odd = (*found.odd(), *_publishers(found, wanted), *pose.odd, *times.odd)
    return RawTake(
        path.stem, sources, times.pose_s, pose.values, times.command_s, command.values[:, :2], None, channels, odd,
        times.splits_s,
    )  # fmt: skip
