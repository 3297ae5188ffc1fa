"""Messages of a view as JSON objects: Foxglove's published types, with only the fields that a view needs.

Positions are in m on the floor (z up), angles in rad; a stamp is a whole number of nanoseconds.  Fields and units are
those of https://docs.foxglove.dev/docs/sdk/schemas; `schemas` defines each type.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from bcid.aliases import Floats

Message = dict[str, Any]

NS_PER_S = 1_000_000_000
PLACE_DIGITS, TURN_DIGITS = 6, 9
"""Decimals of a position (1 µm) and of a quaternion's components."""
FLOOR_FRAME = "floor"
PRIMITIVES = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
INFO, WARNING = 2, 3
"""Levels of a `foxglove.Log`."""
LINE_STRIP, LINE_LOOP = 0, 1
"""Types of a line: open, and closed."""


class Colour(NamedTuple):
    """Red, green, blue and opacity, from 0 to 1."""

    r: float
    g: float
    b: float
    a: float = 1.0


def parse_colour(text: str, opacity: float = 1.0) -> Colour:
    """The colour written as "#rrggbb", with an opacity.

    >>> parse_colour("#ff0000", 0.5)
    Colour(r=1.0, g=0.0, b=0.0, a=0.5)
    """
    r, g, b = (round(int(text[k : k + 2], 16) / 255, 3) for k in (1, 3, 5))
    return Colour(r, g, b, opacity)


def stamp_message(ns: int) -> Message:
    """A time, or a duration, of `ns` nanoseconds as seconds and nanoseconds."""
    return {"sec": ns // NS_PER_S, "nsec": ns % NS_PER_S}


def vector_message(x: float, y: float, z: float = 0.0) -> Message:
    """A position or a size (m)."""
    return {name: round(float(value), PLACE_DIGITS) for name, value in zip("xyz", (x, y, z), strict=True)}


def yaw_message(yaw: float) -> Message:
    """The quaternion of a turn by `yaw` (rad) about the vertical."""
    return {
        "x": 0.0, "y": 0.0, "z": round(math.sin(0.5 * yaw), TURN_DIGITS), "w": round(math.cos(0.5 * yaw), TURN_DIGITS)
    }  # fmt: skip


UPRIGHT = {"x": 0.0, "y": round(-math.sqrt(0.5), TURN_DIGITS), "z": 0.0, "w": round(math.sqrt(0.5), TURN_DIGITS)}
"""The quaternion that turns the x axis, along which arrows lie, upward."""
DOWNRIGHT = {**UPRIGHT, "y": -UPRIGHT["y"]}
"""The quaternion that turns the x axis downward."""


def pose_message(x: float, y: float, yaw: float, z: float = 0.0) -> Message:
    """A pose on the floor, or at the height `z` (m)."""
    return {"position": vector_message(x, y, z), "orientation": yaw_message(yaw)}


def pose_in_frame(ns: int, pose: Floats) -> Message:
    """A `foxglove.PoseInFrame` of a pose (3,): x, y (m) and yaw (rad) on the floor."""
    return {"timestamp": stamp_message(ns), "frame_id": FLOOR_FRAME, "pose": pose_message(*pose.tolist())}


def poses_in_frame(ns: int, poses: Floats) -> Message:
    """A `foxglove.PosesInFrame` of poses (N, 3): x, y (m) and yaw (rad) on the floor."""
    return {
        "timestamp": stamp_message(ns), "frame_id": FLOOR_FRAME, "poses": [pose_message(*p) for p in poses.tolist()]
    }  # fmt: skip


def frame_transform(ns: int, frame: str, pose: Floats) -> Message:
    """A `foxglove.FrameTransform` that puts the frame of a car at a pose (3,) on the floor."""
    x, y, yaw = pose.tolist()
    return {
        "timestamp": stamp_message(ns), "parent_frame_id": FLOOR_FRAME, "child_frame_id": frame,
        "translation": vector_message(x, y), "rotation": yaw_message(yaw),
    }  # fmt: skip


def numbers_message(ns: int, names: Sequence[str], values: Iterable[float]) -> Message:
    """A message of bcid's own: a stamp, and one number for each of `names`."""
    numbers = {name: round(float(value), TURN_DIGITS) for name, value in zip(names, values, strict=True)}
    return {"timestamp": stamp_message(ns), **numbers}


def log_message(ns: int, text: str, name: str, level: int = INFO) -> Message:
    """A `foxglove.Log` that says `text`; `name` is what it is about."""
    return {"timestamp": stamp_message(ns), "level": level, "message": text, "name": name, "file": "", "line": 0}


def scene_update(*entities: Message) -> Message:
    """A `foxglove.SceneUpdate` that draws `entities`, each in the place of an earlier one of its id."""
    return {"deletions": [], "entities": list(entities)}


def scene_entity(
    ns: int, name: str, frame: str = FLOOR_FRAME, lifetime_ns: int = 0, **primitives: list[Message]
) -> Message:
    """A `foxglove.SceneEntity` called `name` in the coordinates of `frame`, with which it moves.

    It stays for `lifetime_ns`, or until it is replaced where that is 0.  Primitives (arrows, cubes, cylinders, lines,
    texts) that are not given are empty lists, which viewers ask for.
    """
    return {
        "timestamp": stamp_message(ns), "frame_id": frame, "id": name, "lifetime": stamp_message(lifetime_ns),
        "frame_locked": True, "metadata": [], **{kind: primitives.pop(kind, []) for kind in PRIMITIVES}, **primitives,
    }  # fmt: skip


def arrow_message(tail: Message, turn: Message, length: float, thickness: float, colour: Colour) -> Message:
    """An arrow from a position `tail` along the x axis as `turn` (a quaternion) turns it, `length` (m) long in all."""
    head = min(0.4 * length, 3.0 * thickness)
    return {
        "pose": {"position": tail, "orientation": turn},
        "shaft_length": round(length - head, PLACE_DIGITS), "shaft_diameter": round(thickness, PLACE_DIGITS),
        "head_length": round(head, PLACE_DIGITS), "head_diameter": round(2.0 * thickness, PLACE_DIGITS),
        "color": colour._asdict(),
    }  # fmt: skip


def cube_message(pose: Message, size: Message, colour: Colour) -> Message:
    """A box of a size (m) with its middle at a pose."""
    return {"pose": pose, "size": size, "color": colour._asdict()}


def cylinder_message(pose: Message, diameter: float, height: float, colour: Colour) -> Message:
    """An upright cylinder with its middle at a pose; lengths in m."""
    size = vector_message(diameter, diameter, height)
    return {"pose": pose, "size": size, "bottom_scale": 1.0, "top_scale": 1.0, "color": colour._asdict()}


def line_message(points: Floats, colour: Colour, thickness: float, kind: int = LINE_STRIP, z: float = 0.0) -> Message:
    """A line through points (N, 2) in m at the height `z`; its thickness is in pixels of the screen."""
    return {
        "type": kind, "pose": pose_message(0.0, 0.0, 0.0), "thickness": thickness, "scale_invariant": True,
        "points": [vector_message(x, y, z) for x, y in points.tolist()], "color": colour._asdict(),
        "colors": [], "indices": [],
    }  # fmt: skip


def text_message(x: float, y: float, z: float, size: float, colour: Colour, text: str) -> Message:
    """A text that faces the viewer, `size` (m) high, with its middle at (x, y, z)."""
    return {
        "pose": pose_message(x, y, 0.0, z), "billboard": True, "font_size": round(size, PLACE_DIGITS),
        "scale_invariant": False, "color": colour._asdict(), "text": text,
    }  # fmt: skip
