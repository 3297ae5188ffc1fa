"""Attitude and height of the tracked body: rotations, and which quaternions and heights a car on wheels can have."""

from collections.abc import Callable
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.errors import InputRefused
from bcid.recording.checks.rowwise import find_runs, in_all_columns, lengths_of_rows, total_variance
from bcid.recording.checks.samples import note_rows
from bcid.recording.limits import POSE, STREAM
from bcid.recording.types import Irregularity

X_AXIS = np.array([1.0, 0.0, 0.0])  # of the body: forward, unless it was defined otherwise
MIN_NORM = 1e-6  # of a quaternion that can be brought to unit length
PLANE_ITERATIONS = 20  # of reweighted least squares
PLANE_SAMPLES = 20_000  # of a long take, evenly spread, that show the floor's plane
MIN_DISTANCE_M = 1e-4  # off the plane, by which a sample is weighted
EDGE_SAMPLES = 30  # before and after the end of an excursion, over which its climb is taken
SPREAD_QUANTILES = (0.15, 0.85)  # of positions: carried for a while, a car still drove for most of the time


class UsualVertical(NamedTuple):
    """How an axis of the world, maybe its vertical, lies in the axes of a body over N samples."""

    usual: Floats  # (3,), its median
    along_usual: Floats  # (N,) parts along the median
    upright_share: float  # of the samples within 20 degrees of the median; 0 without any, or if they scatter


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
    good = in_all_columns(np.isfinite(degrees))
    turns = degrees[good][:, ["XYZ".index(axis) for axis in order]]
    quaternions[good] = np.atleast_2d(Rotation.from_euler(order, turns, degrees=True).as_quat())
    return quaternions


def yaw_of_quaternions(xyzw: Floats, up_axis: Literal["Y", "Z"], forward: Floats = X_AXIS) -> Floats:
    """Yaw (N,) in rad of a direction of the body on the floor, by quaternions x, y, z, w (N, 4); NaN where they are.

    `forward` (3,) is that direction in body axes: a unit vector, the body's X axis unless given.
    """
    # what is no number has no yaw
    with np.errstate(over="ignore", invalid="ignore"):
        norm = lengths_of_rows(xyzw)
        x, y, z, w = xyzw.T / np.where(norm > MIN_NORM, norm, np.nan)
    # rows of the rotation matrix, which q and -q have in common, entry by entry and only where they are needed
    rows: dict[str, tuple[Callable[[], Floats], ...]] = {
        "X": (lambda: 1 - 2 * (y * y + z * z), lambda: 2 * (x * y - w * z), lambda: 2 * (x * z + w * y)),
        "Y": (lambda: 2 * (x * y + w * z), lambda: 1 - 2 * (x * x + z * z), lambda: 2 * (y * z - w * x)),
        "Z": (lambda: 2 * (x * z - w * y), lambda: 2 * (y * z + w * x), lambda: 1 - 2 * (x * x + y * y)),
    }

    def ahead(axis: str) -> Floats:
        """The component (N,) of the direction along a world axis."""
        parts = [part * entry() for part, entry in zip(forward, rows[axis], strict=True) if part != 0.0]
        return np.asarray(sum(parts, np.zeros(len(xyzw))))

    return np.arctan2(-ahead("Z") if up_axis == "Y" else ahead("Y"), ahead("X"))


def verticals_in_body(xyzw: Floats) -> dict[str, Floats]:
    """World's Y and Z axes as unit vectors (N, 3) in the body frame, by quaternions x, y, z, w (N, 4)."""
    x, y, z, w = xyzw.T / lengths_of_rows(xyzw)
    # rows of the rotation matrix
    return {
        "Y": np.column_stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
        "Z": np.column_stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
    }


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
    blank = ~in_all_columns(np.isfinite(xyzw))
    with np.errstate(over="ignore"):
        length = lengths_of_rows(xyzw)
    off = ~blank & ~(np.abs(length - 1.0) <= POSE.max_length_error)
    if off.sum() > POSE.max_non_unit_share * len(xyzw):
        cause = f"{off.mean():.0%} of the quaternions are not of unit length (one has {length[off][0]:.3g})"
        raise InputRefused(path, "orientation", cause, "export or record the orientation again")
    good = ~blank & ~off
    turns = xyzw if good.all() else xyzw[good]
    verticals = verticals_in_body(turns)
    axis = _steadiest(verticals)
    vertical = _usual_vertical(verticals[axis])
    _check_component_order(turns, vertical.upright_share, path)
    tipped, forward, axes = np.zeros(len(xyzw), dtype=bool), X_AXIS, list[Irregularity]()
    # a body that leans all the time is mounted so
    if vertical.upright_share > POSE.min_upright_share:
        stated = vertical if axis == up_axis else _usual_vertical(verticals[up_axis])
        _check_turning_axis(stated, vertical, axis, path)
        tipped[good] = vertical.along_usual < POSE.tipped_cosine
        forward, axes = _level_direction(stated.usual / np.linalg.norm(stated.usual), path)
    del verticals, vertical, turns
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


