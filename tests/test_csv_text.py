"""CSV files as editors, cameras and crashes leave them: read as they mean it, or refused with the place."""

from __future__ import annotations

import os
import pickle
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from bcid.errors import InputRefused
from bcid.mapping import FieldMapping
from bcid.recording.formats.csv_text import read_csv_text
from bcid.recording.formats.raw import map_field
from bcid.recording.read import read_raw_take
from bcid.vehicle import Vehicle, read_vehicle


def changed(take: Path, folder: Path, change: Callable[[bytes], bytes]) -> Path:
    """A copy of a Motive export whose bytes went through `change`, with its commands."""
    path = folder / "drive.csv"
    path.write_bytes(change(take.read_bytes()))
    path.with_suffix(".commands.csv").write_bytes(take.with_suffix(".commands.csv").read_bytes())
    return path


def kinds(path: Path, vehicle: Vehicle) -> dict[str, int]:
    return {i.kind: i.count for i in read_raw_take(path, vehicle).irregularities}


def semicolons(data: bytes) -> bytes:
    return data.replace(b",", b";").replace(b".", b",")


def cell(data: bytes, line: int, column: int, text: bytes) -> bytes:
    lines = data.split(b"\n")
    cells = lines[line].split(b",")
    cells[column] = text
    lines[line] = b",".join(cells)
    return b"\n".join(lines)


SAME: dict[str, tuple[Callable[[bytes], bytes], str | None]] = {
    "UTF-8 with a mark": (lambda d: b"\xef\xbb\xbf" + d, None),
    "UTF-16 by its mark": (lambda d: d.decode().encode("utf-16"), "encoding"),
    "decimal commas": (semicolons, "CSV dialect"),
    "old line ends": (lambda d: d.replace(b"\r\n", b"\n").replace(b"\n", b"\r"), None),
    "NUL bytes behind the end": (lambda d: d + bytes(64), "cut file"),
    "a last line without an end": (lambda d: d.rstrip(), "cut file"),
}


@pytest.mark.parametrize("name", SAME)
def test_other_bytes_of_the_same_table_are_the_same_take(
    name: str, takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path
) -> None:
    change, kind = SAME[name]
    clean, path = read_raw_take(takes["motive"], vehicle), changed(takes["motive"], tmp_path, change)
    np.testing.assert_array_equal(read_raw_take(path, vehicle).pose, clean.pose)
    assert set(kinds(path, vehicle)) - set(kinds(takes["motive"], vehicle)) == ({kind} if kind else set())


