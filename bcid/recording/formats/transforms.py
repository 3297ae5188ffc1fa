"""The tree of transforms in tf2 messages, and the body's poses in the world that it makes."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.recording.formats.limits import MCAP
from bcid.recording.formats.message_fields import get_field
from bcid.recording.formats.message_stamps import Stamp, message_stamp
from bcid.recording.formats.names import list_names, printable_name
from bcid.recording.formats.ros_messages import SeveralBodies, pose_row
from bcid.recording.limits import POSE
from bcid.recording.types import Irregularity

TREE_SCHEMAS = {"tf2_msgs/TFMessage": "header.frame_id", "foxglove.FrameTransforms": "parent_frame_id"}
"""Types whose messages hold a list of transforms, and where each has its parent's name."""
STATIC_TOPIC = "/tf_static"
NAME_BODY = "set topics.child_frame in the vehicle file to one of them"


class FrameTransforms(NamedTuple):
    """The transforms that were sent for one edge of the tree, in file order."""

    log_ns: list[int]
    stamps: list[Stamp]
    rows: list[list[float]]  # x, y, z, then the quaternion x, y, z, w of the child in its parent


TransformTree = dict[str, dict[str, FrameTransforms]]
"""The transforms that were sent, by the names of the child and the parent frame."""


class SentTransform(NamedTuple):
    """One transform in a message."""

    child: str
    parent: str
    stamp: Stamp
    row: list[float]  # x, y, z, then the quaternion x, y, z, w


def read_transforms(message: Any, stamped: bool = True) -> list[SentTransform]:
    """All transforms in a decoded message that holds a list of them; without stamps unless `stamped`."""
    return [read_transform(item, stamped) for item in get_field(message, "transforms")]


def read_transform(item: Any, stamped: bool = True) -> SentTransform:
    """A decoded transform of tf2, or of Foxglove, whose translation and rotation stand one level higher."""
    child = str(get_field(item, "child_frame_id"))
    parent = str(get_field(item, "parent_frame_id", get_field(item, "header.frame_id", "")))
    move = get_field(item, "transform", item)
    row = pose_row(get_field(move, "translation"), get_field(move, "rotation"))
    return SentTransform(child, parent, message_stamp(item) if stamped else None, row)


def read_transform_tree(messages: Iterable[tuple[int, Iterable[SentTransform]]]) -> TransformTree:
    """All transforms of messages (log time in ns, transforms), collected by child and parent frame."""
    tree: TransformTree = {}
    for logged, transforms in messages:
        for sent in transforms:
            moves = tree.setdefault(sent.child, {}).setdefault(sent.parent, FrameTransforms([], [], []))
            moves.log_ns.append(logged)
            moves.stamps.append(sent.stamp)
            moves.rows.append(sent.row)
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
            raise SeveralBodies(leaves)
        body = leaves[0] if leaves else next(iter(tree), None)
    if body is None or body not in tree:
        cause = f"no message holds the body {printable_name(repr(body))}, only {list_names(tree)}"
        raise InputRefused(path, place, cause, NAME_BODY)
    edges, frame, seen = [], body, {body}
    while frame in tree and frame != world:
        if len(tree[frame]) > 1:
            cause = f"{printable_name(frame)} has several parents: {list_names(sorted(tree[frame]))}"
            raise InputRefused(path, place, cause, "let one node send each frame")
        parent, moves = next(iter(tree[frame].items()))
        if parent in seen:
            parent, frame = printable_name(parent), printable_name(frame)
            raise InputRefused(path, place, f"a cycle: {parent} -> {frame} leads back to {parent}", "mend the tree")
        edges.append(moves)
        seen.add(parent)
        frame = parent
    roots = {parent for parents in tree.values() for parent in parents} - tree.keys()
    if world is None and len(roots) > 1:
        others, frame = list_names(sorted(roots - {frame})), printable_name(frame)
        cause = f"the tree is broken: {printable_name(body)} hangs on {frame}, other frames on {others}"
        step = f'record the transform between them, or set topics.world_frame = "{frame}"'
        raise InputRefused(path, place, cause, step)
    if world is not None and frame != world:
        frame, body = printable_name(frame), printable_name(body)
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
    text = f"sent beside {len(own.log_ns)} of the body: {list_names(map(repr, rare))}; a name gone wrong?"
    return [Irregularity("rare frames", "warning", sum(rare.values()), "transforms", text)]


def moving_edge(edges: list[FrameTransforms]) -> FrameTransforms:
    """The first edge from the body up that is not static: a body may be fixed to a tracked frame."""
    # static transforms have a log time of 0
    return next((edge for edge in edges if any(edge.log_ns)), edges[0])


def compose_transforms(edges: list[FrameTransforms], log_ns: list[int]) -> Floats:
    """Poses (N, 7) of the body in the world at the log times (N,): x, y, z (m), quaternion x, y, z, w.

    `edges` lead from the body up to the world; each pose is composed of the last transform of every edge that was
    logged by then, and NaN where there is none.
    """
    from scipy.spatial.transform import Rotation

    if len(edges) == 1:
        return np.array(edges[0].rows)
    rows = _last_rows(edges[0], log_ns)
    for above in edges[1:]:
        moved = _last_rows(above, log_ns)
        good = np.isfinite(rows).all(axis=1) & np.isfinite(moved).all(axis=1)
        turn = Rotation.from_quat(moved[good, 3:])
        together = np.full_like(rows, np.nan)
        together[good, :3] = moved[good, :3] + turn.apply(rows[good, :3])
        together[good, 3:] = (turn * Rotation.from_quat(rows[good, 3:])).as_quat()
        rows = together
    return rows


def _last_rows(edge: FrameTransforms, log_ns: list[int]) -> Floats:
    """The last transform (N, 7) of an edge by each of the log times (N,); NaN where there is none."""
    last = np.searchsorted(edge.log_ns, log_ns, side="right") - 1
    return np.where((last >= 0)[:, None], _blank_non_unit_rows(edge)[np.maximum(last, 0)], np.nan)


def _blank_non_unit_rows(moves: FrameTransforms) -> Floats:
    """One edge's transforms (N, 7), x, y, z and quaternion; a row is NaN where its quaternion is not of unit length."""
    rows = np.array(moves.rows)
    with np.errstate(over="ignore"):
        rows[~(np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1.0) <= POSE.max_length_error)] = np.nan
    return rows
