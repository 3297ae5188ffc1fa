"""Recordings as Parquet and JSON, units in the schema's metadata."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from bcid.files.parquet import read_columns, write_columns
from bcid.recording.types import Irregularity, Recording, Source, Stream

POSE = {"time": "s", "x": "m", "y": "m", "yaw": "rad"}
COMMAND = {"time": "s", "steering": "rad", "throttle": "m/s or brake share"}


def save_recording(recording: Recording, folder: Path) -> None:
    """Write poses.parquet, commands.parquet, one channel_NAME.parquet each and recording.json."""
    write_columns(folder / "poses.parquet", _stacked(recording.poses), POSE)
    write_columns(folder / "commands.parquet", _stacked(recording.commands), COMMAND)
    for name, stream in recording.channels.items():
        write_columns(folder / f"channel_{name}.parquet", _stacked(stream), {"time": "s", "value": "SI"})
    facts = {
        "name": recording.name,
        "sources": [asdict(s) | {"path": Path(s.path).name} for s in recording.sources],
        "duration_s": recording.duration_s,
        "rate_hz": recording.rate_hz,
        "hold_s": recording.hold_s,
        "breaks_s": list(recording.breaks_s),
        "channels": list(recording.channels),
        "irregularities": [asdict(i) for i in recording.irregularities],
        "clock": dict(recording.clock),
    }
    (folder / "recording.json").write_text(json.dumps(facts, indent=1))


def load_recording(folder: Path) -> Recording:
    """The inverse of `save_recording`."""
    facts = json.loads((folder / "recording.json").read_text())
    return Recording(
        facts["name"],
        tuple(Source(**s) for s in facts["sources"]),
        _stream(folder / "poses.parquet", POSE),
        _stream(folder / "commands.parquet", COMMAND),
        facts["rate_hz"],
        facts["hold_s"],
        tuple(facts["breaks_s"]),
        {n: _stream(folder / f"channel_{n}.parquet", {"time": "s", "value": "SI"}) for n in facts["channels"]},
        tuple(Irregularity(**i) for i in facts["irregularities"]),
        facts["clock"],
    )


def _stacked(stream: Stream) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    return np.column_stack([stream.time_s, stream.values])


def _stream(path: Path, units: dict[str, str]) -> Stream:
    table = read_columns(path, units)
    return Stream(table[:, 0], table[:, 1:])
