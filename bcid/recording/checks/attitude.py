"""Attitude and height of the tracked body: rotations, and which quaternions and heights a car on wheels can have."""

from pathlib import Path
from typing import Literal

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.errors import InputRefused
from bcid.recording.checks.samples import note_rows
from bcid.recording.limits import POSE, STREAM
from bcid.recording.types import Irregularity

X_AXIS = np.array([1.0, 0.0, 0.0])  # of the body: forward, unless it was defined otherwise
MIN_NORM = 1e-6  # of a quaternion that can be brought to unit length
PLANE_ITERATIONS = 20  # of reweighted least squares
MIN_DISTANCE_M = 1e-4  # off the plane, by which a sample is weighted
EDGE_SAMPLES = 30  # before and after the end of an excursion, over which its climb is taken
SPREAD_QUANTILES = (0.15, 0.85)  # of positions: carried for a while, a car still drove for most of the time


def project_to_floor(vectors: Floats, up_axis: Literal["Y", "Z"]) -> Floats:
    """Floor coordinates (N, 2) of world vectors (N, 3): (X, -Z) where `up_axis` is Y, (X, Y) where it is Z."""
    x, y, z = vectors.T
    return np.column_stack([x, -z] if up_axis == "Y" else [x, y])


def rotate_vectors(vectors: Floats, angle: Floats) -> Floats:
    """Plane vectors (N, 2) or (2,), each turned counter-clockwise by its angle (N,) in rad, as (N, 2)."""
    x, y = np.asarray(vectors, dtype=float).T
    cos_a, sin_a = np.cos(angle), np.sin(angle)
    return np.column_stack([cos_a * x - sin_a * y, sin_a * x + cos_a * y])


def quaternions_of_euler(degrees: Floats, order: str) -> Floats:
    """Quaternions x, y, z, w (N, 4) of intrinsic turns about X, Y, Z (N, 3) in degrees, in an `order` such as "YXZ"."""
    from scipy.spatial.transform import Rotation

    quaternions = np.full((len(degrees), 4), np.nan)
    good = np.isfinite(degrees).all(axis=1)
    turns = degrees[good][:, ["XYZ".index(axis) for axis in order]]
    quaternions[good] = np.atleast_2d(Rotation.from_euler(order, turns, degrees=True).as_quat())
    return quaternions


def yaw_of_quaternions(xyzw: Floats, up_axis: Literal["Y", "Z"], forward: Floats = X_AXIS) -> Floats:
    """Yaw (N,) in rad of a direction of the body on the floor, by quaternions x, y, z, w (N, 4); NaN where they are.

    `forward` (3,) is that direction in body axes: a unit vector, the body's X axis unless given.
    """
    # what is no number has no yaw
    with np.errstate(over="ignore", invalid="ignore"):
        norm = np.linalg.norm(xyzw, axis=1, keepdims=True)
        x, y, z, w = (xyzw / np.where(norm > MIN_NORM, norm, np.nan)).T
    # the columns of the rotation matrix, which q and -q have in common
    columns = (
        np.column_stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)]),
        np.column_stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)]),
        np.column_stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]),
    )
    ahead = np.einsum("k,knc->nc", forward, np.array(columns))
    floor = project_to_floor(ahead, up_axis)
    return np.arctan2(floor[:, 1], floor[:, 0])


def verticals_in_body(xyzw: Floats) -> dict[str, Floats]:
    """World's Y and Z axes as unit vectors (N, 3) in the body frame, by quaternions x, y, z, w (N, 4)."""
    x, y, z, w = (xyzw / np.linalg.norm(xyzw, axis=1, keepdims=True)).T
    # rows of the rotation matrix
    return {
        "Y": np.column_stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
        "Z": np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
    }


def vertical_in_body(xyzw: Floats) -> Floats:
    """World's vertical as unit vectors (N, 3) in the body frame, by quaternions x, y, z, w (N, 4).

    It is the world's Y or Z axis, whichever varies less over the samples, as a car on wheels keeps it.
    """
    if not len(xyzw):
        return np.empty((0, 3))
    return min(verticals_in_body(xyzw).values(), key=lambda rows: float(np.var(rows, axis=0).sum()))


