"""ROS messages, read by the definitions that the file carries: these are bounded before anything is built.

A definition names each field and its type, line by line (docs.ros.org: About ROS 2 interfaces); the types that it uses
follow after lines of `=`.  CDR (OMG DDSI-RTPS, clause 10), the encoding of ROS 2, writes the fields one after the
other, each number aligned to its size, lists and texts after their length.  ROS 1 writes them so without a head and
without alignment (wiki.ros.org: msg), and nothing for a message without fields.
"""

import re
import struct
from collections.abc import Callable
from typing import Any, NamedTuple

from bcid.recording.formats.limits import MESSAGE as LIMITS

NUMBERS = {
    "bool": "?", "byte": "B", "char": "B", "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i",
    "uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d",
}  # fmt: skip
"""The letter of `struct` for each type of number."""
TEXT = "string"
FIELD_LINE = re.compile(r"([A-Za-z][\w/]*)(?:<=\d+)?(\[(<=)?(\d*)\])?\s+([A-Za-z]\w*)\s*(=?)")
TYPE_LINE = re.compile(r"MSG:\s+(\S+)\s*\Z")
RULE_LINE = re.compile(r"={3,}\s*\Z")
TIME = "int32 sec\nuint32 nanosec"
WELL_KNOWN = {"builtin_interfaces/Time": TIME, "builtin_interfaces/Duration": TIME, "time": TIME, "duration": TIME}
"""Types that a definition need not define; the last two are those of ROS 1."""
ENCAPSULATIONS = {0: (">", 8), 1: ("<", 8), 6: (">", 4), 7: ("<", 4)}
"""Byte order and largest alignment by the second byte of a message: CDR, and plain CDR 2."""
HEAD_BYTES = 4
SIZE_DIGITS = 12  # of a fixed list: longer ones are too long for any message anyway


class BadDefinition(Exception):
    """A message definition that cannot be read, or that is larger than any real one."""


class BadMessage(Exception):
    """A message that does not agree with its definition."""


class Field(NamedTuple):
    """A field of a message: its name, its type, and how many of it: one (None), a list (-1), or a fixed number."""

    name: str
    type_name: str
    size: int | None


class Cursor:
    """A place in a CDR message, from which numbers and texts are read one after the other."""

    __slots__ = ("at", "data", "list_items", "max_align", "order")

    def __init__(self, data: bytes, ros_1: bool = False) -> None:
        """The place behind a message's head, which messages of ROS 1 do not have."""
        self.data, self.at, self.list_items = data, 0, 0
        self.order, self.max_align = "<", 1
        if not ros_1:
            kind = data[1] if len(data) >= HEAD_BYTES else -1
            if kind not in ENCAPSULATIONS:
                raise BadMessage("its first bytes are none of plain CDR")
            self.at = HEAD_BYTES
            self.order, self.max_align = ENCAPSULATIONS[kind]

    def numbers(self, letter: str, count: int) -> tuple[Any, ...]:
        """The next `count` numbers of the kind `letter` of `struct`."""
        size = struct.calcsize(letter)
        align = min(size, self.max_align)
        at = self.at + (HEAD_BYTES - self.at) % align if count else self.at
        if at + count * size > len(self.data):
            raise BadMessage("it ends inside a field")
        self.at = at + count * size
        return struct.unpack_from(f"{self.order}{count}{letter}", self.data, at)

    def length(self) -> int:
        """The length of the next list or text."""
        n = self.numbers("I", 1)[0]
        return int(n)

    def text(self) -> str:
        """The next text."""
        n, begin = self.length(), self.at
        self.at = begin + n
        if self.at > len(self.data):
            raise BadMessage("it ends inside a text")
        return self.data[begin : self.at].removesuffix(b"\0").decode("utf-8", "replace")

    def count_items(self, n: int) -> None:
        """Count `n` more items of lists; `BadMessage` where the message holds more than `LIMITS.max_list_items`."""
        self.list_items += n
        if self.list_items > LIMITS.max_list_items:
            raise BadMessage(f"it holds lists of {self.list_items} items, {LIMITS.max_list_items} are the most")


Reader = Callable[[Cursor], Any]


def _short_name(name: str) -> str:
    """The name of a message type without its middle part: geometry_msgs/Pose for geometry_msgs/msg/Pose."""
    parts = name.split("/")
    return f"{parts[0]}/{parts[-1]}"


def parse_definition(name: str, text: str) -> dict[str, list[Field]]:
    """The fields of the message type `name` and of all types in its definition `text`, by their short names.

    Raises:
        BadDefinition: a line is no field, or there are more types or fields than `LIMITS` allows.
    """
    if len(text) > LIMITS.max_definition_bytes:
        raise BadDefinition(f"has {len(text)} characters, {LIMITS.max_definition_bytes} are the most")
    types: dict[str, list[Field]] = {}
    current = _short_name(name)
    types[current] = []
    for raw in text.splitlines():
        line = raw.partition("#")[0].strip()
        if RULE_LINE.match(line):
            current = ""
        elif named := TYPE_LINE.match(line):
            current = _short_name(named[1])
            if len(types) >= LIMITS.max_definition_types:
                raise BadDefinition(f"holds more than {LIMITS.max_definition_types} types")
            types[current] = []
        elif line:
            field = _parse_field(line, current)
            if field is not None:
                types.setdefault(current, []).append(field)
    for known, lines in WELL_KNOWN.items():
        types.setdefault(known, [f for line in lines.splitlines() if (f := _parse_field(line, known))])
    return types


