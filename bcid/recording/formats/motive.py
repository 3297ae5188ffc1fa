"""OptiTrack Motive's CSV export, format versions 1.22 to 1.25."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from bcid.aliases import Bools, Floats
from bcid.errors import InputRefused, Problem, Problems
from bcid.recording.checks import attitude
from bcid.recording.formats import motive_header
from bcid.recording.formats.commands_file import TakeStart, read_commands_file
from bcid.recording.formats.csv_table import parse_rows
from bcid.recording.formats.csv_text import CsvText, read_csv_text, read_whole_text
from bcid.recording.formats.floor import poses_in_space
from bcid.recording.formats.limits import TABLE as LIMITS
from bcid.recording.formats.motive_header import MotiveHeader
from bcid.recording.formats.names import printable_name
from bcid.recording.formats.numbers import parse_numbers
from bcid.recording.formats.raw import RawTake, TimeCut, identify_file
from bcid.recording.types import Irregularity, SourceFile
from bcid.vehicle import Vehicle

EDGE_S = 1.0  # before and after a part of a take, within which poses are read with it


class _FramesWithin:
    """Which frames lie within a part of a take, as far as their numbers tell; `first` is the take's first frame."""

    def __init__(self, cut: TimeCut, rate_hz: float) -> None:
        """The frames within `cut`, and EDGE_S before and after it, of an export at `rate_hz` (Hz)."""
        self.cut, self.rate_hz, self.first = cut, rate_hz, math.nan

    def __call__(self, block: pd.DataFrame) -> Bools:
        """Mask (N,) of the rows of the table's next block that are kept: those without a number, too."""
        frame = block[0].to_numpy()
        known = frame[np.isfinite(frame)]
        if math.isnan(self.first) and len(known):
            self.first = float(known[0])
        since_s = (frame - self.first) / self.rate_hz
        return np.asarray(~((since_s < self.cut.begin_s - EDGE_S) | (since_s > self.cut.end_s + EDGE_S)))


def _parse_frames(
    file: CsvText, header: MotiveHeader, columns: list[int], within: _FramesWithin | None = None
) -> pd.DataFrame:  # fmt: skip
    """The rows of a Motive export below its header, a frame each, as a table with columns 0, 1, ...; no blank rows.

    Of a table of plain numbers only the wanted `columns` are there, and only the frames `within` a part of it.
    """
    try:
        table = parse_rows(file, len(header.axes), header.table_row + 1, columns, within, skip_blank_lines=False)
        if file.rows is not None and table[0].isna().any():
            # whether a row without frame number is blank is seen by all of its cells
            whole = read_whole_text(file.path)
            table = parse_rows(whole, len(header.axes), header.table_row + 1, columns, skip_blank_lines=False)
    except pd.errors.EmptyDataError:
        return pd.DataFrame()
    except (pd.errors.ParserError, pd.errors.ParserWarning) as error:
        raise InputRefused(file.path, "table", f"cannot be read: {error}", "export the take again") from None
    return table.dropna(how="all") if table[0].isna().any() else table


def _numeric_cells(table: pd.DataFrame, columns: list[int], header: MotiveHeader, path: Path) -> Floats:
    """The table's n columns of these indices as floats (N, n), blank cells NaN; `InputRefused` where one holds text."""
    parsed = [parse_numbers(table[c], header.decimal) for c in columns]
    bad = [(int(p.bad_rows[0]), column) for p, column in zip(parsed, columns, strict=True) if len(p.bad_rows)]
    if bad:
        row, column = min(bad)
        place = f"line {header.table_row + 2 + int(table.index[row])}, column {column + 1}"
        cell = table[column].iloc[row]
        raise InputRefused(path, place, f"{printable_name(cell)!r} is no number", "export the take again")
    return np.column_stack([p.values for p in parsed])


def _frame_times(table: pd.DataFrame, clock: int, rate: float, path: Path, header: MotiveHeader) -> Floats:
    """Times (N,) in s of a table's frames: number / rate, since the Time column, that of index `clock`, is rounded.

    Raises:
        InputRefused: a row has no frame number, or its stated time differs by more than LIMITS.max_time_error_*.
    """
    frames, stated_s = _numeric_cells(table, [0, clock], header, path).T
    if not np.isfinite(frames).all():
        row = int(table.index[int(np.argmin(np.isfinite(frames)))])
        raise InputRefused(path, f"line {header.table_row + 2 + row}", "has no frame number", "export the take again")
    time_s: Floats = frames / rate
    apart = np.abs(time_s - stated_s)
    k = int(np.nanargmax(apart)) if np.isfinite(apart).any() else 0
    if apart[k] > max(LIMITS.max_time_error_periods / rate, LIMITS.max_time_error_s):
        cause = f"Time is {stated_s[k]:g} s where frame {frames[k]:g} at {rate:g} Hz is {time_s[k]:g} s"
        step = "check the Export Frame Rate, or export the take again"
        raise InputRefused(path, f"line {header.table_row + 2 + int(table.index[k])}", cause, step)
    return time_s