def _level_direction(upward: Floats, path: Path) -> tuple[Floats, list[Irregularity]]:
    """The direction (3,) of the body, in its axes, whose yaw is taken, by the vertical (3,) there; and a warning or [].

    It is the body's X axis where that is level, and its part in the floor where it leans, so that roll and pitch do not
    enter the yaw; where X points up, the axis of the body that is most level, which may be at any angle to the car.
    """
    axes = np.eye(3)
    level = np.sqrt(np.maximum(0.0, 1.0 - upward**2))
    if level[0] > POSE.level_cosine:
        return X_AXIS, []
    axis, odd = 0, list[Irregularity]()
    if level[0] < POSE.min_level_part:
        axis = 1 if level[1] >= level[2] else 2
        text = (
            f"the X axis of the tracked body points up or down: the yaw is that of its {'XYZ'[axis]} axis, or quarter "
            "turns from it; define the body with X forward, or state mocap.yaw_offset_rad"
        )
        odd = [Irregularity("body axes", "warning", 1, path.name, text)]
    flat = axes[axis] - upward[axis] * upward
    return np.asarray(flat / np.linalg.norm(flat)), odd


def checked_yaw(
    xyzw: Floats, up_axis: Literal["Y", "Z"], time_s: Floats, path: Path
) -> tuple[Floats, list[Irregularity]]:
    """Yaw (N,) in rad of quaternions x, y, z, w (N, 4), NaN where these are invalid, and a list of irregularities.

    Invalid are quaternions that are blank or not of unit length, and those of a body that leans by more than 45
    degrees from its usual vertical, as when the car is carried or on its side.

    The yaw is that of the body's X axis, of its part in the floor where it leans, or of another axis where X is up.

    Raises:
        InputRefused: too many quaternions are not of unit length, all are written w first, or they turn about another
            axis than the one that is up.
    """
    blank = ~np.isfinite(xyzw).all(axis=1)
    with np.errstate(over="ignore"):
        length = np.linalg.norm(xyzw, axis=1)
    off = ~blank & ~(np.abs(length - 1.0) <= POSE.max_length_error)
    if off.sum() > POSE.max_non_unit_share * len(xyzw):
        cause = f"{off.mean():.0%} of the quaternions are not of unit length (one has {length[off][0]:.3g})"
        raise InputRefused(path, "orientation", cause, "export or record the orientation again")
    good = ~blank & ~off
    vertical = vertical_in_body(xyzw[good])
    _check_component_order(xyzw[good], vertical, path)
    tipped, forward, axes = np.zeros(len(xyzw), dtype=bool), X_AXIS, list[Irregularity]()
    # a body that leans all the time is mounted so
    if _upright_share(vertical) > POSE.min_upright_share:
        _check_turning_axis(xyzw[good], up_axis, path)
        usual = np.median(verticals_in_body(xyzw[good])[up_axis], axis=0)
        tipped[good] = vertical @ np.median(vertical, axis=0) < POSE.tipped_cosine
        forward, axes = _level_direction(usual / np.linalg.norm(usual), path)
    yaw = yaw_of_quaternions(xyzw, up_axis, forward)
    yaw[off | tipped] = np.nan
    mended = good & (np.abs(length - 1.0) > POSE.rounding_length_error)
    text = "the body leans by more than 45 degrees: carried, or on its side"
    odd = [
        *axes,
        *note_rows(time_s, off, "quaternion", "excluded", "not of unit length"),
        *note_rows(time_s, mended, "quaternion length", "fixed", "brought to unit length"),
        *note_rows(time_s, tipped, "tipped over", "excluded", text),
    ]
    flips = int((np.einsum("ij,ij->i", xyzw[1:], xyzw[:-1]) < 0.0).sum())
    if flips:
        odd.append(Irregularity("quaternion sign", "fixed", flips, path.name, "q and -q are the same turn"))
    return yaw, odd


def _upright_share(vertical: Floats) -> float:
    """Share of verticals in body axes (N, 3) within 20 degrees of their median; 0 without any, or if they scatter."""
    if not len(vertical):
        return 0.0
    usual = np.median(vertical, axis=0)
    size = float(np.linalg.norm(usual))
    return float((vertical @ usual > POSE.upright_cosine * size).mean()) if size > POSE.upright_cosine else 0.0


def _check_turning_axis(xyzw: Floats, up_axis: str, path: Path) -> None:
    """Raise `InputRefused` where quaternions (N, 4) turn about the world's Y or Z axis, and the other is up."""
    shares = {axis: _upright_share(rows) for axis, rows in verticals_in_body(xyzw).items()}
    other = "Z" if up_axis == "Y" else "Y"
    if shares[up_axis] < POSE.max_leaning_share and shares[other] > POSE.min_upright_share:
        cause = f"the body turns about the {other} axis, and {up_axis} is up by the vehicle file"
        step = f'set mocap.up_axis = "{other}" in the vehicle file, or export positions and rotations in the same axes'
        raise InputRefused(path, "orientation", cause, step)


