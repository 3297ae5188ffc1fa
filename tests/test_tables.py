"""Tables as loggers, spreadsheets and tracking programs write them: read as they mean it, or refused with the place."""

from __future__ import annotations

import datetime as dt
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from bcid.errors import InputRefused, UsageError
from bcid.recording.formats.raw import RawTake
from bcid.recording.read import read_raw_take
from bcid.vehicle import Vehicle

CAR = {"name": "car", "body": {"cog_to_front_m": 0.54, "cog_to_rear_m": 0.33}, "steering": {"max_angle_rad": 2.0}}
COLUMNS = {"time_s": "t", "x_m": "x", "y_m": "y", "yaw_rad": "w", "steering_rad": "s", "throttle_mps": "u"}
N = 300
T = np.arange(N) / 100.0
YAW = 0.6 * T
POSE = np.column_stack([np.sin(YAW) / 0.6, (1.0 - np.cos(YAW)) / 0.6, YAW])
HEAD = "t,x,y,w,s,u\n"


def row(k: int) -> str:
    """A row of the plain table."""
    x, y, yaw = POSE[k]
    return f"{T[k]:.2f},{x:.6f},{y:.6f},{yaw:.6f},-0.5,1.25"


def table(write: Callable[[int], str] = row, head: str = HEAD) -> str:
    """A table whose rows `write` writes."""
    return head + "".join(write(k) + "\n" for k in range(N))


def vehicle_of(**more: Any) -> Vehicle:
    """The car whose tables have the columns of `COLUMNS`, with other parts of its vehicle file."""
    return Vehicle.model_validate({**CAR, "columns": COLUMNS, **more})


def read(folder: Path, text: str | bytes, name: str = "drive.csv", **more: Any) -> RawTake:
    """What is read of a file with this content."""
    (folder / name).write_bytes(text.encode() if isinstance(text, str) else text)
    return read_raw_take(folder / name, vehicle_of(**more))


def kinds(take: RawTake) -> set[tuple[str, str]]:
    """The action and the kind of what is noted."""
    return {(i.action, i.kind) for i in take.irregularities}


def plain_cells(k: int) -> list[str]:
    """The cells of a plain row."""
    return row(k).split(",")


def fortran(cell: str) -> str:
    """A number as Fortran writes it."""
    return f"{float(cell):.9E}".replace("E", "D")


def grouped(cell: str) -> str:
    """A number with groups of three digits."""
    return f'"{float(cell):,.6f}"'


