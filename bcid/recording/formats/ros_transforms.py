"""Poses out of /tf: the transforms from the world down to the body, put together."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.recording.checks.attitude import UNIT
from bcid.recording.formats.ros_messages import SeveralBodies, get, number, stamp_of
from bcid.recording.types import Irregularity

RARE, MANY = 2, 50  # times that a frame comes; times as often as that the body's does
SCHEMA, STATIC = "tf2_msgs/TFMessage", "/tf_static"


class Moves(NamedTuple):
    """What was sent of one edge of the tree, in file order."""

    log_ns: list[int]
    stamp_ns: list[int | None]
    rows: list[list[float]]  # x, y, z, then the quaternion x, y, z, w of the child in its parent


Tree = dict[str, dict[str, Moves]]
"""What was sent, by child and parent."""


def read_tree(messages: Iterable[tuple[int, Any]]) -> Tree:
    """All transforms in tf2 messages."""
    tree: Tree = {}
    for logged, message in messages:
        for item in get(message, "transforms"):
            child, parent = str(get(item, "child_frame_id")), str(get(item, "header.frame_id", ""))
            moves = tree.setdefault(child, {}).setdefault(parent, Moves([], [], []))
            moves.log_ns.append(logged)
            moves.stamp_ns.append(stamp_of(item))
            p, q = get(item, "transform.translation"), get(item, "transform.rotation")
            moves.rows.append([number(get(p, c)) for c in "xyz"] + [number(get(q, c)) for c in "xyzw"])
    return tree


def chain(tree: Tree, body: str | None, world: str | None, path: Path) -> list[Moves]:
    """The edges from the body up to the world, or to the tree's root where none is named.

    Raises:
        InputRefused: no such body, two parents of one frame, a cycle, or a world that is not reached, or not named
            where the tree falls apart.
        SeveralBodies: none is named, and several are nobody's parent.
    """
    place = "transforms"
    if body is None:
        parents = {p for of in tree.values() for p in of}
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
    roots = {parent for of in tree.values() for parent in of} - tree.keys()
    if world is None and len(roots) > 1:
        others = ", ".join(sorted(roots - {frame}))
        cause = f"the tree is broken: {body} hangs on {frame}, other frames on {others}"
        step = f'record the transform between them, or set topics.world_frame = "{frame}"'
        raise InputRefused(path, place, cause, step)
    if world is not None and frame != world:
        cause = f"the tree is broken: {frame} has no parent, so {body} is not connected to {world}"
        raise InputRefused(path, place, cause, "record the missing transform, or set topics.world_frame")
    return edges


def strangers(tree: Tree, own: Moves) -> list[Irregularity]:
    """Word of frames that hardly ever come beside the body's `own`: its name may have gone wrong there."""
    sent = {child: sum(log > 0 for m in of.values() for log in m.log_ns) for child, of in tree.items()}  # static: at 0
    rare = {child: n for child, n in sent.items() if 0 < n <= RARE and n * MANY <= len(own.log_ns)}
    if not rare:
        return []
    text = f"sent beside {len(own.log_ns)} of the body: {', '.join(map(repr, rare))}; a name gone wrong?"
    return [Irregularity("rare frames", "warning", sum(rare.values()), "transforms", text)]


def put_together(edges: list[Moves]) -> Floats:
    """Position and quaternion (N, 7) of the body in the world at each message of its own edge.

    Frames above it are where they were last said to be; before that is known, the row is NaN.
    """
    from scipy.spatial.transform import Rotation

    own = edges[0]
    if len(edges) == 1:
        return np.array(own.rows)
    rows = _of_unit_length(own)
    for above in edges[1:]:
        last = np.searchsorted(above.log_ns, own.log_ns, side="right") - 1
        moved = _of_unit_length(above)[np.maximum(last, 0)]
        good = np.isfinite(rows).all(axis=1) & np.isfinite(moved).all(axis=1) & (last >= 0)
        turn = Rotation.from_quat(moved[good, 3:])
        together = np.full_like(rows, np.nan)
        together[good, :3] = moved[good, :3] + turn.apply(rows[good, :3])
        together[good, 3:] = (turn * Rotation.from_quat(rows[good, 3:])).as_quat()
        rows = together
    return rows


def _of_unit_length(moves: Moves) -> Floats:
    """The rows, NaN where the quaternion is none: put together with others it could not be judged any more."""
    rows = np.array(moves.rows)
    with np.errstate(over="ignore"):
        rows[~(np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1.0) <= UNIT)] = np.nan
    return rows