REFUSED: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "Latin-1": (lambda d: d.replace(b"simulated by", b"gr\xfcn by", 1), r"byte \d+: is not UTF-8 \(0xfc\)"),
    "NUL bytes inside": (lambda d: d[:20000] + bytes(8) + d[20008:], r"line \d+: holds NUL bytes"),
    "two takes in one file": (lambda d: d + d, r"line \d+: a second header"),
    "commas and points": (lambda d: semicolons(d).replace(b"0,016667;", b"0.016667;", 1), "decimal comma and with a"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_told_is_refused_with_its_place(
    name: str, takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path
) -> None:
    change, says = REFUSED[name]
    with pytest.raises(InputRefused, match=says):
        read_raw_take(changed(takes["motive"], tmp_path, change), vehicle)


def test_the_second_header_is_found_at_its_line(takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    lines = takes["motive"].read_bytes().count(b"\n")
    path = changed(takes["motive"], tmp_path, lambda d: d + d)
    with pytest.raises(InputRefused) as error:
        read_raw_take(path, vehicle)
    assert error.value.place == f"line {lines + 1}"


@pytest.mark.parametrize("cut", [5, 12, 30])
def test_a_row_that_the_end_of_the_file_cuts_is_left_out_and_told(
    cut: int, takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path
) -> None:
    path = changed(takes["motive"], tmp_path, lambda d: d.rstrip()[:-cut])
    found, clean = read_raw_take(path, vehicle), read_raw_take(takes["motive"], vehicle)
    np.testing.assert_array_equal(found.pose, clean.pose[:-1])
    assert kinds(path, vehicle)["cut file"] == 1


def test_a_last_line_without_an_end_is_kept_where_nothing_says_that_it_is_cut(
    takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path
) -> None:
    """As people write commands: digits as they come, and no line end behind the last row."""
    path = changed(takes["motive"], tmp_path, bytes)
    commands = path.with_suffix(".commands.csv")
    rows = [line.split(",") for line in commands.read_text().splitlines()]
    commands.write_text("\n".join([",".join(rows[0]), *(",".join(f"{float(c):g}" for c in row) for row in rows[1:])]))
    assert len(read_raw_take(path, vehicle).command) == len(rows) - 1
    assert kinds(path, vehicle)["cut file"] == 1


@pytest.mark.parametrize("text", [b"nan", b"NaN", b"-nan(ind)", b"1.#INF", b"-1.#IND", b"1.#QNAN", b"inf", b"1e400"])
def test_no_number_is_told_from_a_blank(text: bytes, takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    found = read_raw_take(changed(takes["motive"], tmp_path, lambda d: cell(d, 50, 6, text)), vehicle)
    assert np.isinf(found.pose[43, 0])
    blank = read_raw_take(changed(takes["motive"], tmp_path, lambda d: cell(d, 50, 6, b"")), vehicle)
    assert np.isnan(blank.pose[43, 0])


def test_all_that_is_wrong_with_a_header_is_told_at_once(
    takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path
) -> None:
    def change(data: bytes) -> bytes:
        data = data.replace(b"Length Units,Meters", b"Length Units,Furlongs").replace(b"bumper_car", b"bumper_cat")
        return re.sub(rb"Coordinate Space,\w+", b"Coordinate Space,Local", data)

    with pytest.raises(InputRefused) as error:
        read_raw_take(changed(takes["motive"], tmp_path, change), vehicle)
    for word in ("Furlongs", "bumper_cat", "Global"):
        assert word in error.value.cause
    assert error.value.next_step.count(";") >= 2


def test_what_is_wrong_with_an_export_and_with_its_commands_is_told_at_once(
    takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path
) -> None:
    path = changed(takes["motive"], tmp_path, lambda d: d.replace(b"Length Units,Meters", b"Length Units,Furlongs"))
    beside = path.with_suffix(".commands.csv")
    beside.write_bytes(beside.read_bytes().replace(b"throttle_mps", b"gas"))
    with pytest.raises(InputRefused) as error:
        read_raw_take(path, vehicle)
    assert error.value.source == str(path)
    assert "Furlongs" in error.value.cause
    assert f"\n{beside}: column 'throttle_mps': is not in the file" in str(error.value)
    assert {p.source for p in error.value.problems} == {str(path), str(beside)}
    assert str(pickle.loads(pickle.dumps(error.value))) == str(error.value)  # noqa: S301  # from a worker


def test_all_columns_that_hold_text_are_told_at_once(takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    path = changed(takes["motive"], tmp_path, bytes)
    commands = path.with_suffix(".commands.csv")
    lines = commands.read_text().splitlines()
    lines[3] = lines[3].split(",")[0] + ",left,fast"
    commands.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputRefused) as error:
        read_raw_take(path, vehicle)
    assert "'left'" in error.value.cause
    assert "'fast'" in error.value.cause
    assert error.value.place.count("data row 3") == 2


def test_a_decimal_comma_between_commas_is_refused(takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    path = changed(takes["motive"], tmp_path, bytes)
    commands = path.with_suffix(".commands.csv")
    commands.write_text(commands.read_text().replace(".", ","))
    with pytest.raises(InputRefused, match="decimal comma"):
        read_raw_take(path, vehicle)


def test_separators_are_told_by_the_first_lines(tmp_path: Path) -> None:
    for separator, decimal in ((",", "."), (";", "."), (";", ","), ("\t", ".")):
        rows = [["t", "a", "b"], *([str(k), f"{k}{decimal}5", f"-{k}{decimal}25"] for k in range(5))]
        path = tmp_path / "t.csv"
        path.write_text("".join(separator.join(row) + "\n" for row in rows))
        found = read_csv_text(path)
        assert (found.separator, found.decimal) == (separator, decimal)


def test_what_is_no_number_stays_none_through_a_mapping_with_bounds() -> None:
    field = FieldMapping.model_validate({"from": "u", "gain": 2.0, "low": -1.0, "high": 1.0, "dead_zone": 0.1})
    raw = np.array([np.inf, -np.inf, np.nan, 0.05, 0.3, 9.0, -9.0])
    found = map_field(field, lambda name: raw)
    assert np.isinf(found[:2]).all()
    assert np.isnan(found[2])
    np.testing.assert_allclose(found[3:], [0.0, 0.4, 1.0, -1.0])


def test_a_calibrated_servo_is_read_off_between_its_points() -> None:
    given = {"from": "u", "points": [[-1.0, -0.4], [0.0, 0.0], [0.5, 0.25], [1.0, 0.3]], "offset": 0.01}
    raw = np.array([-2.0, -0.5, 0.25, 0.75, 3.0, np.nan])
    found = map_field(FieldMapping.model_validate(given), lambda name: raw)
    np.testing.assert_allclose(found, np.array([-0.4, -0.2, 0.125, 0.275, 0.3, np.nan]) + 0.01)


def test_commands_of_a_calibrated_servo_are_raw_ones() -> None:
    """So that a diagnosis may correct their gain."""
    car = {"name": "car", "body": {"cog_to_front_m": 0.1, "cog_to_rear_m": 0.1}, "steering": {"max_angle_rad": 0.4}}
    columns = {"time_s": "t", "x_m": "x", "y_m": "y", "yaw_rad": "yaw", "throttle_mps": "u"}
    points = {"from": "servo", "points": [[-1.0, -0.4], [1.0, 0.3]]}
    assert Vehicle.model_validate(car | {"columns": columns | {"steering_rad": points}}).has_raw_steering
    assert not Vehicle.model_validate(car | {"columns": columns | {"steering_rad": "servo"}}).has_raw_steering


@pytest.mark.parametrize(
    "wrong",
    [{"points": [[0.0, 0.0]]}, {"points": [[0.0, 0.0], [0.0, 0.1]]}, {"points": [[0.0, 0.0], [1.0, 0.1]], "gain": 2.0}],
)
def test_points_that_say_nothing_or_two_things_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError, match="points"):
        FieldMapping.model_validate({"from": "u", **wrong})


def test_a_pipe_in_place_of_a_vehicle_file_is_refused(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "car.toml")
    with pytest.raises(InputRefused, match="regular file"):
        read_vehicle(tmp_path / "car.toml")
