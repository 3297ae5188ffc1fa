"""What stands above the table of a Motive export: its keys, bodies and columns.

The first row is key,value pairs (their set varies by version); the table's header is found by its
first cell `Frame`, the row above it names what each column measures, and the row that reads
`Rigid Body` (labelled `Type` from 1.23 on) is followed by the bodies' names.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass
from pathlib import Path

from bcid.errors import InputRefused
from bcid.recording.formats.csv_text import CsvText
from bcid.recording.types import Irregularity
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


def read_header(file: CsvText) -> Header:
    """The export's header, found by content.

    Raises:
        InputRefused: no header, an unknown version, or no rigid body in it.
    """
    path, rows = file.path, file.rows(_HEADER_ROWS)
    first = rows[0]
    keys = {k.strip(): v.strip() for k, v in zip(first[::2], first[1::2], strict=False) if k.strip()}
    if file.decimal == ",":
        keys = {k: re.sub(r"^(\d+),(\d+)$", r"\1.\2", v) for k, v in keys.items()}
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


def choose_body(header: Header, wanted: str | None, path: Path) -> str:
    """The rigid body that is meant.

    Raises:
        InputRefused: none of that name, or none named where there are several.
    """
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


def metres(header: Header, vehicle: Vehicle, path: Path) -> float:
    """What the export's unit of length is in metres: the header wins over the vehicle file.

    Raises:
        InputRefused: neither states it, or it is not known.
    """
    unit = header.keys.get("Length Units") or vehicle.mocap.length_unit
    if unit is None:
        raise InputRefused(
            path, "line 1", "states no Length Units", 'set mocap.length_unit = "m", "cm" or "mm" in the vehicle file'
        )
    if unit.lower() not in METRES:
        raise InputRefused(path, "line 1", f"Length Units {unit!r} are not known", "export in meters")
    return METRES[unit.lower()]


def frame_rate(header: Header, path: Path) -> tuple[float, tuple[Irregularity, ...]]:
    """The export's rate (Hz), and what was odd about it.

    Raises:
        InputRefused: none that is a positive number.
    """
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


def global_space(header: Header, path: Path) -> None:
    """Raise `InputRefused` where positions are not those of the world."""
    if header.keys.get("Coordinate Space", "Global") != "Global":
        raise InputRefused(path, "line 1", "Coordinate Space is not Global", "export with global coordinates")


def time_column(header: Header, path: Path) -> int:
    """The index of the Time column.

    Raises:
        InputRefused: there is none.
    """
    found = next((i for i, a in enumerate(header.axes) if a.startswith("Time (")), None)
    if found is None:
        raise InputRefused(path, f"line {header.table_row + 1}", "has no Time column", "export the take again")
    return found


def rotation_order(header: Header, path: Path) -> str:
    """Which turn comes first, where the export has Euler angles.

    Raises:
        InputRefused: no order of X, Y, Z.
    """
    order = header.keys.get("Rotation Type", "XYZ").upper()
    if sorted(order) != ["X", "Y", "Z"]:
        raise InputRefused(path, "line 1", f"Rotation Type {order!r} is no order of X, Y, Z", "export quaternions")
    return order
