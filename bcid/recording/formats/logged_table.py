"""Tables of any kind, CSV or Parquet, as columns of numbers and stamps by the names that a vehicle file maps."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from bcid.aliases import Floats
from bcid.errors import Problem, Problems
from bcid.mapping import ChannelMapping, FieldMapping, StampMapping
from bcid.recording.formats.csv_table import read_csv_columns
from bcid.recording.formats.csv_text import read_csv_text
from bcid.recording.formats.detect import PARQUET_MAGIC
from bcid.recording.formats.names import list_names, printable_name
from bcid.recording.formats.numbers import next_step_for, parse_numbers
from bcid.recording.formats.raw import nearest_hint
from bcid.recording.formats.stamps import NO_PAIR, NO_STAMP, Stamps, find_pair, pair_stamps, parse_stamps
from bcid.recording.formats.table_head import UNIT_SIZES
from bcid.recording.types import Irregularity

PARTS_OF_MAPPINGS = ("time_s", "comment", "time_zero")  # entries of a mapping that are no fields with a gain


@dataclass(frozen=True)
class LoggedTable:
    """The mapped columns of a table as they stand there, the names of all, and units that a row of the table states."""

    path: Path
    columns: dict[str, pd.Series]
    names: list[str]
    units: dict[str, str]
    decimal: str
    irregularities: tuple[Irregularity, ...]
    remedy: str  # the next step where a column is missing

    def __len__(self) -> int:
        """The number of rows."""
        return max((len(c) for c in self.columns.values()), default=0)

    def find_missing(self, wanted: Iterable[str]) -> list[Problem]:
        """A problem for each wanted column that is not there, with the names that are."""
        return [
            Problem(
                f"column {printable_name(name)!r}",
                f"is not in the file (found: {list_names(self.names)}{nearest_hint(name, self.names)})", self.remedy,
            )
            for name in dict.fromkeys(wanted) if name not in self.columns
        ]  # fmt: skip

    def numbers(self, wanted: Iterable[str]) -> tuple[dict[str, Floats], list[Irregularity]]:
        """The wanted columns as floats (N,), NaN where blank; and the notations that are not plain, as irregularities.

        Raises:
            InputRefused: columns that are missing or hold text, all of them in one error.
        """
        problems, values = Problems(self.find_missing(wanted)), dict[str, Floats]()
        notations = dict[str, list[str]]()
        for name in dict.fromkeys(wanted):
            if name not in self.columns:
                continue
            parsed = parse_numbers(self.columns[name], self.decimal)
            problems += self._bad_cells([name], parsed.bad_rows, "number")
            values[name] = parsed.values
            if parsed.notation:
                notations.setdefault(parsed.notation, []).append(name)
        problems.raise_if_any(self.path)
        return values, [
            Irregularity("number notation", "fixed", len(names), self.path.name, f"{how}: column {list_names(names)}")
            for how, names in notations.items()
        ]

    def stamps(self, mapping: StampMapping) -> tuple[Stamps, list[Irregularity]]:
        """The stamps of the rows by `mapping`; and what was mended in them.

        Raises:
            InputRefused: a column is missing, or a stamp is in no known notation.
        """
        name = mapping.columns[0]
        pair = (mapping.sec, mapping.nanosec) if mapping.sec and mapping.nanosec else find_pair(name, self.names)
        problems = Problems(self.find_missing(pair or [name]))
        problems.raise_if_any(self.path)
        if pair:
            stamps = pair_stamps(*(self.columns[part] for part in pair))
        else:
            stamps = parse_stamps(self.columns[name], mapping.gain, self.decimal)
        problems += self._bad_cells(pair or [name], stamps.bad_rows, "stamp")
        problems.raise_if_any(self.path)
        return stamps, [Irregularity("stamp notation", "fixed", len(self), self.path.name, n) for n in stamps.notes]

    def _bad_cells(self, names: Sequence[str], rows: Sequence[int] | np.ndarray, what: str) -> list[Problem]:
        """A problem with the first of the bad `rows` of a column, or of columns that are one stamp; [] without any."""
        if not len(rows):
            return []
        more = f" (and {len(rows) - 1} more in this column)" if len(rows) > 1 else ""
        cells = [self.columns[name].iloc[rows[0]] for name in names]
        step = next_step_for(cells[0]) if what == "number" else NO_STAMP if len(names) == 1 else NO_PAIR
        place = f"data row {rows[0] + 1}, column {' and '.join(repr(printable_name(name)) for name in names)}"
        shown = " with ".join(repr(printable_name(cell)) for cell in cells)
        return [Problem(place, f"{shown} is no {what}{more}", step)]

    def check_units(self, mapping: ChannelMapping, stamps: StampMapping, metres_per_unit: float) -> None:
        """Raise `InputRefused` where the table's row of units states another unit than a field of gain 1 is mapped in.

        `metres_per_unit` is the size (m) of the vehicle file's unit of positions.
        """
        problems = Problems()
        fields = [(key, getattr(mapping, key)) for key in type(mapping).model_fields if key not in PARTS_OF_MAPPINGS]
        mapped = [
            (key, field.source, metres_per_unit if key in ("x_m", "y_m", "z_m") else 1.0)
            for key, field in fields if isinstance(field, FieldMapping) and field.gain == 1.0 and field.points is None
        ]  # fmt: skip
        if stamps.source is not None and stamps.gain == 1.0:
            mapped.append(("time_s", stamps.source, 1.0))
        for key, name, size in mapped:
            unit = self.units.get(name)
            if unit is not None and not np.isclose(UNIT_SIZES[unit], size):
                cause = f"is in {unit} by the row of units, and mapped without a gain"
                step = f'map its unit: {key} = {{ from = "{name}", gain = {UNIT_SIZES[unit]:.6g} }}'
                problems.append(Problem(f"column {printable_name(name)!r}", cause, step))
        problems.raise_if_any(self.path)


def read_logged_table(path: Path, wanted: Sequence[str], remedy: str, comment: str | None = None) -> LoggedTable:
    """The `wanted` columns of a CSV or Parquet table, as far as it has them; `remedy` is the advice where it lacks one.

    Raises:
        InputRefused: the file cannot be read, has no rows, or has a wanted column twice.
    """
    with path.open("rb") as file:
        is_parquet = file.read(len(PARQUET_MAGIC)) == PARQUET_MAGIC
    if is_parquet:
        from bcid.recording.formats.parquet_table import read_parquet_columns

        columns, names, odd = read_parquet_columns(path, wanted)
        return LoggedTable(path, columns, names, {}, ".", tuple(odd), remedy)
    text = read_csv_text(path, comment)
    csv = read_csv_columns(text, wanted, comment)
    return LoggedTable(path, csv.columns, csv.names, csv.units, text.decimal, csv.irregularities, remedy)
