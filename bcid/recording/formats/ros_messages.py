"""Which parts of a message are its stamp, its pose, its command; decoded JSON, ROS 2 and protobuf alike."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

_MISSING = object()


class Pose3(NamedTuple):
    """A stamped pose in space; `stamp_ns` is None where the message carries no stamp."""

    stamp_ns: int | None
    position: tuple[float, float, float]
    xyzw: tuple[float, float, float, float]


def get(message: Any, path: str, default: Any = _MISSING) -> Any:
    """The field at a dotted `path` of a JSON object or a decoded message; numbers count in lists (`axes.0`).

    Raises:
        KeyError: when it is not there and no default is given.
    """
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


def number(value: Any) -> float:
    """A field as a number: NaN where it is blank (JSON's null), infinite where it holds no finite number."""
    if value is None:
        return math.nan
    return float(value) if math.isfinite(float(value)) else math.inf


def nanoseconds(stamp: Any) -> int | None:
    """A stamp in ns: {sec, nanosec | nsec}, {seconds, nanos}, or seconds as a number."""
    if isinstance(stamp, int | float):
        return round(stamp * 1e9)
    for whole, part in (("sec", "nanosec"), ("sec", "nsec"), ("seconds", "nanos")):
        sec, nsec = get(stamp, whole, None), get(stamp, part, None)
        if sec is not None and nsec is not None:
            return int(sec) * 1_000_000_000 + int(nsec)
    return None


def stamp_of(message: Any) -> int | None:
    """The message's own stamp in ns, or None where it carries none."""
    for path in ("header.stamp", "timestamp", "stamp", "time_s"):
        stamp = get(message, path, None)
        if stamp is not None:
            return nanoseconds(stamp)
    return None


def _pose(message: Any, stamp: int | None) -> Pose3:
    p, q = get(message, "position"), get(message, "orientation")
    return Pose3(
        stamp,
        (number(get(p, "x")), number(get(p, "y")), number(get(p, "z"))),
        (number(get(q, "x")), number(get(q, "y")), number(get(q, "z")), number(get(q, "w"))),
    )


def _transform(message: Any, stamp: int | None) -> Pose3:
    moved = {"position": get(message, "translation"), "orientation": get(message, "rotation")}
    return _pose(moved, stamp)


def _at(path: str) -> Callable[[Any, str | None], Pose3 | None]:
    return lambda message, body: _pose(get(message, path), stamp_of(message))


class SeveralBodies(Exception):
    """Messages hold several bodies and none was named."""


def _chosen(items: Any, name: str, body: str | None) -> Any:
    """The item whose field `name` is `body`; None where there is none.

    Raises:
        SeveralBodies: when no body is named and there are several.
    """
    if body is None and len(items) > 1:
        raise SeveralBodies(", ".join(str(get(item, name)) for item in items))
    return next((item for item in items if body is None or get(item, name) == body), None)


def _transform_stamped(message: Any, body: str | None) -> Pose3 | None:
    if body is not None and get(message, "child_frame_id", body) != body:
        return None
    return _transform(get(message, "transform"), stamp_of(message))


def _rigid_bodies(message: Any, body: str | None) -> Pose3 | None:
    chosen = _chosen(get(message, "rigidbodies"), "rigid_body_name", body)
    return None if chosen is None else _pose(get(chosen, "pose"), stamp_of(message))


POSES: dict[str, Callable[[Any, str | None], Pose3 | None]] = {
    "foxglove.PoseInFrame": _at("pose"),
    "geometry_msgs/PoseStamped": _at("pose"),
    "geometry_msgs/PoseWithCovarianceStamped": _at("pose.pose"),
    "geometry_msgs/TransformStamped": _transform_stamped,
    "nav_msgs/Odometry": _at("pose.pose"),
    "mocap4r2_msgs/RigidBodies": _rigid_bodies,
}
"""Pose reader by schema name: (message, body's name) -> pose, or None where it holds another body."""

COMMANDS: dict[str, tuple[str, str]] = {
    "ackermann_msgs/AckermannDrive": ("steering_angle", "speed"),
    "ackermann_msgs/AckermannDriveStamped": ("drive.steering_angle", "drive.speed"),
}
"""Paths of steering angle and speed by schema name."""

OWN_COMMAND = ("steering_rad", "throttle_mps")
TWISTS = ("geometry_msgs/Twist", "geometry_msgs/TwistStamped")


def base_name(schema: str) -> str:
    """A schema's name without ROS 2's middle part: geometry_msgs/msg/PoseStamped is .../PoseStamped."""
    return schema.replace("/msg/", "/")
