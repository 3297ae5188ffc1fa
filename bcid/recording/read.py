"""Any recording, whose format is detected by its content: one function from a path to a `Recording`."""

from pathlib import Path

from bcid.recording.assemble import assemble_recording
from bcid.recording.formats.detect import detect_format, find_commands_file
from bcid.recording.formats.raw import RawTake
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle


def read_raw_take(path: Path, vehicle: Vehicle, commands: Path | None = None, allow_partial: bool = False) -> RawTake:
    """The unchecked poses, commands and channels, in SI units, of a recording of any format; refused if unreadable.

    `allow_partial` leaves out what cannot be read of a damaged MCAP file.
    """
    kind = detect_format(path)
    if kind == "mcap":
        from bcid.recording.formats.mcap import read_mcap

        return read_mcap(path, vehicle, allow_partial)
    beside = find_commands_file(path, commands)
    if beside is not None:
        from bcid.recording.formats.motive import read_motive

        return read_motive(path, vehicle, beside)
    from bcid.recording.formats.tables import read_table

    return read_table(path, vehicle)


def read_recording(
    path: Path, vehicle: Vehicle, commands: Path | None = None, allow_partial: bool = False
) -> Recording:
    """The recording at `path`, read, checked and mended.

    Args:
        path: a Motive export, MCAP file, folder of a split bag, CSV or Parquet table.
        vehicle: the car, and how its logs are to be read.
        commands: the commands file of a Motive export, where it is not beside it.
        allow_partial: whether parts that cannot be read are left out, noted as lost, instead of refused.
    """
    return assemble_recording(read_raw_take(path, vehicle, commands, allow_partial), vehicle)
