"""OptiTrack Motive's CSV export, format versions 1.22 to 1.25.

The first row is key,value pairs (their set varies by version); the table's header is found by its
first cell `Frame`, the row above it names what each column measures, and the row that reads
`Rigid Body` (labelled `Type` from 1.23 on) is followed by the bodies' names.
"""

from __future__ import annotations

import csv
import difflib
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from bcid.errors import InputRefused
from bcid.recording.commands import read_commands
from bcid.recording.orientation import on_floor, yaw_of_euler
from bcid.recording.quaternions import judged_yaw
from bcid.recording.raw import RawTake, source_of
from bcid.recording.types import Floats, Irregularity
from bcid.vehicle import Vehicle

METRES = {"meters": 1.0, "centimeters": 1e-2, "millimeters": 1e-3, "m": 1.0, "cm": 1e-2, "mm": 1e-3}
VERSIONS = ("1.22", "1.23", "1.24", "1.25")
_HEADER_ROWS = 30


@dataclass(frozen=True)
class Header:
    """What stands above the table."""

    keys: dict[str, str]
    table_row: int  # index of the row that begins with Frame
    axes: list[str]  # X, Y, Z, W, ... per column
    measures: list[str]  # Rotation, Position, Mean Marker Error, ... per column
    types: list[str]  # Rigid Body, Marker, ... per column
    names: list[str]  # the asset's name per column

    def bodies(self) -> list[str]:
        """The rigid bodies' names, in order."""
        return list(dict.fromkeys(n for n, t in zip(self.names, self.types, strict=True) if t == "Rigid Body"))

    def columns(self, body: str, measure: str) -> dict[str, int]:
        """Column index by axis letter of one body's measure."""
        rows = zip(self.types, self.names, self.measures, self.axes, strict=True)
        return {
            axis.upper(): i
            for i, (t, n, m, axis) in enumerate(rows)
            if t == "Rigid Body" and n == body and m == measure
        }


def read_header(path: Path) -> Header:
    """The export's header, found by content.

    Raises:
        InputRefused: no header, an unknown version, or no rigid body in it.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            rows = [row for row, _ in zip(reader, range(_HEADER_ROWS), strict=False)]
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputRefused(path, "header", f"cannot be read as CSV: {error}", "export the take again") from None
    first = rows[0]
    keys = {k.strip(): v.strip() for k, v in zip(first[::2], first[1::2], strict=False) if k.strip()}
    version = keys.get("Format Version", "")
    if version not in VERSIONS:
        raise InputRefused(
            path, "line 1", f"Motive format version {version!r} is not known", f"export as one of {', '.join(VERSIONS)}"
        )
    table = next((i for i, row in enumerate(rows) if row and row[0].strip() == "Frame"), None)
    if table is None:
        raise InputRefused(path, "header", "no row begins with Frame", "export the take with its table")
    kinds = next((i for i, row in enumerate(rows[:table]) if i > 0 and "Rigid Body" in row), None)
    if kinds is None:
        raise InputRefused(
            path,
            f"lines 1 to {table + 1}",
            "the export holds no rigid body (no assets)",
            "create a rigid body in Motive, solve the take and export with Rigid Bodies ticked",
        )
    width = len(rows[table])
    padded = [[*(cell.strip() for cell in row), *[""] * (width - len(row))][:width] for row in rows[: table + 1]]
    return Header(keys, table, padded[table], padded[table - 1], padded[kinds], padded[kinds + 1])


def _choose_body(header: Header, wanted: str | None, path: Path) -> str:
    bodies = header.bodies()
    if wanted in bodies:
        return str(wanted)
    if wanted is None and len(bodies) == 1:
        return bodies[0]
    near = difflib.get_close_matches(wanted or "", bodies, n=1)
    cause = "mocap.rigid_body is not set" if wanted is None else f"there is no rigid body {wanted!r}"
    hint = f"; nearest: {near[0]}" if near else ""
    raise InputRefused(
        path,
        "rigid bodies",
        f"{cause}; the export has {', '.join(bodies)}{hint}",
        "set mocap.rigid_body in the vehicle file",
    )


def _metres(header: Header, vehicle: Vehicle, path: Path) -> float:
    unit = header.keys.get("Length Units") or vehicle.mocap.length_unit
    if unit is None:
        raise InputRefused(
            path, "line 1", "states no Length Units", 'set mocap.length_unit = "m", "cm" or "mm" in the vehicle file'
        )
    if unit.lower() not in METRES:
        raise InputRefused(path, "line 1", f"Length Units {unit!r} are not known", "export in meters")
    return METRES[unit.lower()]


def _rate(header: Header, path: Path) -> tuple[float, tuple[Irregularity, ...]]:
    try:
        rate = float(header.keys["Export Frame Rate"])
        capture = float(header.keys.get("Capture Frame Rate", rate))
    except (KeyError, ValueError):
        raise InputRefused(path, "line 1", "states no frame rate that is a number", "export the take again") from None
    if rate <= 0:
        raise InputRefused(path, "line 1", f"Export Frame Rate is {rate:g}", "export the take again")
    if rate == capture:
        return rate, ()
    text = f"exported at {rate:g} Hz of {capture:g} Hz captured"
    return rate, (Irregularity("export rate", "warning", 1, f"{path.name} line 1", text),)


def _table(path: Path, header: Header) -> pd.DataFrame:
    """The rows after the header; blank lines at the end are no rows."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            table = pd.read_csv(
                path, skiprows=header.table_row + 1, header=None, names=list(range(len(header.axes))),
                index_col=False, encoding="utf-8-sig", low_memory=False, skip_blank_lines=False,
            )  # fmt: skip
    except pd.errors.EmptyDataError:
        return pd.DataFrame()
    except (pd.errors.ParserError, pd.errors.ParserWarning, UnicodeDecodeError) as error:
        raise InputRefused(path, "table", f"cannot be read: {error}", "export the take again") from None
    return table.dropna(how="all")


