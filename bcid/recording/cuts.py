"""Takes cut by time: `take.csv[12:40]` is the part of take.csv from 12 to 40 s after its first pose.

A cut stands wherever a recording is named, on the command line and in a pipeline file; either end may be left out.
It is made before anything is checked or mended, so that what is wrong elsewhere in the take does not matter.  Times
stay those of the whole take.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.errors import InputRefused
from bcid.recording.assemble import assemble_recording
from bcid.recording.formats.detect import find_commands_file
from bcid.recording.formats.raw import RawTake, TimeCut, earliest_s
from bcid.recording.read import read_raw_take
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

COMMAND_MARGIN_S = 0.2
"""Time before and after a cut for which commands are kept: they act late, and their clock may be off by as much."""
_NUMBER = r"(?:\d+\.?\d*|\.\d+)?"
_CUT = re.compile(rf"(?P<file>.+)\[(?P<begin>{_NUMBER}):(?P<end>{_NUMBER})\]", re.DOTALL)


def split_cut(recording: Path) -> tuple[Path, TimeCut | None]:
    """The file of a recording as it is named, and the cut behind its name, None where there is none.

    >>> split_cut(Path("take.csv[12:40]"))[1]
    TimeCut(begin_s=12.0, end_s=40.0)

    Raises:
        InputRefused: there is something in brackets that is no cut, or one that ends before it begins.
    """
    matched = _CUT.fullmatch(str(recording))
    if recording.exists() or not recording.name.endswith("]"):
        return recording, None
    file = Path(str(recording).rpartition("[")[0])
    if matched is None:
        # a wrong name is told by whoever opens it
        if not file.exists():
            return recording, None
        cause, step = "is no cut", f"write [BEGIN:END] in seconds, such as {file.name}[12:40]"
        raise InputRefused(file, recording.name[len(file.name) :], cause, step)
    begin, end = matched["begin"], matched["end"]
    cut = TimeCut(float(begin or 0.0), float(end) if end else math.inf)
    if not cut.begin_s < cut.end_s:
        place = recording.name[len(file.name) :]
        raise InputRefused(file, place, "ends before it begins", "write [BEGIN:END] in seconds after the first pose")
    return file, cut


def without_cut(recording: Path) -> Path:
    """The file of a recording as it is named, without the cut behind its name."""
    return split_cut(recording)[0]


def read_named_recording(
    named: Path, vehicle: Vehicle, commands: Path | None = None, allow_partial: bool = False
) -> Recording:
    """The recording that is `named`, or the part of it that a cut behind its name says, checked and mended.

    Args:
        named: the path of its file, or a cut of it such as take.csv[12:40].
        vehicle: the car, and how its logs are to be read.
        commands: the commands file of a Motive export or table, where it is not NAME.commands.csv.
        allow_partial: whether parts that cannot be read are left out, noted as lost, instead of refused.

    Raises:
        InputRefused: it cannot be read or used, or the cut lies outside it.
        UsageError: `commands` is named for an MCAP file, which holds its own.
    """
    file, cut = split_cut(named)
    return read_cut_recording(file, vehicle, find_commands_file(file, commands), allow_partial, cut)


def read_cut_recording(
    path: Path, vehicle: Vehicle, commands: Path | None, allow_partial: bool, cut: TimeCut | None
) -> Recording:
    """The recording in the file `path`, or the part of it that `cut` names, checked and mended.

    Raises:
        InputRefused: it cannot be read or used, or the cut lies outside it.
    """
    raw = read_raw_take(path, vehicle, commands, allow_partial, cut)
    return assemble_recording(raw if cut is None else cut_raw_take(raw, cut), vehicle)


def cut_raw_take(raw: RawTake, cut: TimeCut) -> RawTake:
    """The part of a raw take within a cut, with the last commands before it, which still hold when it begins.

    Raises:
        InputRefused: no pose lies within it.
    """
    known = raw.pose_time_s[np.isfinite(raw.pose_time_s)]
    # rows of a table may stand in any order
    zero = earliest_s(known) if raw.first_pose_s is None else raw.first_pose_s
    begin, end = zero + cut.begin_s, zero + cut.end_s
    poses = (raw.pose_time_s >= begin) & (raw.pose_time_s <= end)
    if not poses.any():
        lasts = float(known.max()) - zero if len(known) else 0.0
        cause = f"no pose lies between {cut.begin_s:g} and {cut.end_s:g} s: the take lasts {lasts:.1f} s"
        raise InputRefused(raw.sources[0].path, "cut", cause, "cut within the take")
    # rows of one table hold poses and commands, and stay together
    one_table = np.array_equal(raw.pose_time_s, raw.command_time_s)
    commands = poses if one_table else _keep_held(raw.command_time_s, begin, end)
    channels = {
        name: (time_s[kept], values[kept])
        for name, (time_s, values) in raw.channels.items()
        if (kept := _keep_held(time_s, begin, end)).any()
    }
    return replace(
        raw, pose_time_s=raw.pose_time_s[poses], pose=raw.pose[poses],
        command_time_s=raw.command_time_s[commands], command=raw.command[commands],
        channels=channels, splits_s=tuple(t for t in raw.splits_s if begin < t <= end),
    )  # fmt: skip


def _keep_held(time_s: Floats, begin: float, end: float) -> Bools:
    """Which samples (M,) at `time_s` hold within [begin, end] (s), or COMMAND_MARGIN_S before and after it."""
    low, high = begin - COMMAND_MARGIN_S, end + COMMAND_MARGIN_S
    kept = (time_s >= low) & (time_s <= high)
    before = np.flatnonzero(time_s < low)
    if len(before):
        kept[before[-1]] = True
    return np.asarray(kept)
