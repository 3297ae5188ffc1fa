"""JSON schemas of a view's messages, as they stand in the MCAP file: the fields that are written, and no others.

Types called `foxglove.…` are Foxglove's, which its panels draw by name; a reader that knows them finds a part of their
fields here.  Types called `bcid.…` hold numbers in SI units.
"""

import json
from typing import Any

from bcid.view.messages import PRIMITIVES

Schema = dict[str, Any]

NUMBER: Schema = {"type": "number"}
TEXT: Schema = {"type": "string"}


def _object(title: str, **fields: Schema) -> Schema:
    """The schema of an object that has just these `fields`."""
    return {
        "title": title, "type": "object", "properties": fields, "required": list(fields), "additionalProperties": False
    }  # fmt: skip


def _list(items: Schema) -> Schema:
    """The schema of a list of `items`."""
    return {"type": "array", "items": items}


_NSEC: Schema = {"type": "integer", "minimum": 0, "maximum": 999_999_999}
TIME = _object("time", sec={"type": "integer", "minimum": 0}, nsec=_NSEC)
DURATION = _object("duration", sec={"type": "integer", "minimum": 0}, nsec=_NSEC)
VECTOR = _object("foxglove.Vector3", x=NUMBER, y=NUMBER, z=NUMBER)
QUATERNION = _object("foxglove.Quaternion", x=NUMBER, y=NUMBER, z=NUMBER, w=NUMBER)
POSE = _object("foxglove.Pose", position=VECTOR, orientation=QUATERNION)
_SHARE: Schema = {"type": "number", "minimum": 0, "maximum": 1}
COLOUR = _object("foxglove.Color", r=_SHARE, g=_SHARE, b=_SHARE, a=_SHARE)
_POINTS = _list(_object("foxglove.Point3", x=NUMBER, y=NUMBER, z=NUMBER))

_SHAPES: dict[str, Schema] = {
    "arrows": _object(
        "foxglove.ArrowPrimitive", pose=POSE, shaft_length=NUMBER, shaft_diameter=NUMBER, head_length=NUMBER,
        head_diameter=NUMBER, color=COLOUR,
    ),
    "cubes": _object("foxglove.CubePrimitive", pose=POSE, size=VECTOR, color=COLOUR),
    "cylinders": _object(
        "foxglove.CylinderPrimitive", pose=POSE, size=VECTOR, bottom_scale=_SHARE, top_scale=_SHARE, color=COLOUR
    ),
    "lines": _object(
        "foxglove.LinePrimitive", type={"enum": [0, 1, 2]}, pose=POSE, thickness=NUMBER,
        scale_invariant={"type": "boolean"}, points=_POINTS, color=COLOUR, colors=_list(COLOUR),
        indices=_list({"type": "integer", "minimum": 0}),
    ),
    "texts": _object(
        "foxglove.TextPrimitive", pose=POSE, billboard={"type": "boolean"}, font_size=NUMBER,
        scale_invariant={"type": "boolean"}, color=COLOUR, text=TEXT,
    ),
}  # fmt: skip
"""Shapes that a view draws; lists of all others are empty."""

_ENTITY = _object(
    "foxglove.SceneEntity", timestamp=TIME, frame_id=TEXT, id=TEXT, lifetime=DURATION,
    frame_locked={"type": "boolean"}, metadata=_list(_object("foxglove.KeyValuePair", key=TEXT, value=TEXT)),
    **{kind: _list(_SHAPES.get(kind, {"type": "object"})) for kind in PRIMITIVES},
)  # fmt: skip

SCHEMAS: dict[str, Schema] = {
    "foxglove.PoseInFrame": _object("foxglove.PoseInFrame", timestamp=TIME, frame_id=TEXT, pose=POSE),
    "foxglove.PosesInFrame": _object("foxglove.PosesInFrame", timestamp=TIME, frame_id=TEXT, poses=_list(POSE)),
    "foxglove.FrameTransform": _object(
        "foxglove.FrameTransform", timestamp=TIME, parent_frame_id=TEXT, child_frame_id=TEXT, translation=VECTOR,
        rotation=QUATERNION,
    ),
    "foxglove.SceneUpdate": _object(
        "foxglove.SceneUpdate", deletions=_list({"type": "object"}), entities=_list(_ENTITY)
    ),
    "foxglove.Log": _object(
        "foxglove.Log", timestamp=TIME, level={"enum": [0, 1, 2, 3, 4, 5]}, message=TEXT, name=TEXT, file=TEXT,
        line={"type": "integer", "minimum": 0},
    ),
    "bcid.Command": _object("bcid.Command", timestamp=TIME, steering_rad=NUMBER, throttle_mps=NUMBER),
    "bcid.BrakedCommand": _object(
        "bcid.BrakedCommand", timestamp=TIME, steering_rad=NUMBER, throttle_mps=NUMBER, brake_share=NUMBER
    ),
    "bcid.Twist": _object("bcid.Twist", timestamp=TIME, v_x_mps=NUMBER, v_y_mps=NUMBER, yaw_rate_radps=NUMBER),
    "bcid.Channel": _object("bcid.Channel", timestamp=TIME, value=NUMBER),
    "bcid.State": _object(
        "bcid.State", timestamp=TIME, motion=TEXT, segment={"type": "integer"}, place=TEXT, contact=TEXT
    ),
}  # fmt: skip
"""The schema of every type of message in a view, by its name."""


def schema_bytes(name: str) -> bytes:
    """The schema of the type `name` as an MCAP file holds it."""
    return json.dumps(SCHEMAS[name], separators=(",", ":")).encode()
