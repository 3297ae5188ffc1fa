"""OptiTrack Motive's CSV export, format versions 1.22 to 1.25."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from bcid.aliases import Floats
from bcid.errors import InputRefused, Problems
from bcid.recording.checks.attitude import check_up_axis, judged_yaw, off_the_floor, on_floor, quaternions_of_euler
from bcid.recording.formats.commands_file import read_commands
from bcid.recording.formats.csv_text import CsvText, read_text
from bcid.recording.formats.motive_header import (
    Header,
    choose_body,
    frame_rate,
    global_space,
    metres,
    read_header,
    rotation_order,
    time_column,
)
from bcid.recording.formats.raw import RawTake, source_of
from bcid.recording.formats.tables import as_numbers
from bcid.recording.types import Irregularity
from bcid.vehicle import Vehicle

RARE = 0.05  # share of the samples, of errors that are exactly zero
WRAPS_AT = 3.0  # that an angle in radians reaches on both sides before it wraps
MARKER_ERROR_M, MARKER_FACTOR = 0.005, 5.0  # a mean marker error beyond both this and the usual by this is no solution


def _table(file: CsvText, header: Header) -> pd.DataFrame:
    """The rows after the header; blank lines at the end are no rows."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pd.errors.ParserWarning)
            table = pd.read_csv(
                io.StringIO(file.text), skiprows=header.table_row + 1, header=None, sep=file.separator,
                names=list(range(len(header.axes))), decimal=file.decimal, index_col=False, low_memory=False,
                skip_blank_lines=False,
            )  # fmt: skip
    except pd.errors.EmptyDataError:
        return pd.DataFrame()
    except (pd.errors.ParserError, pd.errors.ParserWarning) as error:
        raise InputRefused(file.path, "table", f"cannot be read: {error}", "export the take again") from None
    return table.dropna(how="all")


def _numbers(table: pd.DataFrame, columns: list[int], header: Header, path: Path) -> Floats:
    part = np.column_stack([as_numbers(table[c]) for c in columns])
    bad = np.isnan(part) & table[columns].notna().to_numpy()
    if bad.any():
        row, col = np.argwhere(bad)[0]
        line = header.table_row + 2 + int(table.index[row])
        cell = table[columns[col]].iloc[row]
        raise InputRefused(
            path, f"line {line}, column {columns[col] + 1}", f"{cell!r} is no number", "export the take again"
        )
    return part


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


def _pose_columns(header: Header, body: str, path: Path) -> tuple[dict[str, int], dict[str, int]]:
    """Position and rotation columns by axis."""
    position, rotation = header.columns(body, "Position"), header.columns(body, "Rotation")
    if set(position) != set("XYZ") or set(rotation) not in ({*"XYZ"}, {*"XYZW"}):
        raise InputRefused(path, f"rigid body {body!r}", "lacks rotation or position columns", "export both")
    return position, rotation


def _poorly_solved(header: Header, body: str, table: pd.DataFrame, scale: float, path: Path) -> npt.NDArray[np.bool_]:
    """Where the mean marker error is so large, or so exactly zero, that the pose was not measured (N,)."""
    columns = [i for name in ("Mean Marker Error", "Marker Error") for i in header.columns(body, name).values()]
    if not columns:
        return np.zeros(len(table), dtype=bool)
    error = scale * _numbers(table, columns[:1], header, path)[:, 0]
    known = error[np.isfinite(error)]
    limit = max(MARKER_ERROR_M, MARKER_FACTOR * float(np.median(known))) if len(known) else np.inf
    zero = error == 0.0  # exactly: solved by interpolation, unless the errors are so small as written
    filled = zero & (zero.mean() < RARE) & (np.median(known) > 0.0) if len(known) else False
    return np.asarray((error > limit) | filled)


