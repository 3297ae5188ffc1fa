"""Messages that have the layout of one that was decoded: their numbers are read as arrays, without decoding each.

In the decoded message every number is a mark that says where it stands.  A message in JSON has the same layout if it is
the same text but for its numbers; one of ROS, if it is as long and differs in the bytes of numbers (and between them)
only.  Whatever else would be decoded, names, lengths of lists, texts, is then the same, so that the same numbers stand
in the same fields.
"""

import json
import re
import struct
from itertools import chain, repeat
from typing import Any, NamedTuple, Protocol

import numpy as np

from bcid.aliases import Bools
from bcid.recording.formats.message_store import StoredMessages
from bcid.recording.formats.ros_encoding import Cursor, Reader

BLOCK_BYTES, BLOCK_MESSAGES = 1 << 21, 1 << 8  # that are compared at a time, so few that their texts stay in the cache
MAX_TEXT_BYTES = 1 << 13  # of a text that others are compared with
STRING_OR_NUMBER = re.compile(rb'"(?:[^"\\]|\\.)*"|-?\d[\d.eE+-]*')
WHOLE_NUMBER = rb"0|-?[1-9]\d{0,18}"
"""Of JSON, as long as one of 64 bits, nanoseconds since 1970 among them; -0 is the whole number 0."""
NUMBER = rb"(?:-?[1-9]\d{0,99}+|0|-0(?=[.eE]))(?:\.\d{1,99}+)?+(?:[eE][-+]?+\d{1,3}+)?+"
"""Of JSON, but for -0 and for what is longer than any number; its parts are never tried shorter than they are."""


class MarkedInt(int):
    """A whole number of a decoded message, and its place among all marks."""

    mark: int


class MarkedFloat(float):
    """A number of a decoded message that is none of the whole ones, and its place among all marks."""

    mark: int


def _marked(value: Any, mark: int) -> Any:
    """A number with its mark; what is no number as it is."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return value
    number: MarkedInt | MarkedFloat = MarkedInt(value) if isinstance(value, int) else MarkedFloat(value)
    number.mark = mark
    return number


class FixedLayout(Protocol):
    """Where the numbers stand in messages like one that was decoded."""

    message: Any  # as it was decoded, with marked numbers

    def read(self, stored: StoredMessages, marks: list[int]) -> tuple[Bools, list[np.ndarray]]:
        """Which of N messages have this layout (N,), and the numbers of these (M,) at each of the `marks`.

        Numbers are int64 where all are whole ones, or else float64.
        """
        ...


class JsonLayout:
    """Where the numbers stand in the texts of messages in JSON, whose other characters are the same."""

    def __init__(self, data: bytes) -> None:
        """The layout of the message `data`; `ValueError` where it is no JSON, or its numbers cannot be told apart."""
        if len(data) > MAX_TEXT_BYTES or b"\0" in data:
            raise ValueError("no short text")
        tokens = [m for m in STRING_OR_NUMBER.finditer(data) if m[0][:1] != b'"']
        values = iter(range(len(tokens)))
        self.message = json.loads(
            data, parse_int=lambda text: _marked(int(text), next(values)),
            parse_float=lambda text: _marked(float(text), next(values)),
        )  # fmt: skip
        if next(values, None) is not None:
            raise ValueError("numbers are not where they seem")
        self.whole = [re.fullmatch(WHOLE_NUMBER, m[0]) is not None for m in tokens]
        edges = [0, *chain.from_iterable(m.span() for m in tokens), len(data)]
        self.literals = [re.escape(data[a:b]) for a, b in zip(edges[::2], edges[1::2], strict=True)]

    def read(self, stored: StoredMessages, marks: list[int]) -> tuple[Bools, list[np.ndarray]]:
        """Which of N messages have this layout (N,), and the numbers of these (M,) at each of the `marks`."""
        pattern, order = self.literals[0], list[int]()
        for k, literal in enumerate(self.literals[1:]):
            pattern += (rb"(%b)" if k in marks else rb"%b") % NUMBER + literal
            order += [k] if k in marks else []
        match, content = re.compile(pattern, re.DOTALL).fullmatch, stored.content
        same, parts = np.zeros(len(stored.begins), dtype=bool), list[list[np.ndarray]]()
        for at in range(0, len(same), BLOCK_MESSAGES):
            # texts of numbers take much more memory than numbers
            block = slice(at, at + BLOCK_MESSAGES)
            found = list(map(match, repeat(content), stored.begins[block].tolist(), stored.ends[block].tolist()))
            same[block] = [m is not None for m in found]
            columns = zip(*(m.groups() for m in found if m), strict=True)
            parts.append([_numbers(texts, self.whole[k]) for texts, k in zip(columns, order, strict=False)])
        joined = {k: np.concatenate([part[i] for part in parts if part] or [np.empty(0)]) for i, k in enumerate(order)}
        return same, [joined[k] for k in marks]


def _numbers(texts: tuple[bytes, ...], whole: bool) -> np.ndarray:
    """The numbers (M,) of these texts, int64 where they are `whole` in all of them, or else float64."""
    if whole:
        try:
            return np.fromiter(map(int, texts), dtype=np.int64, count=len(texts))
        except (ValueError, OverflowError):
            pass
    return np.fromiter(map(float, texts), dtype=float, count=len(texts))


class _Number(NamedTuple):
    """Where a number stands in a binary message."""

    begin: int
    letter: str  # of `struct`


class _MarkingCursor(Cursor):
    """A place in a message of ROS, whose numbers are read with marks, and which knows what may differ elsewhere."""

    __slots__ = ("free", "places")

    def __init__(self, data: bytes, ros_1: bool) -> None:
        """The place behind the message's head."""
        super().__init__(data, ros_1)
        self.places, self.free = list[_Number](), np.zeros(len(data), dtype=bool)

    def numbers(self, letter: str, count: int) -> tuple[Any, ...]:
        """The next `count` numbers, each with its mark."""
        before = self.at
        values = super().numbers(letter, count)
        size = struct.calcsize(letter)
        first = self.at - count * size
        # what lies between two fields means nothing
        self.free[before : self.at] = True
        marks = range(len(self.places), len(self.places) + count)
        self.places += [_Number(first + k * size, letter) for k in range(count)]
        return tuple(_marked(value, mark) for value, mark in zip(values, marks, strict=True))

    def length(self) -> int:
        """The length of the next list or text, which no other message may have otherwise."""
        n = super().length()
        self.free[self.at - struct.calcsize("I") : self.at] = False
        return n


