"""Which day each log of a fleet was driven on, and by which car: from a table, or from its name and folder."""

from __future__ import annotations

import csv
import os
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from bcid.errors import InputRefused
from bcid.recording.cuts import without_cut

DATE = re.compile(r"(?<!\d)(20\d\d)([-_.]?)(0[1-9]|1[0-2])\2(0[1-9]|[12]\d|3[01])(?:(?=\d{6}(?!\d))|(?!\d))")
"""A date with the year first, as in Take 2026-11-28 10.01.02 AM.csv and 20261128101502.mcap."""
LOG, DAY, CAR = "log", "day", "car"


class LogLabel(NamedTuple):
    """When a log was driven, and by which car."""

    day: str  # "" where it is not known
    car: str = ""  # "" where it is not known


class FleetLabels(NamedTuple):
    """The labels of all logs of a fleet, and its days in their order."""

    of_logs: tuple[LogLabel, ...]
    days: tuple[str, ...]
    undated: tuple[str, ...] = ()  # logs that have no date, where others do, so that no date counts

    def describe(self) -> str:
        """The days and how many logs each has, how many cars there are, and for want of which logs no date counts."""
        counts = Counter(label.day for label in self.of_logs)
        if self.days == ("",):
            text = "days unknown, all logs count as of one"
        else:
            text = "days " + ", ".join(f"{day} ({counts[day]})" for day in self.days)
        cars = {label.car for label in self.of_logs}
        text += f"; {len(cars)} cars" if cars != {""} else ""
        if not self.undated:
            return text
        more = f" ({len(self.undated)} such logs)" if len(self.undated) > 1 else ""
        return f"{text}; dates do not count, as {self.undated[0]} has none{more}"


def label_logs(logs: Sequence[Path], names: Sequence[str], table: Path | None = None) -> FleetLabels:
    """The labels of logs, which are called by `names`, and the order of their days.

    Without a `table` a day is the date in the log's name, or in that of a folder above it that not all logs share, the
    year first; where any log has none, it is the folder if logs lie in several, and unknown otherwise.  The car is then
    unknown.  Dates come in their order, other days in that of the table's lines or of the logs.

    Raises:
        InputRefused: the table cannot be read, or says nothing of a log, or of a log twice, or of two by one name.
    """
    if table is not None:
        rows = _read_table(table)
        labels = [_find_row(rows, logs, names, number, table) for number in range(len(logs))]
        lines, undated = [label.day for label in rows.values()], list[str]()
    else:
        lines, dated = _days_of_names([without_cut(log).absolute() for log in logs])
        labels = [LogLabel(day) for day in lines]
        undated = [name for name, date in zip(names, dated, strict=True) if not date] if any(dated) else []
    driven = {label.day for label in labels}
    days = [day for day in dict.fromkeys(lines) if day in driven]
    if all(DATE.fullmatch(day) for day in days):
        days.sort()
    return FleetLabels(tuple(labels), tuple(days), tuple(undated))


def _days_of_names(files: Sequence[Path]) -> tuple[list[str], list[str]]:
    """The days of logs by their names and folders, and their dates, "" where there is none."""
    shared = len(Path(os.path.commonpath([file.parent for file in files])).parts)
    dates = [_find_date(file.parts[shared:]) for file in files]
    if all(dates):
        return dates, dates
    # counted from the folder that all share: a last name, such as "run", may be that of each day's folder
    folders = ["/".join(file.parent.parts[shared:]) or file.parent.name for file in files]
    return (folders if len(set(folders)) > 1 else [""] * len(files)), dates


def _find_date(parts: Sequence[str]) -> str:
    """The date in the last of the names in a path that has one; "" if none has."""
    found = (DATE.search(part) for part in reversed(parts))
    return next((_write_date(match) for match in found if match), "")


def _write_date(match: re.Match[str]) -> str:
    """A date that was found as YYYY-MM-DD, however it was written."""
    return f"{match[1]}-{match[3]}-{match[4]}"


def _read_table(table: Path) -> dict[str, LogLabel]:
    """The labels in a CSV table, by log."""
    labels = dict[str, LogLabel]()
    try:
        with table.open(newline="", encoding="utf-8-sig") as file:
            lines = csv.reader(file, skipinitialspace=True)
            columns = _find_columns([name.strip().lower() for name in next(lines, [])], table)
            for cells in lines:
                if any(cell.strip() for cell in cells):
                    log, label = _read_line(cells, columns, f"line {lines.line_num}", table)
                    if log in labels:
                        cause = f"{log} was there before"
                        raise InputRefused(table, f"line {lines.line_num}", cause, "name each log once")
                    labels[log] = label
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputRefused(table, "labels", str(error), "name a CSV table with the columns log, day and car") from error
    return labels


def _find_columns(header: Sequence[str], table: Path) -> dict[str, int]:
    """Indices of the columns of log, day and, where it is there, car."""
    next_step = f"call its columns {LOG}, {DAY} and, where several drove, {CAR}"
    if twice := [name for name in (LOG, DAY, CAR) if header.count(name) > 1]:
        raise InputRefused(table, "header", f"has several columns {twice[0]}", next_step)
    if missing := [name for name in (LOG, DAY) if name not in header]:
        cause = f"has no column {' and no column '.join(missing)}, but {', '.join(header) or 'none at all'}"
        raise InputRefused(table, "header", cause, next_step)
    return {name: header.index(name) for name in (LOG, DAY, CAR) if name in header}


def _read_line(cells: Sequence[str], columns: dict[str, int], place: str, table: Path) -> tuple[str, LogLabel]:
    """Log and label of a line of a table."""
    said = {name: cells[i].strip() if i < len(cells) else "" for name, i in columns.items()}
    if not said[LOG] or not said[DAY]:
        raise InputRefused(table, place, "says no log or no day", "fill in both, or leave the line out")
    date = DATE.fullmatch(said[DAY])
    return said[LOG], LogLabel(_write_date(date) if date else said[DAY], said.get(CAR, ""))


def _find_row(
    rows: dict[str, LogLabel], logs: Sequence[Path], names: Sequence[str], number: int, table: Path
) -> LogLabel:
    """The label of a log, which a table calls by its name in the fleet, its path, or its file's name."""
    log, name = logs[number], names[number]
    for called in (name, str(log)):
        if called in rows:
            return rows[called]
    for short in (log.name, log.stem):
        if short not in rows:
            continue
        if sum(short in (other.name, other.stem) for other in logs) > 1:
            raise InputRefused(table, "labels", f"{short} may be several logs", f"call this one {name}")
        return rows[short]
    raise InputRefused(table, "labels", f"says nothing of {name}", f"add a line for it: {name}, DAY, CAR")
