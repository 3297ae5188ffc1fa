"""Numbers and stamps of a topic's messages as tables: as arrays where messages have one layout, else one by one."""

from array import array
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.recording.formats.fixed_layout import FixedLayout, MarkedFloat, MarkedInt
from bcid.recording.formats.limits import MCAP as LIMITS
from bcid.recording.formats.mcap_contents import McapContents
from bcid.recording.formats.message_fields import MissingField, chooses_item, get_field
from bcid.recording.formats.message_stamps import (
    NS_PER_S,
    PARTS_NS,
    STAMP_PATHS,
    WHOLE_SECONDS,
    PlainStamp,
    Stamp,
)
from bcid.recording.formats.message_store import StoredMessages

BLOCK_MESSAGES = 1 << 14  # that are read at a time, as arrays of all would need several times their memory
MAX_LAYOUTS = 4  # that are tried: bodies, or senders, which share a topic
MAX_SECONDS = 9_000_000_000  # whose nanoseconds fit into 64 bits


class NumberTable:
    """Rows of numbers with their times, as they come from messages, in few bytes."""

    def __init__(self, width: int) -> None:
        """No rows yet, of `width` numbers each."""
        self.width, self.log_ns, self.stamps = width, list[int](), list[Stamp]()
        self._numbers = array("d")

    def add(self, log_ns: int, stamp: Stamp, row: Iterable[float]) -> None:
        """Add a row, logged at `log_ns`."""
        self.log_ns.append(log_ns)
        self.stamps.append(stamp)
        self._numbers.extend(row)

    def add_all(self, log_ns: list[int], stamps: list[Stamp], rows: Floats) -> None:
        """Add rows (N, width), logged at `log_ns`."""
        self.log_ns += log_ns
        self.stamps += stamps
        self._numbers.frombytes(np.ascontiguousarray(rows, dtype=float).data.cast("B"))

    @property
    def rows(self) -> Floats:
        """The numbers (N, width), which stay where they are: no row can be added while they are in use."""
        return np.frombuffer(self._numbers, dtype=float).reshape(len(self.log_ns), self.width)

    @property
    def logged_s(self) -> Floats:
        """The log times (N,) in s from the first."""
        return np.array([ns - self.log_ns[0] for ns in self.log_ns], dtype=float) / 1e9


class NumberFields(NamedTuple):
    """Paths of what is read of each message: numbers, and perhaps the name of a body."""

    names: list[str]
    body: str | None = None
    stamped: bool = True
    stamp: str | None = None  # None for the usual places

    def stamp_of(self, message: Any) -> Any:
        """What stands in a decoded message where its stamp belongs; None where it has none, or none is wanted."""
        if not self.stamped:
            return None
        if self.stamp is not None:
            return get_field(message, self.stamp)
        every = (get_field(message, path, None) for path in STAMP_PATHS)
        return next((stamp for stamp in every if stamp is not None), None)


class BodyRow(NamedTuple):
    """What is read of one message: the name of its body, or "", its stamp and its numbers."""

    body: str
    stamp: Stamp
    numbers: list[float]


