"""MCAP recordings: the pose and command topics that the vehicle file names."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from bcid.errors import InputRefused, Problems
from bcid.recording.formats.detect import recording_files
from bcid.recording.formats.mcap_commands import command_topics, merge_commands, read_command_track
from bcid.recording.formats.mcap_contents import CHANNELS_PER_FILE, McapContents, read_contents
from bcid.recording.formats.mcap_part import LoggedPart, TooManyMessages
from bcid.recording.formats.mcap_poses import read_pose_track
from bcid.recording.formats.mcap_times import common_times
from bcid.recording.formats.names import SHOWN_NAMES, printable_name
from bcid.recording.formats.raw import RawTake, TimeCut, identify_file, nearest_hint
from bcid.recording.formats.transforms import STATIC_TOPIC
from bcid.recording.types import Irregularity
from bcid.vehicle import Vehicle


def _topic_schema_name(contents: McapContents, topic: str) -> str:
    """The name of the type of a topic's messages; `InputRefused` where it has none, is absent, or has several types."""
    every, path, place = contents.channels.values(), contents.path, f"topic {printable_name(topic)}"
    if not every:
        raise InputRefused(path, place, "is not in the file, which has no channels", "record the topics")
    if topic not in {c.topic for c in every}:
        texts = [f"{printable_name(c.topic)} ({printable_name(contents.schema_name(c.schema_id))})" for c in every]
        listing = ", ".join(texts[:SHOWN_NAMES]) + (", …" if len(texts) > SHOWN_NAMES else "")
        nearest = printable_name(nearest_hint(topic, (c.topic for c in every)))
        cause = f"is not in the file, which has {listing}{nearest}"
        raise InputRefused(path, place, cause, "correct [topics] in the vehicle file")
    channels = contents.published_channels(topic)
    if not channels:
        raise InputRefused(path, place, "has no messages", "check that it was published during the take")
    schemas = {c.id: contents.schemas.get(c.schema_id) for c in channels}
    types = {(c.message_encoding, *((s.name, s.encoding, s.data) if (s := schemas[c.id]) else ())) for c in channels}
    if len(types) > 1:
        kinds = {f"{contents.schema_name(c.schema_id)} in {c.message_encoding}" for c in channels}
        names = sorted(map(printable_name, kinds))
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
            warnings.append(Irregularity("publishers", "warning", n, f"topic {printable_name(topic)}", text))
    return warnings


def read_mcap(path: Path, vehicle: Vehicle, allow_partial: bool = False, cut: TimeCut | None = None) -> RawTake:
    """The unchecked pose and command streams of an MCAP file or a split bag's folder, by the vehicle file's topics.

    With `allow_partial`, parts that cannot be read are left out and noted.  Where a `cut` is given and the file holds
    more messages than are held at once, those far outside of it are left out.

    Raises:
        InputRefused: the file cannot be used, with the problems of all topics.
    """
    sources = tuple(identify_file(part, "mcap") for part in recording_files(path))
    topics = vehicle.topics
    if topics is None:
        raise InputRefused(path, "vehicle file", "has no [topics]", "name the pose and command topics there")
    wanted, problems, commands = (topics.pose, *command_topics(topics)), Problems(), []
    try:
        contents = read_contents(path, (*wanted, STATIC_TOPIC), allow_partial)
    except TooManyMessages:
        if cut is None:
            raise
        part = LoggedPart(cut, vehicle.command.max_hold_s)
        contents = read_contents(path, (*wanted, STATIC_TOPIC), allow_partial, topics.pose, part)
    with problems.gather_refusals():
        pose = read_pose_track(contents, _topic_schema_name(contents, topics.pose), vehicle, topics)
        if contents.part is not None:
            contents.part.check_first_pose(pose.log_ns, path)
    for topic in command_topics(topics):
        with problems.gather_refusals():
            commands.append(read_command_track(contents, topic, _topic_schema_name(contents, topic), topics, vehicle))
    problems.raise_if_any(path)
    times = common_times(pose, [command.track for command in commands], topics, path)
    channels = {
        name: (time_s, command.track.values[:, i])
        for command, time_s in zip(commands, times.command_s, strict=True)
        for i, name in enumerate(command.columns)
        if name not in ("steering_rad", "throttle_mps")
    }
    command_s, command = merge_commands(commands, times.command_s, vehicle.command.max_hold_s)
    several = _find_several_publishers(contents, command_topics(topics))
    of_pose = [*_find_several_publishers(contents, [topics.pose]), *pose.irregularities]
    return RawTake(
        path.stem, sources, times.pose_s, pose.values, command_s, command, None, channels,
        (*contents.irregularities(), *several, *of_pose, *times.irregularities), times.splits_s, bool(several),
    )  # fmt: skip
