"""Recorded quaternions, judged before they become a yaw: of unit length, in order, and of a car on its wheels."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.recording.checks.samples import LARGEST
from bcid.recording.types import Irregularity

UNIT, MANY = 1e-3, 0.01  # off a length of one, and a share of the samples
ROUNDED = 2e-5  # what the digits of an export leave
UPRIGHT, TIPPED = 0.94, 0.7  # cosines of 20 and 45 degrees, to where a car's up usually points
STEADY, UNSTEADY = 0.8, 0.5  # share of the samples that are upright


def judged_yaw(
    xyzw: Floats, up_axis: Literal["Y", "Z"], time_s: Floats, path: Path
) -> tuple[Floats, list[Irregularity]]:
    """Yaw (N,) of the quaternions (N, 4), NaN where one is none or the car is off its wheels; and what was odd.

    Raises:
        InputRefused: too many that are not of unit length, or all of them written w first.
    """
    blank = ~np.isfinite(xyzw).all(axis=1)
    with np.errstate(over="ignore"):
        length = np.linalg.norm(xyzw, axis=1)
    off = ~blank & ~(np.abs(length - 1.0) <= UNIT)
    if off.sum() > MANY * len(xyzw):
        cause = f"{off.mean():.0%} of the quaternions are not of unit length (one has {length[off][0]:.3g})"
        raise InputRefused(path, "orientation", cause, "export or record the orientation again")
    good = ~blank & ~off
    up = turned_up(xyzw[good])
    _check_order(xyzw[good], up, path)
    tipped = np.zeros(len(xyzw), dtype=bool)
    tipped[good] = _tipped(up)
    yaw, odd = yaw_of_quaternions(xyzw, up_axis), list[Irregularity]()
    yaw[off | tipped] = np.nan
    flips = int((np.einsum("ij,ij->i", xyzw[1:], xyzw[:-1]) < 0.0).sum())
    grown = good & (np.abs(length - 1.0) > ROUNDED)
    for rows, kind, action, text in (
        (off, "quaternion", "excluded", "not of unit length"),
        (grown, "quaternion length", "fixed", "brought to unit length"),
        (tipped, "tipped over", "excluded", "the body leans by more than 45 degrees: carried, or on its side"),
    ):
        if rows.any():
            hit = time_s[rows]
            where = f"{np.nanmin(hit):.3f} to {np.nanmax(hit):.3f} s"
            odd.append(Irregularity(kind, action, int(rows.sum()), where, text))  # type: ignore[arg-type]
    if flips:
        odd.append(Irregularity("quaternion sign", "fixed", flips, path.name, "q and -q are the same turn"))
    return yaw, odd


def _steady(up: Floats) -> float:
    """The share of the samples in which the body's up points where it usually does."""
    usual = np.median(up, axis=0)
    size = float(np.linalg.norm(usual))
    return float((up @ usual > UPRIGHT * size).mean()) if size > UPRIGHT else 0.0


def _check_order(xyzw: Floats, up: Floats, path: Path) -> None:
    """Raise `InputRefused` where only w first is a car that keeps its wheels on one floor."""
    if len(up) and _steady(up) < UNSTEADY and _steady(turned_up(np.roll(xyzw, -1, axis=1))) > STEADY:
        cause = "the quaternions are those of a car on its wheels only if they are written w first"
        raise InputRefused(path, "orientation", cause, "write them x, y, z, w, or map the fields")


def _tipped(up: Floats) -> npt.NDArray[np.bool_]:
    """Samples that lean far from the rest; none where the body leans all the time, as on a hand."""
    if not len(up) or _steady(up) <= STEADY:
        return np.zeros(len(up), dtype=bool)
    return np.asarray(up @ np.median(up, axis=0) < TIPPED)


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


LIFTED_M, LIFTED_FACTOR = 0.05, 10.0  # above the floor, and of how far the height usually lies off it


MOST_LIFTED = 0.5  # of the samples; more is no floor