def read_number_tables(
    contents: McapContents, topic: str, fields: NumberFields, read: Callable[[Any], BodyRow]
) -> dict[str, NumberTable]:
    """The numbers of a topic's messages at `fields`, in a table for each body, in the order of their first messages.

    `read` takes the same from a decoded message that has no layout of its own, and raises what is wrong with it.

    Raises:
        InputRefused: a message cannot be read.
    """
    stored = contents.stored_messages(topic)
    rows, stamps = np.full((len(stored.begins), len(fields.names)), np.nan), np.empty(len(stored.begins), dtype=object)
    body, bodies = np.full(len(rows), -1), dict[str, int]()
    left = np.arange(len(rows))
    for k in range(MAX_LAYOUTS):
        if not len(left):
            break
        like = int(left[k * len(left) // MAX_LAYOUTS])
        layout = contents.fixed_layout(topic, stored, like)
        places = None if layout is None else _find_places(layout, fields)
        if layout is None or places is None:
            continue
        # another channel of the topic may have another schema
        mine = left[stored.channels[left] == stored.channels[like]]
        number, read_ones = bodies.setdefault(places.body, len(bodies)), np.zeros(len(stored.begins), dtype=bool)
        for block in np.split(mine, np.arange(BLOCK_MESSAGES, len(mine), BLOCK_MESSAGES)):
            alike, values, of_rows = _read_alike(layout, places, stored.select(block))
            own = block[alike]
            rows[own], stamps[own], body[own], read_ones[own] = values, of_rows, number, True
        left = left[~read_ones[left]]
    for row, (name, stamp, numbers) in contents.read_rows(topic, stored, left, read):
        rows[row], stamps[row] = numbers, stamp
        body[row] = bodies.setdefault(name, len(bodies))
    # large, and no longer needed
    log_ns = stored.log_ns
    del stored, left
    tables = dict[str, NumberTable]()
    # bodies by their first messages
    for name, number in sorted(bodies.items(), key=lambda item: int(np.argmax(body == item[1]))):
        own = np.flatnonzero(body == number)
        if len(own):
            tables[name] = NumberTable(len(fields.names))
            own_rows = rows if len(own) == len(rows) else rows[own]
            tables[name].add_all(log_ns[own].tolist(), stamps[own].tolist(), own_rows)
    return tables


class _Places(NamedTuple):
    """The marks of the numbers and of the stamp in a layout, the unit (ns) of its second mark, and the body's name."""

    numbers: list[int]
    stamp: list[int]  # none, a plain number, or whole seconds and perhaps the part of a second
    is_plain: bool
    part_ns: int
    body: str


def _find_places(layout: FixedLayout, fields: NumberFields) -> _Places | None:
    """Where a layout has the `fields`; None where it lacks one, or where one is no plain number."""
    paths = [*fields.names, fields.body or "", fields.stamp or ""]
    if any(chooses_item(path) for path in paths):
        return None
    try:
        numbers = [get_field(layout.message, name) for name in fields.names]
        stamp = fields.stamp_of(layout.message)
        body = "" if fields.body is None else get_field(layout.message, fields.body, "")
    except MissingField:
        return None
    if not isinstance(body, str) or not all(isinstance(n, MarkedInt | MarkedFloat) for n in numbers):
        return None
    marks = [n.mark for n in numbers]
    if stamp is None:
        return _Places(marks, [], False, 1, body)
    if isinstance(stamp, MarkedInt | MarkedFloat):
        return _Places(marks, [stamp.mark], True, 1, body)
    if not isinstance(stamp, Mapping):
        return None
    whole = next((stamp[name] for name in WHOLE_SECONDS if stamp.get(name) is not None), None)
    parts = {name: stamp[name] for name in PARTS_NS if stamp.get(name) is not None}
    if len(parts) > 1 or not all(isinstance(n, MarkedInt) for n in (whole, *parts.values())):
        return None
    unit = next((PARTS_NS[name] for name in parts), 1)
    return _Places(marks, [n.mark for n in (whole, *parts.values()) if n is not None], False, unit, body)


def _read_alike(layout: FixedLayout, places: _Places, stored: StoredMessages) -> tuple[Bools, Floats, Any]:
    """Which of N messages have the layout and a stamp that is a time (N,), the numbers (M, n) and stamps of these."""
    every = sorted({*places.numbers, *places.stamp})
    alike, columns = layout.read(stored, every)
    at = dict(zip(every, columns, strict=True))
    values = np.array([at[k] for k in places.numbers], dtype=float).reshape(len(places.numbers), alike.sum()).T
    # what is no number, or too large for one
    values[~np.isfinite(values)] = np.inf
    good, stamps = _stamps([at[k] for k in places.stamp], places, len(values))
    alike[np.flatnonzero(alike)[~good]] = False
    return alike, values[good], stamps[good]


def _stamps(columns: list[np.ndarray], places: _Places, count: int) -> tuple[Bools, Any]:
    """Which of the stamps (M,) in these columns are times, as they are parsed one by one; and all, as objects (M,)."""
    stamps = np.empty(count, dtype=object)
    good = np.ones(count, dtype=bool)
    if places.is_plain:
        stamps[:] = list(map(PlainStamp, columns[0].tolist()))
        good = np.abs(columns[0].astype(float)) < LIMITS.max_plain_stamp
    elif columns:
        whole, part = columns[0], columns[1] if len(columns) > 1 else np.zeros(count, dtype=np.int64)
        if whole.dtype != np.int64 or part.dtype != np.int64:
            return np.zeros(count, dtype=bool), stamps
        good = (np.abs(whole) < MAX_SECONDS) & (part >= 0) & (part < NS_PER_S // places.part_ns)
        stamps[good] = (whole[good] * NS_PER_S + part[good] * places.part_ns).tolist()
    return good, stamps
