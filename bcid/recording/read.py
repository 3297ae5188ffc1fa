"""Any recording, whose format is detected by its content: one function from a path to a `Recording`."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bcid.errors import BcidError, InputRefused
from bcid.recording.assemble import assemble_recording
from bcid.recording.formats.detect import detect_format, find_commands_file
from bcid.recording.formats.names import describe_error
from bcid.recording.formats.raw import RawTake, TimeCut
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle


class UnforeseenContent(InputRefused):
    """A file that its reader cannot read and does not refuse by itself: it is broken in a way that nobody foresaw."""


@contextmanager
def refuse_unforeseen(path: Path) -> Iterator[None]:
    """Context for the decoding of a file's content, in which any error but a refusal becomes `UnforeseenContent`.

    The error stays its cause: a mistake of the reader is seen in the traceback of a test, and counted by `make fuzz`.
    """
    try:
        yield
    except (BcidError, MemoryError):
        raise
    except Exception as error:
        cause = f"this file is broken, or of a kind that its reader does not know ({describe_error(error)})"
        step = "export or record it again; if other programs read it, report it with the file"
        raise UnforeseenContent(path, "file", cause, step) from error


def read_raw_take(
    path: Path, vehicle: Vehicle, commands: Path | None = None, allow_partial: bool = False,
    cut: TimeCut | None = None,
) -> RawTake:  # fmt: skip
    """The unchecked poses, commands and channels, in SI units, of a recording of any format; refused if unreadable.

    `allow_partial` leaves out what cannot be read of a damaged MCAP file.  Where a `cut` is given, what lies outside
    of it may be left out, too; `RawTake.first_pose_s` then says when the whole take begins.
    """
    with refuse_unforeseen(path):
        return _read_by_format(path, vehicle, commands, allow_partial, cut)


def _read_by_format(
    path: Path, vehicle: Vehicle, commands: Path | None, allow_partial: bool, cut: TimeCut | None
) -> RawTake:  # fmt: skip
    """What the reader of a file's format, detected by its content, reads of it."""
    kind = detect_format(path)
    if kind == "mcap":
        from bcid.recording.formats.mcap import read_mcap

        return read_mcap(path, vehicle, allow_partial, cut)
    beside = find_commands_file(path, commands)
    if kind == "motive" and beside is not None:
        from bcid.recording.formats.motive import read_motive

        return read_motive(path, vehicle, beside, cut)
    from bcid.recording.formats.tables import read_table

    return read_table(path, vehicle, beside)


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
