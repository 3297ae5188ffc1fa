"""From three-dimensional poses to the floor: position on its axes and yaw about its normal."""

from __future__ import annotations

from typing import Literal

import numpy as np

from bcid.recording.types import Floats

MIN_NORM = 1e-6
_UP = {"Y": ((0, 1.0), (2, -1.0)), "Z": ((0, 1.0), (1, 1.0))}  # floor x, y as (world axis, sign)


def on_floor(vectors: Floats, up_axis: Literal["Y", "Z"]) -> Floats:
    """World vectors (N, 3) as floor vectors (N, 2): Y up (X, -Z), Z up (X, Y)."""
    (ax, sx), (ay, sy) = _UP[up_axis]
    return np.column_stack([sx * vectors[:, ax], sy * vectors[:, ay]])


def yaw_of_quaternions(xyzw: Floats, up_axis: Literal["Y", "Z"]) -> Floats:
    """Yaw (rad) of the body's X axis on the floor; NaN rows stay NaN, and zero quaternions become it.

    The first column of the rotation matrix is the X axis; q and -q give the same.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # what is no number has no yaw
        norm = np.linalg.norm(xyzw, axis=1, keepdims=True)
        x, y, z, w = (xyzw / np.where(norm > MIN_NORM, norm, np.nan)).T
    forward = np.column_stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)])
    floor = on_floor(forward, up_axis)
    return np.arctan2(floor[:, 1], floor[:, 0])


def turned_up(xyzw: Floats) -> Floats:
    """Where the axis of the world that a body turns about least points in it (N, 3): Z, or Y where that is up.

    The row of the rotation matrix that changes least is the world's vertical in the body's axes.
    """
    if not len(xyzw):
        return np.empty((0, 3))
    x, y, z, w = (xyzw / np.linalg.norm(xyzw, axis=1, keepdims=True)).T
    of_y = np.column_stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)])
    of_z = np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)])
    return min((of_y, of_z), key=lambda rows: float(np.var(rows, axis=0).sum()))


def quaternions_of_euler(degrees: Floats, order: str) -> Floats:
    """Quaternions x, y, z, w (N, 4) of intrinsic Euler angles; NaN rows stay NaN.

    The columns of `degrees` (N, 3) are the turns about X, Y, Z; `order` (such as "YXZ") says which comes first.
    """
    from scipy.spatial.transform import Rotation

    found = np.full((len(degrees), 4), np.nan)
    good = np.isfinite(degrees).all(axis=1)
    turns = degrees[good][:, ["XYZ".index(axis) for axis in order]]
    found[good] = np.atleast_2d(Rotation.from_euler(order, turns, degrees=True).as_quat())
    return found


def rotated(vectors: Floats, angle: Floats) -> Floats:
    """Vectors (N, 2) or (2,) turned by `angle` (N,), counter-clockwise."""
    x, y = np.asarray(vectors, dtype=float).T
    cos_a, sin_a = np.cos(angle), np.sin(angle)
    return np.column_stack([cos_a * x - sin_a * y, sin_a * x + cos_a * y])
