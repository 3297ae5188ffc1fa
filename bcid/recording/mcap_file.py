"""MCAP recordings: pose and command topics named by the vehicle file."""

from __future__ import annotations

import difflib
import json
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.decoder import DecoderFactory
from mcap.exceptions import McapError
from mcap.reader import McapReader, make_reader
from mcap.records import Schema
from mcap.summary import Summary

from bcid.errors import InputRefused
from bcid.recording import messages
from bcid.recording.mapping import mapped
from bcid.recording.orientation import yaw_of_quaternions
from bcid.recording.raw import RawTake, source_of
from bcid.recording.types import Floats, Irregularity
from bcid.vehicle import CommandFields, Mapped, PoseFields, Topics, Vehicle


class _JsonDecoder(DecoderFactory):
    def decoder_for(self, message_encoding: str, schema: Schema | None) -> Callable[[bytes], Any] | None:
        return json.loads if message_encoding == "json" else None


class Track(NamedTuple):
    """The messages of one topic, in file order."""

    log_ns: list[int]
    stamp_ns: list[int | None]
    values: Floats  # (N, n)


def _reading_errors() -> tuple[type[Exception], ...]:
    """What the libraries raise on broken data: format, decompression, decoding, missing fields.

    lz4 knows no better than RuntimeError.
    """
    from zstandard import ZstdError

    broken = (McapError, ZstdError, RuntimeError, struct.error, EOFError)
    return (*broken, json.JSONDecodeError, UnicodeDecodeError, KeyError, AssertionError, TypeError, ValueError)


@contextmanager
def _refusing(path: Path) -> Iterator[None]:
    try:
        yield
    except _reading_errors() as error:
        cause = f"a field is missing: {error}" if isinstance(error, KeyError) else f"{type(error).__name__}: {error}"
        raise InputRefused(
            path, "MCAP data", f"cannot be read: {cause}", "record again, or repair a copy with `mcap recover`"
        ) from None


def _decoders() -> list[DecoderFactory]:
    from mcap_protobuf.decoder import DecoderFactory as Protobuf
    from mcap_ros2.decoder import DecoderFactory as Ros2

    return [_JsonDecoder(), Ros2(), Protobuf()]


def _schema_of(summary: Summary, topic: str, path: Path) -> str:
    """The topic's schema name.

    Raises:
        InputRefused: no such topic (with the nearest name), no message, several schemas or an unreadable encoding.
    """
    channels = [c for c in summary.channels.values() if c.topic == topic]
    listing = ", ".join(f"{c.topic} ({_name(summary, c.schema_id)})" for c in summary.channels.values())
    if not channels:
        near = difflib.get_close_matches(topic, [c.topic for c in summary.channels.values()], n=1)
        hint = f"; nearest: {near[0]}" if near else ""
        raise InputRefused(
            path,
            f"topic {topic}",
            f"is not in the file, which has {listing or 'no topics'}{hint}",
            "correct [topics] in the vehicle file",
        )
    names = {_name(summary, c.schema_id) for c in channels}
    if len(names) > 1:
        raise InputRefused(
            path, f"topic {topic}", f"carries several schemas: {', '.join(sorted(names))}", "record one type per topic"
        )
    unknown = {c.message_encoding for c in channels} - {"json", "cdr", "protobuf"}
    if unknown:
        raise InputRefused(
            path, f"topic {topic}", f"encoding {sorted(unknown)[0]!r} is not read", "record as JSON, CDR or protobuf"
        )
    counts = summary.statistics.channel_message_counts if summary.statistics else {}
    if summary.statistics and not any(counts.get(c.id, 0) for c in channels):
        raise InputRefused(path, f"topic {topic}", "has no messages", "check that it was published during the take")
    return names.pop()


def _name(summary: Summary, schema_id: int) -> str:
    schema = summary.schemas.get(schema_id)
    return messages.base_name(schema.name) if schema else "no schema"


def _field_names(*fields: str | Mapped) -> list[str]:
    names = []
    for f in fields:
        names.append(f if isinstance(f, str) else f.source)
        if isinstance(f, Mapped) and f.zero_where is not None:
            names.append(f.zero_where.field)
    return list(dict.fromkeys(names))


