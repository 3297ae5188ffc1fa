"""Stamps, poses, transforms and commands in messages, be they decoded from JSON, ROS 2 or protobuf."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.recording.limits import MCAP, POSE
from bcid.recording.types import Irregularity

_MISSING = object()


class StampedPose(NamedTuple):
    """A pose in space, and its stamp, which is None where the message carries none."""

    stamp_ns: int | None
    row: list[float]  # position x, y, z, then quaternion x, y, z, w


def get_field(message: Any, path: str, default: Any = _MISSING) -> Any:
    """The field at a dotted `path` such as `axes.0` of a decoded message, or `default`; `KeyError` without either."""
    for part in path.split("."):
        if part.isdecimal() and isinstance(message, Sequence):
            message = message[int(part)] if int(part) < len(message) else _MISSING
        elif isinstance(message, Mapping):
            message = message.get(part, _MISSING)
        else:
            message = getattr(message, part, _MISSING)
        if message is _MISSING:
            if default is _MISSING:
                raise KeyError(path)
            return default
    return message


def parse_number(value: Any) -> float:
    """A message field's value as a float: NaN where it is blank (JSON's null), +inf where it is NaN or infinite."""
    if value is None:
        return math.nan
    return float(value) if math.isfinite(float(value)) else math.inf


def stamp_to_nanoseconds(stamp: Any) -> int | None:
    """A stamp in ns, from {sec, nanosec}, {sec, nsec}, {seconds, nanos} or a number of seconds; None from others."""
    if isinstance(stamp, int | float):
        return round(stamp * 1e9)
    for whole, part in (("sec", "nanosec"), ("sec", "nsec"), ("seconds", "nanos")):
        sec, nsec = get_field(stamp, whole, None), get_field(stamp, part, None)
        if sec is not None and nsec is not None:
            return int(sec) * 1_000_000_000 + int(nsec)
    return None


def message_stamp_ns(message: Any) -> int | None:
    """The stamp (ns) of a message, in its `header.stamp`, `timestamp`, `stamp` or `time_s`; None where it has none."""
    for path in ("header.stamp", "timestamp", "stamp", "time_s"):
        stamp = get_field(message, path, None)
        if stamp is not None:
            return stamp_to_nanoseconds(stamp)
    return None


def pose_row(position: Any, orientation: Any) -> list[float]:
    """The list [x, y, z, q_x, q_y, q_z, q_w] of a decoded position and quaternion."""
    fields = [(position, c) for c in "xyz"] + [(orientation, c) for c in "xyzw"]
    return [parse_number(get_field(vector, c)) for vector, c in fields]


def _read_pose(message: Any, pose: Any) -> StampedPose:
    """A decoded `pose` (position and quaternion) with the stamp of the message that holds it."""
    return StampedPose(message_stamp_ns(message), pose_row(get_field(pose, "position"), get_field(pose, "orientation")))


def _pose_reader_at(path: str) -> Callable[[Any, str | None], StampedPose | None]:
    """A function (message, body) -> pose that reads the pose at the dotted `path`, whatever the body's name."""
    return lambda message, body: _read_pose(message, get_field(message, path))


class SeveralBodies(Exception):
    """Messages hold several bodies and none was named."""


def _read_transform_stamped(message: Any, body: str | None) -> StampedPose | None:
    """The pose in a TransformStamped message; None where its child frame is another than `body`."""
    if body is not None and get_field(message, "child_frame_id", body) != body:
        return None
    row = pose_row(get_field(message, "transform.translation"), get_field(message, "transform.rotation"))
    return StampedPose(message_stamp_ns(message), row)


def _read_rigid_body(message: Any, body: str | None) -> StampedPose | None:
    """The pose of the rigid body named `body` in a RigidBodies message; None where only others are in it.

    Where no body is named it is that of the only one; `SeveralBodies` where there are more.
    """
    bodies = get_field(message, "rigidbodies")
    if body is None and len(bodies) > 1:
        raise SeveralBodies(", ".join(str(get_field(b, "rigid_body_name")) for b in bodies))
    found = next((b for b in bodies if body is None or get_field(b, "rigid_body_name") == body), None)
    return None if found is None else _read_pose(message, get_field(found, "pose"))


POSE_READERS: dict[str, Callable[[Any, str | None], StampedPose | None]] = {
    "foxglove.PoseInFrame": _pose_reader_at("pose"),
    "geometry_msgs/PoseStamped": _pose_reader_at("pose"),
    "geometry_msgs/PoseWithCovarianceStamped": _pose_reader_at("pose.pose"),
    "geometry_msgs/TransformStamped": _read_transform_stamped,
    "nav_msgs/Odometry": _pose_reader_at("pose.pose"),
    "mocap4r2_msgs/RigidBodies": _read_rigid_body,
}
"""Pose reader by schema name: (message, name of the body) -> pose, or None where it holds another body."""

COMMAND_PATHS: dict[str, tuple[str, str]] = {
    "ackermann_msgs/AckermannDrive": ("steering_angle", "speed"),
    "ackermann_msgs/AckermannDriveStamped": ("drive.steering_angle", "drive.speed"),
}
"""Paths of the steering angle and the speed by schema name."""

OWN_COMMAND_PATHS = ("steering_rad", "throttle_mps")
TWIST_SCHEMAS = ("geometry_msgs/Twist", "geometry_msgs/TwistStamped")
TF_SCHEMA, STATIC_TOPIC = "tf2_msgs/TFMessage", "/tf_static"