LAYOUTS: dict[str, tuple[str, set[tuple[str, str]]]] = {
    "sep=, first": (f"sep=,\n{table()}", {("fixed", "CSV dialect")}),
    "lines above the header": (f"Logger: run 7\nDate: 4 May 2026\n\n{table()}", {("fixed", "preamble")}),
    "a row of units": (table(head=HEAD + "s,m,m,rad,rad,m/s\n"), {("fixed", "units row")}),
    "units in brackets": (table(head=HEAD + "[s],[m],[m],[rad],[rad],[m/s]\n"), {("fixed", "units row")}),
    "two header rows": (table(head=",car,,,command,\n" + HEAD), set()),
    "blanks behind names": (table(head="t , x,\ty ,w,s, u\n"), set()),
    "quoted names": (table(head='"t","x","y","w","s","u"\n'), set()),
    "blanks between cells": (table(lambda k: row(k).replace(",", "   "), "t x  y w s u\n"), {("fixed", "CSV dialect")}),
    "a commented header": (table(head="# made by hand\n# t,x,y,w,s,u\n"), set()),
    "comment lines": (
        table(lambda k: ("# lap\n" if k % 50 == 9 else "") + row(k)), {("fixed", "comment")},
    ),
    "a comma behind each row": (table(lambda k: row(k) + ","), set()),
    "text before the numbers": (table(lambda k: f"car,{row(k)}", f"name,{HEAD}"), set()),
    "a quoted note with a line end": (
        table(lambda k: row(k) + (',"a, b\nc"' if k == 5 else ',"ok"'), HEAD.replace("\n", ",note\n")), set(),
    ),
    "an inch sign in a note": (table(lambda k: row(k) + ',tape 5"', HEAD.replace("\n", ",note\n")), set()),
    "semicolons and decimal commas": (table().replace(",", ";").replace(".", ","), {("fixed", "CSV dialect")}),
    "tabs and decimal commas": (table().replace(",", "\t").replace(".", ","), {("fixed", "CSV dialect")}),
    "decimal commas in quotes": (
        table(lambda k: ",".join(f'"{c.replace(".", ",")}"' for c in plain_cells(k))),
        {("fixed", "number notation"), ("fixed", "stamp notation")},
    ),
    "Fortran's exponents": (
        table(lambda k: ",".join(fortran(c) for c in plain_cells(k))),
        {("fixed", "number notation"), ("fixed", "stamp notation")},
    ),
    "typographic minus signs": (table().replace("-", "\N{MINUS SIGN}"), {("fixed", "number notation")}),
    "groups of three digits": (
        table(lambda k: ",".join([grouped(str(T[k] + 1000.0)), *plain_cells(k)[1:]])), {("fixed", "stamp notation")},
    ),
    "German groups": (
        table(
            lambda k: ";".join([f"1.000,{k:03d}", *(c.replace(".", ",") for c in plain_cells(k)[1:])]), "t;x;y;w;s;u\n"
        ),
        {("fixed", "CSV dialect"), ("fixed", "stamp notation")},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", list(LAYOUTS))
def test_a_table_in_another_layout_is_the_same_take(name: str, tmp_path: Path) -> None:
    text, noted = LAYOUTS[name]
    take = read(tmp_path, text)
    np.testing.assert_allclose(take.pose, POSE, atol=1e-6)
    np.testing.assert_allclose(take.command, np.tile([-0.5, 1.25], (N, 1)))
    scale = 0.1 if name == "German groups" else 1.0
    np.testing.assert_allclose(take.pose_time_s, scale * T, atol=1e-9)
    assert kinds(take) == noted


def changed(k: int, column: int, cell: str, only: int | None = None) -> str:
    """A row with another cell, or the plain one beside the row `only`."""
    cells = plain_cells(k)
    if only in (None, k):
        cells[column] = cell
    return ",".join(cells)


REFUSED: dict[str, tuple[str, str, str]] = {
    "TRUE in a column": (table(lambda k: changed(k, 5, "TRUE")), "column 'u'.*'True' is no number", "log 0 and 1"),
    "true in a cell": (table(lambda k: changed(k, 5, "true", 7)), "row 8, column 'u'.*'true'", "log 0 and 1"),
    "underscores": (table(lambda k: changed(k, 5, "0_1.5")), "'0_1.5' is no number", "without underscores"),
    "percent signs": (table(lambda k: changed(k, 5, "50 %")), "'50 %' is no number", "gain = 0.01"),
    "units in cells": (table(lambda k: changed(k, 4, "0.5 rad")), "'0.5 rad' is no number", "without their unit"),
    "a narrow spreadsheet": (table(lambda k: changed(k, 1, "####", 9)), "row 10, column 'x'", "too narrow"),
    "commas that may be either": (table(lambda k: changed(k, 5, '"1,234"')), "'1,234' is no number", "decimal mark"),
    "a column twice": (table(lambda k: row(k) + ",1", "t,x,y,w,s,u,x\n"), "'x': is there twice", "apart"),
    "a column without a name": (table(lambda k: f"{k},{row(k)}"), "6 column names, and rows of 7", "above every"),
    "no header": (table(head=""), "no header", '#1'),
    "a row cut, in a table with quotes": (
        table(lambda k: row(k)[:20] if k == 99 else row(k) + ',"ok"', HEAD.replace("\n", ",note\n")),
        "line 101: holds 3 cells where rows have 7", "export the file again",
    ),
    "two rows in one": (table(lambda k: row(k) + row(k + 1) if k == 99 else row(k)), "line 101: holds 11 cells", ""),
    "a quotation mark that swallows rows": (
        table(lambda k: row(k) + (',"n' if k == 50 else ',n"' if k == N - 1 else ",n"), HEAD.replace("\n", ",note\n")),
        "line 52: a quotation mark opens a cell that runs over 249 more rows", "remove that mark",
    ),
    "a quotation mark that swallows the next row": (
        table(lambda k: row(k) + (',"n' if k in (50, 51) else ",n"), HEAD.replace("\n", ",note\n")),
        "line 52: a quotation mark", "remove that mark",
    ),
    "a quotation mark in the last row": (
        table(lambda k: row(k) + (',"n' if k == N - 1 else ",n"), HEAD.replace("\n", ",note\n")),
        "line 301: a quotation mark is never closed", "remove that mark",
    ),
    "units that the mapping does not state": (
        table(head=HEAD + "ms,mm,m,deg,rad,m/s\n"), "is in mm by the row of units", "gain = 0.001",
    ),
    "stamps in no notation": (table(lambda k: changed(k, 0, f"frame {k}")), "'frame 0' is no stamp", "ISO|dates such"),
}  # fmt: skip


@pytest.mark.parametrize("name", list(REFUSED))
def test_what_is_not_plain_is_refused_with_the_next_step(name: str, tmp_path: Path) -> None:
    text, cause, step = REFUSED[name]
    with pytest.raises(InputRefused, match=cause) as error:
        read(tmp_path, text)
    assert any(word in error.value.next_step for word in step.split("|"))


def clock(k: int, start_s: float) -> str:
    """A clock time of the row k of a take that begins at `start_s`."""
    s = (start_s + T[k]) % 86_400
    return f"{int(s // 3600):02d}:{int(s // 60 % 60):02d}:{s % 60:06.3f}"


STAMPS: dict[str, tuple[Callable[[int], str], str]] = {
    "Unix time": (lambda k: f"{1_780_000_000 + T[k]:.3f}", ""),
    "Unix time in ms": (lambda k: f"{1_780_000_000_000 + 10 * k}", "ms since 1970"),
    "Unix time in ns": (lambda k: f"{1_780_000_000_000_000_000 + 10_000_000 * k}", "ns since 1970"),
    "RFC 3339": (lambda k: f"2026-05-04T{clock(k, 5e4)}Z", ""),
    "ISO 8601 with a zone": (lambda k: f"2026-05-04 {clock(k, 5e4)}+02:00", ""),
    "local time": (lambda k: f"2026-05-04 {clock(k, 5e4)}", ""),
    "a clock": (lambda k: clock(k, 5e4), ""),
    "a clock past midnight": (lambda k: clock(k, 86_399.0), "midnight"),
    "seconds of the day past midnight": (lambda k: f"{(86_399.0 + T[k]) % 86_400:.2f}", "midnight"),
    "the end of summer time": (
        lambda k: f"2026-10-25 {clock(k, 3 * 3600 - 1.0 - (3600 if k >= 100 else 0))}", "summer time",
    ),
    "day and month in some order": (lambda k: f"04/05/2026 {clock(k, 5e4)}", ""),
    "a pair in a cell": (lambda k: f"\"{{'secs': {1_780_000_000 + k // 100}, 'nsecs': {k % 100 * 10_000_000}}}\"", ""),
}  # fmt: skip


@pytest.mark.parametrize("name", list(STAMPS))
def test_stamps_in_other_notations_are_the_same_times(name: str, tmp_path: Path) -> None:
    write, note = STAMPS[name]
    take = read(tmp_path, table(lambda k: changed(k, 0, write(k))))
    np.testing.assert_allclose(take.pose_time_s, T, atol=1e-6)
    assert any(note in i.detail for i in take.irregularities) == bool(note)
    assert {i.action for i in take.irregularities} <= {"fixed"}


@pytest.mark.parametrize("names", [("t.sec", "t.nanosec"), ("t_secs", "t_nsecs"), ("t.seconds", "t.nanos")])
def test_two_columns_of_a_stamp_are_found(names: tuple[str, str], tmp_path: Path) -> None:
    def write(k: int) -> str:
        return f"{1_780_000_000 + k // 100},{k % 100 * 10_000_000},{row(k).partition(',')[2]}"

    head = f"{','.join(names)},x,y,w,s,u\n"
    take = read(tmp_path, table(write, head))
    np.testing.assert_allclose(take.pose_time_s, T, atol=1e-9)
    mapped = {**COLUMNS, "time_s": {"sec": names[0], "nanosec": names[1]}}
    np.testing.assert_allclose(read(tmp_path, table(write, head), columns=mapped).pose_time_s, T, atol=1e-9)


@pytest.mark.parametrize("wrong", ["1500000000", "-5", "1000000000", "half"])
@pytest.mark.parametrize("in_a_cell", [False, True])
def test_nanoseconds_that_are_no_part_of_a_second_are_refused(wrong: str, in_a_cell: bool, tmp_path: Path) -> None:
    def write(k: int) -> str:
        sec, part = str(1_780_000_000 + k // 100), wrong if k == 7 else str(k % 100 * 10_000_000)
        stamp = f"\"{{'sec': {sec}, 'nanosec': {part}}}\"" if in_a_cell else f"{sec},{part}"
        return f"{stamp},{row(k).partition(',')[2]}"

    head = HEAD if in_a_cell else "t.sec,t.nanosec,x,y,w,s,u\n"
    # a text that begins otherwise is no pair at all
    place = r"data row \d+" if in_a_cell and not wrong.isdigit() else "data row 8"
    with pytest.raises(InputRefused, match=rf"{place}, column 't.*is no stamp"):
        read(tmp_path, table(write, head))


def test_rows_of_their_own_are_no_dropouts(tmp_path: Path) -> None:
    """As an outer join of poses at 100 Hz, steering at 10 Hz and throttle at 10 Hz between them."""

    def write(k: int) -> str:
        pose = ",".join([*plain_cells(k)[:4], "", ""])
        late = [f"{T[k] + 0.003:.3f},,,,{0.01 * k:.2f},", f"{T[k] + 0.006:.3f},,,,,1.25"] if k % 10 == 0 else []
        return "\n".join([pose, *late])

    take = read(tmp_path, table(write))
    np.testing.assert_allclose(take.pose, POSE, atol=1e-6)
    assert len(take.command) == 2 * N // 10 - 1
    np.testing.assert_allclose(take.command[0], [0.0, 1.25])
    np.testing.assert_allclose(take.command[1:3], [[0.1, 1.25], [0.1, 1.25]])
    assert take.command_time_s[1] == pytest.approx(0.103)


def test_blank_poses_among_full_rows_stay_dropouts(tmp_path: Path) -> None:
    take = read(tmp_path, table(lambda k: f"{T[k]:.2f},,,,-0.5,1.25" if 50 <= k < 60 else row(k)))
    assert len(take.pose) == N
    assert np.isnan(take.pose[50:60]).all()


@pytest.mark.parametrize(("up_axis", "unit"), [("Y", "mm"), ("Z", "cm"), ("Z", "m")])
def test_positions_in_space_have_the_unit_and_vertical_of_the_vehicle_file(
    up_axis: str, unit: str, tmp_path: Path
) -> None:
    size = {"m": 1.0, "cm": 100.0, "mm": 1000.0}[unit]
    x, y, yaw = POSE.T
    half = yaw / 2
    zero = np.zeros(N)
    place = [x, zero + 0.4, -y] if up_axis == "Y" else [x, y, zero + 0.4]
    turn = [zero, np.sin(half), zero, np.cos(half)] if up_axis == "Y" else [zero, zero, np.sin(half), np.cos(half)]
    values = np.column_stack([T, size * np.column_stack(place), *turn, zero - 0.5, zero + 1.25])
    text = "t,x,y,z,qx,qy,qz,qw,s,u\n" + "".join(",".join(f"{v:.9f}" for v in r) + "\n" for r in values)
    columns = {**COLUMNS, "z_m": "z", **{q: q for q in ("qx", "qy", "qz", "qw")}}
    del columns["yaw_rad"]
    take = read(tmp_path, text, columns=columns, mocap={"up_axis": up_axis, "length_unit": unit})
    np.testing.assert_allclose(take.pose, POSE, atol=1e-6)


def test_a_length_unit_and_a_gain_are_not_both_applied(tmp_path: Path) -> None:
    columns = {**COLUMNS, "x_m": {"from": "x", "gain": 0.001}}
    text = table(lambda k: f"{T[k]:.2f},{1e3 * POSE[k, 0]:.6f},{1e3 * POSE[k, 1]:.6f},{POSE[k, 2]:.6f},-0.5,1.25")
    take = read(tmp_path, text, columns=columns, mocap={"length_unit": "mm"})
    np.testing.assert_allclose(take.pose, POSE, atol=1e-6)


# --- commands in a file of their own -------------------------------------------------------------------------------


def poses_alone(folder: Path, commands: str, **mapped: Any) -> RawTake:
    """A table of poses with Unix times, and the commands beside it, which `mapped` maps."""
    columns = {k: v for k, v in COLUMNS.items() if k not in ("steering_rad", "throttle_mps")}
    (folder / "drive.commands.csv").write_text(commands)
    text = table(lambda k: f"{1_780_000_000 + T[k]:.3f},{','.join(plain_cells(k)[1:4])}", "t,x,y,w\n")
    return read(folder, text, columns=columns, commands=mapped)


def test_a_commands_file_beside_a_table_shares_its_clock(tmp_path: Path) -> None:
    rows = "".join(f"{1_780_000_000 + 0.1 * k:.1f},-0.5,1.25\n" for k in range(30))
    take = poses_alone(tmp_path, f"time_s,steering_rad,throttle_mps\n{rows}")
    np.testing.assert_allclose(take.command_time_s, 0.1 * np.arange(30), atol=1e-6)


def test_a_commands_file_of_another_clock_is_refused_and_then_placed(tmp_path: Path) -> None:
    rows = "".join(f"14:15:{30 + 0.1 * k:06.3f},-0.5,1.25\n" for k in range(30))
    text = f"time_s,steering_rad,throttle_mps\n{rows}"
    with pytest.raises(InputRefused, match="another kind") as error:
        poses_alone(tmp_path, text)
    assert 'time_zero = "14:15:30.000"' in error.value.next_step
    take = poses_alone(tmp_path, text, time_zero="14:15:30.000")
    np.testing.assert_allclose(take.command_time_s, 0.1 * np.arange(30), atol=1e-6)


def test_a_table_without_commands_says_where_they_may_be(tmp_path: Path) -> None:
    columns = {k: v for k, v in COLUMNS.items() if k not in ("steering_rad", "throttle_mps")}
    with pytest.raises(InputRefused, match="maps no commands") as error:
        read(tmp_path, table(), columns=columns)
    assert "NAME.commands.csv" in error.value.next_step


def test_a_table_with_commands_takes_no_other_ones(tmp_path: Path) -> None:
    (tmp_path / "drive.csv").write_text(table())
    (tmp_path / "more.csv").write_text("time_s,steering_rad,throttle_mps\n0,0,0\n")
    with pytest.raises(UsageError, match="holds its own commands"):
        read_raw_take(tmp_path / "drive.csv", vehicle_of(), tmp_path / "more.csv")


# --- Parquet -------------------------------------------------------------------------------------------------------


def parquet(folder: Path, change: dict[str, Any] | None = None, **how: Any) -> Path:
    """The table as Parquet, with other columns by name."""
    columns: dict[str, Any] = dict(zip("txyw", [T, *POSE.T], strict=True))
    columns |= {"s": np.full(N, -0.5), "u": np.full(N, 1.25), **(change or {})}
    pq.write_table(pa.table(columns), folder / "drive.parquet", **{"write_page_checksum": True, **how})
    return folder / "drive.parquet"


START = dt.datetime(2026, 5, 4, 14, 15)
TIMES = [START + dt.timedelta(seconds=float(t)) for t in T]
TYPES: dict[str, dict[str, Any]] = {
    "as it is": {},
    "float32": {"w": pa.array(POSE[:, 2], pa.float32())},
    "decimals": {"x": pa.array([Decimal(f"{x:.6f}") for x in POSE[:, 0]], pa.decimal128(9, 6))},
    "text": {"x": pa.array([f"{x:.6f}" for x in POSE[:, 0]])},
    "a dictionary of text": {"x": pa.array([f"{x:.6f}" for x in POSE[:, 0]]).dictionary_encode()},
    "Unix ns": {"t": pa.array([1_780_000_000_000_000_000 + 10_000_000 * k for k in range(N)], pa.uint64())},
    "timestamps": {"t": pa.array(TIMES, pa.timestamp("ms"))},
    "timestamps with a zone": {"t": pa.array(TIMES, pa.timestamp("us", tz="Europe/Berlin"))},
    "durations": {"t": pa.array([dt.timedelta(seconds=float(t)) for t in T], pa.duration("us"))},
    "clock times": {"t": pa.array([t.time() for t in TIMES], pa.time64("us"))},
}


@pytest.mark.parametrize("name", list(TYPES))
def test_parquet_types_are_the_same_take(name: str, tmp_path: Path) -> None:
    take = read_raw_take(parquet(tmp_path, TYPES[name]), vehicle_of())
    np.testing.assert_allclose(take.pose, POSE, atol=1e-6)
    np.testing.assert_allclose(take.pose_time_s, T, atol=1e-6)
    assert {i.kind for i in take.irregularities} <= {"stamp notation"}


def test_columns_inside_a_structure_are_named_by_their_path(tmp_path: Path) -> None:
    place = pa.array([{"place": {"x": x, "y": y}} for x, y in POSE[:, :2]])
    columns = {**COLUMNS, "x_m": "pose.place.x", "y_m": "pose.place.y"}
    take = read_raw_take(parquet(tmp_path, {"pose": place}), vehicle_of(columns=columns))
    np.testing.assert_allclose(take.pose, POSE, atol=1e-12)


@pytest.mark.parametrize(
    ("column", "says"),
    [
        (pa.array([True] * N), "true and false are no numbers"),
        (pa.array([[1.0]] * N), "holds list"),
        (pa.array([b"1"] * N), "holds binary"),
        (pa.array(["fast"] * N), "'fast' is no number"),
        (pa.array(["1" * 500] * N), "text of 500 bytes"),
    ],
)
def test_parquet_columns_that_are_no_numbers_are_refused_by_name(column: Any, says: str, tmp_path: Path) -> None:
    with pytest.raises(InputRefused, match=says) as error:
        read_raw_take(parquet(tmp_path, {"u": column}), vehicle_of())
    assert "'u'" in error.value.place


def test_a_parquet_column_twice_is_refused(tmp_path: Path) -> None:
    table_twice = pa.table([pa.array(T)] * 7, names=[*"txywsu", "x"])
    pq.write_table(table_twice, tmp_path / "drive.parquet")
    with pytest.raises(InputRefused, match="'x': is there twice"):
        read_raw_take(tmp_path / "drive.parquet", vehicle_of())


@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_parquet_without_page_checksums_says_so(version: str, tmp_path: Path) -> None:
    bare = read_raw_take(parquet(tmp_path, write_page_checksum=False, data_page_version=version), vehicle_of())
    assert kinds(bare) == {("warning", "integrity")}
    whole = read_raw_take(parquet(tmp_path, data_page_version=version), vehicle_of())
    assert kinds(whole) == set()