FLAT = 0.25  # the true floor's normal varies so much less than what the vehicle file calls up


ROUNDS, SMALL_M = 20, 1e-4


EDGE, CLIMB = 30, 0.7  # samples about the end of an excursion, and height by way that no car climbs


LEAST_DRIVE_M = 0.5  # of motion, below which no axis can be told from the others


def check_up_axis(world: Floats, up_axis: str, path: Path) -> None:
    """Raise `InputRefused` where the body moves along the axis that should point up, and not along another.

    `world` holds positions (N, 3) in metres.
    """
    known = world[(np.abs(world) < LARGEST).all(axis=1)]
    if len(known) < 2:
        return
    low, high = np.quantile(known, (0.15, 0.85), axis=0)  # carried for a while, it still drove for most of the time
    spread = dict(zip("XYZ", high - low, strict=True))
    flat = min(spread, key=lambda axis: float(spread[axis]))
    if flat in "YZ" and flat != up_axis and spread[up_axis] > LEAST_DRIVE_M and spread[flat] < FLAT * spread[up_axis]:
        cause = (
            f"the body moves by {spread[up_axis]:.2f} m along {up_axis}, which is up by the vehicle file, and by "
            f"{spread[flat]:.2f} m along {flat}"
        )
        raise InputRefused(path, "position", cause, f'set mocap.up_axis = "{flat}" in the vehicle file')


def lifted(floor: Floats, height: Floats) -> npt.NDArray[np.bool_]:
    """The samples (N,) in which the body is off the floor: far from the plane that most heights (m) lie on.

    The plane may lean: cameras are seldom level.  No sample is lifted where most would be.
    """
    good = (np.abs(np.column_stack([floor, height])) < LARGEST).all(axis=1)
    if good.sum() < 3:
        return np.zeros(len(height), dtype=bool)
    plane = np.column_stack([np.ones(len(floor)), floor])
    off = np.where(good, height - float(np.median(height[good])), 0.0)
    for _ in range(ROUNDS):  # least absolute deviations by reweighting: what is lifted bears no weight
        weight = 1.0 / np.sqrt(np.maximum(np.abs(off[good]), SMALL_M))
        coefficients = np.linalg.lstsq(plane[good] * weight[:, None], height[good] * weight, rcond=None)[0]
        off[good] = height[good] - plane[good] @ coefficients
    usual = 1.4826 * float(np.median(np.abs(off[good])))
    up = good & (np.abs(off) > max(LIFTED_M, LIFTED_FACTOR * usual))
    up = _steeply(up, floor, off)
    return up if up.sum() < MOST_LIFTED * good.sum() else np.zeros(len(height), dtype=bool)


def _steeply(up: npt.NDArray[np.bool_], floor: Floats, off: Floats) -> npt.NDArray[np.bool_]:
    """Those excursions that begin or end steeper than a car can climb: hills and ramps are driven over."""
    edges = np.flatnonzero(np.diff(np.r_[False, up, False].astype(int))).reshape(-1, 2)
    found = np.zeros(len(up), dtype=bool)
    for a, b in edges:
        for edge in (a, b):
            i, j = max(0, edge - EDGE), min(len(up) - 1, edge + EDGE)
            part = slice(i, j + 1)
            path = np.nansum(np.hypot(*np.diff(floor[part], axis=0).T))
            if np.ptp(off[part]) > CLIMB * path:
                found[a:b] = True
    return found


def off_the_floor(floor: Floats, height: Floats, time_s: Floats) -> tuple[npt.NDArray[np.bool_], list[Irregularity]]:
    """The samples (N,) in which the body is off the floor, and word of them."""
    up = lifted(floor, height)
    if not up.any():
        return up, []
    where = f"{np.nanmin(time_s[up]):.3f} to {np.nanmax(time_s[up]):.3f} s"
    text = f"up to {np.abs(height[up] - np.nanmedian(height)).max():.2f} m off the floor: carried, or tipped over"
    return up, [Irregularity("lifted", "excluded", int(up.sum()), where, text)]
