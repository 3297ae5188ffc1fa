"""Decoders of messages in JSON, the encodings of ROS, and protobuf, made of what an MCAP file says of its channels."""

import json
from collections.abc import Callable
from contextlib import redirect_stderr
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any

from mcap import records as kinds

from bcid.errors import InputRefused
from bcid.recording.formats.fixed_layout import FixedLayout, JsonLayout, RosLayout
from bcid.recording.formats.limits import MESSAGE as LIMITS
from bcid.recording.formats.names import describe_error, printable_name
from bcid.recording.formats.ros_encoding import compile_ros_decoder, compile_ros_reader

REMEDY = "record as JSON, CDR (ros2msg) or protobuf"

ROS_NOTATIONS = {"cdr": "ros2msg", "ros1": "ros1msg"}
"""How the types of each encoding of ROS are defined."""

Decoder = Callable[[bytes], Any]


def message_decoder(channel: kinds.Channel, schema: kinds.Schema | None, path: Path) -> Decoder:
    """The decoder of a channel's messages from bytes to dicts, lists, or protobuf messages.

    Raises:
        InputRefused: the encoding is not read, or the definition of the type is broken or larger than any real one.
    """
    encoding, place = channel.message_encoding, f"topic {printable_name(channel.topic)}"
    if encoding == "json":
        return json.loads
    if encoding not in MAKERS:
        raise InputRefused(path, place, f"encoding {printable_name(repr(encoding))} is not read", REMEDY)
    decode = None
    if schema is not None:
        try:
            decode = MAKERS[encoding](schema)
        except Exception as error:  # whatever a parser raises on a definition that nobody vouches for
            cause = f"its type's definition cannot be read: {describe_error(error)}"
            raise InputRefused(path, place, cause, REMEDY) from error
    if decode is None:
        with_schema = f"a schema in {printable_name(repr(schema.encoding))}" if schema else "no schema"
        raise InputRefused(path, place, f"encoding {encoding!r} with {with_schema} is not read", REMEDY)
    return decode


def fixed_layout(channel: kinds.Channel, schema: kinds.Schema | None, data: bytes) -> FixedLayout | None:
    """The layout of a channel's message, by which others are read as arrays; None where it cannot be decoded."""
    try:
        if channel.message_encoding == "json":
            return JsonLayout(data)
        notation = ROS_NOTATIONS.get(channel.message_encoding)
        if notation is None or schema is None or schema.encoding != notation or len(data) > LIMITS.max_message_bytes:
            return None
        ros_1 = notation == "ros1msg"
        read = compile_ros_reader(schema.name, schema.data.decode("utf-8", "replace"), ros_1)
        return RosLayout(data, read, ros_1)
    except MemoryError:
        raise
    except Exception:  # whatever decoders raise: each message is then decoded by itself, and refused there
        return None


def _ros_decoder(schema: kinds.Schema, notation: str) -> Decoder | None:
    """The decoder of ROS messages that a schema in this `notation` defines; None for another notation."""
    if schema.encoding != notation:
        return None
    return compile_ros_decoder(schema.name, schema.data.decode("utf-8", "replace"), notation == "ros1msg")


def _protobuf_decoder(schema: kinds.Schema) -> Decoder | None:
    """The decoder of protobuf messages that a set of file descriptors defines; None for another notation.

    Raises:
        ValueError: there are more bytes or types in it than `MESSAGE` allows.
    """
    from google.protobuf.descriptor_pb2 import FileDescriptorSet
    from mcap_protobuf.decoder import DecoderFactory

    if len(schema.data) > LIMITS.max_definition_bytes:
        raise ValueError(f"{len(schema.data)} bytes, {LIMITS.max_definition_bytes} are the most")
    # every type becomes a class
    waiting = [m for file in FileDescriptorSet.FromString(schema.data).file for m in file.message_type]
    types = 0
    while waiting:
        types += 1
        waiting += waiting.pop().nested_type
        if types > LIMITS.max_definition_types:
            raise ValueError(f"more than {LIMITS.max_definition_types} types")
    with redirect_stderr(StringIO()):
        decode: Decoder | None = DecoderFactory().decoder_for("protobuf", schema)
    return decode


MAKERS: dict[str, Callable[[kinds.Schema], Decoder | None]] = {
    **{encoding: partial(_ros_decoder, notation=notation) for encoding, notation in ROS_NOTATIONS.items()},
    "protobuf": _protobuf_decoder,
}  # fmt: skip
"""What makes the decoder of each encoding but JSON, whose messages need no schema."""
