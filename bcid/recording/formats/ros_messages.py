"""Poses and commands in messages of known types, be they decoded from JSON, ROS 2 or protobuf.

A pose type is one row of `SINGLE_POSES` or `POSE_LISTS`, a command type one of `COMMAND_PATHS`.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

from bcid.recording.formats.message_fields import get_field, number_at, parse_number
from bcid.recording.formats.message_stamps import Stamp, message_stamp
from bcid.recording.formats.names import list_names


class StampedPose(NamedTuple):
    """A pose in space, and its stamp, which is None where the message carries none."""

    stamp: Stamp
    row: list[float]  # position x, y, z, then quaternion x, y, z, w


class SeveralBodies(Exception):
    """Messages hold several bodies and none was named."""

    def __init__(self, names: Iterable[object]) -> None:
        """The bodies of these `names`."""
        super().__init__(list_names(names))


class SinglePose(NamedTuple):
    """Where a message of one body has its pose: the position, and the quaternion or the yaw."""

    position: str
    orientation: str
    body: str | None = None  # the field with the body's name, where messages of several bodies share a topic
    unit_m: float = 1.0  # of the position, by the type's own definition
    names: tuple[str, ...] = ("x", "y", "z", "x", "y", "z", "w")  # of the numbers in both

    def paths(self) -> list[str]:
        """The paths of the seven numbers."""
        above = [self.position] * 3 + [self.orientation] * 4
        return [f"{part}.{name}" if part else name for part, name in zip(above, self.names, strict=True)]


class PoseList(NamedTuple):
    """Where a message of several bodies has its list, and each item its name and its pose."""

    items: str
    name: str | None  # None where the type has none: bodies are told by their place
    pose: str


def _pose_at(path: str) -> SinglePose:
    """A pose with a position and an orientation, at `path`."""
    return SinglePose(f"{path}.position", f"{path}.orientation")


SINGLE_POSES: dict[str, SinglePose] = {
    "foxglove.PoseInFrame": _pose_at("pose"),
    "geometry_msgs/Pose": SinglePose("position", "orientation"),
    "geometry_msgs/PoseStamped": _pose_at("pose"),
    "geometry_msgs/PoseWithCovariance": _pose_at("pose"),
    "geometry_msgs/PoseWithCovarianceStamped": _pose_at("pose.pose"),
    "geometry_msgs/Transform": SinglePose("translation", "rotation"),
    "geometry_msgs/TransformStamped": SinglePose("transform.translation", "transform.rotation", "child_frame_id"),
    "foxglove.FrameTransform": SinglePose("translation", "rotation", "child_frame_id"),
    "nav_msgs/Odometry": _pose_at("pose.pose"),
    # Vicon's SDK counts in mm
    "vicon_receiver/Position": SinglePose(
        "", "", "subject_name", 1e-3, ("x_trans", "y_trans", "z_trans", "x_rot", "y_rot", "z_rot", "w")
    ),
}
"""Types of messages that hold the pose of one body."""

POSE_LISTS: dict[str, PoseList] = {
    "mocap4r2_msgs/RigidBodies": PoseList("rigidbodies", "rigid_body_name", "pose"),
    "motion_capture_tracking_interfaces/NamedPoseArray": PoseList("poses", "name", "pose"),
    "geometry_msgs/PoseArray": PoseList("poses", None, ""),
    "foxglove.PosesInFrame": PoseList("poses", None, ""),
}
"""Types of messages that hold a list of bodies."""

FLOOR_POSES: dict[str, tuple[str, str, str]] = {"geometry_msgs/Pose2D": ("x", "y", "theta")}
"""Types of poses on the floor: the fields of x, y and yaw."""

COMMAND_PATHS: dict[str, tuple[str, str]] = {
    "ackermann_msgs/AckermannDrive": ("steering_angle", "speed"),
    "ackermann_msgs/AckermannDriveStamped": ("drive.steering_angle", "drive.speed"),
}
"""Paths of the steering angle and the speed by schema name."""

OWN_COMMAND_PATHS = ("steering_rad", "throttle_mps")
NUMBER_PATHS = ("data", "value")
"""Where a message of a single number has it: std_msgs/Float64 and Float32, and JSON."""
TWIST_SCHEMAS = ("geometry_msgs/Twist", "geometry_msgs/TwistStamped")


def pose_row(position: Any, orientation: Any) -> list[float]:
    """The list [x, y, z, q_x, q_y, q_z, q_w] of a decoded position and quaternion."""
    at = [number_at(position, c) for c in "xyz"]
    return at + [number_at(orientation, c) for c in "xyzw"]


def read_single_pose(message: Any, where: SinglePose, stamped: bool) -> StampedPose:
    """The pose of a message of one body, without its stamp unless `stamped`; lengths in the type's own unit.

    Raises:
        MissingField, NotANumber, UnreadableStamp: a field is not there, or is none.
    """
    if where.names[:3] == ("x", "y", "z"):
        row = pose_row(get_field(message, where.position), get_field(message, where.orientation))
    else:
        row = [number_at(message, name) for name in where.names]
    return StampedPose(message_stamp(message) if stamped else None, row)


def read_listed_pose(message: Any, where: PoseList, body: str | None, stamped: bool) -> StampedPose | None:
    """The pose of the body named `body` in a message with a list of bodies; None where only others are in it.

    Where no body is named, or the type has no names, it is that of the only one.

    Raises:
        SeveralBodies: there are more, or several of that name.
    """
    items = list(get_field(message, where.items))
    if where.name is None or body is None:
        if len(items) > 1:
            raise SeveralBodies(body_names(message, where))
        chosen = items
    else:
        chosen = [item for item in items if str(get_field(item, where.name)) == body]
        if len(chosen) > 1:  # of one name
            raise SeveralBodies(body_names(message, where))
    if not chosen:
        return None
    pose = get_field(chosen[0], where.pose) if where.pose else chosen[0]
    row = pose_row(get_field(pose, "position"), get_field(pose, "orientation"))
    return StampedPose(message_stamp(message) if stamped else None, row)


def body_names(message: Any, where: PoseList) -> list[str]:
    """The names of the bodies in a message with a list of them, or their places where the type has no names."""
    items = get_field(message, where.items)
    if where.name is None:
        return [f"{where.items}[{k}]" for k in range(len(items))]
    return [str(get_field(item, where.name)) for item in items]


def read_floor_pose(message: Any, fields: tuple[str, str, str], stamped: bool) -> StampedPose:
    """The pose on the floor at `fields`, x, y and yaw, as a row of these three numbers."""
    row = [parse_number(get_field(message, name), name) for name in fields]
    return StampedPose(message_stamp(message) if stamped else None, row)
