"""Stamps of rows in the notations of loggers: numbers, dates, clock times, time spans, seconds with nanoseconds."""

import re
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt
import pandas as pd

from bcid.aliases import Floats, Ints
from bcid.recording.formats.limits import STAMP as LIMITS
from bcid.recording.formats.numbers import blank_long_cells, parse_numbers

NANOSECONDS = 1_000_000_000
DAY_S, HOUR_S = 86_400.0, 3_600.0
MOMENT_UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}  # of pandas' dates
NO_PAIR = "the part of a second has 0 to 999999999 ns: map the column that holds it, or mend such rows"
NO_STAMP = (
    'write seconds, or dates such as 2026-05-04T14:15:30.125Z, and map another unit: { from = "…", gain = 0.001 }'
)

ZONE = r"\s?(?:Z|UTC|[+-]\d{2}:?\d{2})"
ISO_DATE = rf"\d{{4}}-\d{{2}}-\d{{2}}[T ]\d{{2}}:\d{{2}}:\d{{2}}(?:[.,]\d+)?(?:{ZONE})?"
CLOCK_TIME = (
    r"(?:\d{1,4}[./-]\d{1,2}[./-]\d{1,4}[T ,]+)?"
    r"(?P<h>\d{1,3})[:.](?P<m>\d{2})[:.](?P<s>\d{2}(?:[.,]\d+)?)\s?(?P<half>[AaPp]\.?[Mm]\.?)?"
)
"""A clock time, perhaps after a date whose order of day and month nobody knows; a take is no longer than a day."""
MINUTES = r"(?P<h>)(?P<m>\d{1,4}):(?P<s>\d{2}[.,]\d+)(?P<half>)"
PAIR_IN_A_CELL = (
    r".*?\bs(?:ecs?|econds)?['\"]?\s*[:=]\s*(?P<sec>\d+)\s*,\s*"
    r"['\"]?n(?:secs?|anos|anosecs?|anoseconds)['\"]?\s*[:=]\s*(?P<nanosec>\d+)\W*"
)
PAIRED_NAME = re.compile(r"(?P<stem>.*?)(?:secs?|seconds)", re.IGNORECASE)
PAIRED_NAMES = [
    ("sec", "nanosec"),
    ("secs", "nsecs"),
    ("sec", "nsec"),
    ("seconds", "nanos"),
    ("seconds", "nanoseconds"),
]

Kind = Literal["number", "date", "clock", "span"]


class Stamps(NamedTuple):
    """Stamps of N rows as seconds (N,) since `origin_s`, NaN where blank; those of `bad_rows` could not be read.

    `origin_s` counts from 1970 for dates, from midnight for clock times, else from the file's own zero.
    """

    kind: Kind
    origin_s: float
    seconds: Floats
    bad_rows: Ints = np.zeros(0, dtype=np.int64)
    notes: tuple[str, ...] = ()  # what was mended, in words
    zoned: bool = True  # whether the seconds are the same in all time zones


def parse_stamps(cells: pd.Series, gain: float = 1.0, decimal: str = ".") -> Stamps:
    """The stamps of a table's column; plain numbers have the unit `gain` (s), and ms, µs or ns if they are Unix times.

    Clock times that pass midnight, and local dates at the end of summer time, go on from there.
    """
    if cells.dtype.kind == "M":
        zone = getattr(cells.dt, "tz", None)
        utc = cells.dt.tz_convert("UTC").dt.tz_localize(None) if zone is not None else cells
        return _dates(utc, zoned=zone is not None)
    if cells.dtype.kind == "m":
        return _since_first("span", cells.dt.total_seconds().to_numpy(dtype=float), 1.0)
    numbers = parse_numbers(cells, decimal)
    if not len(numbers.bad_rows):
        raw = cells.to_numpy() if cells.dtype.kind in "iu" else numbers.values
        notes = (f"numbers with {numbers.notation}",) if numbers.notation else ()
        return _number_stamps(raw, gain)._replace(notes=notes) if notes else _number_stamps(raw, gain)
    blank = cells.isna()
    text = cells.where(blank, blank_long_cells(cells.astype(str).str.strip()))
    if text[~blank].str.fullmatch(ISO_DATE).all():
        zones = text[~blank].str.fullmatch(f".*{ZONE}")
        if zones.all() or not zones.any():
            plain = text.str.replace(",", ".", regex=False).str.replace(r"\s?UTC$", "Z", regex=True)
            dates = pd.to_datetime(plain, format="ISO8601", utc=True, errors="coerce")
            return _dates(dates.dt.tz_localize(None), zoned=bool(zones.all()))
    for pattern in (CLOCK_TIME, MINUTES):
        if text[~blank].str.fullmatch(pattern).all():
            return _clock_times(text, pattern)
    if text[~blank].str.fullmatch(PAIR_IN_A_CELL).all():
        pair = text.str.extract(PAIR_IN_A_CELL)
        return pair_stamps(pd.to_numeric(pair["sec"]), pd.to_numeric(pair["nanosec"]))
    return Stamps("number", 0.0, numbers.values, numbers.bad_rows)


