"""Poses on the floor from the messages of an MCAP file's pose topic: known types, transform trees, mapped fields."""

from collections.abc import Iterable, Iterator
from functools import partial
from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.mapping import PoseFields
from bcid.recording.formats import ros_messages as ros
from bcid.recording.formats import transforms as tf
from bcid.recording.formats.floor import mapped_poses_on_floor, poses_on_floor
from bcid.recording.formats.limits import MCAP as LIMITS
from bcid.recording.formats.mcap_contents import McapContents
from bcid.recording.formats.mcap_times import MessageTrack
from bcid.recording.formats.message_fields import chooses_item, get_field, names_in_list, number_at
from bcid.recording.formats.message_stamps import parse_stamp, resolve_stamps
from bcid.recording.formats.names import list_names, printable_name
from bcid.recording.formats.number_tables import BodyRow, NumberFields, NumberTable, read_number_tables
from bcid.recording.formats.raw import map_field, raw_field_names
from bcid.recording.types import Irregularity
from bcid.vehicle import Mocap, Topics, Vehicle

NAME_BODY = "set topics.child_frame (or mocap.rigid_body) in the vehicle file to one of them"
MAP_FIELDS = (
    'map its fields in [topics.pose_fields]: x_m, y_m, and yaw_rad or qx, qy, qz, qw, such as "poses[0].position.x" '
    'or "bodies[name=car].pose.position.x"'
)


def read_mapped_fields(
    contents: McapContents, topic: str, names: list[str], topics: Topics, time: str | None
) -> NumberTable:
    """The fields `names` of a topic's messages as a `NumberTable` of as many columns.

    Stamps are read from the field `time`, or from the usual places in the header where it is None; they are None
    where the vehicle file wants log times.
    """
    fields = NumberFields(names, stamped=topics.time != "log", stamp=time)

    def read(message: Any) -> BodyRow:
        """The stamp and the numbers of one message."""
        stamp = parse_stamp(fields.stamp_of(message))
        return BodyRow("", stamp, [number_at(message, name) for name in names])

    tables = read_number_tables(contents, topic, fields, read)
    return tables.get("", NumberTable(len(names)))


def track_of_table(
    table: NumberTable, values: Floats, topic: str, contents: McapContents, odd: Iterable[Irregularity] = ()
) -> MessageTrack:
    """The track of a topic whose messages gave `table`, with these `values` (N, n) and their irregularities."""
    stamps = resolve_stamps(table.stamps, table.log_ns, topic, contents.path)
    return MessageTrack(table.log_ns, stamps, values, list(odd), topic)


def read_pose_track(contents: McapContents, schema: str, vehicle: Vehicle, topics: Topics) -> MessageTrack:
    """The pose topic's messages as values (N, 3): x (m), y (m) and yaw (rad) of the vehicle's body, with their times.

    `schema` names the message type: a known pose type, a transform tree, or any if the vehicle file maps its fields.

    Raises:
        InputRefused: the type is not known, the body is not in the messages, or the poses are none of a car.
    """
    if topics.pose_fields is not None:
        return _read_mapped_poses(contents, topics.pose_fields, vehicle, topics)
    if schema in tf.TREE_SCHEMAS:
        return _read_tree(contents, vehicle, topics)
    if schema in ros.FLOOR_POSES:
        return _read_floor_poses(contents, ros.FLOOR_POSES[schema], vehicle.mocap, topics)
    place, mocap = f"topic {printable_name(topics.pose)}", vehicle.mocap
    if schema in ros.POSE_LISTS:
        table = _read_listed(contents, ros.POSE_LISTS[schema], vehicle, topics)
    elif schema in ros.SINGLE_POSES:
        where = ros.SINGLE_POSES[schema]
        table = _read_single(contents, where, vehicle, topics)
        if where.unit_m != 1.0 and mocap.length_unit is None:
            mocap = mocap.model_copy(update={"length_unit": {1e-3: "mm", 1e-2: "cm"}[where.unit_m]})
    else:
        known = ", ".join((*ros.SINGLE_POSES, *ros.POSE_LISTS, *ros.FLOOR_POSES, *tf.TREE_SCHEMAS))
        cause = f"type {printable_name(schema)} is no known pose; known: {known}"
        raise InputRefused(contents.path, place, cause, MAP_FIELDS)
    values, odd = poses_on_floor(table.rows, mocap, table.logged_s, contents.path)
    return track_of_table(table, values, topics.pose, contents, odd)


def _read_mapped_poses(contents: McapContents, mapping: PoseFields, vehicle: Vehicle, topics: Topics) -> MessageTrack:
    """The pose topic's messages by the fields that the vehicle file maps."""
    names = raw_field_names(mapping.fields)
    table = read_mapped_fields(contents, topics.pose, names, topics, mapping.time_s)
    columns = dict(zip(names, table.rows.T, strict=True))
    _check_choices(contents, topics.pose, columns)
    if mapping.yaw_rad is not None:
        _check_yaw_field(contents, topics.pose, mapping.yaw_rad.source)
    mapped = [map_field(f, columns.__getitem__) for f in mapping.fields]
    values, odd = mapped_poses_on_floor(mapped, mapping, vehicle.mocap, table.logged_s, contents.path)
    return track_of_table(table, values, topics.pose, contents, odd)


def _check_choices(contents: McapContents, topic: str, columns: dict[str, Floats]) -> None:
    """Raise `InputRefused` where no message holds the item of a list that a field's path chooses by its name."""
    for name, column in columns.items():
        if chooses_item(name) and np.isnan(column).all():
            listed = contents.read_messages(topic, partial(names_in_list, path=name))
            every = dict.fromkeys(n for _, names in listed for n in names)
            cause = f"no message holds {printable_name(name)}; there are {list_names(every)}"
            place = f"topic {printable_name(topic)}"
            raise InputRefused(contents.path, place, cause, "correct the name in [topics.pose_fields]")


