"""Stamps of messages, in the notations of ROS, protobuf, JSON and text, as whole nanoseconds.

A plain number says no unit: it is taken as seconds, milliseconds, microseconds or nanoseconds, whichever lets a topic's
stamps span as long as its log times, or else has them lie after 1973.
"""

import datetime as dt
import math
import re
from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from bcid.errors import InputRefused
from bcid.recording.formats.limits import MCAP as LIMITS
from bcid.recording.formats.message_fields import NUMBER_TEXT, get_field
from bcid.recording.formats.names import printable_name

NS_PER_S = 1_000_000_000
STAMP_PATHS = ("header.stamp", "timestamp", "stamp", "time_s")
"""Where messages have their stamps."""
WHOLE_SECONDS = ("sec", "secs", "seconds", "s")
PARTS_NS = {
    "nanosec": 1, "nsec": 1, "nsecs": 1, "nanos": 1, "nanosecs": 1, "nanoseconds": 1, "ns": 1, "usec": 1000,
    "usecs": 1000, "micros": 1000, "microseconds": 1000,
}  # fmt: skip
"""Names of the part of a second beside the whole ones, with its unit in ns."""
UNITS_NS = {"s": NS_PER_S, "ms": 1_000_000, "µs": 1_000, "ns": 1}
DATE = re.compile(
    r"\s*(\d{4})-(\d\d)-(\d\d)[Tt ](\d\d):(\d\d):(\d\d)(?:[.,](\d{1,12}))?"
    r"(?:\s*(?:([Zz]|UTC)|([+-])(\d\d):?(\d\d)))?\s*\Z",
    re.ASCII,
)
"""RFC 3339, and ISO 8601 without an offset, which is read as UTC."""


class UnreadableStamp(Exception):
    """A stamp in no notation that is read."""

    def __init__(self, stamp: Any) -> None:
        """What stands there."""
        super().__init__(f"its stamp {printable_name(repr(stamp))} is in no notation that is read")


class PlainStamp(NamedTuple):
    """A stamp that is a plain number, whose unit only its neighbours show."""

    value: int | float | Decimal


Stamp = int | PlainStamp | None
"""A stamp in ns, or a plain number; None where a message carries none."""


def parse_stamp(stamp: Any) -> Stamp:
    """A stamp as {sec, nanosec} or alike, text with a date, or a plain number; None where there is nothing.

    Raises:
        UnreadableStamp: something stands there that is none of these, no finite number, or a part of a second that is
            below zero or makes a whole one.
    """
    if stamp is None or (isinstance(stamp, Mapping) and not stamp):
        return None
    if _is_finite_number(stamp):
        return PlainStamp(stamp)
    if isinstance(stamp, str):
        return _parse_text(stamp)
    whole = next((v for name in WHOLE_SECONDS if (v := get_field(stamp, name, None)) is not None), None)
    parts = {name: v for name in PARTS_NS if (v := get_field(stamp, name, None)) is not None}
    if whole is None or len(parts) > 1 or not all(_is_finite_number(v) for v in (whole, *parts.values())):
        raise UnreadableStamp(stamp)
    part_ns = sum(_nanoseconds(v, PARTS_NS[name]) for name, v in parts.items())
    # what is no part of a second is no stamp of this notation
    if not 0 <= part_ns < NS_PER_S:
        raise UnreadableStamp(stamp)
    return _nanoseconds(whole, NS_PER_S) + part_ns


def _is_finite_number(value: Any) -> bool:
    """Whether a value is a finite number of fewer digits than would be no time, and no truth value."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    # false for NaN
    return abs(value) < LIMITS.max_plain_stamp


def _nanoseconds(value: float | Decimal, unit_ns: int) -> int:
    """A number of units of `unit_ns` ns each, as whole ns; exact for what stands in the file, as floats lose digits."""
    if isinstance(value, float):
        value = Decimal(repr(value))
    return value * unit_ns if isinstance(value, int) else round(value * unit_ns)


def _parse_text(text: str) -> Stamp:
    """A stamp that is written as a decimal number, or as a date and time with or without an offset from UTC."""
    if NUMBER_TEXT.match(text):
        value = Decimal(text.strip())
        # a text such as 1e999999 would make an integer as long
        if abs(value.adjusted()) > math.log10(LIMITS.max_plain_stamp):
            raise UnreadableStamp(text)
        return PlainStamp(value)
    match = DATE.match(text)
    if match is None:
        raise UnreadableStamp(text)
    *whole, fraction, _, sign, hours, minutes = match.groups()
    year, month, day, hour, minute, second = map(int, whole)
    try:
        moment = dt.datetime(year, month, day, hour, minute, second, tzinfo=dt.UTC)
    except ValueError:
        raise UnreadableStamp(text) from None
    since = moment - dt.datetime(1970, 1, 1, tzinfo=dt.UTC)
    ahead_s = (1 if sign == "+" else -1) * (3600 * int(hours) + 60 * int(minutes)) if sign else 0
    part_ns = int((fraction or "").ljust(9, "0")[:9])
    return (since.days * 86400 + since.seconds - ahead_s) * NS_PER_S + part_ns


def message_stamp(message: Any) -> Stamp:
    """The stamp of a message, in its `header.stamp`, `timestamp`, `stamp` or `time_s`; None where it has none.

    Raises:
        UnreadableStamp: something stands there that is no stamp.
    """
    for path in STAMP_PATHS:
        stamp = get_field(message, path, None)
        if stamp is not None:
            return parse_stamp(stamp)
    return None


def resolve_stamps(stamps: Sequence[Stamp], log_ns: Sequence[int], topic: str, path: Path) -> list[int | None]:
    """A topic's stamps as whole ns, None where there is none; plain numbers in the unit that all of them show.

    Raises:
        InputRefused: the unit of plain numbers cannot be told.
    """
    if PlainStamp not in set(map(type, stamps)):
        return list(cast("Sequence[int | None]", stamps))
    plain = [s.value for s in stamps if isinstance(s, PlainStamp)]
    unit = _plain_unit_ns(plain, log_ns) if plain else NS_PER_S
    if unit is None:
        span, logged_s = float(max(plain)) - float(min(plain)), (max(log_ns) - min(log_ns)) / 1e9
        cause = f"are plain numbers over {span:.6g}, and log times over {logged_s:.6g} s: in which unit?"
        step = 'write them in seconds, or set topics.time = "log"'
        raise InputRefused(path, f"stamps of topic {printable_name(topic)}", cause, step)
    return [_nanoseconds(s.value, unit) if isinstance(s, PlainStamp) else s for s in stamps]


def _plain_unit_ns(plain: Sequence[float | Decimal], log_ns: Sequence[int]) -> int | None:
    """The unit (ns) of stamps that are plain numbers, by their span or else their size; None where neither shows it."""
    values = np.array([float(v) for v in plain])
    span, logged_ns = (float(np.ptp(np.quantile(x, [0.05, 0.95]))) for x in (values, np.array(log_ns, dtype=float)))
    usual = abs(float(np.median(values)))
    dated = (ns for ns in sorted(UNITS_NS.values()) if LIMITS.min_dated_ns < usual * ns < LIMITS.max_stamp_ns)
    by_size = next(dated, None)
    if span == 0.0 or logged_ns == 0.0:
        return by_size or NS_PER_S
    ratio = LIMITS.max_span_ratio
    by_span = next((ns for ns in UNITS_NS.values() if 1.0 / ratio < span * ns / logged_ns < ratio), None)
    return by_span or by_size