def _usual_vertical(rows: Floats) -> UsualVertical:
    """The median of verticals in body axes (N, 3), and how the others lie about it."""
    if not len(rows):
        return UsualVertical(np.full(3, np.nan), np.empty(0), 0.0)
    usual = np.median(rows, axis=0)
    size, along = float(np.linalg.norm(usual)), rows @ usual
    share = float((along > POSE.upright_cosine * size).mean()) if size > POSE.upright_cosine else 0.0
    return UsualVertical(usual, along, share)


def _steadiest(verticals: dict[str, Floats]) -> str:
    """The world's vertical: of its Y and Z axis, as (N, 3) in the body frame, the one that varies less on wheels."""
    return min(verticals, key=lambda axis: total_variance(verticals[axis]))


def _check_turning_axis(stated: UsualVertical, steadiest: UsualVertical, axis: str, path: Path) -> None:
    """Raise `InputRefused` where the body turns about the world's `axis`, Y or Z, and the other one is stated."""
    if stated.upright_share < POSE.max_leaning_share and steadiest.upright_share > POSE.min_upright_share:
        cause = f"the body turns about the {axis} axis, and {'Z' if axis == 'Y' else 'Y'} is up by the vehicle file"
        step = f'set mocap.up_axis = "{axis}" in the vehicle file, or export positions and rotations in the same axes'
        raise InputRefused(path, "orientation", cause, step)


def _check_component_order(xyzw: Floats, upright: float, path: Path) -> None:
    """Raise `InputRefused` where quaternions (N, 4) read as x, y, z, w lean all over, and read as w, x, y, z do not.

    `upright` is the share of samples in which the body is upright by the first reading.
    """
    if upright >= POSE.max_leaning_share:
        return
    other = verticals_in_body(np.roll(xyzw, -1, axis=1))
    if _usual_vertical(other[_steadiest(other)]).upright_share > POSE.min_upright_share:
        cause = "the quaternions are those of a car on its wheels only if they are written w first"
        raise InputRefused(path, "orientation", cause, "write them x, y, z, w, or map the fields")


def check_up_axis(world: Floats, up_axis: str, path: Path) -> None:
    """Raise `InputRefused` where positions (N, 3) in m move along the stated `up_axis` and hardly along Y or Z."""
    known = world[in_all_columns(np.abs(world) < STREAM.max_value)]
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
    good = in_all_columns(np.abs(np.column_stack([floor, height])) < STREAM.max_value)
    if good.sum() < 3:
        return np.zeros(len(height), dtype=bool), []
    rows = np.flatnonzero(good)
    off = np.zeros(len(height))
    off[rows] = _heights_above_plane(floor[rows], height[rows])
    usual = 1.4826 * float(np.median(np.abs(off[rows])))
    up = good & (np.abs(off) > max(POSE.lifted_m, POSE.lifted_factor * usual))
    up = _keep_steep_excursions(up, floor, off)
    if not up.any() or up.sum() >= POSE.max_lifted_share * good.sum():
        return np.zeros(len(height), dtype=bool), []
    text = f"up to {np.abs(height[up] - np.nanmedian(height)).max():.2f} m off the floor: carried, or tipped over"
    return up, note_rows(time_s, up, "lifted", "excluded", text)


def _heights_above_plane(floor: Floats, height: Floats) -> Floats:
    """Heights (N,) above the plane that fits `height` (N,) over `floor` (N, 2), all in m, by least absolute deviations.

    The plane is fitted by reweighted least squares to at most PLANE_SAMPLES samples.
    """
    some = slice(None, None, -(-len(height) // PLANE_SAMPLES))
    x, y = np.column_stack([np.ones(len(height[some])), floor[some]]), height[some]
    off = y - float(np.median(height))
    for _ in range(PLANE_ITERATIONS):
        weight = 1.0 / np.sqrt(np.maximum(np.abs(off), MIN_DISTANCE_M))
        coefficients = np.linalg.lstsq(x * weight[:, None], y * weight, rcond=None)[0]
        off = y - x @ coefficients
    return np.asarray(height - coefficients[0] - floor @ coefficients[1:])


def _keep_steep_excursions(up: Bools, floor: Floats, off: Floats) -> Bools:
    """The mask `up` (N,) of samples off the floor's plane, without runs that start and end gently, as over a hill.

    A run is kept if, at either end, the height above the plane `off` (N,) changes by more than `POSE.max_climb` of the
    way driven there on the floor (N, 2), in m.
    """
    steep = np.zeros(len(up), dtype=bool)
    for a, b in find_runs(up):
        for edge in (a, b):
            i, j = max(0, edge - EDGE_SAMPLES), min(len(up) - 1, edge + EDGE_SAMPLES)
            part = slice(i, j + 1)
            path = np.nansum(np.hypot(*np.diff(floor[part], axis=0).T))
            if np.ptp(off[part]) > POSE.max_climb * path:
                steep[a:b] = True
    return steep
