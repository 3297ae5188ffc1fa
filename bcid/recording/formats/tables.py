"""CSV and Parquet tables with a column mapping: poses, commands and channels, in the same rows or in their own."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.errors import InputRefused, Problems, UsageError
from bcid.mapping import Columns
from bcid.recording.formats.commands_file import TakeStart, read_commands_file
from bcid.recording.formats.detect import COMMANDS_ENDING
from bcid.recording.formats.floor import mapped_poses_on_floor
from bcid.recording.formats.held_commands import held_too_long
from bcid.recording.formats.logged_table import read_logged_table
from bcid.recording.formats.raw import RawTake, earliest_s, identify_file, map_field, raw_field_names
from bcid.recording.formats.stamps import Stamps
from bcid.vehicle import Vehicle


def _has_own_rows(some: Bools, others: Bools) -> bool:
    """Whether two streams of a table stand in rows of their own: rows with one of them outnumber those with both."""
    return bool(some.any() and others.any() and (some ^ others).sum() > (some & others).sum())


def _hold_last(values: Floats) -> Floats:
    """Values (N, n) with each blank cell filled by the last one above it; NaN above the first."""
    filled = np.empty_like(values)
    for k, column in enumerate(values.T):
        last = np.maximum.accumulate(np.where(np.isnan(column), -1, np.arange(len(column))))
        filled[:, k] = np.where(last >= 0, column[np.maximum(last, 0)], np.nan)
    return filled


def _command_rows(time_s: Floats, command: Floats, rows: Bools, hold_s: float) -> tuple[Floats, Bools]:
    """Commands (N, 2), and the mask (N,) of their rows, where steering and throttle may have rows of their own.

    If they do, each holds until its next value, and a command begins where both are known; one that comes at a rate
    and then stays away for more than `hold_s` says nothing more until it comes again.
    """
    steering, throttle = ~np.isnan(command.T)
    if not _has_own_rows(steering, throttle):
        return command, rows
    held = _hold_last(command)
    kept = (steering | throttle) & ~np.isnan(held).any(axis=1)
    for k, own in enumerate((steering, throttle)):
        sample_s = np.unique(time_s[own & np.isfinite(time_s)])
        held[held_too_long(sample_s, time_s, hold_s), k] = np.nan
    return held, kept


class StreamsOfRows(NamedTuple):
    """The streams of a table, each with the times and values of its own rows."""

    pose: tuple[Floats, Floats]  # (N,), (N, 3)
    command: tuple[Floats, Floats]  # (M,), (M, 2)
    channels: dict[str, tuple[Floats, Floats]]


def _part_rows(
    time_s: Floats, pose: Floats, blank_pose: Bools, command: Floats, channels: dict[str, Floats], hold_s: float
) -> StreamsOfRows:
    """The streams of a table with rows at `time_s` (K,): poses (K, 3), commands (K, 2) or (K, 0), channels (K,).

    `blank_pose` (K,) marks rows without any cell of a pose.
    """
    every = np.ones(len(time_s), dtype=np.bool_)
    has_pose = np.logical_not(blank_pose)
    has_command = np.logical_not(np.isnan(command).all(axis=1)) if command.shape[1] else ~every
    joined = _has_own_rows(has_pose, has_command)
    pose_rows, command_rows = (has_pose, has_command) if joined else (every, every)
    if command.shape[1]:
        command, command_rows = _command_rows(time_s, command, command_rows, hold_s)
    else:
        command, command_rows = np.empty((len(time_s), 2)), ~every
    parted = dict[str, tuple[Floats, Floats]]()
    for name, values in channels.items():
        known = np.logical_not(np.isnan(values))
        rows = known if _has_own_rows(known, has_pose | has_command) else every
        parted[name] = (time_s[rows], values[rows])
    poses, commands = (time_s[pose_rows], pose[pose_rows]), (time_s[command_rows], command[command_rows])
    return StreamsOfRows(poses, commands, parted)


def _read_rows(path: Path, columns: Columns, vehicle: Vehicle) -> tuple[RawTake, Stamps]:
    """The poses, commands (M = 0 where a commands file holds them) and channels of a table; and its rows' stamps.

    Raises:
        InputRefused: a column is missing, or there is text where a number belongs.
    """
    source = identify_file(path, "table-" + path.suffix.lstrip(".").lower())
    fields = [*columns.fields, *columns.command_fields, *columns.channels.values()]
    names = raw_field_names(fields)
    remedy = "correct [columns] in the vehicle file"
    table = read_logged_table(path, [*columns.time_s.columns, *names], remedy, columns.comment)
    if not len(table) and table.columns:
        raise InputRefused(path, "table", "holds a header and no rows", "export the take again")
    problems = Problems()
    with problems.gather_refusals():
        stamps, odd_stamps = table.stamps(columns.time_s)
    with problems.gather_refusals():
        numbers, odd_numbers = table.numbers(names)
        table.check_units(columns, columns.time_s, vehicle.mocap.metres_per_unit)
    problems.raise_if_any(path)
    first_s = earliest_s(stamps.seconds[np.isfinite(stamps.seconds)])
    time_s = stamps.seconds - first_s
    in_si = np.column_stack([map_field(field, numbers.__getitem__) for field in fields])
    n, m = len(columns.fields), len(columns.fields) + len(columns.command_fields)
    pose, odd_poses = mapped_poses_on_floor(list(in_si[:, :n].T), columns, vehicle.mocap, time_s, path)
    blank_pose = np.asarray(np.isnan(in_si[:, :n]).all(axis=1), dtype=np.bool_)
    channels = dict(zip(columns.channels, in_si[:, m:].T, strict=True))
    streams = _part_rows(time_s, pose, blank_pose, in_si[:, n:m], channels, vehicle.command.max_hold_s)
    odd = (*table.irregularities, *odd_stamps, *odd_numbers, *odd_poses)
    take = RawTake(path.stem, (source,), *streams.pose, *streams.command, None, streams.channels, odd)
    return take, stamps._replace(origin_s=stamps.origin_s + first_s + columns.time_s.offset, seconds=time_s)


def read_table(path: Path, vehicle: Vehicle, commands: Path | None = None) -> RawTake:
    """The unchecked poses, commands and channels of a CSV or Parquet table, in SI by `[columns]` of the vehicle file.

    Streams may have rows of their own, as an outer join writes them: a row that is blank in one stream, and has a value
    of another, is then no sample of the first. Where [columns] maps no command, it stands in the file `commands`, with
    stamps of the same clock unless [commands] says what they read at the first pose.

    Raises:
        InputRefused: there is no mapping or no such column, or text where a number belongs.
        UsageError: a commands file is named, and the table holds its own commands.
    """
    columns = vehicle.columns
    if columns is None:
        cause = "has no [columns], and the file is no Motive export"
        step = "map the table's columns in the vehicle file, as `bcid init` shows"
        raise InputRefused(path, "vehicle file", cause, step)
    if columns.command_fields:
        # a file that merely lies beside the table was not asked for
        if commands is not None and commands != path.with_suffix(COMMANDS_ENDING):
            raise UsageError(f"--commands {commands}: {path.name} holds its own commands\n  next: leave --commands out")
        return _read_rows(path, columns, vehicle)[0]
    if commands is None:
        step = "map steering_rad and throttle_mps in [columns], or put the commands beside it as NAME.commands.csv"
        raise InputRefused(path, "commands", "the vehicle file maps no commands of the table", step)
    poses, stamps = _read_rows(path, columns, vehicle)
    file = read_commands_file(commands, vehicle.commands, TakeStart(None, stamps))
    return replace(
        poses, sources=poses.sources + file.sources, command_time_s=file.command_time_s, command=file.command,
        channels={**poses.channels, **file.channels}, irregularities=poses.irregularities + file.irregularities,
    )  # fmt: skip
