"""CSV files as text: encoding, line ends, separators and cut lines, before any cell is read as a number."""

import csv
import io
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from bcid.errors import InputRefused
from bcid.recording.formats.detect import UTF_16_MARKS
from bcid.recording.limits import TABLE as LIMITS
from bcid.recording.types import Irregularity

SEPARATORS = (",", ";", "\t")
HEAD_LINES, TAIL_LINES = 40, 20  # lines that show how a file is written, at its head and at its end
EXPORT_AGAIN = "export the file again"

NON_FINITE_NUMBER = re.compile(
    r"(?<=[,;\t\n])[ ]*[+-]?(?:nan(?:\([^,;\t\n]*\))?|1[.,]#\w+)(?=[ \t\r]*[,;\t\n])", re.IGNORECASE
)
"""How printf writes what is no finite number: nan, -nan(ind), 1.#INF, -1.#IND, 1.#QNAN."""

DECIMAL_COMMA = re.compile(r"(?:^|[;\t])[ ]*[+-]?\d+,\d+(?:[eE][+-]?\d+)?[ ]*(?=[;\t]|$)", re.MULTILINE)
DECIMAL_POINT = re.compile(r"(?:^|[;\t])[ ]*[+-]?\d+\.\d+(?:[eE][+-]?\d+)?[ ]*(?=[;\t]|$)", re.MULTILINE)
FIRST_NUMBERS = re.compile(r"^[ \t]*[+-]?[\d.]", re.MULTILINE)
"""The start of the first line of numbers: a header's lines begin otherwise."""


@dataclass(frozen=True)
class CsvText:
    """The text of a CSV file with complete lines, its separator and its decimal mark.

    Cells that stand for no finite number read `inf`, to distinguish them from blank ones.
    """

    path: Path
    text: str
    separator: str
    decimal: str
    irregularities: tuple[Irregularity, ...]

    def first_rows(self, count: int) -> list[list[str]]:
        """The cells of the first `count` rows; `InputRefused` where quotes never close."""
        try:
            reader = csv.reader(io.StringIO(self.text, newline=""), delimiter=self.separator)
            return [row for row, _ in zip(reader, range(count), strict=False)]
        except csv.Error as error:
            raise InputRefused(self.path, "header", f"cannot be read as CSV: {error}", EXPORT_AGAIN) from None


def read_csv_text(path: Path, comment: str | None = None) -> CsvText:
    """The text of a CSV file, decoded, with its separator and decimal mark; a last line that was cut is left out.

    Lines that begin with `comment` are not taken for rows.

    Raises:
        InputRefused: bytes of another encoding, NUL bytes inside, a second header, or numbers of two kinds.
    """
    text, odd = _decode_file(path)
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if not text.strip():
        raise InputRefused(path, "line 1", "holds no table", EXPORT_AGAIN)
    head = [line for line in text.split("\n", HEAD_LINES)[:HEAD_LINES] if not (comment and line.startswith(comment))]
    _check_single_header(path, text, head)
    counts = {s: max((line.count(s) for line in head), default=0) for s in SEPARATORS}
    # with a decimal comma, a row has about as many commas as semicolons
    semicolons = counts[";"] > 0 and counts[";"] >= counts[","] / 2
    separator = ";" if semicolons else max(SEPARATORS, key=lambda s: counts[s])
    decimal = _find_decimal_mark(path, text, separator)
    if separator != "," or decimal != ".":
        how = f"separator {separator!r}, decimal {decimal!r}"
        odd.append(Irregularity("CSV dialect", "fixed", 1, path.name, how))
    text, cut = _drop_cut_line(path, text, separator)
    begin = FIRST_NUMBERS.search(text)
    top = begin.start() if begin else len(text)
    _check_row_lengths(path, text, top, separator, comment)
    return CsvText(path, text[:top] + NON_FINITE_NUMBER.sub("inf", text[top:]), separator, decimal, (*odd, *cut))


