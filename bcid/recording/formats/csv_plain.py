"""Rows of plain numbers in a CSV file, proven by one pass over its bytes and read block by block, in bounded memory.

Rows are plain where they hold nothing but digits, signs, exponents, decimal marks and separators, as many cells each,
and complete line ends: no quotes, texts, comments, NULs or blank lines, so that a row is a line and a cell is what lies
between two separators.  The cells are read by the same parser of pandas as those of any other table.
"""

import io
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from bcid.aliases import Bools
from bcid.errors import InputRefused
from bcid.recording.formats.limits import TABLE as LIMITS

NEWLINE, RETURN = ord("\n"), ord("\r")
NUMBER_SIGNS = "0123456789+-eE "
PROOF_BYTES, PARSED_BYTES = 1 << 18, 1 << 22  # that are held at a time
MAX_HEAD_BYTES = 1 << 23  # in which a table's first lines are looked for

KeepRows = Callable[[pd.DataFrame], Bools]
"""Which rows (N,) of a block of a table are kept."""


class PlainRows(NamedTuple):
    """The rows of a CSV file from the byte `begin`, the start of the line with index `line`, to its end."""

    path: Path
    begin: int
    line: int
    separator: str
    decimal: str
    cells: int  # in each row

    @property
    def characters(self) -> str:
        """All characters that the rows may hold, line ends aside."""
        return NUMBER_SIGNS + self.separator + self.decimal

    def are_proven(self) -> bool:
        """Whether the file from `begin` on holds plain rows of `cells` cells and nothing else."""
        allowed = f"{self.characters}\r\n".encode()
        return self.cells > 1 and all(
            block.endswith(b"\n") and self._is_plain(block, allowed) for block in self._blocks(PROOF_BYTES)
        )

    def _is_plain(self, block: bytes, allowed: bytes) -> bool:
        """Whether complete lines hold only `allowed` bytes, returns only at their ends, and as many cells each."""
        if block.translate(None, allowed):
            return False
        data = np.frombuffer(block, dtype=np.uint8)
        ends = data == NEWLINE
        if (data[:-1][~ends[1:]] == RETURN).any():
            return False
        starts = np.r_[0, np.flatnonzero(ends)[:-1] + 1]
        separators = np.add.reduceat(data == ord(self.separator), starts, dtype=np.int64)
        return bool((separators == self.cells - 1).all())

    def _blocks(self, size: int) -> Iterator[bytes]:
        """The bytes from `begin` on, in blocks of complete lines of about `size` bytes; the last one may be cut."""
        with self.path.open("rb") as file:
            file.seek(self.begin)
            while block := file.read(size):
                yield block if block.endswith(b"\n") else block + file.readline()

    def parse(self, columns: list[int], keep: KeepRows | None = None, **options: Any) -> pd.DataFrame | None:
        """The cells of these columns as a table with their indices as names; None where a cell is no plain number.

        Whole numbers stay whole where all of a column's are.  Where `keep` is given, only the rows that it keeps are
        held, and the table's index is their numbers.  `options` are those of `pandas.read_csv`, but for the separator,
        the decimal mark, names and rows to skip.

        Raises:
            InputRefused: there are more rows than `LIMITS.max_rows`.
        """
        try:
            parts, rows = self._parse_blocks(columns, {}, keep, options)
            # whole numbers in one block, others in the next: as one column they are read in one way
            kinds = {c: {a.dtype.kind for a in arrays} for c, arrays in parts.items()}
            mixed: dict[int, type] = {c: float for c in columns if len(kinds[c]) > 1}
            if mixed:
                parts, rows = self._parse_blocks(columns, mixed, keep, options)
        except (ValueError, pd.errors.ParserWarning):
            return None
        if any(a.dtype.kind not in "if" for arrays in parts.values() for a in arrays):
            return None
        index = None if keep is None else np.concatenate(rows)
        return pd.DataFrame({c: np.concatenate(parts.pop(c)) for c in columns}, index, copy=False)

    def _parse_blocks(
        self, columns: list[int], kinds: dict[int, type], keep: KeepRows | None, options: dict[str, Any]
    ) -> tuple[dict[int, list[np.ndarray]], list[np.ndarray]]:
        """The numbers of each block by column, of the kind that pandas infers or that `kinds` asks for; and its rows.

        Raises:
            ValueError: a cell of a column of `kinds` is no number.
            InputRefused: there are more rows than `LIMITS.max_rows`.
        """
        parts: dict[int, list[np.ndarray]] = {c: [] for c in columns}
        rows, first, held = list[np.ndarray](), 0, 0
        for block in self._blocks(PARSED_BYTES):
            table = pd.read_csv(
                io.BytesIO(block), sep=self.separator, decimal=self.decimal, index_col=False, low_memory=False,
                header=None, names=list(range(self.cells)), usecols=columns, dtype=kinds, **options,
            )  # fmt: skip
            kept = slice(None) if keep is None else keep(table)
            numbers = np.arange(first, first + len(table))[kept]
            first, held = first + len(table), held + len(numbers)
            if held > LIMITS.max_rows:
                cause = f"has more rows than {LIMITS.max_rows}, the most that are held at once"
                step = f"cut it into takes, or read a part of a Motive export: {self.path.name}[0:3600]"
                raise InputRefused(self.path, "rows", cause, step)
            if keep is not None:
                rows.append(numbers)
            for column, arrays in parts.items():
                arrays.append(table[column].to_numpy()[kept])
        return parts, rows


def read_first_lines(path: Path, count: int) -> bytes | None:
    """More than `count` complete first lines of a file; None where it has no more, or they are longer than any."""
    data, size = b"", 1 << 16
    with path.open("rb") as file:
        while data.count(b"\n") <= count:
            if len(data) > MAX_HEAD_BYTES or not (more := file.read(size)):
                return None
            data, size = data + more, 2 * size
        return data[: data.rindex(b"\n") + 1] if file.read(1) else None
