"""Any recording by its content: one function from a path to a `Recording`."""

from __future__ import annotations

from pathlib import Path

from bcid.recording.assemble import assemble
from bcid.recording.formats.detect import commands_of, format_of
from bcid.recording.formats.raw import RawTake
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle


def read_raw(path: Path, vehicle: Vehicle, commands: Path | None = None, allow_partial: bool = False) -> RawTake:
    """The file's streams as they stand, by the reader its content asks for.

    Raises:
        InputRefused: no such file, none of the known formats, or what the reader refuses.
    """
    kind = format_of(path)
    if kind == "mcap":
        from bcid.recording.formats.mcap import read_mcap

        return read_mcap(path, vehicle, allow_partial)
    beside = commands_of(path, commands)
    if beside is not None:
        from bcid.recording.formats.motive import read_motive

        return read_motive(path, vehicle, beside)
    from bcid.recording.formats.tables import read_table

    return read_table(path, vehicle)


def read_recording(
    path: Path, vehicle: Vehicle, commands: Path | None = None, allow_partial: bool = False
) -> Recording:
    """The take at `path`; `commands` names a Motive export's commands file where it lies elsewhere.

    With `allow_partial`, what cannot be read of it is left out, and told as lost.
    """
    return assemble(read_raw(path, vehicle, commands, allow_partial), vehicle)
