"""CSV tables: their columns by name, as pandas reads the cells."""

import io
import itertools
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import pandas as pd

from bcid.errors import InputRefused, Problem, Problems
from bcid.recording.formats.csv_plain import KeepRows
from bcid.recording.formats.csv_text import CsvText, read_whole_text
from bcid.recording.formats.stamps import find_pair
from bcid.recording.formats.table_head import find_table_head
from bcid.recording.types import Irregularity

MEND_ROWS = "mend the rows, or export with ; between the cells"


class CsvColumns(NamedTuple):
    """The wanted columns of a CSV table by name; the names of all columns; stated units by name; and what was odd."""

    columns: dict[str, pd.Series]
    names: list[str]
    units: dict[str, str]
    irregularities: tuple[Irregularity, ...]


def parse_rows(
    file: CsvText, width: int, skiprows: int, columns: Sequence[int], keep: KeepRows | None = None, **options: Any
) -> pd.DataFrame:  # fmt: skip
    """The rows of a CSV text below its first `skiprows` lines as a table with the columns 0, 1, ... `width` - 1.

    Of rows of plain numbers only the wanted `columns` are there, and only the rows that `keep` keeps, where it is
    given.  `options` are those of `pandas.read_csv`.

    Raises:
        InputRefused: there are more rows than are held at once.
        pandas.errors.ParserError or ParserWarning: a row has more than `width` cells.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("error", pd.errors.ParserWarning)
        if file.rows is not None:
            plain = file.rows
            fits = plain.line == skiprows and plain.cells == width
            table = plain.parse(sorted(set(columns)), keep, **options) if fits and columns else None
            if table is not None:
                return table
            file = read_whole_text(file.path, options.get("comment"))
        whole: pd.DataFrame = pd.read_csv(
            io.StringIO(file.text), sep=file.separator, decimal=file.decimal, index_col=False, low_memory=False,
            header=None, names=range(width), skiprows=skiprows, **options,
        )  # fmt: skip
        return whole


def read_csv_columns(file: CsvText, wanted: Sequence[str], comment: str | None = None) -> CsvColumns:
    """Those of the `wanted` columns that a CSV table has; a name that stands for a pair of columns gives both.

    Raises:
        InputRefused: there are no names or no rows, a wanted column is there twice, or rows are longer than the names.
    """
    head, problems = find_table_head(file, wanted), Problems()
    width = max(len(head.names), 1)
    named = max((i for i, name in enumerate(head.names) if name), default=0) + 1
    pairs = [part for name in wanted for part in find_pair(name, head.names) or ()]
    places = {name: head.indices(name) for name in [*wanted, *pairs]}
    chosen = [*itertools.chain.from_iterable(places.values()), *range(named, width)]
    try:
        table = parse_rows(file, width, head.body_row, chosen, comment=comment, skipinitialspace=True)
    except pd.errors.EmptyDataError:
        table = pd.DataFrame({i: pd.Series(dtype=float) for i in range(width)})
    except (pd.errors.ParserError, pd.errors.ParserWarning) as error:
        cause = f"rows are longer than the header, or is no regular CSV (a decimal comma?): {error}"
        raise InputRefused(file.path, "table", cause.strip(), MEND_ROWS) from None
    if not table[range(named, width)].isna().all(axis=None):
        cause = f"has {named} column names, and rows of {width} cells: a column without a name, or a decimal comma?"
        step = "write a name above every column, or export with ; between the cells"
        raise InputRefused(file.path, "header", cause, step)
    columns, units = dict[str, pd.Series](), dict[str, str]()
    for name, at in places.items():
        if len(at) > 1:
            apart = [both for both in (head.alternatives[i] for i in at) if both]
            step = f"name the columns apart{f', or map {apart[0]!r}' if apart else ''}"
            problems.append(Problem(f"column {name!r}", "is there twice", step))
        elif at:
            columns[name] = table[at[0]]
            units |= {name: head.units[at[0]]} if at[0] in head.units else {}
    problems.raise_if_any(file.path)
    return CsvColumns(columns, head.all_names, units, (*file.irregularities, *head.irregularities))