class RosLayout:
    """Where the numbers stand in the bytes of messages of ROS."""

    def __init__(self, data: bytes, read: Reader, ros_1: bool) -> None:
        """The layout of the message `data` of a type that `read` reads; the same error as of that where it is none."""
        cursor = _MarkingCursor(data, ros_1)
        self.message, self.places, self.order = read(cursor), cursor.places, cursor.order
        self.fixed = np.flatnonzero(~cursor.free)
        self.template = np.frombuffer(data, dtype=np.uint8)

    def read(self, stored: StoredMessages, marks: list[int]) -> tuple[Bools, list[np.ndarray]]:
        """Which of N messages have this layout (N,), and the numbers of these (M,) at each of the `marks`."""
        size = len(self.template)
        same = stored.ends - stored.begins == size
        rows, every = np.flatnonzero(same), np.frombuffer(stored.content, dtype=np.uint8)
        columns: list[list[np.ndarray]] = [[] for _ in marks]
        for some in np.split(rows, np.arange(0, len(rows), max(1, BLOCK_BYTES // size))[1:]):
            block = every[stored.begins[some][:, None] + np.arange(size)]
            alike = (block[:, self.fixed] == self.template[self.fixed]).all(axis=1)
            same[some] = alike
            for column, k in zip(columns, marks, strict=True):
                begin, letter = self.places[k]
                raw = np.ascontiguousarray(block[alike, begin : begin + struct.calcsize(letter)])
                numbers = raw.view(np.dtype(f"{self.order}{letter}"))[:, 0]
                # a signalling NaN of 32 bits is one of 64 bits, too
                with np.errstate(invalid="ignore"):
                    fits = letter not in "fd" and not (letter == "Q" and (numbers > np.iinfo(np.int64).max).any())
                    column.append(numbers.astype(np.int64 if fits else float))
        return same, [np.concatenate(column) for column in columns]
