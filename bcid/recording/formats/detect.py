"""The format of a file by its content, and the files of which a recording consists."""

import codecs
from pathlib import Path
from typing import Literal

from bcid.errors import InputRefused, UsageError
from bcid.recording.formats.foreign import explain_foreign
from bcid.recording.formats.names import printable_name
from bcid.recording.formats.rosbag import (
    PACKED_MAGICS,
    PACKED_SUFFIXES,
    SQLITE_SUFFIX,
    bag_parts,
    explain_packed,
    explain_sqlite,
)

Format = Literal["mcap", "motive", "table"]

MCAP_MAGIC = b"\x89MCAP0\r\n"
PARQUET_MAGIC = b"PAR1"
SQLITE_MAGIC, ROS_1_MAGIC = b"SQLite format 3\0", b"#ROSBAG V"
UTF_16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
COMMANDS_ENDING = ".commands.csv"  # of a commands file beside a recording of the same name
HEAD_BYTES = 4096  # by which the format is detected
SHOWN_NAME_LENGTH = 60  # characters of an unusable name in a message


def check_path_name(path: Path) -> None:
    """Raise `InputRefused` where no file can have this name, or no document hold it: too long, NUL, not UTF-8."""
    try:
        path.exists()
        path.name.encode("utf-8")
    except UnicodeEncodeError:
        shown = path.name.encode("utf-8", "replace").decode()
        next_step = "rename the file, and its commands file"
        raise InputRefused(shown, "file", "the name is not in UTF-8", next_step) from None
    except (OSError, ValueError) as error:
        name = str(path)[:SHOWN_NAME_LENGTH].replace("\0", "\\0")
        cause = f"is no usable name: {str(error)[:SHOWN_NAME_LENGTH]}"
        raise InputRefused(name, "file", cause, "check the path") from None


def check_nonempty_file(path: Path) -> None:
    """Raise `InputRefused` unless `path` is a regular file that is not empty."""
    check_path_name(path)
    if not path.exists():
        raise InputRefused(path, "file", "does not exist", "check the path")
    if not path.is_file():
        raise InputRefused(path, "file", "is not a regular file", "name a recording, not a folder or device")
    if path.stat().st_size == 0:
        raise InputRefused(path, "file", "is empty", "record or export the take again")


def recording_files(path: Path) -> list[Path]:
    """The files of a recording: `path` itself, or in order the MCAP parts of a ROS 2 bag whose folder is `path`."""
    check_path_name(path)
    return (bag_parts(path) if path.is_dir() else []) or [path]


def detect_format(path: Path) -> Format:
    """The format of a recording, by its first bytes or a text file's suffix; `InputRefused` if unknown or no file."""
    path = recording_files(path)[0]
    check_nonempty_file(path)
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    if head.startswith(MCAP_MAGIC):
        return "mcap"
    if head.startswith(PARQUET_MAGIC):
        return "table"
    packed = next((suffix for magic, suffix in PACKED_MAGICS.items() if head.startswith(magic)), "")
    if packed or path.suffix in PACKED_SUFFIXES:
        raise InputRefused(path, "file", *explain_packed(path, packed))
    if path.suffix == SQLITE_SUFFIX or head.startswith(SQLITE_MAGIC):
        raise InputRefused(path, "file", *explain_sqlite(path))
    if head.startswith(ROS_1_MAGIC):
        step = f"convert it: mcap convert '{printable_name(path.name)}' NAME.mcap"
        raise InputRefused(path, "file", "is a ROS 1 bag, which is not read", step)
    foreign = explain_foreign(path, head)
    if foreign is not None:
        raise InputRefused(path, "file", *foreign)
    utf_16 = head.startswith(UTF_16_MARKS)
    is_text = utf_16 or b"\0" not in head.rstrip(b"\0")
    # programs that save the export again may quote every cell
    if is_text and head.decode("utf-16" if utf_16 else "utf-8-sig", "ignore").lstrip('"').startswith("Format Version"):
        return "motive"
    if is_text and path.suffix.lower() in (".csv", ".txt", ".tsv"):
        return "table"
    place, table = ("byte 0", "mapped .csv or .parquet") if is_text else (f"byte {head.index(0)}", "table")
    raise InputRefused(path, place, "is no MCAP file, Motive CSV or table", f"name a .mcap, a Motive .csv or a {table}")


def find_commands_file(path: Path, commands: Path | None) -> Path | None:
    """The path of a take's commands file: `commands`, else NAME.commands.csv beside it, which a table need not have.

    It is None for MCAP, and for a table without one.

    Raises:
        UsageError: `commands` is named for an MCAP file, which holds its own.
    """
    kind, beside = detect_format(path), path.with_suffix(COMMANDS_ENDING)
    if kind == "motive":
        return commands or beside
    if kind == "table":
        return commands or (beside if beside.is_file() else None)
    if commands is not None:
        raise UsageError(f"--commands {commands}: {path.name} holds its own commands\n  next: leave --commands out")
    return None