def _parse_field(line: str, owner: str) -> Field | None:
    """The field in a line of the definition of the type `owner`; None for a constant."""
    match = FIELD_LINE.match(line)
    if match is None or not owner:
        raise BadDefinition(f"holds the line {line[:40]!r}, which is no field")
    type_name, is_array, bound, size, name, constant = match.groups()
    if constant:
        return None
    if type_name not in NUMBERS and type_name not in (TEXT, "wstring", "time", "duration"):
        package = "std_msgs" if type_name == "Header" else owner.split("/", maxsplit=1)[0]
        type_name = _short_name(type_name if "/" in type_name else f"{package}/{type_name}")
    count = None if not is_array else int(size[:SIZE_DIGITS]) if size and not bound else -1
    if count == 0:
        raise BadDefinition(f"has {name}, a list of nothing")
    return Field(name, type_name, count)


class _Compiler:
    """Turns the fields of all types of a definition into functions that read them, each type once."""

    def __init__(self, types: dict[str, list[Field]], ros_1: bool) -> None:
        """Nothing is compiled yet."""
        self.types, self.path, self.ros_1 = types, list[str](), ros_1
        self.done: dict[str, tuple[Reader, int]] = {}  # reader and least number of bytes by type

    def message(self, type_name: str) -> tuple[Reader, int]:
        """The reader of messages of a type as dicts, and the fewest bytes that one takes."""
        if type_name in self.done:
            return self.done[type_name]
        if type_name in self.path:
            raise BadDefinition(f"defines {type_name} by itself")
        if type_name == "wstring":
            raise BadDefinition("has a wstring, whose width no standard settles")
        if type_name not in self.types:
            raise BadDefinition(f"uses {type_name}, which it does not define")
        if len(self.path) >= LIMITS.max_definition_depth:
            raise BadDefinition(f"is nested deeper than {LIMITS.max_definition_depth} types")
        self.path.append(type_name)
        readers = [(f.name, *self._field(f)) for f in self.types[type_name]]
        self.path.pop()
        # ROS 2 writes a message without fields as one byte
        readers = readers or ([] if self.ros_1 else [("", _read_number("B"), 1)])
        # one at least, so that nothing is without bounds
        least = max(1, sum(size for _, _, size in readers))
        if least > LIMITS.max_message_bytes:
            raise BadDefinition(f"makes {type_name} longer than {LIMITS.max_message_bytes} bytes")
        pairs = tuple((name, read) for name, read, _ in readers)
        self.done[type_name] = (lambda cursor: {name: read(cursor) for name, read in pairs}), least
        return self.done[type_name]

    def _field(self, field: Field) -> tuple[Reader, int]:
        """The reader of a field, and the fewest bytes that it takes."""
        count, letter = field.size, NUMBERS.get(field.type_name)
        if letter:
            size = struct.calcsize(letter)
            if count is None:
                return _read_number(letter), size
            return _read_numbers(letter, count), 4 if count < 0 else size * count
        read, size = (Cursor.text, 4) if field.type_name == TEXT else self.message(field.type_name)
        if count is None:
            return read, size
        return _read_list(read, count, size), 4 if count < 0 else size * count


def _read_number(letter: str) -> Reader:
    """A function that reads one number of the kind `letter` of `struct`."""
    return lambda cursor: cursor.numbers(letter, 1)[0]


def _read_numbers(letter: str, count: int) -> Reader:
    """A function that reads `count` numbers of the kind `letter` of `struct`, or, where negative, as many as stated."""
    return lambda cursor: cursor.numbers(letter, cursor.length() if count < 0 else count)


def _read_list(read: Reader, count: int, least: int) -> Reader:
    """A function that reads `count` items of at least `least` bytes each, or, where negative, as many as stated."""

    def read_items(cursor: Cursor) -> list[Any]:
        n = cursor.length() if count < 0 else count
        if n * least > len(cursor.data) - cursor.at:
            raise BadMessage(f"it states a list of {n} items, which is longer than the message")
        cursor.count_items(n)
        return [read(cursor) for _ in range(n)]

    return read_items


def compile_ros_decoder(name: str, text: str, ros_1: bool = False) -> Callable[[bytes], dict[str, Any]]:
    """A function that decodes a message of the type `name`, defined by `text`, to nested dicts and lists.

    It decodes CDR, the encoding of ROS 2, or that of ROS 1 if `ros_1`.

    Raises:
        BadDefinition: the definition cannot be read, refers to itself, or is larger than any real one; the function
            that is returned raises `BadMessage` where a message does not agree with the definition.
    """
    read = compile_ros_reader(name, text, ros_1)

    def decode(data: bytes) -> dict[str, Any]:
        message: dict[str, Any] = read(Cursor(data, ros_1))
        return message

    return decode


def compile_ros_reader(name: str, text: str, ros_1: bool = False) -> Reader:
    """A function that reads a message of the type `name`, defined by `text`, from a `Cursor` at its beginning.

    Raises:
        BadDefinition: as of `compile_ros_decoder`.
    """
    return _Compiler(parse_definition(name, text), ros_1).message(_short_name(name))[0]
