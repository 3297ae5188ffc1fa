"""Which day each log of a fleet was driven on, and by which car: from a table, or from its name and folder."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from bcid.errors import InputRefused
from bcid.pipeline.cuts import without_cut

DATE = re.compile(r"(?<!\d)(20\d\d)[-_.]?(0[1-9]|1[0-2])[-_.]?(0[1-9]|[12]\d|3[01])(?!\d)")
"""A date with the year first, as in Take 2026-11-28 10.01.02 AM.csv."""
LOG, DAY, CAR = "log", "day", "car"


class LogLabel(NamedTuple):
    """When a log was driven, and by which car."""

    day: str  # "" where it is not known; days come in the order of their text
    car: str = ""  # "" where it is not known


def label_logs(logs: Sequence[Path], names: Sequence[str], table: Path | None = None) -> list[LogLabel]:
    """The label of each log, which is called by one of `names`.

    Without a `table` a day is the date in the log's name or in that of a folder above it, the year first; where any log
    has none, it is the folder if logs lie in several, and unknown otherwise.  The car is then unknown.

    Raises:
        InputRefused: the table cannot be read, or says nothing of a log, or of a log twice.
    """
    if table is not None:
        rows = _read_table(table)
        return [_find_row(rows, log, name, table) for log, name in zip(logs, names, strict=True)]
    files = [without_cut(log).absolute() for log in logs]
    days = [_find_date(file) for file in files]
    if not all(days):
        folders = [file.parent.name for file in files]
        days = folders if len(set(folders)) > 1 else [""] * len(files)
    return [LogLabel(day) for day in days]


def _find_date(file: Path) -> str:
    """The date in the name of a file or, nearest first, of a folder above it; "" if there is none."""
    found = (DATE.search(part) for part in reversed(file.parts))
    return next(("-".join(match.groups()) for match in found if match), "")


def _read_table(table: Path) -> dict[str, LogLabel]:
    """The labels in a CSV table, by log."""
    try:
        with table.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            rows, columns = list(reader), reader.fieldnames or ()
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputRefused(table, "labels", str(error), "name a CSV table with the columns log, day and car") from error
    if missing := [name for name in (LOG, DAY) if name not in columns]:
        cause = f"has no column {' and no column '.join(missing)}, but {', '.join(columns) or 'none at all'}"
        raise InputRefused(table, "header", cause, f"call its columns {LOG}, {DAY} and, where several drove, {CAR}")
    found = dict[str, LogLabel]()
    for number, row in enumerate(rows, start=2):
        log, day = ((row[name] or "").strip() for name in (LOG, DAY))
        if not log or not day:
            raise InputRefused(table, f"line {number}", "says no log or no day", "fill in both, or leave the line out")
        if log in found:
            raise InputRefused(table, f"line {number}", f"{log} was there before", "name each log once")
        found[log] = LogLabel(day, (row.get(CAR) or "").strip())
    return found


def _find_row(rows: dict[str, LogLabel], log: Path, name: str, table: Path) -> LogLabel:
    """The row of a log, which a table calls by its name, its file's name or its path."""
    for called in (name, log.name, str(log), log.stem):
        if called in rows:
            return rows[called]
    raise InputRefused(table, "labels", f"says nothing of {name}", f"add a line for it: {log.name}, DAY, CAR")