def _check_component_order(xyzw: Floats, vertical: Floats, path: Path) -> None:
    """Raise `InputRefused` where quaternions (N, 4) read as x, y, z, w lean all over, and read as w, x, y, z do not.

    `vertical` (N, 3) is the world's vertical in body axes by the first reading.
    """
    if _upright_share(vertical) >= POSE.max_leaning_share:
        return
    if _upright_share(vertical_in_body(np.roll(xyzw, -1, axis=1))) > POSE.min_upright_share:
        cause = "the quaternions are those of a car on its wheels only if they are written w first"
        raise InputRefused(path, "orientation", cause, "write them x, y, z, w, or map the fields")


def check_up_axis(world: Floats, up_axis: str, path: Path) -> None:
    """Raise `InputRefused` where positions (N, 3) in m move along the stated `up_axis` and hardly along Y or Z."""
    known = world[(np.abs(world) < STREAM.max_value).all(axis=1)]
    if len(known) < 2:
        return
    low, high = np.quantile(known, SPREAD_QUANTILES, axis=0)
    spread = dict(zip("XYZ", high - low, strict=True))
    flat = min(spread, key=lambda axis: float(spread[axis]))
    drives = spread[up_axis] > POSE.min_drive_m and spread[flat] < POSE.max_vertical_share * spread[up_axis]
    if flat in "YZ" and flat != up_axis and drives:
        stated = f"the body moves by {spread[up_axis]:.2f} m along {up_axis}, which is up by the vehicle file"
        cause = f"{stated}, and by {spread[flat]:.2f} m along {flat}"
        raise InputRefused(path, "position", cause, f'set mocap.up_axis = "{flat}" in the vehicle file')


def find_lifted_samples(floor: Floats, height: Floats, time_s: Floats) -> tuple[Bools, list[Irregularity]]:
    """Mask (N,) of samples with a body lifted far off the floor, carried or tipped over, and the irregularity noted.

    `height` (N,) is compared with a plane over the positions `floor` (N, 2), both in m, fitted by least absolute
    deviations since lifted samples are outliers; the plane may tilt, as cameras are seldom level.  Nothing is marked
    where most samples would be; nor are runs whose ends rise as gently as a hill (`POSE.max_climb`).
    """
    good = (np.abs(np.column_stack([floor, height])) < STREAM.max_value).all(axis=1)
    if good.sum() < 3:
        return np.zeros(len(height), dtype=bool), []
    plane = np.column_stack([np.ones(len(floor)), floor])
    off = np.where(good, height - float(np.median(height[good])), 0.0)
    for _ in range(PLANE_ITERATIONS):
        weight = 1.0 / np.sqrt(np.maximum(np.abs(off[good]), MIN_DISTANCE_M))
        coefficients = np.linalg.lstsq(plane[good] * weight[:, None], height[good] * weight, rcond=None)[0]
        off[good] = height[good] - plane[good] @ coefficients
    usual = 1.4826 * float(np.median(np.abs(off[good])))
    up = good & (np.abs(off) > max(POSE.lifted_m, POSE.lifted_factor * usual))
    up = _keep_steep_excursions(up, floor, off)
    if not up.any() or up.sum() >= POSE.max_lifted_share * good.sum():
        return np.zeros(len(height), dtype=bool), []
    text = f"up to {np.abs(height[up] - np.nanmedian(height)).max():.2f} m off the floor: carried, or tipped over"
    return up, note_rows(time_s, up, "lifted", "excluded", text)


def _keep_steep_excursions(up: Bools, floor: Floats, off: Floats) -> Bools:
    """The mask `up` (N,) of samples off the floor's plane, without runs that start and end gently, as over a hill.

    A run is kept if, at either end, the height above the plane `off` (N,) changes by more than `POSE.max_climb` of the
    way driven there on the floor (N, 2), in m.
    """
    edges = np.flatnonzero(np.diff(np.r_[False, up, False].astype(int))).reshape(-1, 2)
    steep = np.zeros(len(up), dtype=bool)
    for a, b in edges:
        for edge in (a, b):
            i, j = max(0, edge - EDGE_SAMPLES), min(len(up) - 1, edge + EDGE_SAMPLES)
            part = slice(i, j + 1)
            path = np.nansum(np.hypot(*np.diff(floor[part], axis=0).T))
            if np.ptp(off[part]) > POSE.max_climb * path:
                steep[a:b] = True
    return steep
