"""The rows of a CSV text by CSV's own rules: where its body begins, and rows that were cut, joined or swallowed."""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from bcid.errors import InputRefused
from bcid.recording.formats.limits import TABLE as LIMITS
from bcid.recording.types import Irregularity

FIRST_NUMBERS = re.compile(r'[ \t"]*[+\N{MINUS SIGN}-]?[.,]?\d')
"""The start of a line of numbers: a header's lines begin otherwise."""
LINE = re.compile(r".*\n")
COMMENT_SIGNS = ("#", "%", "//")  # at the start of a line
REMOVE_MARK = "remove that mark, or write it twice inside quotes"
SAMPLE_LINES = 200  # lines of numbers that show how many cells a row has


class CsvRow(NamedTuple):
    """A row of a CSV text: its first line, how many lines and cells it has, and how many separators its later lines."""

    line: int
    lines: int
    cells: int
    most_separators: int
    closed: bool  # whether every quotation mark has its partner


def find_body(text: str, separator: str) -> int:
    """The character at which the table's body begins: the first line of numbers with as many cells as most have.

    Where no line begins with a number, it is the first line that has as many cells as most.
    """
    lines = [(m.start(), m[0]) for m, _ in zip(LINE.finditer(text), range(SAMPLE_LINES), strict=False)]
    numbers = [(start, line) for start, line in lines if FIRST_NUMBERS.match(line)]
    chosen = numbers or [(start, line) for start, line in lines if line.strip()]
    if not chosen:
        return len(text)
    usual = Counter(line.count(separator) for _, line in chosen).most_common(1)[0][0]
    return next(start for start, line in chosen if line.count(separator) == usual)


def drop_comment_lines(
    path: Path, text: str, top: int, separator: str, comment: str | None
) -> tuple[str, list[Irregularity]]:
    """The text with blank lines in place of comments in the table's body, which begins at the character `top`.

    Comments begin with `comment`, or, where that is None, with #, % or // and have fewer cells than a row; the latter
    are noted.
    """
    signs = COMMENT_SIGNS if comment is None else (comment,)
    if all(text.find("\n" + sign, max(top - 1, 0)) < 0 for sign in signs):
        return text, []
    body = text[top:]
    usual = body.partition("\n")[0].count(separator)
    dropped = 0

    def blank(match: re.Match[str]) -> str:
        """A line end in place of a comment; the line itself where it is a row."""
        nonlocal dropped
        if comment is None and match[0].count(separator) >= usual:
            return match[0]
        dropped += 1
        return "\n"

    pattern = re.compile("^(?:" + "|".join(re.escape(sign) for sign in signs) + ").*\n", re.MULTILINE)
    body = pattern.sub(blank, body)
    odd = [Irregularity("comment", "fixed", dropped, path.name, "lines that begin with #, % or // are no rows")]
    return text[:top] + body, odd if dropped and comment is None else []


def check_rows(path: Path, text: str, top: int, separator: str) -> None:
    """Raise `InputRefused` where a row has other cells than nearly all rows, or a quotation mark swallows rows.

    A shorter row was never written whole, a longer one is two rows in one line. Rows begin at the character `top` of
    the text; the last one may be cut.
    """
    quoted = '"' in text[top:]
    # most tables have rows of one length, and pairs of quotes in a row
    body = text[top:].split("\n")
    even = not quoted or not any(line.count('"') % 2 for line in body)
    if even and len({line.count(separator) for line in body if line}) <= 1:
        return
    rows = list(_read_quoted_rows(path, text, top, separator) if quoted else _read_plain_rows(text, top, separator))
    if not rows:
        return
    usual, most = Counter(row.cells for row in rows).most_common(1)[0]
    for row in rows:
        if row.lines > 1 and row.most_separators >= max(1, usual - 1):
            cause = f"a quotation mark opens a cell that runs over {row.lines - 1} more rows"
            raise InputRefused(path, f"line {row.line}", cause, REMOVE_MARK)
        if not row.closed:
            raise InputRefused(path, f"line {row.line}", "a quotation mark is never closed", "remove that mark")
    if most < LIMITS.min_equal_length_share * len(rows):
        return
    for row in rows[:-1]:
        if row.cells != usual:
            how = "a part was never written" if row.cells < usual else "two rows in one line, or a separator too many"
            cause = f"holds {row.cells} cells where rows have {usual}: {how}"
            raise InputRefused(path, f"line {row.line}", cause, "export the file again, or remove that line")


def _read_plain_rows(text: str, top: int, separator: str) -> Iterator[CsvRow]:
    """The rows, a line each, of a text without quotation marks after the character `top`; blank lines are none."""
    first = text.count("\n", 0, top) + 1
    for number, line in enumerate(text[top:].split("\n"), first):
        if line.strip():
            yield CsvRow(number, 1, line.count(separator) + 1, 0, closed=True)


def _read_quoted_rows(path: Path, text: str, top: int, separator: str) -> Iterator[CsvRow]:
    """The rows of a text with quotation marks after the character `top`, by the csv module; blank lines are none."""
    first = text.count("\n", 0, top) + 1
    lines = text.split("\n")
    reader, begin = csv.reader(io.StringIO(text, newline=""), delimiter=separator), 0
    try:
        for cells in reader:
            line, begin = begin + 1, reader.line_num
            own = lines[line - 1 : begin]
            if line >= first and any(cells):
                most = max((text_line.count(separator) for text_line in own[1:]), default=0)
                # a mark that is never closed has swallowed the last line's end, too
                closed = not cells[-1].endswith("\n") or own[-1].rstrip().endswith('"')
                yield CsvRow(line, len(own), len(cells), most, closed)
    except csv.Error:
        cause = "a quotation mark opens a cell that runs over many rows"
        raise InputRefused(path, f"line {begin + 1}", cause, REMOVE_MARK) from None
