"""A long run of one character, wherever it stands in a file, is read or refused in seconds: no pattern is quadratic."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path

import pandas as pd
import pytest
from test_tables import HEAD, N, T, row, table, vehicle_of

from bcid.errors import InputRefused
from bcid.files.toml import Settings, read_toml
from bcid.recording.formats.message_fields import NotANumber, parse_number
from bcid.recording.formats.message_stamps import UnreadableStamp, parse_stamp
from bcid.recording.formats.numbers import next_step_for, parse_numbers
from bcid.recording.formats.ros_encoding import BadDefinition, compile_ros_decoder
from bcid.recording.formats.stamps import parse_stamps
from bcid.recording.read import UnforeseenContent, read_raw_take

LENGTH, MOST_S = 1_000_000, 5.0
RUNS = [" ", "\t", '"', ",", "1", "-", ".", "_", "\n", "[", "{", "a", "#"]
MIDDLE = N // 2


@contextmanager
def within(most_s: float) -> Iterator[None]:
    """Context whose content may take `most_s` seconds of the processor."""
    begin = time.process_time()
    yield
    assert time.process_time() - begin < most_s


def refusal(act: Callable[[], object], *kinds: type[Exception]) -> str:
    """What is said where `act` refuses by an error of these kinds; empty where it does not."""
    try:
        act()
    except UnforeseenContent:
        raise
    except kinds as error:
        return str(error)
    return ""


def by_blanks(cell: str) -> str:
    """A table of numbers that only blanks keep apart, with a cell in its middle."""
    return table(lambda k: row(k).replace(",", " ") + (cell if k == MIDDLE else ""), HEAD.replace(",", " "))


PLACES: dict[str, Callable[[str], str]] = {
    "all of the file": lambda run: run,
    "above the names": lambda run: run + table(),
    "a name": lambda run: HEAD.strip() + run + "\n" + table().partition("\n")[2],
    "a stamp": lambda run: table(lambda k: f"{T[k]:.2f}{run if k == MIDDLE else ''},{row(k).partition(',')[2]}"),
    "a cell": lambda run: table(lambda k: row(k) + (run + "x" if k == MIDDLE else "")),
    "a row between blanks": lambda run: by_blanks(run + "x"),
    "the end": lambda run: table() + run,
}


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("sign", RUNS)
def test_a_table_is_read_or_refused_in_time(sign: str, place: str, tmp_path: Path) -> None:
    path = tmp_path / "long.csv"
    path.write_text(PLACES[place](sign * LENGTH), encoding="utf-8")
    with within(MOST_S):
        assert len(refusal(lambda: read_raw_take(path, vehicle_of()), InputRefused)) < 2000


CELLS = ["{}", "1{}x", "1.5{}x", "{}%", "2026-05-04T14:15:30{}x", "12:30:15{}x", "s=1{},ns=1"]


@pytest.mark.parametrize("sign", RUNS)
def test_a_cell_or_a_text_in_a_message_is_no_number_in_time(sign: str) -> None:
    with within(MOST_S):
        for cell in (form.format(sign * LENGTH) for form in CELLS):
            column = pd.Series(["0.5", cell, "0.25"], dtype=object)
            assert parse_numbers(column).bad_rows.tolist() in ([1], [])
            assert parse_numbers(column, ",").bad_rows.tolist() in ([1], [])
            assert parse_stamps(column).bad_rows.tolist() in ([1], [])
            next_step_for(cell)
            assert len(refusal(partial(parse_number, cell), NotANumber)) < 400
            assert len(refusal(partial(parse_stamp, cell), UnreadableStamp)) < 400


@pytest.mark.parametrize("sign", RUNS)
def test_a_definition_is_read_or_refused_in_time(sign: str) -> None:
    with within(MOST_S):
        for line in ("{}", "float64 x{}", "float64 {}!", "float64[{}] x", "===\nMSG: a{}b c"):
            with suppress(BadDefinition):
                compile_ros_decoder("a/B", line.format(sign * (LENGTH // 8)))


@pytest.mark.parametrize("sign", RUNS)
def test_a_settings_file_is_refused_in_time_and_in_few_words(sign: str, tmp_path: Path) -> None:
    path, run = tmp_path / "car.toml", sign * LENGTH
    for text in (f"a{run} = 1\n", f"a = {run}\n", f'a = "{run}"\n', f"{run}\n{run} = 1\n"):
        path.write_text(text, encoding="utf-8")
        with within(MOST_S):
            assert len(refusal(lambda: read_toml(path, Settings, "vehicle file"), InputRefused)) < 2000