def _yaw(
    header: Header, turn: Floats, vehicle: Vehicle, time_s: Floats, path: Path
) -> tuple[Floats, list[Irregularity]]:
    """Yaw (N,) of quaternions (N, 4) or Euler angles in degrees (N, 3), and what was odd."""
    if turn.shape[1] == 4:
        return judged_yaw(turn, vehicle.mocap.up_axis, time_s, path)
    low, high = np.nanmin(turn, axis=0, initial=0.0), np.nanmax(turn, axis=0, initial=0.0)
    if max(-low.min(), high.max()) <= np.pi and ((low < -WRAPS_AT) & (high > WRAPS_AT)).any():
        cause = "the angles fill -3.14 to 3.14: radians, where Motive writes degrees"
        raise InputRefused(path, "rotation", cause, "export the take again, with quaternions")
    order = rotation_order(header, path)
    odd = []
    if "Rotation Type" not in header.keys:
        odd = [Irregularity("rotation order", "warning", 1, path.name, f"the header names none: {order} is assumed")]
    yaw, turns = judged_yaw(quaternions_of_euler(turn, order), vehicle.mocap.up_axis, time_s, path)
    # signs of quaternions that nobody wrote say nothing
    return yaw, [*odd, *(i for i in turns if i.kind != "quaternion sign")]


def read_poses(path: Path, vehicle: Vehicle) -> RawTake:
    """The poses of the vehicle's rigid body in a Motive export, with no commands (M = 0).

    Raises:
        InputRefused: with the line and the reason, where the export cannot be used.
    """
    source, file = source_of(path, "motive-csv"), read_text(path)
    header, problems = read_header(file), Problems()
    with problems.gathered():
        global_space(header, path)
    with problems.gathered():
        rate, odd_rate = frame_rate(header, path)
    with problems.gathered():
        scale = metres(header, vehicle, path)
    with problems.gathered():
        clock = time_column(header, path)
    with problems.gathered():
        body = choose_body(header, vehicle.mocap.rigid_body, path)
        position, rotation = _pose_columns(header, body, path)
        if "W" not in rotation:
            rotation_order(header, path)
    problems.refuse(path)
    table = _table(file, header)
    if table.empty:
        raise InputRefused(path, f"line {header.table_row + 2}", "no frame follows the header", "export the take again")
    frames, stated = _numbers(table, [0, clock], header, path).T
    time_s = _times(frames, stated, rate, path, header)
    world = scale * _numbers(table, [position[a] for a in "XYZ"], header, path)
    turn = _numbers(table, [rotation[a] for a in "XYZW" if a in rotation], header, path)
    check_up_axis(world, vehicle.mocap.up_axis, path)
    floor = on_floor(world, vehicle.mocap.up_axis)
    yaw, turns = _yaw(header, turn, vehicle, time_s, path)
    up, lifts = off_the_floor(floor, world[:, "XYZ".index(vehicle.mocap.up_axis)], time_s)
    poor = _poorly_solved(header, body, table, scale, path)
    pose = np.column_stack([floor, yaw])
    pose[up | poor] = np.nan
    odd = [*file.odd, *odd_rate, *_missing(header, len(table), path), *turns, *lifts]
    if poor.any():
        text = "the mean marker error is far above the usual, or exactly zero: not measured"
        odd.append(Irregularity("marker error", "excluded", int(poor.sum()), path.name, text))
    return RawTake(path.stem, (source,), time_s, pose, np.empty(0), np.empty((0, 2)), rate, {}, tuple(odd))


def read_motive(path: Path, vehicle: Vehicle, commands: Path) -> RawTake:
    """A Motive export with its commands file; what is wrong with either is told at once."""
    problems = Problems()
    with problems.gathered():
        poses = read_poses(path, vehicle)
    with problems.gathered():
        source, time_s, command, channels, odd = read_commands(commands)
    problems.refuse(path)
    return RawTake(
        poses.name, (*poses.sources, source), poses.pose_time_s, poses.pose, time_s, command,
        poses.rate_hz, channels, (*poses.irregularities, *odd),
    )  # fmt: skip
