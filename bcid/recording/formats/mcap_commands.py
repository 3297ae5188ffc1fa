"""Commands and further channels from the messages of an MCAP file's command topic, or of one topic each."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.mapping import OPTIONAL_CHANNELS, CommandFields, FieldMapping
from bcid.recording.formats import ros_messages as ros
from bcid.recording.formats.held_commands import held_too_long
from bcid.recording.formats.mcap_contents import McapContents
from bcid.recording.formats.mcap_poses import read_mapped_fields, track_of_table
from bcid.recording.formats.mcap_times import MessageTrack
from bcid.recording.formats.message_fields import get_field
from bcid.recording.formats.names import list_names, printable_name
from bcid.recording.formats.raw import map_field, raw_field_names
from bcid.vehicle import CommandTopics, Topics, Vehicle

MAP_FIELDS = "name its fields in [topics.command_fields]"
TWO_TOPICS = 'or the two topics: [topics] command = {steering = "/a", throttle = "/b"}'


class CommandTrack(NamedTuple):
    """Columns of one topic's messages, each a command or a channel, with their times."""

    columns: tuple[str, ...]
    track: MessageTrack


def command_topics(topics: Topics) -> dict[str, str]:
    """The topics of the commands, each with its part: "command", or "steering" and "throttle"."""
    if isinstance(topics.command, CommandTopics):
        if topics.command.steering == topics.command.throttle:
            return {topics.command.steering: "command"}
        return {topics.command.steering: "steering", topics.command.throttle: "throttle"}
    return {topics.command: "command"}


def read_command_track(
    contents: McapContents, topic: str, schema: str, topics: Topics, vehicle: Vehicle
) -> CommandTrack:
    """The columns that the messages of one command topic hold, in SI units.

    Raises:
        InputRefused: the type is no known command and its fields are not mapped, or holds what reads as another.
    """
    part, place = command_topics(topics)[topic], f"topic {printable_name(topic)}"
    first = next((m for _, m in contents.read_messages(topic, lambda m: m)), None)
    if first is None:
        raise InputRefused(contents.path, place, "has no message in this part", "choose another part of the take")
    fields = _choose_fields(contents, topic, schema, first, topics)
    missing = [n for n in raw_field_names(fields.values()) if get_field(first, n, None) is None]
    if missing:
        has = f"; it has {list_names(first)}" if isinstance(first, Mapping) else ""
        cause = f"type {printable_name(schema)} has no {list_names(missing)}: it is no known {part}{has}"
        raise InputRefused(contents.path, place, cause, f"{MAP_FIELDS}, {TWO_TOPICS}")
    mapped = topics.command_fields
    names = raw_field_names(fields.values())
    table = read_mapped_fields(contents, topic, names, topics, mapped.time_s if mapped else None)
    columns = dict(zip(names, table.rows.T, strict=True))
    values = np.column_stack([map_field(f, columns.__getitem__) for f in fields.values()])
    if schema in ros.COMMAND_PATHS and mapped is None and not vehicle.motor.reverses:
        _check_signs(values, list(fields).index("throttle_mps"), contents, place)
    return CommandTrack(tuple(fields), track_of_table(table, values, topic, contents))


def _check_signs(values: Floats, throttle: int, contents: McapContents, place: str) -> None:
    """Raise `InputRefused` where speeds below zero in the column `throttle` of `values` would read as brake shares."""
    if np.nanmin(values[:, throttle], initial=0.0) < 0.0:
        cause = "holds negative speeds, which would read as brake shares"
        step = "set motor.reverses = true where the car drives backward then, "
        step += "or map them in [topics.command_fields], with low = 0.0 where it only coasts"
        raise InputRefused(contents.path, place, cause, step)


def _choose_fields(
    contents: McapContents, topic: str, schema: str, first: Any, topics: Topics
) -> dict[str, FieldMapping]:
    """Which fields of a topic's messages hold which commands and channels, by the vehicle file or the type.

    `first` is the first message, which shows what channels there are; a Twist without a mapping is refused.
    """
    part, mapped = command_topics(topics)[topic], topics.command_fields
    wanted = {"command": ("steering_rad", "throttle_mps"), "steering": ("steering_rad",), "throttle": ("throttle_mps",)}
    if mapped is None:
        mapped = _known_fields(contents, topic, schema, first, part)
    fields = {name: getattr(mapped, name) for name in wanted[part]}
    # of two topics, each gives the channels that it holds
    present = {n: f for n, f in mapped.channels.items() if part == "command" or _holds(first, f)}
    return {**fields, **present}


def _holds(message: Any, field: FieldMapping) -> bool:
    """Whether a message holds a mapped field."""
    return get_field(message, field.source, None) is not None


def _known_fields(contents: McapContents, topic: str, schema: str, first: Any, part: str) -> CommandFields:
    """The fields of a command of a known type, or of bcid's own; a single number stands for a `part` of a command."""
    if part == "command" and schema in ros.TWIST_SCHEMAS:
        inside = "twist." if schema.endswith("Stamped") else ""
        raise InputRefused(
            contents.path, f"topic {printable_name(topic)}", f"type {schema} holds a yaw rate, not a steering angle",
            f'if angular.z is an angle here, map it: [topics.command_fields] steering_rad = "{inside}angular.z", '
            f'throttle_mps = "{inside}linear.x"',
        )  # fmt: skip
    steering, throttle = ros.COMMAND_PATHS.get(schema, ros.OWN_COMMAND_PATHS)
    if part != "command":
        single = next((name for name in ros.NUMBER_PATHS if get_field(first, name, None) is not None), None)
        steering, throttle = (single, single) if single else (steering, throttle)
    extra = {name: name for name in OPTIONAL_CHANNELS if get_field(first, name, None) is not None}
    return CommandFields.model_validate({"steering_rad": steering, "throttle_mps": throttle, **extra})


def merge_commands(tracks: list[CommandTrack], times_s: list[Floats], hold_s: float) -> tuple[Floats, Floats]:
    """Command times (M,) in s and commands [steering, throttle] (M, 2), from one topic or from one of each.

    A value holds until the next message of its topic: each message makes a row, from the first on at which both are
    known; messages of one instant make one.  A topic that is sent at a rate and then is silent for more than `hold_s`
    says nothing more until its next message.
    """
    if len(tracks) == 1:
        rows = [tracks[0].columns.index(name) for name in ("steering_rad", "throttle_mps")]
        return times_s[0], tracks[0].track.values[:, rows]
    series = {}
    for command, time_s in zip(tracks, times_s, strict=True):
        order = np.argsort(time_s, kind="stable")
        name = "steering_rad" if "steering_rad" in command.columns else "throttle_mps"
        series[name] = (time_s[order], command.track.values[order, command.columns.index(name)])
    (steering_s, u_s), (throttle_s, u_m) = series["steering_rad"], series["throttle_mps"]
    merged_s = np.unique(np.r_[steering_s, throttle_s])
    merged_s = merged_s[merged_s >= max(steering_s[0], throttle_s[0])]
    at = [np.searchsorted(t, merged_s, side="right") - 1 for t in (steering_s, throttle_s)]
    commands = np.column_stack([u_s[at[0]], u_m[at[1]]])
    for k, sample_s in enumerate((steering_s, throttle_s)):
        commands[held_too_long(sample_s, merged_s, hold_s), k] = np.nan
    return merged_s, commands
