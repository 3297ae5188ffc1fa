"""MCAP recordings: pose and command topics named by the vehicle file."""

from __future__ import annotations

import difflib
import json
import struct
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.decoder import DecoderFactory
from mcap.exceptions import McapError
from mcap.reader import McapReader, NonSeekingReader, make_reader
from mcap.records import Channel, Schema

from bcid.errors import InputRefused
from bcid.recording import messages
from bcid.recording.formats import MCAP_MAGIC
from bcid.recording.mapping import mapped
from bcid.recording.orientation import yaw_of_quaternions
from bcid.recording.raw import RawTake, source_of
from bcid.recording.types import Floats, Irregularity
from bcid.vehicle import CHANNELS, CommandFields, Mapped, Topics, Vehicle


class _JsonDecoder(DecoderFactory):
    def decoder_for(self, message_encoding: str, schema: Schema | None) -> Callable[[bytes], Any] | None:
        return json.loads if message_encoding == "json" else None


class Track(NamedTuple):
    """The messages of one topic, in file order."""

    log_ns: list[int]
    stamp_ns: list[int | None]
    values: Floats  # (N, n)


def _reading_errors() -> tuple[type[Exception], ...]:
    """What the libraries raise on broken data: format, decompression, decoding.

    lz4 knows no better than RuntimeError.
    """
    from zstandard import ZstdError

    broken = (McapError, ZstdError, RuntimeError, struct.error, EOFError, OSError, OverflowError)
    return (*broken, json.JSONDecodeError, UnicodeDecodeError, AssertionError, TypeError, ValueError)


@contextmanager
def _refusing(path: Path) -> Iterator[None]:
    try:
        yield
    except messages.SeveralBodies as error:
        raise InputRefused(
            path,
            "pose topic",
            f"its messages hold several bodies: {error}",
            "set topics.child_frame in the vehicle file",
        ) from None
    except KeyError as error:
        raise InputRefused(
            path,
            "message",
            f"a field is missing: {error}",
            "name the fields in [topics.pose_fields] or [topics.command_fields]",
        ) from None
    except _reading_errors() as error:
        raise InputRefused(
            path, "MCAP data", f"cannot be read: {type(error).__name__}: {error}",
            "record again, or repair a copy with `mcap recover`",
        ) from None  # fmt: skip


def _check_end(path: Path) -> None:
    """Raise `InputRefused` where the closing magic is missing."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(0, size - len(MCAP_MAGIC)))
        if file.read() != MCAP_MAGIC or size < 2 * len(MCAP_MAGIC):
            raise InputRefused(
                path,
                f"byte {size}",
                "is cut: the closing magic is missing",
                "record again, or repair a copy with `mcap recover`",
            )


class Inventory(NamedTuple):
    """The file's topics: from the summary, or counted message by message where it has none."""

    schemas: dict[int, Schema]
    channels: dict[int, Channel]
    counts: dict[int, int]


def _inventory(path: Path) -> Inventory:
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    if summary is not None and summary.channels and summary.statistics is not None:
        return Inventory(summary.schemas, summary.channels, dict(summary.statistics.channel_message_counts))
    found = Inventory({}, {}, {})
    with path.open("rb") as file:
        for schema, channel, _ in NonSeekingReader(file).iter_messages(log_time_order=False):
            if schema is not None:
                found.schemas[schema.id] = schema
            found.channels[channel.id] = channel
            found.counts[channel.id] = found.counts.get(channel.id, 0) + 1
    return found


def _decoders() -> list[DecoderFactory]:
    from mcap_protobuf.decoder import DecoderFactory as Protobuf
    from mcap_ros2.decoder import DecoderFactory as Ros2

    return [_JsonDecoder(), Ros2(), Protobuf()]


def _schema_of(inventory: Inventory, topic: str, path: Path) -> str:
    """The topic's schema name.

    Raises:
        InputRefused: no such topic (with the nearest name), no message, several schemas or an unreadable encoding.
    """
    every = inventory.channels.values()
    channels = [c for c in every if c.topic == topic]
    place = f"topic {topic}"
    if not channels:
        listing = ", ".join(f"{c.topic} ({_name(inventory, c.schema_id)})" for c in every)
        near = difflib.get_close_matches(topic, [c.topic for c in every], n=1)
        hint = f"; nearest: {near[0]}" if near else ""
        cause = f"is not in the file, which has {listing or 'no messages'}{hint}"
        raise InputRefused(path, place, cause, "correct [topics] in the vehicle file")
    names = {_name(inventory, c.schema_id) for c in channels}
    if len(names) > 1:
        raise InputRefused(
            path, place, f"carries several schemas: {', '.join(sorted(names))}", "record one type a topic"
        )
    unknown = {c.message_encoding for c in channels} - {"json", "cdr", "protobuf"}
    if unknown:
        cause = f"encoding {sorted(unknown)[0]!r} is not read"
        raise InputRefused(path, place, cause, "record as JSON, CDR or protobuf")
    if not any(inventory.counts.get(c.id, 0) for c in channels):
        raise InputRefused(path, place, "has no messages", "check that it was published during the take")
    return names.pop()


def _name(inventory: Inventory, schema_id: int) -> str:
    schema = inventory.schemas.get(schema_id)
    return messages.base_name(schema.name) if schema else "no schema"


