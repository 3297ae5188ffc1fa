"""The tracked body's height: the floor it should keep to, and what leaves it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from bcid.errors import InputRefused
from bcid.recording.cleaning import LARGEST
from bcid.recording.types import Floats, Irregularity

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