def _mapped_track(reader: McapReader, topic: str, fields: PoseFields | CommandFields) -> Track:
    targets = [f for name, f in fields if name != "time_s"]
    names = _field_names(*targets)
    log_ns, stamps, rows = [], [], []
    for decoded in reader.iter_decoded_messages(topics=[topic], log_time_order=False):
        message = decoded.decoded_message
        log_ns.append(decoded.message.log_time)
        stamps.append(
            messages.nanoseconds(messages.get(message, fields.time_s)) if fields.time_s else messages.stamp_of(message)
        )
        rows.append([float(messages.get(message, name)) for name in names])
    raw = np.array(rows, dtype=float).reshape(len(rows), len(names))
    columns = dict(zip(names, raw.T, strict=True))
    return Track(log_ns, stamps, np.column_stack([mapped(f, columns.__getitem__) for f in targets]))


def _pose_track(reader: McapReader, schema: str, vehicle: Vehicle, topics: Topics, path: Path) -> Track:
    if topics.pose_fields is not None:
        return _mapped_track(reader, topics.pose, topics.pose_fields)
    if schema not in messages.POSES:
        raise InputRefused(
            path,
            f"topic {topics.pose}",
            f"type {schema} is no known pose; known: {', '.join(messages.POSES)}",
            "name its fields in [topics.pose_fields]",
        )
    body = topics.child_frame or vehicle.mocap.rigid_body
    log_ns, stamps, rows = [], [], []
    for decoded in reader.iter_decoded_messages(topics=[topics.pose], log_time_order=False):
        pose = messages.POSES[schema](decoded.decoded_message, body)
        if pose is not None:
            log_ns.append(decoded.message.log_time)
            stamps.append(pose.stamp_ns)
            rows.append([*pose.position, *pose.xyzw])
    if not rows:
        raise InputRefused(
            path,
            f"topic {topics.pose}",
            f"no message holds the body {body!r}",
            "set topics.child_frame in the vehicle file",
        )
    raw = np.array(rows)
    yaw = yaw_of_quaternions(raw[:, 3:], "Z")
    return Track(log_ns, stamps, np.column_stack([raw[:, :2], yaw]))


def _command_track(reader: McapReader, schema: str, topics: Topics, path: Path) -> Track:
    if topics.command_fields is not None:
        return _mapped_track(reader, topics.command, topics.command_fields)
    if schema in messages.TWISTS:
        raise InputRefused(
            path, f"topic {topics.command}", f"type {schema} holds a yaw rate, not a steering angle",
            'if angular.z is an angle here, map it: [topics.command_fields] steering_rad = "angular.z"',
        )  # fmt: skip
    steering, throttle = messages.COMMANDS.get(schema, messages.OWN_COMMAND)
    return _mapped_track(reader, topics.command, CommandFields(steering_rad=steering, throttle_mps=throttle))


def _common_times(pose: Track, command: Track, topics: Topics, path: Path) -> tuple[Floats, Floats, str]:
    """Seconds from the first pose for both tracks: header stamps for both or log times for both."""
    stamped = all(s is not None for s in (*pose.stamp_ns, *command.stamp_ns))
    if topics.time == "header" and not stamped:
        raise InputRefused(
            path, "stamps", "topics.time is header, but a message carries none", 'set topics.time = "log"'
        )
    header = stamped and topics.time != "log"
    pose_ns, command_ns = (np.array(t.stamp_ns if header else t.log_ns, dtype=np.int64) for t in (pose, command))
    zero = pose_ns.min()
    return (pose_ns - zero) / 1e9, (command_ns - zero) / 1e9, "header stamps" if header else "log times"


def read_mcap(path: Path, vehicle: Vehicle) -> RawTake:
    """The take in an MCAP file.

    Raises:
        InputRefused: with the topic and the reason, where the file cannot be used.
    """
    source = source_of(path, "mcap")
    topics = vehicle.topics
    if topics is None:
        raise InputRefused(path, "vehicle file", "has no [topics]", "name the pose and command topics there")
    with path.open("rb") as file, _refusing(path):
        reader = make_reader(file, validate_crcs=True, decoder_factories=_decoders())
        summary = reader.get_summary()
        if summary is None or not summary.channels:
            raise InputRefused(path, "summary", "lists no topics: the file is empty or cut", "record the take again")
        pose = _pose_track(reader, _schema_of(summary, topics.pose, path), vehicle, topics, path)
        command = _command_track(reader, _schema_of(summary, topics.command, path), topics, path)
    pose_s, command_s, base = _common_times(pose, command, topics, path)
    odd: tuple[Irregularity, ...] = ()
    if base == "log times":
        odd = (
            Irregularity(
                "time base", "warning", 1, path.name, "log times stand for both streams: a topic has no stamps"
            ),
        )
    return RawTake(path.stem, (source,), pose_s, pose.values, command_s, command.values, None, {}, odd)