def _field_names(fields: Iterable[Mapped]) -> list[str]:
    names = [name for f in fields for name in (f.source, f.zero_where.field if f.zero_where else None) if name]
    return list(dict.fromkeys(names))


def _mapped_track(reader: McapReader, topic: str, fields: list[Mapped], time_field: str | None) -> Track:
    """The mapped `fields` of every message, one column each."""
    names = _field_names(fields)
    log_ns, stamps, rows = [], [], []
    for decoded in reader.iter_decoded_messages(topics=[topic], log_time_order=False):
        message = decoded.decoded_message
        log_ns.append(decoded.message.log_time)
        own = messages.nanoseconds(messages.get(message, time_field)) if time_field else messages.stamp_of(message)
        stamps.append(own)
        rows.append([float(messages.get(message, name)) for name in names])
    raw = np.array(rows, dtype=float).reshape(len(rows), len(names))
    columns = dict(zip(names, raw.T, strict=True))
    return Track(log_ns, stamps, np.column_stack([mapped(f, columns.__getitem__) for f in fields]))


def _pose_track(reader: McapReader, schema: str, vehicle: Vehicle, topics: Topics, path: Path) -> Track:
    fields = topics.pose_fields
    if fields is not None:
        return _mapped_track(reader, topics.pose, [fields.x_m, fields.y_m, fields.yaw_rad], fields.time_s)
    if schema not in messages.POSES:
        cause = f"type {schema} is no known pose; known: {', '.join(messages.POSES)}"
        raise InputRefused(path, f"topic {topics.pose}", cause, "name its fields in [topics.pose_fields]")
    body = topics.child_frame or vehicle.mocap.rigid_body
    log_ns, stamps, rows = [], [], []
    for decoded in reader.iter_decoded_messages(topics=[topics.pose], log_time_order=False):
        pose = messages.POSES[schema](decoded.decoded_message, body)
        if pose is not None:
            log_ns.append(decoded.message.log_time)
            stamps.append(pose.stamp_ns)
            rows.append([*pose.position, *pose.xyzw])
    if not rows:
        cause = f"no message holds the body {body!r}"
        raise InputRefused(path, f"topic {topics.pose}", cause, "set topics.child_frame in the vehicle file")
    raw = np.array(rows)
    yaw = yaw_of_quaternions(raw[:, 3:], "Z")
    return Track(log_ns, stamps, np.column_stack([raw[:, :2], yaw]))


def _command_fields(schema: str, first: Any, topics: Topics, path: Path) -> CommandFields:
    """Where the commands' fields are: as the vehicle file says, or as the message type has them."""
    if topics.command_fields is not None:
        return topics.command_fields
    if schema in messages.TWISTS:
        inside = "twist." if schema.endswith("Stamped") else ""
        raise InputRefused(
            path, f"topic {topics.command}", f"type {schema} holds a yaw rate, not a steering angle",
            f'if angular.z is an angle here, map it: [topics.command_fields] steering_rad = "{inside}angular.z", '
            f'throttle_mps = "{inside}linear.x"',
        )  # fmt: skip
    steering, throttle = messages.COMMANDS.get(schema, messages.OWN_COMMAND)
    extra = {name: name for name in CHANNELS if messages.get(first, name, None) is not None}
    return CommandFields.model_validate({"steering_rad": steering, "throttle_mps": throttle, **extra})


def _command_track(reader: McapReader, schema: str, topics: Topics, path: Path) -> tuple[Track, list[str]]:
    """Steering, throttle and what further channels there are, with their names."""
    messages_of = reader.iter_decoded_messages(topics=[topics.command], log_time_order=False)
    fields = _command_fields(schema, next(iter(messages_of)).decoded_message, topics, path)
    extra = {name: field for name in CHANNELS if (field := getattr(fields, name)) is not None}
    wanted = [fields.steering_rad, fields.throttle_mps, *extra.values()]
    track = _mapped_track(reader, topics.command, wanted, fields.time_s)
    if schema in messages.COMMANDS and topics.command_fields is None and track.values[:, 1].min() < 0.0:
        raise InputRefused(
            path, f"topic {topics.command}", "holds negative speeds, which would read as brake shares",
            "map them in [topics.command_fields], with low = 0.0 where the car only coasts",
        )  # fmt: skip
    return track, list(extra)


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
    _check_end(path)
    with path.open("rb") as file, _refusing(path):
        inventory = _inventory(path)
        schemas = [_schema_of(inventory, topic, path) for topic in (topics.pose, topics.command)]
        reader = make_reader(file, validate_crcs=True, decoder_factories=_decoders())
        pose = _pose_track(reader, schemas[0], vehicle, topics, path)
        command, extra = _command_track(reader, schemas[1], topics, path)
        pose_s, command_s, base = _common_times(pose, command, topics, path)
    odd: tuple[Irregularity, ...] = ()
    if base == "log times":
        text = "log times stand for both streams: a topic has no stamps, or the vehicle file says so"
        odd = (Irregularity("time base", "warning", 1, path.name, text),)
    channels = {name: (command_s, command.values[:, 2 + i]) for i, name in enumerate(extra)}
    values = command.values[:, :2]
    return RawTake(path.stem, (source,), pose_s, pose.values, command_s, values, None, channels, odd)
