"""Stage `ingest`: a recording in any format becomes poses, commands and what was odd about them."""

from __future__ import annotations

from pathlib import Path

from bcid.recording.read import read_recording
from bcid.recording.saving import save_recording
from bcid.vehicle import Vehicle


def make(folder: Path, recording: Path, commands: Path | None, vehicle: Vehicle, allow_partial: bool) -> None:
    """Read, judge and write one recording."""
    save_recording(read_recording(recording, vehicle, commands, allow_partial), folder)
