"""Any recording by its content: one function from a path to a `Recording`."""

from __future__ import annotations

from pathlib import Path

from bcid.errors import InputRefused
from bcid.recording.assemble import assemble
from bcid.recording.raw import RawTake, source_of
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle

MCAP_MAGIC = b"\x89MCAP"


def read_raw(path: Path, vehicle: Vehicle, commands: Path | None = None) -> RawTake:
    """The file's streams as they stand, by the reader its content asks for.

    Raises:
        InputRefused: no such file, or none of the known formats.
    """
    source_of(path, "unknown")
    with path.open("rb") as file:
        start = file.read(16)
    if start.startswith(MCAP_MAGIC):
        from bcid.recording.mcap_file import read_mcap

        return read_mcap(path, vehicle)
    from bcid.recording.motive import is_motive, read_motive

    if is_motive(path):
        return read_motive(path, vehicle, commands)
    if path.suffix.lower() in (".csv", ".parquet", ".txt"):
        from bcid.recording.tables import read_table

        return read_table(path, vehicle)
    raise InputRefused(
        path,
        "byte 0",
        "is no MCAP file, Motive CSV or table",
        "name a .mcap, a Motive .csv, or a mapped .csv or .parquet",
    )


def read_recording(path: Path, vehicle: Vehicle, commands: Path | None = None) -> Recording:
    """The take at `path`; `commands` names a Motive export's commands file where it lies elsewhere."""
    return assemble(read_raw(path, vehicle, commands), vehicle)
