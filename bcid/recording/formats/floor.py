"""From positions and rotations as files hold them to poses on the floor: units, axes, placeholders."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from bcid.aliases import Floats
from bcid.errors import Problems
from bcid.mapping import FieldMapping, PoseMapping
from bcid.recording.checks import attitude, lost
from bcid.recording.types import Irregularity
from bcid.vehicle import Mocap

Poses = tuple[Floats, list[Irregularity]]
"""Poses (N, 3) on the floor, x and y in m and yaw in rad, NaN where none was measured; and what was odd about them."""


def poses_in_space(position_m: Floats, xyzw: Floats, up_axis: Literal["Y", "Z"], time_s: Floats, path: Path) -> Poses:
    """Poses on the floor from positions (N, 3) in m and quaternions x, y, z, w (N, 4), whose vertical is `up_axis`.

    Placeholders of a body that was not seen, rotations that no car has, and lifted bodies are NaN and noted.

    Raises:
        InputRefused: the body moves along the stated vertical, or too many quaternions are invalid.
    """
    attitude.check_up_axis(position_m, up_axis, path)
    unseen = lost.find_lost_poses(position_m, xyzw)
    odd, world, turns = list[Irregularity](), position_m, xyzw
    if unseen.any():
        odd = lost.note_lost_poses(time_s, unseen, np.column_stack([position_m, xyzw]))
        world, turns = (np.where(unseen[:, None], np.nan, values) for values in (position_m, xyzw))
    floor = attitude.project_to_floor(world, up_axis)
    yaw, of_turns = attitude.checked_yaw(turns, up_axis, time_s, path)
    up, lifts = attitude.find_lifted_samples(floor, world[:, "XYZ".index(up_axis)], time_s)
    pose = np.column_stack([floor, yaw])
    pose[up] = np.nan
    return pose, [*odd, *of_turns, *lifts]


def choose_up_axis(position: Floats, mocap: Mocap, path: Path) -> Literal["Y", "Z"]:
    """The vertical of positions (N, 3) of a format whose own convention is Z-up, as ROS and most tables have it.

    It is Y where the vehicle file says so and the body drives in the plane of X and Z: a vehicle file may state the Y
    of Motive's exports and serve ROS bags of the same car, too.

    Raises:
        InputRefused: the body drives in the plane of X and Z, and the vehicle file does not say that Y is up.
    """
    problems = Problems()
    with problems.gather_refusals():
        attitude.check_up_axis(position, "Z", path)
    if problems and mocap.up_axis == "Y" and "up_axis" in mocap.model_fields_set:
        return "Y"
    problems.raise_if_any(path)
    return "Z"


def poses_on_floor(rows: Floats, mocap: Mocap, time_s: Floats, path: Path) -> Poses:
    """Poses on the floor from rows (N, 7) as logged: x, y, z in the vehicle file's unit and a quaternion x, y, z, w.

    Raises:
        InputRefused: the rows contradict `mocap.up_axis`, or too many quaternions are invalid.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        position_m = mocap.metres_per_unit * rows[:, :3]
    return poses_in_space(position_m, rows[:, 3:], choose_up_axis(position_m, mocap, path), time_s, path)


def mapped_poses_on_floor(
    columns: Sequence[Floats], mapping: PoseMapping, mocap: Mocap, time_s: Floats, path: Path
) -> Poses:
    """Poses on the floor from the columns (N,) of `mapping.fields`, each by its own gain and offset.

    The vehicle file's unit of length holds for positions that no gain turns into m. Positions without a height are on
    the floor already; a yaw is taken as it is.

    Raises:
        InputRefused: positions in space contradict `mocap.up_axis`, or too many quaternions are invalid.
    """
    n = len(mapping.position_fields)
    scales = [_position_scale(field, mocap) for field in mapping.position_fields]
    # what is no number stays none
    with np.errstate(invalid="ignore", over="ignore"):
        position_m = np.column_stack([k * c for k, c in zip(scales, columns[:n], strict=True)])
    turn = np.column_stack(columns[n:])
    if mapping.yaw_rad is None:
        height = position_m if n == 3 else np.column_stack([position_m, np.where(np.isfinite(turn[:, 0]), 0.0, np.nan)])
        up_axis = choose_up_axis(height, mocap, path) if n == 3 else "Z"
        return poses_in_space(height, turn, up_axis, time_s, path)
    if n == 2:
        return np.column_stack([position_m, turn]), []
    up_axis = choose_up_axis(position_m, mocap, path)
    floor = attitude.project_to_floor(position_m, up_axis)
    up, lifts = attitude.find_lifted_samples(floor, position_m[:, "XYZ".index(up_axis)], time_s)
    pose = np.column_stack([floor, turn])
    pose[up] = np.nan
    return pose, lifts


def _position_scale(field: FieldMapping, mocap: Mocap) -> float:
    """The size (m) of a mapped position's unit: 1 where a gain or calibration points make it m already.

    A gain of -1 turns an axis round, and says nothing of the unit.
    """
    return mocap.metres_per_unit if abs(field.gain) == 1.0 and field.points is None else 1.0
