"""Recordings as Parquet and JSON, units in the schema's metadata."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from bcid.aliases import Floats
from bcid.documents.document import Document, NotNegative, Part
from bcid.documents.health import ClockEstimate
from bcid.errors import InputRefused
from bcid.files.parquet import read_columns, write_columns
from bcid.recording.types import Action, Irregularity, Recording, SourceFile, Stream

POSE_UNITS = {"time": "s", "x": "m", "y": "m", "yaw": "rad"}
COMMAND_UNITS = {"time": "s", "steering": "rad", "throttle": "m/s or brake share"}
CHANNEL_UNITS = {"time": "s", "value": "SI"}

MIN_POSES, MIN_SAMPLES = 2, 1
"""Fewest poses of a recording, without which it has no motion, and fewest samples of every other stream."""
MAX_VALUE = 1e9
"""Size (SI) that no sample of a recording has, and with which estimates can still be computed."""
Positive = Annotated[float, Field(gt=0.0)]
ChannelName = Annotated[str, Field(pattern="^[a-z][a-z0-9_]*$")]
"""The name of a channel, which is part of a file's name: no path."""


class SourceSummary(Part):
    """A file that was read, without its folder."""

    path: str
    sha256: str
    format: str


class IrregularitySummary(Part):
    """A fault of a recording, see `Irregularity`."""

    kind: str
    action: Action
    count: Annotated[int, Field(ge=0)]
    where: str
    detail: str


class RecordingSummary(Document):
    """All of a recording but its samples (recording.json); these stand in Parquet files beside it."""

    name: str
    sources: Annotated[tuple[SourceSummary, ...], Field(min_length=1)]
    duration_s: NotNegative
    rate_hz: Positive
    hold_s: Positive
    breaks_s: tuple[float, ...]
    channels: tuple[ChannelName, ...]
    irregularities: tuple[IrregularitySummary, ...]
    clock: ClockEstimate


def save_recording(recording: Recording, folder: Path) -> None:
    """Write a recording into `folder`: poses, commands and each channel as Parquet, all else as recording.json."""
    write_columns(folder / "poses.parquet", _stream_table(recording.poses), POSE_UNITS)
    write_columns(folder / "commands.parquet", _stream_table(recording.commands), COMMAND_UNITS)
    for name, stream in recording.channels.items():
        write_columns(folder / f"channel_{name}.parquet", _stream_table(stream), CHANNEL_UNITS)
    summary = RecordingSummary(
        name=recording.name,
        sources=tuple(SourceSummary(**asdict(s) | {"path": Path(s.path).name}) for s in recording.sources),
        duration_s=recording.duration_s,
        rate_hz=recording.rate_hz,
        hold_s=recording.hold_s,
        breaks_s=recording.breaks_s,
        channels=tuple(recording.channels),
        irregularities=tuple(IrregularitySummary(**asdict(i)) for i in recording.irregularities),
        clock=recording.clock,
    )
    summary.write(folder / "recording.json")


def load_recording(folder: Path) -> Recording:
    """The recording that `save_recording` wrote into `folder`; its sources are names of files without folders.

    Raises:
        InputRefused: a file is damaged, or holds what no recording does.
    """
    summary = RecordingSummary.read(folder / "recording.json")
    poses = _read_stream(folder / "poses.parquet", POSE_UNITS, MIN_POSES)
    if any(t > poses.time_s[-1] for t in summary.breaks_s):
        cause = f"names a break behind the last pose, at {poses.time_s[-1]:g} s"
        raise InputRefused(folder / "recording.json", "breaks_s", cause, "ingest the recording again")
    return Recording(
        summary.name,
        tuple(SourceFile(s.path, s.sha256, s.format) for s in summary.sources),
        poses,
        _read_stream(folder / "commands.parquet", COMMAND_UNITS),
        summary.rate_hz,
        summary.hold_s,
        summary.breaks_s,
        {n: _read_stream(folder / f"channel_{n}.parquet", CHANNEL_UNITS) for n in summary.channels},
        tuple(Irregularity(i.kind, i.action, i.count, i.where, i.detail) for i in summary.irregularities),
        summary.clock,
    )


def _stream_table(stream: Stream) -> Floats:
    """A stream's times and its n values side by side, as one table (N, 1 + n)."""
    return np.column_stack([stream.time_s, stream.values])


def _read_stream(path: Path, units: dict[str, str], least: int = MIN_SAMPLES) -> Stream:
    """The stream in a Parquet file, whose columns with their units are `units`: the time (s), then the values.

    Raises:
        InputRefused: the file is missing or damaged, has fewer than `least` rows, or its times do not increase.
    """
    try:
        table = read_columns(path, units)
    except FileNotFoundError:
        raise InputRefused(path, "Parquet data", "is missing", "ingest the recording again") from None
    if len(table) and np.abs(table).max() > MAX_VALUE:
        raise InputRefused(path, "values", f"are beyond {MAX_VALUE:g} in SI units", "ingest the recording again")
    if len(table) < least:
        raise InputRefused(path, "rows", f"fewer than {least}", "ingest the recording again")
    back = np.diff(table[:, 0]) <= 0.0
    if back.any():
        cause = f"does not increase from row {int(np.argmax(back)) + 1} to the next"
        raise InputRefused(path, "column time", cause, "ingest the recording again")
    return Stream(table[:, 0], table[:, 1:])
