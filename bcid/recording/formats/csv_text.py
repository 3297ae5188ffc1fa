"""CSV files as text: encoding, line ends, separators and cut lines, before any cell is read as a number."""

import csv
import io
import re
from dataclasses import dataclass, replace
from pathlib import Path

from bcid.errors import InputRefused
from bcid.recording.formats.csv_plain import PlainRows, read_first_lines
from bcid.recording.formats.csv_rows import (
    FIRST_NUMBERS,
    LINE,
    SAMPLE_LINES,
    check_rows,
    drop_comment_lines,
    find_body,
)
from bcid.recording.formats.detect import UTF_16_MARKS
from bcid.recording.formats.limits import TABLE as LIMITS
from bcid.recording.types import Irregularity

HEAD_LINES, TAIL_LINES = 40, 20  # lines that show how a file is written, at its head and at its end
EXPORT_AGAIN = "export the file again"

NON_FINITE_NUMBER = re.compile(
    r"(?<=[,;\t\n])[ ]*[+-]?(?:nan(?:\([^,;\t\n]*\))?|1[.,]#\w+)(?=[ \t\r]*[,;\t\n])", re.IGNORECASE
)
"""How printf writes what is no finite number: nan, -nan(ind), 1.#INF, -1.#IND, 1.#QNAN."""

DECIMAL_COMMA = re.compile(r"(?:^|[;\t])[ ]*[+-]?\d+,\d+(?:[eE][+-]?\d+)?[ ]*(?=[;\t]|$)", re.MULTILINE)
DECIMAL_POINT = re.compile(r"(?:^|[;\t])[ ]*[+-]?\d+\.\d+(?:[eE][+-]?\d+)?[ ]*(?=[;\t]|$)", re.MULTILINE)
SEPARATOR_LINE = re.compile(r'"?sep=([,;|\t])"?[ ]*\n', re.IGNORECASE)
"""The first line with which Excel is told the separator."""
APART_BY_BLANKS = re.compile(r"[+-]?[\d.,]+(?:[eEdD][+-]?\d+)?(?:[ \t]+[+-]?[\d.,]+(?:[eEdD][+-]?\d+)?){2,}[ \t]*")
"""A line of at least three numbers that only blanks keep apart."""


@dataclass(frozen=True)
class CsvText:
    """The text of a CSV file with complete lines, its separator and its decimal mark.

    Cells that stand for no finite number read `inf`, to distinguish them from blank ones.  Where `rows` are plain
    numbers, the text is that of the first lines only.
    """

    path: Path
    text: str
    separator: str
    decimal: str
    irregularities: tuple[Irregularity, ...]
    rows: PlainRows | None = None

    def first_rows(self, count: int) -> list[list[str]]:
        """The cells of the first `count` rows; `InputRefused` where quotes never close."""
        try:
            # line by line, as a copy of the text is large
            reader = csv.reader((line[0] for line in LINE.finditer(self.text)), delimiter=self.separator)
            return [row for row, _ in zip(reader, range(count), strict=False)]
        except csv.Error as error:
            raise InputRefused(self.path, "header", f"cannot be read as CSV: {error}", EXPORT_AGAIN) from None


def read_csv_text(path: Path, comment: str | None = None) -> CsvText:
    """The text of a CSV file, decoded, with its separator and decimal mark; a last line that was cut is left out.

    Lines that begin with `comment`, or without it with #, % or //, are not taken for rows: they are blank in the text.
    Of a long table of plain numbers only the first lines are held.

    Raises:
        InputRefused: bytes of another encoding, NUL bytes inside, a second header, numbers of two kinds, or rows that
            were cut or swallowed by a quotation mark.
    """
    return _read_plain_text(path, comment) or read_whole_text(path, comment)


def read_whole_text(path: Path, comment: str | None = None) -> CsvText:
    """The text of a CSV file as `read_csv_text` has it, with all lines, whatever they hold."""
    return _prepare_text(path, *_decode_file(path), comment)[0]


