"""The commands file beside a Motive export: its columns, its units, and where its stamps stand in the take."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from bcid.aliases import Floats
from bcid.errors import InputRefused, Problems
from bcid.mapping import OPTIONAL_CHANNELS, CommandColumns, FieldMapping
from bcid.recording.formats.limits import STAMP as LIMITS
from bcid.recording.formats.logged_table import LoggedTable, read_logged_table
from bcid.recording.formats.names import list_names, printable_name
from bcid.recording.formats.raw import RawTake, identify_file, map_field, raw_field_names
from bcid.recording.formats.stamps import DAY_S, Stamps, find_pair, parse_stamps
from bcid.recording.types import COMMANDS_FORMAT, Irregularity

COMMAND_COLUMNS = ("time_s", "steering_rad", "throttle_mps")
OWN_HEADER = ",".join(COMMAND_COLUMNS)
CAPTURE_START = "capture start"  # what stands for the export's own Capture Start Time


class TakeStart(NamedTuple):
    """What is known of the clock at a take's time zero, by which the stamps of its commands file are placed."""

    capture: str | None = None  # a Motive export's Capture Start Time
    stamp: Stamps | None = None  # that of a table's first pose
    clock_offset_s: float = 0.0  # what the vehicle file's [clock] adds to the commands later on


UNKNOWN_START = TakeStart()


def read_commands_file(path: Path, mapping: CommandColumns | None = None, start: TakeStart = UNKNOWN_START) -> RawTake:
    """The commands [steering, throttle] (M, 2) and channels of a file beside a take's poses; no poses (N = 0).

    Args:
        path: the file; without a mapping its columns are `time_s,steering_rad,throttle_mps`, in seconds from the take's
            frame 0, and those of OPTIONAL_CHANNELS that it has.
        mapping: columns and units by the vehicle file's table [commands].
        start: what is known of the clock at the take's time zero.

    Raises:
        InputRefused: the file or a column is missing, a cell is no number, or stamps count from another zero.
    """
    if not path.exists():
        step = "put the commands beside the export as NAME.commands.csv, or name them with --commands"
        raise InputRefused(path, "commands file", "does not exist", step)
    mapping = mapping or CommandColumns()
    source = identify_file(path, COMMANDS_FORMAT)
    by_name = {name: FieldMapping.model_validate({"from": name}) for name in OPTIONAL_CHANNELS}
    channels = by_name | mapping.channels
    commands = [mapping.steering_rad, mapping.throttle_mps]
    wanted = [*mapping.time_s.columns, *raw_field_names(commands)]
    remedy = f'map the columns in the vehicle file: [commands] time_s = "…", or let the header read {OWN_HEADER}'
    table = read_logged_table(path, [*wanted, *raw_field_names(channels.values())], remedy, mapping.comment)
    channels = {n: f for n, f in channels.items() if n in mapping.channels or f.source in table.columns}
    problems = Problems()
    with problems.gather_refusals():
        stamps, odd_stamps = table.stamps(mapping.time_s)
    with problems.gather_refusals():
        numbers, odd_numbers = table.numbers(raw_field_names([*commands, *channels.values()]))
        table.check_units(mapping, mapping.time_s, 1.0)
    problems.raise_if_any(path)
    if not len(table):
        raise InputRefused(path, "line 2", "holds a header and no commands", "record the commands again")
    time_s, odd_zero = _place_in_take(table, stamps, mapping, start)
    in_si = {n: map_field(f, numbers.__getitem__) for n, f in channels.items()}
    command = np.column_stack([map_field(f, numbers.__getitem__) for f in commands])
    odd = [*table.irregularities, *odd_stamps, *odd_numbers, *odd_zero]
    used = {*table.columns, *OPTIONAL_CHANNELS}
    if extra := [name for name in table.names if name not in used]:
        odd.append(Irregularity("unknown column", "warning", len(extra), f"{path.name} line 1", list_names(extra)))
    no_poses = (np.empty(0), np.empty((0, 3)))
    logged = {n: (time_s, values) for n, values in in_si.items()}
    return RawTake(path.stem, (source,), *no_poses, time_s, command, None, logged, tuple(odd))


