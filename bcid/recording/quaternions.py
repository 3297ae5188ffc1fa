"""Recorded quaternions, judged before they become a yaw: of unit length, in order, and of a car on its wheels."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
import numpy.typing as npt

from bcid.errors import InputRefused
from bcid.recording.orientation import turned_up, yaw_of_quaternions
from bcid.recording.types import Floats, Irregularity

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