def _check_yaw_field(contents: McapContents, topic: str, name: str) -> None:
    """Raise `InputRefused` where the field that is mapped as yaw is a part of a quaternion."""
    whole, _, part = name.rpartition(".")
    first = next((m for _, m in contents.read_messages(topic, lambda m: m)), None)
    if whole and part in "xyzw" and all(get_field(first, f"{whole}.{c}", None) is not None for c in "xyzw"):
        cause = f"yaw_rad is mapped from {printable_name(name)}, a part of a quaternion"
        step = "map all of it: " + ", ".join(f'q{c} = "{whole}.{c}"' for c in "xyzw")
        raise InputRefused(contents.path, f"topic {printable_name(topic)}", cause, step)


def _read_floor_poses(
    contents: McapContents, fields: tuple[str, str, str], mocap: Mocap, topics: Topics
) -> MessageTrack:
    """Poses on the floor from the fields of x, y (in the vehicle file's unit of length) and yaw."""
    table = read_mapped_fields(contents, topics.pose, list(fields), topics, None)
    values = table.rows * [mocap.metres_per_unit, mocap.metres_per_unit, 1.0]
    return track_of_table(table, values, topics.pose, contents)


def _read_listed(contents: McapContents, where: ros.PoseList, vehicle: Vehicle, topics: Topics) -> NumberTable:
    """Poses (N, 7) of the vehicle's body in messages with a list of bodies; refused where it is in none of them."""
    body, stamped = topics.child_frame or vehicle.mocap.rigid_body, topics.time != "log"
    place = f"topic {printable_name(topics.pose)}"

    def read(message: Any) -> tuple[ros.StampedPose | None, list[str]]:
        """The body's pose in one message, or the names of the bodies that are there."""
        try:
            pose = ros.read_listed_pose(message, where, body, stamped)
        except ros.SeveralBodies as error:
            step = MAP_FIELDS if where.name is None else NAME_BODY
            raise InputRefused(contents.path, place, f"its messages hold several bodies: {error}", step) from None
        return pose, [] if pose is not None else ros.body_names(message, where)

    table, others = NumberTable(7), dict[str, None]()
    for log_ns, (pose, names) in contents.read_messages(topics.pose, read):
        others |= dict.fromkeys(names)
        if pose is not None:
            table.add(log_ns, pose.stamp, pose.row)
    if not table.log_ns:
        cause = f"no message holds the body {printable_name(repr(body))}; there are {list_names(others)}"
        raise InputRefused(contents.path, place, cause, NAME_BODY)
    return table


def _read_single(contents: McapContents, where: ros.SinglePose, vehicle: Vehicle, topics: Topics) -> NumberTable:
    """Poses (N, 7) of messages of one body each; of the vehicle's where bodies of several names share the topic.

    The only body of a topic is taken whatever its name, unless `topics.child_frame` asks for another.
    """
    fields = NumberFields(where.paths(), where.body, topics.time != "log")

    def read(message: Any) -> BodyRow:
        """The body's name, or "" without one, and its pose."""
        name = "" if where.body is None else str(get_field(message, where.body, ""))
        return BodyRow(name, *ros.read_single_pose(message, where, fields.stamped))

    tables = read_number_tables(contents, topics.pose, fields, read)
    body = topics.child_frame or vehicle.mocap.rigid_body
    if where.body is not None and body in tables:
        return tables[body]
    if len(tables) > 1 or (topics.child_frame is not None and not {"", topics.child_frame} & tables.keys()):
        cause = f"its messages hold the bodies {list_names(tables)}"
        cause += f", none is {printable_name(repr(body))}" if body is not None else ""
        raise InputRefused(contents.path, f"topic {printable_name(topics.pose)}", cause, NAME_BODY)
    return next(iter(tables.values()))


def _read_tree(contents: McapContents, vehicle: Vehicle, topics: Topics) -> MessageTrack:
    """Poses of the vehicle's body in the world, by the transforms of the pose topic and of /tf_static."""
    stamped, place = topics.time != "log", f"topic {printable_name(topics.pose)}"

    def sent(topic: str) -> Iterator[tuple[int, list[tf.SentTransform]]]:
        """The log times (ns) and the transforms of a topic's messages; refused where there are very many."""
        total = 0
        for log_ns, found in contents.read_messages(topic, lambda m: tf.read_transforms(m, stamped)):
            total += len(found)
            if total > LIMITS.max_messages:
                cause = f"holds more than {LIMITS.max_messages} transforms"
                raise InputRefused(contents.path, place, cause, "cut the recording into takes")
            yield log_ns, found

    messages = list(sent(topics.pose))
    if topics.pose != tf.STATIC_TOPIC:
        # static transforms hold throughout, whenever they were sent
        messages += [(0, found) for _, found in sent(tf.STATIC_TOPIC)]
    tree = tf.read_transform_tree(messages)
    try:
        edges = tf.edges_to_world(
            tree, topics.child_frame or vehicle.mocap.rigid_body, topics.world_frame, contents.path
        )
    except ros.SeveralBodies as error:
        cause = f"its messages hold several bodies: {error}"
        raise InputRefused(contents.path, place, cause, NAME_BODY) from None
    table = NumberTable(7)
    timed = tf.moving_edge(edges)
    table.log_ns, table.stamps = timed.log_ns, timed.stamps
    rows = tf.compose_transforms(edges, timed.log_ns)
    values, odd = poses_on_floor(rows, vehicle.mocap, table.logged_s, contents.path)
    return track_of_table(table, values, topics.pose, contents, [*odd, *tf.find_rare_frames(tree, timed)])
