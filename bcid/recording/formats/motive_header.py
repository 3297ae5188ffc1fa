"""The header of a Motive export: its keys, rigid bodies and columns.

The first row holds pairs of key and value (their set varies by version). The table's header row begins with the cell
`Frame`, the row above it names what each column measures, and the row that reads `Rigid Body` (labelled `Type` from
1.23 on) is followed by that of the bodies' names.
"""

import re
from dataclasses import dataclass
from pathlib import Path

from bcid.errors import InputRefused
from bcid.recording.formats.csv_text import CsvText
from bcid.recording.formats.names import list_names, printable_name
from bcid.recording.formats.raw import nearest_hint
from bcid.recording.types import Irregularity
from bcid.vehicle import Vehicle

METRES_PER_UNIT = {"meters": 1.0, "centimeters": 1e-2, "millimeters": 1e-3, "m": 1.0, "cm": 1e-2, "mm": 1e-3}
VERSIONS = ("1.22", "1.23", "1.24", "1.25")
HEADER_ROWS = 30  # among which the header is looked for


@dataclass(frozen=True)
class MotiveHeader:
    """The header of a Motive export: keys, and four rows with one entry for each column of the table."""

    keys: dict[str, str]
    table_row: int  # index of the row that begins with Frame
    axes: list[str]  # X, Y, Z, W, ... per column
    measures: list[str]  # Rotation, Position, Mean Marker Error, ... per column
    types: list[str]  # Rigid Body, Marker, ... per column
    names: list[str]  # the asset's name per column
    decimal: str = "."  # the mark of its numbers

    def rigid_body_names(self) -> list[str]:
        """The names of the export's rigid bodies, in order."""
        return list(dict.fromkeys(n for n, t in zip(self.names, self.types, strict=True) if t == "Rigid Body"))

    def holds_twice(self, body: str, measure: str) -> bool:
        """Whether an axis of a body's measure has several columns, as where two bodies have one name."""
        columns = zip(self.types, self.names, self.measures, self.axes, strict=True)
        axes = [axis for *column, axis in columns if column == ["Rigid Body", body, measure]]
        return len(set(axes)) < len(axes)

    def column_indices(self, body: str, measure: str) -> dict[str, int]:
        """The index of each column of a body's measure, such as "Position", by axis letter."""
        columns = enumerate(zip(self.types, self.names, self.measures, self.axes, strict=True))
        return {axis.upper(): i for i, (*column, axis) in columns if column == ["Rigid Body", body, measure]}


def _read_keys(first: list[str]) -> dict[str, str]:
    """The pairs of key and value in an export's first row."""
    return {k.strip(): v.strip() for k, v in zip(first[::2], first[1::2], strict=False) if k.strip()}


def read_motive_header(file: CsvText) -> MotiveHeader:
    """The header of a Motive CSV export: its keys (rates, units), and the kind, name, measure and axis of each column.

    Raises:
        InputRefused: a version that is not known, or an export without table or rigid body.
    """
    path, rows = file.path, file.first_rows(HEADER_ROWS)
    keys = _read_keys(rows[0])
    if file.decimal == ",":
        keys = {k: re.sub(r"^(\d+),(\d+)$", r"\1.\2", v) for k, v in keys.items()}
    version = keys.get("Format Version", "")
    if version not in VERSIONS:
        cause = f"Motive format version {version!r} is not known"
        raise InputRefused(path, "line 1", cause, f"export as one of {', '.join(VERSIONS)}")
    table = next((i for i, row in enumerate(rows) if row and row[0].strip() == "Frame"), None)
    if table is None:
        raise InputRefused(path, "header", "no row begins with Frame", "export the take with its table")
    kinds = next((i for i, row in enumerate(rows[:table]) if i > 0 and "Rigid Body" in row), None)
    if kinds is None:
        cause = "the export holds no rigid body (no assets)"
        step = "create a rigid body in Motive, solve the take and export with Rigid Bodies ticked"
        raise InputRefused(path, f"lines 1 to {table + 1}", cause, step)
    width = len(rows[table])
    padded = [[*(cell.strip() for cell in row), *[""] * (width - len(row))][:width] for row in rows[: table + 1]]
    return MotiveHeader(keys, table, padded[table], padded[table - 1], padded[kinds], padded[kinds + 1], file.decimal)


def choose_rigid_body(header: MotiveHeader, wanted: str | None, path: Path) -> str:
    """The rigid body's name: `wanted`, or the only one if that is None; `InputRefused` if absent or one of several."""
    bodies = header.rigid_body_names()
    if wanted in bodies:
        return str(wanted)
    if wanted is None and len(bodies) == 1:
        return bodies[0]
    cause = "mocap.rigid_body is not set" if wanted is None else f"there is no rigid body {printable_name(wanted)!r}"
    cause += f"; the export has {list_names(bodies)}{nearest_hint(wanted or '', bodies)}"
    raise InputRefused(path, "rigid bodies", cause, "set mocap.rigid_body in the vehicle file")


def length_unit_in_metres(header: MotiveHeader, vehicle: Vehicle, path: Path) -> float:
    """The export's unit of length in m, by its header or else the vehicle file; `InputRefused` where unknown."""
    unit = header.keys.get("Length Units") or vehicle.mocap.length_unit
    if unit is None:
        step = 'set mocap.length_unit = "m", "cm" or "mm" in the vehicle file'
        raise InputRefused(path, "line 1", "states no Length Units", step)
    if unit.lower() not in METRES_PER_UNIT:
        raise InputRefused(path, "line 1", f"Length Units {unit!r} are not known", "export in meters")
    return METRES_PER_UNIT[unit.lower()]


def parse_frame_rate(header: MotiveHeader, path: Path) -> tuple[float, tuple[Irregularity, ...]]:
    """The export's frame rate (Hz), and a warning where frames were captured at another; `InputRefused` without one."""
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


def euler_rotation_order(header: MotiveHeader, path: Path) -> str:
    """The order of rotations in the export's Euler angles, by default "XYZ"; `InputRefused` for any other text."""
    order = header.keys.get("Rotation Type", "XYZ").upper()
    if sorted(order) != ["X", "Y", "Z"]:
        raise InputRefused(path, "line 1", f"Rotation Type {order!r} is no order of X, Y, Z", "export quaternions")
    return order


def capture_start_time(file: CsvText) -> str | None:
    """The export's Capture Start Time as it is written, a local time of Motive's computer; None where there is none."""
    return _read_keys(file.first_rows(1)[0]).get("Capture Start Time") or None
