"""What all readers share: the raw take that they return, the identity of files, and the mapping of fields to SI."""

import difflib
import hashlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats
from bcid.mapping import FieldMapping
from bcid.recording.formats.detect import check_nonempty_file
from bcid.recording.formats.names import printable_name
from bcid.recording.types import Irregularity, SourceFile

LONGEST_TAKE_S = 86_400.0
"""Time (s) from a take's usual stamps beyond which a stamp is none of it, such as a zero amid seconds since 1970."""


def earliest_s(time_s: Floats) -> float:
    """The earliest of the times (N,) in s of a take's rows, which may stand in any order; 0 of none at all."""
    if not len(time_s):
        return 0.0
    usual = time_s[np.abs(time_s - np.median(time_s)) <= LONGEST_TAKE_S]
    return float((usual if len(usual) else time_s).min())


@dataclass(frozen=True)
class RawTake:
    """Streams in SI units on the floor's axes as they stand in the files, unchecked; blank samples are NaN rows."""

    name: str
    sources: tuple[SourceFile, ...]
    pose_time_s: Floats  # (N,)
    pose: Floats  # (N, 3) of the tracked body
    command_time_s: Floats  # (M,)
    command: Floats  # (M, 2)
    rate_hz: float | None = None  # where the file states one
    channels: Mapping[str, tuple[Floats, Floats]] = field(default_factory=dict)
    irregularities: tuple[Irregularity, ...] = ()
    splits_s: tuple[float, ...] = ()  # pose times at which a new segment begins, whatever the poses show
    several_command_publishers: bool = False  # by the file's own channels
    first_pose_s: float | None = None  # of the whole take, where only a part of it was read


class TimeCut(NamedTuple):
    """A part of a take: from `begin_s` to `end_s` after its first pose."""

    begin_s: float
    end_s: float  # infinite where the take goes on to its end


def identify_file(path: Path, format_name: str) -> SourceFile:
    """Path, SHA-256 digest and format (`format_name`) of a file; `InputRefused` where it is no file or empty."""
    check_nonempty_file(path)
    with path.open("rb") as file:
        return SourceFile(str(path), hashlib.file_digest(file, "sha256").hexdigest(), format_name)


def nearest_hint(name: str, names: Iterable[str]) -> str:
    """The part "; nearest: ..." of a message about an unknown `name`; empty where none of `names` resembles it."""
    near = difflib.get_close_matches(name, list(names), n=1)
    return f"; nearest: {printable_name(near[0])}" if near else ""


def map_field(field: FieldMapping, column: Callable[[str], Floats]) -> Floats:
    """SI values (N,) of a logged field: gain * dead_zone(raw) + offset or a calibration curve, clipped to [low, high].

    Args:
        field: the mapping; its dead zone takes up to `dead_zone` off |raw|, calibration points are joined by straight
            lines, and values are set to zero where another field meets the condition `zero_where`.
        column: looks up the raw values (N,) of a field by its name; NaN and infinite ones stay as they are.
    """
    raw = column(field.source)
    known = np.isfinite(raw)
    if field.points is not None:
        mapped = np.interp(raw[known], *np.transpose(field.points))
    else:
        beyond = np.sign(raw[known]) * np.maximum(np.abs(raw[known]) - field.dead_zone, 0.0)
        gain_negative = field.gain if field.gain_negative is None else field.gain_negative
        mapped = np.where(beyond < 0.0, gain_negative, field.gain) * beyond
    values = np.array(raw, dtype=float)
    values[known] = np.clip(mapped + field.offset, field.low, field.high)
    if field.zero_where is not None:
        values = np.where(column(field.zero_where.field) == field.zero_where.equals, 0.0, values)
    return values


def raw_field_names(fields: Iterable[FieldMapping]) -> list[str]:
    """The names of the logged fields or columns that these mappings to SI units read, each once."""
    names = [name for f in fields for name in (f.source, f.zero_where.field if f.zero_where else None) if name]
    return list(dict.fromkeys(names))