def _decode_file(path: Path) -> tuple[str, list[Irregularity]]:
    """The file's text, decoded as UTF-8, or UTF-16 by its byte-order mark, and irregularities of the encoding.

    NUL bytes that a crash left at the end are cut off.

    Raises:
        InputRefused: the file exceeds `LIMITS.max_bytes`, has another encoding, or NUL bytes inside.
    """
    if path.stat().st_size > LIMITS.max_bytes:
        cause = f"has {path.stat().st_size} bytes, {LIMITS.max_bytes} are the most"
        raise InputRefused(path, "file", cause, "cut the recording into takes")
    data = path.read_bytes()
    encoding = "utf-16" if data.startswith(UTF_16_MARKS) else "utf-8-sig"
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
        name = f"UTF-16: {error.reason}" if encoding == "utf-16" else f"UTF-8 (0x{data[error.start]:02x})"
        raise InputRefused(path, f"byte {error.start}", f"is not {name}", "save the file as UTF-8") from None
    if "\0" in text:
        line = text.count("\n", 0, text.index("\0")) + 1
        raise InputRefused(path, f"line {line}", "holds NUL bytes: a part was never written", EXPORT_AGAIN)
    return text, odd


def _check_single_header(path: Path, text: str, head: list[str]) -> None:
    """Raise `InputRefused` where the first of the lines `head` that has letters comes again: two takes in one file."""
    first = next((line.strip() for line in head if any(c.isalpha() for c in line)), "")
    key = "Format Version" if first.startswith("Format Version") else first
    again = text.find("\n" + key, text.find(key) + 1) if key else -1
    if again >= 0:
        line = text.count("\n", 0, again + 1) + 1
        raise InputRefused(path, f"line {line}", "a second header: two takes in one file", "cut the file there")


def _find_decimal_mark(path: Path, text: str, separator: str) -> str:
    """The decimal mark of the text's numbers, "," or "."; `InputRefused` where both occur."""
    if separator == ",":
        return "."
    comma, point = DECIMAL_COMMA.search(text), DECIMAL_POINT.search(text)
    if comma and point:
        line = 1 + text.count("\n", 0, max(comma.end(), point.end()))
        cause = f"numbers with a decimal comma and with a point ({comma[0].strip('; ')}, {point[0].strip('; ')})"
        raise InputRefused(path, f"line {line}", cause, "export with one of them")
    return "," if comma else "."


def _check_row_lengths(path: Path, text: str, top: int, separator: str, comment: str | None) -> None:
    """Raise `InputRefused` where a row has fewer cells than nearly all rows: a part of the file was never written.

    Rows begin at the character `top` of the text; the last one is not checked.
    """
    first = text.count("\n", 0, top) + 1
    lines = text[top:].rstrip("\n").split("\n")[:-1]
    cells = [line.count(separator) for line in lines if line and not (comment and line.startswith(comment))]
    # quoted cells may hold separators
    if not cells or '"' in text:
        return
    usual, most = Counter(cells).most_common(1)[0]
    if min(cells) == usual or most < LIMITS.min_equal_length_share * len(cells):
        return
    for number, line in enumerate(lines, first):
        n = line.count(separator)
        if line and n < usual and not (comment and line.startswith(comment)):
            cause = f"holds {n + 1} cells where rows have {usual + 1}: a part was never written"
            raise InputRefused(path, f"line {number}", cause, EXPORT_AGAIN)


def _drop_cut_line(path: Path, text: str, separator: str) -> tuple[str, list[Irregularity]]:
    """The text without a last line that the end of the file has cut, and a warning of a last line without line end.

    A last line without line end is kept if it looks whole: it has as many cells as the line before, and its last cell
    has as many decimals as in the lines before, or these differ among each other.
    """
    if text.endswith("\n"):
        return text, []
    body, _, last = text.rpartition("\n")
    if not body:
        return text + "\n", []
    before = body.rsplit("\n", TAIL_LINES)[-TAIL_LINES:]
    usual = {_count_decimals(line, separator) for line in before}
    same = last.count(separator) == before[-1].count(separator)
    whole = same and (len(usual) > 1 or _count_decimals(last, separator) in usual)
    line = text.count("\n") + 1
    what = "kept, since it looks whole" if whole else "left out"
    odd = Irregularity("cut file", "warning", 1, f"{path.name} line {line}", f"the last line has no end: {what}")
    return (text if whole else body) + "\n", [odd]


def _count_decimals(line: str, separator: str) -> int:
    """The number of digits after the decimal mark in a line's last cell."""
    cell = line.rpartition(separator)[2].strip()
    return len(cell.partition("," if separator == ";" and "," in cell else ".")[2])
