"""Recordings as Parquet and JSON, units in the schema's metadata."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from bcid.aliases import Floats
from bcid.documents.health import ClockEstimate
from bcid.files.parquet import read_columns, write_columns
from bcid.recording.types import Irregularity, Recording, SourceFile, Stream

POSE_UNITS = {"time": "s", "x": "m", "y": "m", "yaw": "rad"}
COMMAND_UNITS = {"time": "s", "steering": "rad", "throttle": "m/s or brake share"}
CHANNEL_UNITS = {"time": "s", "value": "SI"}


def save_recording(recording: Recording, folder: Path) -> None:
    """Write a recording into `folder`: poses, commands and each channel as Parquet, all else as recording.json."""
    write_columns(folder / "poses.parquet", _stream_table(recording.poses), POSE_UNITS)
    write_columns(folder / "commands.parquet", _stream_table(recording.commands), COMMAND_UNITS)
    for name, stream in recording.channels.items():
        write_columns(folder / f"channel_{name}.parquet", _stream_table(stream), CHANNEL_UNITS)
    facts = {
        "name": recording.name,
        "sources": [asdict(s) | {"path": Path(s.path).name} for s in recording.sources],
        "duration_s": recording.duration_s,
        "rate_hz": recording.rate_hz,
        "hold_s": recording.hold_s,
        "breaks_s": list(recording.breaks_s),
        "channels": list(recording.channels),
        "irregularities": [asdict(i) for i in recording.irregularities],
        "clock": recording.clock.as_json(),
    }
    (folder / "recording.json").write_text(json.dumps(facts, indent=1))


def load_recording(folder: Path) -> Recording:
    """The recording that `save_recording` wrote into `folder`; its sources are names of files without folders."""
    facts = json.loads((folder / "recording.json").read_text())
    return Recording(
        facts["name"],
        tuple(SourceFile(**s) for s in facts["sources"]),
        _read_stream(folder / "poses.parquet", POSE_UNITS),
        _read_stream(folder / "commands.parquet", COMMAND_UNITS),
        facts["rate_hz"],
        facts["hold_s"],
        tuple(facts["breaks_s"]),
        {n: _read_stream(folder / f"channel_{n}.parquet", CHANNEL_UNITS) for n in facts["channels"]},
        tuple(Irregularity(**i) for i in facts["irregularities"]),
        ClockEstimate(**facts["clock"]),
    )


def _stream_table(stream: Stream) -> Floats:
    """A stream's times and its n values side by side, as one table (N, 1 + n)."""
    return np.column_stack([stream.time_s, stream.values])


def _read_stream(path: Path, units: dict[str, str]) -> Stream:
    """The stream in a Parquet file, whose columns with their units are `units`: the time (s), then the values."""
    table = read_columns(path, units)
    return Stream(table[:, 0], table[:, 1:])
