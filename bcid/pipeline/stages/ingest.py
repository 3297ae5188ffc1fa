"""Stage `ingest`: a recording in any format becomes poses, commands and a list of its irregularities."""

from pathlib import Path

from bcid.recording.cuts import read_cut_recording
from bcid.recording.formats.raw import TimeCut
from bcid.recording.saving import save_recording
from bcid.vehicle import Vehicle


def run_ingest_stage(
    folder: Path, recording: Path, commands: Path | None, vehicle: Vehicle, allow_partial: bool, cut: TimeCut | None
) -> None:
    """Read one recording and its commands file, check and mend it by the vehicle file, and save it in `folder`.

    Only the part that `cut` names is kept, if any.  With `allow_partial`, a recording of which a part cannot be read is
    saved without that part.
    """
    save_recording(read_cut_recording(recording, vehicle, commands, allow_partial, cut), folder)