def _find_missing_frames(header: MotiveHeader, rows: int, path: Path) -> list[Irregularity]:
    """A warning, in a list, where the header counts more frames than the table has `rows`: the export was cut."""
    stated = header.keys.get("Total Exported Frames", "")
    if not stated.isdecimal() or int(stated) <= rows:
        return []
    text = f"the header counts {stated} frames, the table has {rows}: it is cut, or rows were removed"
    return [Irregularity("frames missing", "warning", int(stated) - rows, path.name, text)]


def _pose_columns(header: MotiveHeader, body: str, path: Path) -> tuple[dict[str, int], dict[str, int]]:
    """Column indices by axis of the body's position and of its rotation (X, Y, Z and perhaps W); refused if missing."""
    if header.holds_twice(body, "Position"):
        cause = "is there twice: it is not known which of them is the car"
        raise InputRefused(path, f"rigid body {body!r}", cause, "give the bodies names of their own, and export again")
    position, rotation = header.column_indices(body, "Position"), header.column_indices(body, "Rotation")
    if set(position) != set("XYZ") or set(rotation) not in ({*"XYZ"}, {*"XYZW"}):
        raise InputRefused(path, f"rigid body {body!r}", "lacks rotation or position columns", "export both")
    return position, rotation


def _marker_error_columns(header: MotiveHeader, body: str) -> list[int]:
    """The index of the column of the body's mean marker error, in a list that is empty where there is none."""
    names = ("Mean Marker Error", "Marker Error")
    return [i for name in names for i in header.column_indices(body, name).values()][:1]


def _find_poor_solutions(error: Floats) -> Bools:
    """Mask (N,) of the rows whose pose was not measured, by Motive's mean marker error (N,) in m.

    Such an error is far above the usual one (LIMITS.max_marker_error_*), or exactly zero where few are.
    """
    known = error[np.isfinite(error)]
    if not len(known):
        return np.zeros(len(error), dtype=bool)
    usual = float(np.median(known))
    # an error of exactly zero: the pose was interpolated, unless the errors are as small as their digits
    zero = error == 0.0
    interpolated = zero & (zero.mean() < LIMITS.max_interpolated_share) & (usual > 0.0)
    return np.asarray((error > max(LIMITS.max_marker_error_m, LIMITS.max_marker_error_factor * usual)) | interpolated)


def _read_rotations(header: MotiveHeader, rotations: Floats, path: Path) -> tuple[Floats, list[Irregularity]]:
    """Quaternions x, y, z, w (N, 4) of rotations (N, 4) as they are, or of Euler angles (N, 3) in degrees; what is odd.

    Raises:
        InputRefused: angles in radians, or an unknown order of turns.
    """
    if rotations.shape[1] == 4:
        return rotations, []
    low, high = np.nanmin(rotations, axis=0, initial=0.0), np.nanmax(rotations, axis=0, initial=0.0)
    wraps = ((low < -LIMITS.min_wrap_rad) & (high > LIMITS.min_wrap_rad)).any()
    if max(-low.min(), high.max()) <= np.pi and wraps:
        cause = "the angles fill -3.14 to 3.14: radians, where Motive writes degrees"
        raise InputRefused(path, "rotation", cause, "export the take again, with quaternions")
    order, odd = motive_header.euler_rotation_order(header, path), []
    if "Rotation Type" not in header.keys:
        odd = [Irregularity("rotation order", "warning", 1, path.name, f"the header names none: {order} is assumed")]
    return attitude.quaternions_of_euler(rotations, order), odd


