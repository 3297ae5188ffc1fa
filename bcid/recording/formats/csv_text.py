"""CSV files as text: what their bytes, line ends and separators say before any cell is read as a number."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from bcid.errors import InputRefused
from bcid.recording.formats.detect import UTF_16
from bcid.recording.types import Irregularity

SEPARATORS = (",", ";", "\t")
HEAD_LINES, BEFORE = 40, 20  # lines that tell how a file is written, at its head and at its end
EXPORT_AGAIN = "export the file again"

NO_NUMBER = re.compile(r"(?<=[,;\t\n])[ ]*[+-]?(?:nan(?:\([^,;\t\n]*\))?|1[.,]#\w+)(?=[ \t\r]*[,;\t\n])", re.IGNORECASE)
"""How printf writes what is no finite number: nan, -nan(ind), 1.#INF, -1.#IND, 1.#QNAN."""

DECIMAL_COMMA = re.compile(r"(?:^|[;\t])[ ]*[+-]?\d+,\d+(?:[eE][+-]?\d+)?[ ]*(?=[;\t]|$)", re.MULTILINE)
DECIMAL_POINT = re.compile(r"(?:^|[;\t])[ ]*[+-]?\d+\.\d+(?:[eE][+-]?\d+)?[ ]*(?=[;\t]|$)", re.MULTILINE)
FIRST_NUMBERS = re.compile(r"^[ \t]*[+-]?[\d.]", re.MULTILINE)  # a header's lines begin otherwise
MAX_BYTES = 1 << 30
NEARLY_ALL = 0.98  # of the rows, which have as many cells as rows have


@dataclass(frozen=True)
class CsvText:
    """A CSV file's text with complete lines, and how its cells are written.

    What stands for no number reads `inf`, so that it is told from a cell that is blank.
    """

    path: Path
    text: str
    separator: str
    decimal: str
    odd: tuple[Irregularity, ...]

    def rows(self, most: int) -> list[list[str]]:
        """The cells of the first lines.

        Raises:
            InputRefused: quotes that never close.
        """
        try:
            reader = csv.reader(io.StringIO(self.text, newline=""), delimiter=self.separator)
            return [row for row, _ in zip(reader, range(most), strict=False)]
        except csv.Error as error:
            raise InputRefused(self.path, "header", f"cannot be read as CSV: {error}", EXPORT_AGAIN) from None


def read_text(path: Path, comment: str | None = None) -> CsvText:
    """The text of the CSV file at `path`; lines that begin with `comment` say nothing of how it is written.

    Raises:
        InputRefused: bytes of another encoding, NUL bytes inside, a second header, or numbers of two kinds.
    """
    text, odd = _decoded(path)
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if not text.strip():
        raise InputRefused(path, "line 1", "holds no table", EXPORT_AGAIN)
    head = [line for line in text.split("\n", HEAD_LINES)[:HEAD_LINES] if not (comment and line.startswith(comment))]
    _check_one_header(path, text, head)
    separator = _separator(head)
    decimal = _decimal(path, text, separator)
    if separator != "," or decimal != ".":
        how = f"separator {separator!r}, decimal {decimal!r}"
        odd.append(Irregularity("CSV dialect", "fixed", 1, path.name, how))
    text, cut = _whole_lines(path, text, separator)
    begin = FIRST_NUMBERS.search(text)
    top = begin.start() if begin else len(text)
    _check_row_lengths(path, text, top, separator, comment)
    return CsvText(path, text[:top] + NO_NUMBER.sub("inf", text[top:]), separator, decimal, (*odd, *cut))