def _numbers(table: pd.DataFrame, columns: list[int], header: Header, path: Path) -> Floats:
    part: Any = table[columns].apply(pd.to_numeric, errors="coerce")
    bad = part.isna().to_numpy() & table[columns].notna().to_numpy()
    if bad.any():
        row, col = np.argwhere(bad)[0]
        line = header.table_row + 2 + int(table.index[row])
        cell = table[columns[col]].iloc[row]
        raise InputRefused(
            path, f"line {line}, column {columns[col] + 1}", f"{cell!r} is no number", "export the take again"
        )
    return np.asarray(part, dtype=float)


def _times(frames: Floats, stated_s: Floats, rate: float, path: Path, header: Header) -> Floats:
    """T = frame/rate, since the Time column is rounded; the two must agree."""
    if not np.isfinite(frames).all():
        row = int(np.argmin(np.isfinite(frames)))
        raise InputRefused(path, f"line {header.table_row + 2 + row}", "has no frame number", "export the take again")
    time_s = frames / rate
    apart = np.abs(time_s - stated_s)
    worst = int(np.nanargmax(apart)) if np.isfinite(apart).any() else 0
    if apart[worst] > max(0.5 / rate, 1.1e-3):
        raise InputRefused(
            path,
            f"line {header.table_row + 2 + worst}",
            f"Time is {stated_s[worst]:g} s where frame {frames[worst]:g} at {rate:g} Hz is {time_s[worst]:g} s",
            "check the Export Frame Rate, or export the take again",
        )
    return time_s


def _missing(header: Header, rows: int, path: Path) -> list[Irregularity]:
    """What the header counts and the table lacks: an export or a copy that was cut."""
    stated = header.keys.get("Total Exported Frames", "")
    if not stated.isdecimal() or int(stated) <= rows:
        return []
    text = f"the header counts {stated} frames, the table has {rows}: it is cut, or rows were removed"
    return [Irregularity("frames missing", "warning", int(stated) - rows, path.name, text)]


def read_poses(path: Path, vehicle: Vehicle) -> RawTake:
    """The poses of the vehicle's rigid body in a Motive export, with no commands (M = 0).

    Raises:
        InputRefused: with the line and the reason, where the export cannot be used.
    """
    source = source_of(path, "motive-csv")
    header = read_header(path)
    if header.keys.get("Coordinate Space", "Global") != "Global":
        raise InputRefused(path, "line 1", "Coordinate Space is not Global", "export with global coordinates")
    body = _choose_body(header, vehicle.mocap.rigid_body, path)
    rate, odd = _rate(header, path)
    metres = _metres(header, vehicle, path)
    position = header.columns(body, "Position")
    rotation = header.columns(body, "Rotation")
    if set(position) != set("XYZ") or set(rotation) not in ({*"XYZ"}, {*"XYZW"}):
        raise InputRefused(path, f"rigid body {body!r}", "lacks rotation or position columns", "export both")
    table = _table(path, header)
    if table.empty:
        raise InputRefused(path, f"line {header.table_row + 2}", "no frame follows the header", "export the take again")
    time_column = next((i for i, a in enumerate(header.axes) if a.startswith("Time (")), None)
    if time_column is None:
        raise InputRefused(path, f"line {header.table_row + 1}", "has no Time column", "export the take again")
    frames, stated = _numbers(table, [0, time_column], header, path).T
    odd = (*odd, *_missing(header, len(table), path))
    time_s = _times(frames, stated, rate, path, header)
    floor = on_floor(metres * _numbers(table, [position[a] for a in "XYZ"], header, path), vehicle.mocap.up_axis)
    turn = _numbers(table, [rotation[a] for a in ("XYZW" if "W" in rotation else "XYZ")], header, path)
    if "W" in rotation:
        yaw, turns = judged_yaw(turn, vehicle.mocap.up_axis, time_s, path)
        odd = (*odd, *turns)
    else:
        order = header.keys.get("Rotation Type", "XYZ").upper()
        if sorted(order) != ["X", "Y", "Z"]:
            raise InputRefused(path, "line 1", f"Rotation Type {order!r} is no order of X, Y, Z", "export quaternions")
        yaw = yaw_of_euler(turn, order, vehicle.mocap.up_axis)
    empty = np.empty(0)
    return RawTake(path.stem, (source,), time_s, np.column_stack([floor, yaw]), empty, np.empty((0, 2)), rate, {}, odd)


def read_motive(path: Path, vehicle: Vehicle, commands: Path) -> RawTake:
    """A Motive export with its commands file."""
    poses = read_poses(path, vehicle)
    source, time_s, command, channels, odd = read_commands(commands)
    return RawTake(
        poses.name, (*poses.sources, source), poses.pose_time_s, poses.pose, time_s, command,
        poses.rate_hz, channels, (*poses.irregularities, *odd),
    )  # fmt: skip