def _read_poses(file: CsvText, source: SourceFile, vehicle: Vehicle, cut: TimeCut | None = None) -> RawTake:
    """The vehicle's poses (N, 3) in the text of a Motive CSV export, as `read_motive_poses` has them.

    Where a `cut` is given, only poses within it need be there, if there are any.
    """
    path = file.path
    header, problems = motive_header.read_motive_header(file), Problems()
    if header.keys.get("Coordinate Space", "Global") != "Global":
        problems.append(Problem("line 1", "Coordinate Space is not Global", "export with global coordinates"))
    with problems.gather_refusals():
        rate, odd_rate = motive_header.parse_frame_rate(header, path)
    with problems.gather_refusals():
        scale = motive_header.length_unit_in_metres(header, vehicle, path)
    clock = [i for i, label in enumerate(header.axes) if label.startswith("Time (")]
    if not clock:
        problems.append(Problem(f"line {header.table_row + 1}", "has no Time column", "export the take again"))
    with problems.gather_refusals():
        body = motive_header.choose_rigid_body(header, vehicle.mocap.rigid_body, path)
        position, rotation = _pose_columns(header, body, path)
        if "W" not in rotation:
            motive_header.euler_rotation_order(header, path)
    problems.raise_if_any(path)
    places, turns = [position[a] for a in "XYZ"], [rotation[a] for a in "XYZW" if a in rotation]
    errors = _marker_error_columns(header, body)
    wanted = [0, *clock[:1], *places, *turns, *errors]
    within = None if cut is None or file.rows is None else _FramesWithin(cut, rate)
    table = _parse_frames(file, header, wanted, within)
    if table.empty and within is not None:
        # whoever cuts the take says that there is nothing, and how long it is
        within, table = None, _parse_frames(file, header, wanted)
    if table.empty:
        raise InputRefused(path, f"line {header.table_row + 2}", "no frame follows the header", "export the take again")
    time_s = _frame_times(table, clock[0], rate, path, header)
    world = scale * _numeric_cells(table, places, header, path)
    quaternions, odd_turns = _read_rotations(header, _numeric_cells(table, turns, header, path), path)
    error = scale * _numeric_cells(table, errors, header, path)[:, 0] if errors else np.full(len(table), np.nan)
    # what is missing elsewhere is nothing to a part
    missing = _find_missing_frames(header, len(table), path) if within is None else []
    # large, and no longer needed
    del table
    pose, odd_poses = poses_in_space(world, quaternions, vehicle.mocap.up_axis, time_s, path)
    if "W" not in rotation:
        # the signs of quaternions are made here, not recorded
        odd_poses = [i for i in odd_poses if i.kind != "quaternion sign"]
    poor = _find_poor_solutions(error)
    pose[poor] = np.nan
    odd = [*file.irregularities, *odd_rate, *missing, *odd_turns, *odd_poses]
    if poor.any():
        text = "the mean marker error is far above the usual, or exactly zero: not measured"
        odd.append(Irregularity("marker error", "excluded", int(poor.sum()), path.name, text))
    first_s = None if within is None else within.first / rate
    return RawTake(
        path.stem, (source,), time_s, pose, np.empty(0), np.empty((0, 2)), rate, {}, tuple(odd), first_pose_s=first_s
    )  # fmt: skip


def read_motive_poses(path: Path, vehicle: Vehicle) -> RawTake:
    """The vehicle's poses (N, 3) in a Motive CSV export, x, y (m) and yaw (rad) on the floor, without commands (M = 0).

    Poses that were not measured, or off the floor, are NaN.

    Raises:
        InputRefused: the export lacks the body, a column, the frame rate or a unit, or a cell is no number.
    """
    source = identify_file(path, "motive-csv")
    return _read_poses(read_csv_text(path), source, vehicle)


def read_motive(path: Path, vehicle: Vehicle, commands: Path, cut: TimeCut | None = None) -> RawTake:
    """The unchecked poses of a Motive CSV export with the commands of its commands file; refused if either is bad.

    Where a `cut` is given, poses far outside of it are left out.
    """
    problems, text = Problems(), None
    with problems.gather_refusals():
        source = identify_file(path, "motive-csv")
        text = read_csv_text(path)
        poses = _read_poses(text, source, vehicle, cut)
    with problems.gather_refusals():
        start = TakeStart(motive_header.capture_start_time(text or read_csv_text(path)), None, vehicle.clock.offset_s)
        file = read_commands_file(commands, vehicle.commands, start)
    problems.raise_if_any(path)
    return replace(
        poses, sources=poses.sources + file.sources, command_time_s=file.command_time_s, command=file.command,
        channels=file.channels, irregularities=poses.irregularities + file.irregularities,
    )  # fmt: skip