def _decoded(path: Path) -> tuple[str, list[Irregularity]]:
    """UTF-8, or what a byte-order mark says; NUL bytes at the end are what a crash leaves of space set aside."""
    if path.stat().st_size > MAX_BYTES:
        cause = f"has {path.stat().st_size} bytes, {MAX_BYTES} are the most"
        raise InputRefused(path, "file", cause, "cut the recording into takes")
    data = path.read_bytes()
    encoding = "utf-16" if data.startswith(UTF_16) else "utf-8-sig"
    odd = []
    if encoding == "utf-16":
        odd.append(Irregularity("encoding", "fixed", 1, path.name, "UTF-16 by its byte-order mark"))
    elif (whole := data.rstrip(b"\0")) != data:
        text = f"{len(data) - len(whole)} NUL bytes at the end: the writer did not finish"
        odd.append(Irregularity("cut file", "warning", 1, path.name, text))
        data = whole
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        cause = (
            f"is not UTF-8 (0x{data[error.start]:02x})" if encoding != "utf-16" else f"is not UTF-16: {error.reason}"
        )
        raise InputRefused(path, f"byte {error.start}", cause, "save the file as UTF-8") from None
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise InputRefused(path, f"line {line}", "holds NUL bytes: a part was never written", EXPORT_AGAIN)
    return text, odd


def _check_one_header(path: Path, text: str, head: list[str]) -> None:
    """Raise `InputRefused` where the first line, or a Motive export's, comes again: two takes in one file."""
    first = next((line.strip() for line in head if any(c.isalpha() for c in line)), "")
    key = "Format Version" if first.startswith("Format Version") else first
    again = text.find("\n" + key, text.find(key) + 1) if key else -1
    if again >= 0:
        line = text.count("\n", 0, again + 1) + 1
        raise InputRefused(path, f"line {line}", "a second header: two takes in one file", "cut the file there")


def _separator(head: list[str]) -> str:
    """What divides the cells."""
    counts = {s: max((line.count(s) for line in head), default=0) for s in SEPARATORS}
    if counts[";"] and counts[";"] >= counts[","] / 2:  # with a decimal comma a row has about as many of both
        return ";"
    return max(SEPARATORS, key=lambda s: counts[s])


def _decimal(path: Path, text: str, separator: str) -> str:
    if separator == ",":
        return "."
    comma, point = DECIMAL_COMMA.search(text), DECIMAL_POINT.search(text)
    if comma and point:
        line = 1 + text.count("\n", 0, max(comma.end(), point.end()))
        cause = f"numbers with a decimal comma and with a point ({comma[0].strip('; ')}, {point[0].strip('; ')})"
        raise InputRefused(path, f"line {line}", cause, "export with one of them")
    return "," if comma else "."


def _check_row_lengths(path: Path, text: str, top: int, separator: str, comment: str | None) -> None:
    """Raise `InputRefused` where a row inside the table has fewer cells than nearly all: a part was never written."""
    first = text.count("\n", 0, top) + 1
    lines = text[top:].rstrip("\n").split("\n")[:-1]  # the last row is the file's end's
    cells = [line.count(separator) for line in lines if line and not (comment and line.startswith(comment))]
    if not cells or '"' in text:  # quoted cells may hold separators
        return
    usual, most = Counter(cells).most_common(1)[0]
    if min(cells) == usual or most < NEARLY_ALL * len(cells):
        return
    for number, line in enumerate(lines, first):
        n = line.count(separator)
        if line and n < usual and not (comment and line.startswith(comment)):
            cause = f"holds {n + 1} cells where rows have {usual + 1}: a part was never written"
            raise InputRefused(path, f"line {number}", cause, EXPORT_AGAIN)


def _whole_lines(path: Path, text: str, separator: str) -> tuple[str, list[Irregularity]]:
    """The text without a last line that the file's end has cut, and word of it.

    A line without an end is whole if it has as many cells as those before, and its last one as many decimals where all
    of theirs have the same.
    """
    if text.endswith("\n"):
        return text, []
    body, _, last = text.rpartition("\n")
    if not body:
        return text + "\n", []
    before = body.rsplit("\n", BEFORE)[-BEFORE:]
    usual = {_decimals(line, separator) for line in before}
    same = last.count(separator) == before[-1].count(separator)
    whole = same and (len(usual) > 1 or _decimals(last, separator) in usual)
    line = text.count("\n") + 1
    what = "kept, since it looks whole" if whole else "left out"
    odd = Irregularity("cut file", "warning", 1, f"{path.name} line {line}", f"the last line has no end: {what}")
    return (text if whole else body) + "\n", [odd]


def _decimals(line: str, separator: str) -> int:
    """Digits behind the point of a line's last cell."""
    cell = line.rpartition(separator)[2].strip()
    return len(cell.partition("," if separator == ";" and "," in cell else ".")[2])