def pair_stamps(sec: pd.Series, nanosec: pd.Series) -> Stamps:
    """The stamps of two columns, of whole seconds and of the nanoseconds beyond them.

    Rows whose nanoseconds are below zero or make a second or more are bad ones: the column holds something else.
    """
    parts = parse_numbers(sec), parse_numbers(nanosec)
    whole, part = (p.values for p in parts)
    outside = np.flatnonzero(np.isfinite(part) & ~((part >= 0.0) & (part < NANOSECONDS)))
    bad = np.unique(np.concatenate([*(p.bad_rows for p in parts), outside]))
    known = np.isfinite(whole) & np.isfinite(part)
    origin = float(whole[known][0]) if known.any() else 0.0
    seconds = np.where(known, (whole - origin) + part / NANOSECONDS, np.nan)
    return Stamps("number", origin, seconds, bad)


def find_pair(name: str, names: Sequence[str]) -> tuple[str, str] | None:
    """The columns of seconds and nanoseconds that `name` stands for: its own parts, or itself and its neighbour."""
    if name not in names:
        pairs = [(f"{name}{dot}{sec}", f"{name}{dot}{nano}") for dot in "._/" for sec, nano in PAIRED_NAMES]
    elif match := PAIRED_NAME.fullmatch(name):
        pairs = [(name, match["stem"] + nano) for nano in dict.fromkeys(nano for _, nano in PAIRED_NAMES)]
    else:
        return None
    return next((pair for pair in pairs if pair[0] in names and pair[1] in names), None)


def _since_first(kind: Kind, raw: npt.NDArray[np.generic], unit_s: float, zoned: bool = True) -> Stamps:
    """Stamps of raw times (N,) in units of `unit_s`, subtracted as they are, so that no digits are lost."""
    finite = np.flatnonzero(np.isfinite(raw.astype(float)))
    if not len(finite):
        return Stamps(kind, 0.0, np.full(len(raw), np.nan), zoned=zoned)
    first = raw[finite[0]]
    # whole numbers of 64 bits wrap round, and so their differences are right
    with np.errstate(invalid="ignore", over="ignore"):
        apart = (raw.astype(np.int64) - np.int64(first)) if raw.dtype.kind in "iu" else raw - first
    return Stamps(kind, float(first) * unit_s, apart.astype(float) * unit_s, zoned=zoned)


def _number_stamps(raw: npt.NDArray[np.generic], gain: float) -> Stamps:
    """Stamps of plain numbers (N,) in units of `gain` (s), or Unix times in ms, µs or ns where they can be no others.

    Seconds of the day that pass midnight go on from there.
    """
    size = np.abs(raw.astype(float))
    typical = float(np.median(size[np.isfinite(size)])) if np.isfinite(size).any() else 0.0
    for unit_s, name in ((1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns")):
        if gain == 1.0 and LIMITS.min_unix_s <= typical * unit_s <= LIMITS.max_unix_s:
            found = _since_first("number", raw, unit_s)
            return found._replace(notes=(f"stamps are {name} since 1970",))
    found = _since_first("number", raw, gain)
    of_day = found.origin_s + found.seconds
    inside = (of_day[np.isfinite(of_day)] >= 0.0) & (of_day[np.isfinite(of_day)] < DAY_S)
    return _unwrap(found, DAY_S, "the clock passes midnight") if inside.all() else found


def _dates(dates: pd.Series, zoned: bool) -> Stamps:
    """Stamps of dates without zone (N,), which are UTC if `zoned`, else local times, whose summer time may end."""
    moments = dates.to_numpy()
    unit_s = MOMENT_UNITS_S[np.datetime_data(moments.dtype)[0]]
    known = ~np.isnat(moments)
    seconds, origin_s = np.full(len(moments), np.nan), 0.0
    if known.any():
        part = _since_first("date", moments[known].astype(np.int64), unit_s)
        seconds[known], origin_s = part.seconds, part.origin_s
    found = Stamps("date", origin_s, seconds, zoned=zoned)
    return found if zoned else _unwrap(found, HOUR_S, "local time is set back by an hour: summer time ends")


def _clock_times(text: "pd.Series[str]", pattern: str) -> Stamps:
    """Stamps of clock times written by `pattern`, in 24 hours or with AM and PM."""
    part = text.str.extract(pattern)
    hours, minutes = pd.to_numeric(part["h"]).fillna(0.0), pd.to_numeric(part["m"])
    seconds = pd.to_numeric(part["s"].str.replace(",", ".", regex=False))
    half = part["half"].fillna("").str[:1].str.upper()
    hours = hours.where(half == "", hours % 12 + 12.0 * (half == "P"))
    found = _since_first("clock", (3600.0 * hours + 60.0 * minutes + seconds).to_numpy(dtype=float), 1.0, zoned=False)
    if pattern == MINUTES:
        return _unwrap(found, HOUR_S, "minutes begin anew at the full hour")
    return _unwrap(found, DAY_S, "the clock passes midnight")


def _unwrap(stamps: Stamps, period_s: float, note: str) -> Stamps:
    """The stamps with `period_s` added from each step back by that much on, and `note` if there is one."""
    seconds = stamps.seconds.copy()
    known = np.flatnonzero(np.isfinite(seconds))
    back = np.abs(np.diff(seconds[known]) + period_s) < LIMITS.max_wrap_pause_s
    if not back.any():
        return stamps
    seconds[known] += period_s * np.r_[0, np.cumsum(back)]
    return stamps._replace(seconds=seconds, notes=(*stamps.notes, note))