def _place_in_take(
    table: LoggedTable, stamps: Stamps, mapping: CommandColumns, start: TakeStart
) -> tuple[Floats, list[Irregularity]]:
    """Times (M,) in s from the take's time zero of a commands file's stamps, and a warning where a guess places them.

    Raises:
        InputRefused: the stamps are dates, clock times or Unix times, and nothing says which of them is frame 0.
    """
    offset, zero = mapping.time_s.offset, mapping.time_zero
    if zero is None and start.stamp is not None:
        if _clock_of(stamps) != _clock_of(start.stamp):
            _refuse_other_zero(table, mapping, start)
        return stamps.seconds + _apart(stamps, stamps.kind, start.stamp.origin_s) + offset, []
    if zero is None:
        begin = stamps.origin_s + offset
        if stamps.kind in ("date", "clock") or abs(begin + start.clock_offset_s) >= LIMITS.min_unix_s:
            _refuse_other_zero(table, mapping, start)
        return stamps.seconds + begin, []
    if zero == CAPTURE_START:
        return _place_by_capture_start(table, stamps, start.capture, offset)
    at_zero = parse_stamps(pd.Series([zero], dtype=object if isinstance(zero, str) else None), mapping.time_s.gain)
    if len(at_zero.bad_rows) or {at_zero.kind, stamps.kind} not in ({stamps.kind}, {"date", "clock"}):
        cause = f"{zero!r} is no stamp such as the file has: {printable_name(_first_stamp(mapping, table))}"
        step = "write time_zero as a stamp in the notation of the file"
        raise InputRefused(table.path, "[commands] time_zero", cause, step)
    origin = at_zero.origin_s + at_zero.seconds[0]
    return stamps.seconds + _apart(stamps, at_zero.kind, origin) + offset, []


def _clock_of(stamps: Stamps) -> tuple[str, bool]:
    """What the stamps count from: dates with a zone and Unix times, both from 1970, are of one clock."""
    since_1970 = stamps.kind == "number" and stamps.origin_s >= LIMITS.min_unix_s
    return ("date", True) if since_1970 else (stamps.kind, stamps.zoned)


def _first_stamp(mapping: CommandColumns, table: LoggedTable) -> object:
    """The first stamp as the file writes it, the seconds of a pair of columns."""
    name = mapping.time_s.columns[0]
    pair = None if name in table.columns else find_pair(name, table.names)
    known = table.columns[pair[0] if pair else name].dropna()
    return known.iloc[0] if len(known) else None


def _apart(stamps: Stamps, kind: str, zero_s: float) -> float:
    """Seconds from `zero_s`, a stamp of this kind, to the origin of the stamps; within half a day for clock times."""
    if "clock" not in (kind, stamps.kind):
        return stamps.origin_s - zero_s
    return (stamps.origin_s - zero_s + DAY_S / 2) % DAY_S - DAY_S / 2


def _place_by_capture_start(
    table: LoggedTable, stamps: Stamps, capture_start: str | None, offset: float
) -> tuple[Floats, list[Irregularity]]:
    """Times (M,) in s after the export's Capture Start Time, a local time, and a warning that its clock is trusted.

    Raises:
        InputRefused: the export states none, or the stamps are no local times.
    """
    clock = parse_stamps(pd.Series([capture_start], dtype=object)) if capture_start else None
    if clock is None or len(clock.bad_rows):
        step = "say what the stamps read at frame 0: [commands] time_zero = a stamp of this file"
        cause = "the export states no Capture Start Time"
        if capture_start:
            cause = f"the export's Capture Start Time, {printable_name(capture_start)}, is in no notation that is read"
        raise InputRefused(table.path, "[commands] time_zero", cause, step)
    if stamps.zoned or stamps.kind not in ("date", "clock"):
        cause = (
            f"the export's Capture Start Time ({printable_name(capture_start)}) is a local time, the stamps are none"
        )
        step = "say what the stamps read at frame 0: [commands] time_zero = a stamp of this file"
        raise InputRefused(table.path, "[commands] time_zero", cause, step)
    text = f"frame 0 is taken as {printable_name(capture_start)} by the export, the clock of Motive's computer"
    odd = Irregularity("command clock", "warning", 1, table.path.name, text)
    return stamps.seconds + _apart(stamps, "clock", clock.origin_s) + offset, [odd]


def _refuse_other_zero(table: LoggedTable, mapping: CommandColumns, start: TakeStart) -> None:
    """Raise `InputRefused` that says what stamps of clocks need: which of them is the take's frame 0."""
    first = _first_stamp(mapping, table)
    shown = f"{first}" if isinstance(first, int | float | np.number) else f'"{printable_name(first)}"'
    counts = "are of another kind" if start.stamp is not None else "count from its frame 0"
    cause = f"the stamps are times of a clock (the first is {shown}), and those of the take's poses {counts}"
    first_pose = "the first pose" if start.stamp is not None else "frame 0"
    step = f"say in the vehicle file what they read at {first_pose}: [commands] time_zero = {shown}, if it is the first"
    if start.capture and isinstance(first, str):
        step += (
            f', or time_zero = "{CAPTURE_START}" for the export\'s Capture Start Time, {printable_name(start.capture)}'
        )
    raise InputRefused(table.path, "command times", cause, step)
