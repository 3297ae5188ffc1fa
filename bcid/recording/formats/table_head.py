"""The head of a CSV table: the row of column names among a preamble, a second header row and a row of units."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from bcid.errors import InputRefused
from bcid.recording.formats.csv_rows import COMMENT_SIGNS, FIRST_NUMBERS
from bcid.recording.formats.csv_text import HEAD_LINES, CsvText
from bcid.recording.formats.names import printable_name
from bcid.recording.formats.stamps import find_pair
from bcid.recording.types import Irregularity

UNIT_SIZES = {
    "s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9,
    "m": 1.0, "meter": 1.0, "meters": 1.0, "metres": 1.0, "cm": 1e-2, "mm": 1e-3,
    "rad": 1.0, "deg": 0.017453292519943295, "°": 0.017453292519943295, "degrees": 0.017453292519943295,
    "m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6, "kph": 1 / 3.6, "mph": 0.44704,
    "rad/s": 1.0, "deg/s": 0.017453292519943295, "°/s": 0.017453292519943295, "%": 0.01,
}  # fmt: skip
"""Units in a row of units, each with its size in the SI unit of its kind."""
NO_UNITS = ("", "-", "1", "none", "unitless", "hz", "n/a", "frame", "count")
MAX_UNIT_ROWS = 2  # below the names: units, and types or descriptions of them


class TableHead(NamedTuple):
    """The names of a table's columns in order, the row (of the file's) at which its numbers begin, and stated units."""

    names: list[str]
    alternatives: list[str]  # names that two header rows make together, or "" for each column
    body_row: int
    units: dict[int, str]  # by the column's index
    irregularities: tuple[Irregularity, ...] = ()

    def indices(self, name: str) -> list[int]:
        """The columns that have this name, that two header rows give it together, or whose number it is (#1)."""
        plain = [i for i, n in enumerate(self.names) if n == name]
        both = [i for i, n in enumerate(self.alternatives) if n and n == name]
        number = re.fullmatch(r"#(\d+)", name)
        if plain or both or not number:
            return plain if len(plain) == 1 or not both else both
        return [int(number[1]) - 1] if 0 < int(number[1]) <= len(self.names) else []

    @property
    def all_names(self) -> list[str]:
        """The names by which columns may be mapped, as messages list them."""
        counts = Counter(self.names)
        return [b if counts[n] > 1 and b else n for n, b in zip(self.names, self.alternatives, strict=True) if n or b]


def find_table_head(file: CsvText, wanted: Sequence[str]) -> TableHead:
    """The head of a CSV table: its names are in the row that has most of the `wanted` ones.

    Raises:
        InputRefused: no row has one of them, and there is no row of names above the numbers.
    """
    rows = [[cell.strip() for cell in row] for row in file.first_rows(HEAD_LINES)]
    numbers = next((i for i, row in enumerate(rows) if len(row) > 1 and FIRST_NUMBERS.match(row[0])), len(rows))
    width = max((len(row) for row in rows[numbers:]), default=0)
    named = [(i, *_names_of_rows(rows, i)) for i in range(len(rows)) if any(rows[i])]
    scores = [sum(_stands_for(name, {*names, *both}) for name in wanted) for _, names, both in named]
    if max(scores, default=0) > 0:
        row, names, both = named[scores.index(max(scores))]
    elif any(re.fullmatch(r"#\d+", name) for name in wanted):
        return TableHead([f"#{i + 1}" for i in range(width)], [""] * width, numbers, {})
    else:
        above = [entry for entry in named if entry[0] < max(numbers, 1) and not FIRST_NUMBERS.match(rows[entry[0]][0])]
        if not above:
            step = 'write a line of column names above it, or map columns by number in the vehicle file: time_s = "#1"'
            raise InputRefused(file.path, "line 1", "the table has no header", step)
        row, names, both = max(above, key=lambda entry: (len(entry[1]), entry[0]))
    body_row, units = _read_units(rows, row)
    width = max(len(names), width)
    names, both = ([*n, *[""] * (width - len(n))] for n in (names, both))
    return TableHead(names, both, body_row, units, _note_preamble(file, rows, row, units, both))


def _names_of_rows(rows: list[list[str]], i: int) -> tuple[list[str], list[str]]:
    """The names in row `i`, and those it makes with the row above, whose names hold until the next: `above.name`."""
    names = rows[i]
    sign = next((s for s in COMMENT_SIGNS if names[0].startswith(s)), "")
    if sign:
        first = names[0].lstrip("#%/").strip()
        names = [first, *names[1:]] if first else names[1:]
    if not names:
        return [], []
    above = rows[i - 1] if i > 0 and len([c for c in rows[i - 1] if c]) > 1 else []
    group, groups = "", []
    for cell in [*above, *[""] * len(names)][: len(names)]:
        group = cell or group
        groups.append(group)
    return names, [f"{g}.{n}" if g and n else "" for g, n in zip(groups, names, strict=True)]


def _stands_for(name: str, names: set[str]) -> bool:
    """Whether `name`, or the pair of columns that it stands for, is among a row's names."""
    return name in names or find_pair(name, list(names)) is not None


def _plain_unit(cell: str) -> str:
    """A unit without brackets, in lower case."""
    return cell.strip("[]() ").replace("\N{GREEK SMALL LETTER MU}", "µ").lower()


def _read_units(rows: list[list[str]], head: int) -> tuple[int, dict[int, str]]:
    """The row at which the numbers begin, and the units by column, of rows of units right below the row `head`."""
    units: dict[int, str] = {}
    for i in range(head + 1, min(head + 1 + MAX_UNIT_ROWS, len(rows))):
        cells = [_plain_unit(cell) for cell in rows[i]]
        if not any(c in UNIT_SIZES for c in cells) or any(c not in UNIT_SIZES and c not in NO_UNITS for c in cells):
            return i, units
        units |= {k: c for k, c in enumerate(cells) if c in UNIT_SIZES}
    return min(head + 1 + MAX_UNIT_ROWS, len(rows)) if units else head + 1, units


def _note_preamble(
    file: CsvText, rows: list[list[str]], head: int, units: dict[int, str], both: Iterable[str]
) -> tuple[Irregularity, ...]:
    """What is noted of lines above the names, which hold no names themselves, and of a row of units."""
    above = [i for i, row in enumerate(rows[:head]) if any(row) and not row[0].startswith(COMMENT_SIGNS)]
    odd = []
    if above and not (above == [head - 1] and any(both)):
        text = f"the column names stand in line {head + 1}: {printable_name(', '.join(rows[above[0]]))!r} is above"
        odd.append(Irregularity("preamble", "fixed", len(above), file.path.name, text))
    if units:
        text = f"a row of units: {', '.join(dict.fromkeys(units.values()))}"
        odd.append(Irregularity("units row", "fixed", 1, file.path.name, text))
    return tuple(odd)