class FrameTransforms(NamedTuple):
    """The transforms that were sent for one edge of the tree, in file order."""

    log_ns: list[int]
    stamp_ns: list[int | None]
    rows: list[list[float]]  # x, y, z, then the quaternion x, y, z, w of the child in its parent


TransformTree = dict[str, dict[str, FrameTransforms]]
"""The transforms that were sent, by the names of the child and the parent frame."""


def read_transform_tree(messages: Iterable[tuple[int, Any]]) -> TransformTree:
    """All transforms in decoded tf2 messages (log time in ns, message), collected by child and parent frame."""
    tree: TransformTree = {}
    for logged, message in messages:
        for item in get_field(message, "transforms"):
            child, parent = str(get_field(item, "child_frame_id")), str(get_field(item, "header.frame_id", ""))
            moves = tree.setdefault(child, {}).setdefault(parent, FrameTransforms([], [], []))
            moves.log_ns.append(logged)
            moves.stamp_ns.append(message_stamp_ns(item))
            moves.rows.append(pose_row(get_field(item, "transform.translation"), get_field(item, "transform.rotation")))
    return tree


def edges_to_world(tree: TransformTree, body: str | None, world: str | None, path: Path) -> list[FrameTransforms]:
    """The chain of transforms from the frame `body` up to the frame `world`, or to the tree's root if that is None.

    Each element holds all that were sent between a child and its parent.  Where `body` is None, it is the only frame
    without a child.

    Raises:
        InputRefused: no such body, two parents of one frame, a cycle, a world that is not reached, or several roots
            where none is named.
        SeveralBodies: no body is named, and several frames have no child.
    """
    place = "transforms"
    if body is None:
        parents = {parent for edges in tree.values() for parent in edges}
        leaves = [child for child in tree if child not in parents]
        if len(leaves) > 1:
            raise SeveralBodies(", ".join(leaves))
        body = leaves[0] if leaves else next(iter(tree), None)
    if body is None or body not in tree:
        cause = f"no message holds the body {body!r}, only {', '.join(tree) or 'none'}"
        raise InputRefused(path, place, cause, "set topics.child_frame in the vehicle file")
    edges, frame, seen = [], body, {body}
    while frame in tree and frame != world:
        if len(tree[frame]) > 1:
            cause = f"{frame} has several parents: {', '.join(sorted(tree[frame]))}"
            raise InputRefused(path, place, cause, "let one node send each frame")
        parent, moves = next(iter(tree[frame].items()))
        if parent in seen:
            raise InputRefused(path, place, f"a cycle: {parent} -> {frame} leads back to {parent}", "mend the tree")
        edges.append(moves)
        seen.add(parent)
        frame = parent
    roots = {parent for parents in tree.values() for parent in parents} - tree.keys()
    if world is None and len(roots) > 1:
        others = ", ".join(sorted(roots - {frame}))
        cause = f"the tree is broken: {body} hangs on {frame}, other frames on {others}"
        step = f'record the transform between them, or set topics.world_frame = "{frame}"'
        raise InputRefused(path, place, cause, step)
    if world is not None and frame != world:
        cause = f"the tree is broken: {frame} has no parent, so {body} is not connected to {world}"
        raise InputRefused(path, place, cause, "record the missing transform, or set topics.world_frame")
    return edges


def find_rare_frames(tree: TransformTree, own: FrameTransforms) -> list[Irregularity]:
    """A list with a warning of frames sent at most `MCAP.max_rare_messages` times, as if the body's were misspelt.

    The body's `own` transforms must be `MCAP.min_rare_ratio` times as many; else the list is empty.
    """
    # static transforms have a log time of 0
    sent = {child: sum(log > 0 for m in edges.values() for log in m.log_ns) for child, edges in tree.items()}
    most, ratio = MCAP.max_rare_messages, MCAP.min_rare_ratio
    rare = {child: n for child, n in sent.items() if 0 < n <= most and n * ratio <= len(own.log_ns)}
    if not rare:
        return []
    text = f"sent beside {len(own.log_ns)} of the body: {', '.join(map(repr, rare))}; a name gone wrong?"
    return [Irregularity("rare frames", "warning", sum(rare.values()), "transforms", text)]


def compose_transforms(edges: list[FrameTransforms]) -> Floats:
    """Poses (N, 7) of the body in the world: x, y, z (m), quaternion x, y, z, w; one per transform in `edges[0]`.

    `edges` lead from the body up to the world; each pose is composed with the last transform of every further edge
    that was logged by then, and NaN where there is none.
    """
    from scipy.spatial.transform import Rotation

    own = edges[0]
    if len(edges) == 1:
        return np.array(own.rows)
    rows = _blank_non_unit_rows(own)
    for above in edges[1:]:
        last = np.searchsorted(above.log_ns, own.log_ns, side="right") - 1
        moved = _blank_non_unit_rows(above)[np.maximum(last, 0)]
        good = np.isfinite(rows).all(axis=1) & np.isfinite(moved).all(axis=1) & (last >= 0)
        turn = Rotation.from_quat(moved[good, 3:])
        together = np.full_like(rows, np.nan)
        together[good, :3] = moved[good, :3] + turn.apply(rows[good, :3])
        together[good, 3:] = (turn * Rotation.from_quat(rows[good, 3:])).as_quat()
        rows = together
    return rows


def _blank_non_unit_rows(moves: FrameTransforms) -> Floats:
    """One edge's transforms (N, 7), x, y, z and quaternion; a row is NaN where its quaternion is not of unit length."""
    rows = np.array(moves.rows)
    with np.errstate(over="ignore"):
        rows[~(np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1.0) <= POSE.max_length_error)] = np.nan
    return rows