def _read_plain_text(path: Path, comment: str | None) -> CsvText | None:
    """The first lines of a CSV file all of whose rows are plain numbers; None of any other one, or of a short one.

    All that is judged of a text is judged by its first lines or by what such rows cannot hold, so that the file is read
    as if it were looked at as a whole.
    """
    head = read_first_lines(path, SAMPLE_LINES)
    if head is None or b"\0" in head:
        return None
    if head.startswith(UTF_16_MARKS) or head.count(b"\r") != head.count(b"\r\n"):
        return None
    try:
        file, top = _prepare_text(path, head.decode("utf-8-sig"), [], comment)
        before = file.text[:top]
        rows = list(csv.reader(io.StringIO(before, newline=""), delimiter=file.separator))
    except (InputRefused, UnicodeDecodeError, csv.Error):
        return None
    line = before.count("\n")
    begin = sum(len(text) for text in head.splitlines(keepends=True)[:line])
    first = file.text[top:].partition("\n")[0]
    plain = PlainRows(path, begin, line, file.separator, file.decimal, first.count(file.separator) + 1)
    # no cell above spans lines; no comment and no other header can look like numbers
    whole = len(rows) == line and (comment is None or comment[0] not in plain.characters)
    header = _header_line(file.text)
    told = not header.strip() or not set(header) <= set(plain.characters)
    return replace(file, rows=plain) if whole and told and plain.are_proven() else None


def _prepare_text(
    path: Path, text: str, odd: list[Irregularity], comment: str | None
) -> tuple[CsvText, int]:  # fmt: skip
    """A decoded `text` as `read_csv_text` has it, `odd` among its irregularities; the character where its rows begin.

    Raises:
        InputRefused: a second header, numbers of two kinds, or rows that were cut or swallowed by a quotation mark.
    """
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    if not text.strip():
        raise InputRefused(path, "line 1", "holds no table", EXPORT_AGAIN)
    stated = SEPARATOR_LINE.match(text)
    if stated:
        odd.append(Irregularity("CSV dialect", "fixed", 1, f"{path.name} line 1", f"names the separator {stated[1]!r}"))
        # a blank line in its place, so that lines keep their numbers
        text = "\n" + text[stated.end() :]
    _check_single_header(path, text)
    separator = stated[1] if stated else _find_separator(text)
    if separator == " ":
        text = "\n".join(re.sub(r"[ \t]+", "\t", line.strip(" \t")) for line in text.split("\n"))
        separator = "\t"
    _check_width(path, text, separator)
    decimal = _find_decimal_mark(path, text, separator)
    if separator != "," or decimal != ".":
        how = f"separator {separator!r}, decimal {decimal!r}"
        odd.append(Irregularity("CSV dialect", "fixed", 1, path.name, how))
    text, cut = _drop_cut_line(path, text, separator)
    top = find_body(text, separator)
    text, comments = drop_comment_lines(path, text, top, separator, comment)
    check_rows(path, text, top, separator)
    body = NON_FINITE_NUMBER.sub("inf", text[top:])
    return CsvText(path, text[:top] + body, separator, decimal, (*odd, *cut, *comments)), top


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


def _check_single_header(path: Path, text: str) -> None:
    """Raise `InputRefused` where the first line that has letters comes again: two takes in one file."""
    first = _header_line(text)
    key = "Format Version" if first.startswith("Format Version") else first + "\n"
    again = text.find("\n" + key, text.find(key) + 1) if key.strip() else -1
    if again >= 0:
        line = text.count("\n", 0, again + 1) + 1
        raise InputRefused(path, f"line {line}", "a second header: two takes in one file", "cut the file there")


def _header_line(text: str) -> str:
    """The first line that has letters and begins with no number; empty where none of the first HEAD_LINES has."""
    head = text.split("\n", HEAD_LINES)[:HEAD_LINES]
    return next((line for line in head if any(c.isalpha() for c in line) and not FIRST_NUMBERS.match(line)), "")


def _find_separator(text: str) -> str:
    """The separator of a table's cells: a comma, semicolon or tab, or a blank where only blanks keep numbers apart."""
    head = text.split("\n", HEAD_LINES)[:HEAD_LINES]
    numbers = [line for line in head if FIRST_NUMBERS.match(line)]
    if numbers and all(APART_BY_BLANKS.fullmatch(line) for line in numbers) and not any("\t" in n for n in numbers):
        return " "
    # a line above the table may hold any sign, a line of numbers only separators and decimal marks
    counts = {s: max((line.count(s) for line in numbers or head), default=0) for s in (",", ";", "\t")}
    # with a decimal comma, a row has about as many commas as semicolons or tabs
    for separator in (";", "\t"):
        if counts[separator] > 0 and counts[separator] >= counts[","] / 2:
            return separator
    return ","


def _check_width(path: Path, text: str, separator: str) -> None:
    """Raise `InputRefused` where a line has more cells than `LIMITS.max_columns`: such a table is no recording."""
    for number, line in enumerate(text.split("\n"), 1):
        if (cells := line.count(separator) + 1) > LIMITS.max_columns:
            cause = f"holds {cells} cells, {LIMITS.max_columns} are the most"
            raise InputRefused(path, f"line {number}", cause, "export fewer columns, or mend that line")


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
