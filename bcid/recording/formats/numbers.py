"""Columns of numbers in the notations of loggers, spreadsheets and Fortran: read where they are plain, else refused."""

import re
from typing import NamedTuple

import numpy as np
import pandas as pd

from bcid.aliases import Floats, Ints
from bcid.recording.formats.limits import TABLE as LIMITS

PLAIN = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:inf(?:inity)?|nan)"
DECIMAL_COMMA = r"[+-]?(?:\d+(?:,\d*)?|,\d+)(?:[eE][+-]?\d+)?"
GROUP_SIGNS = "'\N{RIGHT SINGLE QUOTATION MARK} \N{NO-BREAK SPACE}\N{THIN SPACE}\N{NARROW NO-BREAK SPACE}"
"""Signs, beside the other mark, that part groups of three digits and are never a decimal mark."""
MINUS_SIGNS = dict.fromkeys(
    map(ord, "\N{MINUS SIGN}\N{EN DASH}\N{HYPHEN}\N{NON-BREAKING HYPHEN}\N{SMALL HYPHEN-MINUS}"), "-"
)
FORTRAN_EXPONENT = re.compile(r"(?<=[\d.,])[dDqQ](?=[+-]?\d+$)")

HINTS = (
    (r"#+", "the spreadsheet's column was too narrow, and its numbers are lost: widen it and export again"),
    (
        r".*\d\s*%",
        'write the numbers without percent signs, and map them with gain = 0.01: { from = "…", gain = 0.01 }',
    ),
    (r"(?i)true|false|yes|no|on|off", "map a column of numbers, or log 0 and 1"),
    (r"[+-]?\d[\d.]*_[\d_.]*", "write numbers without underscores"),
    (
        r"[+-]?\d{1,3}(?:,\d{3})+",
        "a comma may be a decimal mark here or part thousands: export with ; between the cells, or with points",
    ),
    (
        r"[+-]?[\d.,]+(?:[eE][+-]?\d+)?\s*[a-zA-Z°µ/]+[²\d]*",
        "write the numbers without their unit, which belongs into the header, and map another unit with a gain",
    ),
)
"""Patterns of cells that are no number, and the next step for each."""
MEND_ROWS = "mend or remove such rows"


class ParsedNumbers(NamedTuple):
    """A column's numbers (N,), NaN where a cell is blank or bad; which rows are bad; and the notation, "" if plain."""

    values: Floats
    bad_rows: Ints
    notation: str = ""


def parse_numbers(cells: pd.Series, decimal: str = ".") -> ParsedNumbers:
    """A table's column as floats (N,), infinite where a number is too large; `decimal` is the file's decimal mark.

    Cells of text are numbers if all of them are in one notation: a minus sign of typography, exponents of Fortran
    (1.0D0), groups of three digits, or decimal commas. True and false are no numbers.
    """
    n = len(cells)
    if cells.dtype.kind in "iuf":
        return ParsedNumbers(np.asarray(cells, dtype=float), np.zeros(0, dtype=int))
    values, blank = np.full(n, np.nan), cells.isna().to_numpy()
    if blank.all():
        return ParsedNumbers(values, np.zeros(0, dtype=int))
    text = blank_long_cells(cells[~blank].astype(str).str.strip())
    tried = [
        (written, written.str.fullmatch(PLAIN).to_numpy(dtype=bool), how)
        for how, written in _read_notations(text, decimal)
    ]
    written, good, notation = max(tried, key=lambda t: int(t[1].sum()))
    numbers = written.where(good).to_numpy(dtype=object).astype(float)
    # text that says nan is no blank cell
    values[~blank] = np.where(good & np.isnan(numbers), np.inf, numbers)
    return ParsedNumbers(values, np.flatnonzero(~blank)[~good], notation)


def blank_long_cells(text: "pd.Series[str]") -> "pd.Series[str]":
    """The texts, but empty where one is longer than any number or stamp, so that no pattern is tried on it."""
    return text.mask(text.str.len() > LIMITS.max_cell_bytes, "")


def _read_notations(text: "pd.Series[str]", decimal: str) -> list[tuple[str, "pd.Series[str]"]]:
    """The column's cells with points as decimal marks, by each notation that they can be in; "" is the plain one."""
    signed = text.str.translate(MINUS_SIGNS).str.replace(FORTRAN_EXPONENT, "e", regex=True)
    changed = bool((signed != text).any())
    what = "a typographic minus sign or exponents of Fortran" if changed else ""
    if decimal == ",":
        pointed = signed.str.replace(",", ".", regex=False)
        whole = signed.str.replace(_groups("."), "", regex=True).str.replace(",", ".", regex=False)
        return [(what, pointed), ("groups of three digits", whole)]
    tried = [(what, signed)]
    grouped = signed.str.fullmatch(_grouped_number(","))
    # 1,234 alone may be a decimal comma; 1,234.5 and 1,234,567 are not, nor is any of 0,5 and 1,25 a group
    if signed.str.contains(rf",\d{{3}}[.,{GROUP_SIGNS}]").any() or not signed.str.contains(",", regex=False).any():
        whole = signed.str.replace(_groups(","), "", regex=True)
        tried.append(("groups of three digits", signed.where(~grouped, whole)))
    elif not grouped.where(signed.str.contains(",", regex=False), True).all():
        comma = signed.str.fullmatch(DECIMAL_COMMA)
        tried.append(("decimal commas", signed.where(~comma, signed.str.replace(",", ".", regex=False))))
    return tried


def _groups(mark: str) -> "re.Pattern[str]":
    """A pattern of the signs that part groups of three digits, `mark` among them."""
    return re.compile(rf"(?<=\d)[{re.escape(mark)}{GROUP_SIGNS}](?=\d{{3}}(?!\d))")


def _grouped_number(mark: str) -> "re.Pattern[str]":
    """A pattern of a number whose digits are in groups of three, parted by `mark` or a sign that is no mark."""
    return re.compile(rf"[+-]?[1-9]\d{{0,2}}(?:[{re.escape(mark)}{GROUP_SIGNS}]\d{{3}})+(?:\.\d+)?")


def next_step_for(cell: object) -> str:
    """The next step for a cell that is no number, by what it looks like."""
    text = str(cell).strip()
    if len(text) > LIMITS.max_cell_bytes:
        return MEND_ROWS
    return next((step for pattern, step in HINTS if re.fullmatch(pattern, text)), MEND_ROWS)
