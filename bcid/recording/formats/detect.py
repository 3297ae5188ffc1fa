"""The format of a file by its content, and the files of which a recording consists."""

import codecs
import re
from pathlib import Path
from typing import Literal

from bcid.errors import InputRefused, UsageError

Format = Literal["mcap", "motive", "table"]

MCAP_MAGIC = b"\x89MCAP0\r\n"
PARQUET_MAGIC = b"PAR1"
UTF_16_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
BAG_METADATA = "metadata.yaml"  # beside the parts of a rosbag2 recording
HEAD_BYTES = 4096  # by which the format is detected
SHOWN_NAME_LENGTH = 60  # characters of an unusable name in a message


def check_path_name(path: Path) -> None:
    """Raise `InputRefused` where the operating system allows no file of this name: too long, or with NUL characters."""
    try:
        path.exists()
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
    bag = path.is_dir() and (path / BAG_METADATA).is_file()
    parts = [p for p in path.glob("*.mcap") if p.is_file()] if bag else []
    # by the number at the end of a part's name
    return sorted(parts, key=lambda p: (int("0" + re.split(r"\D", p.stem)[-1]), p.name)) or [path]


def describe_missing_parts(path: Path) -> str | None:
    """A sentence on the parts of a split ROS 2 bag that are missing or not named; None where none is.

    A part is missing where the folder's metadata.yaml names a file that is not there, or where `path` is one part
    of several.
    """
    if path.is_dir():
        metadata = (path / BAG_METADATA).read_text(encoding="utf-8", errors="replace")
        stated = set(re.findall(r"[^\s\[\],'\"/]+\.mcap", metadata))
        lacking = ", ".join(sorted(stated - {p.name for p in recording_files(path)}))
        return f"a split bag whose {BAG_METADATA} names {lacking} too, which is not there" if lacking else None
    if path.suffix != ".mcap" or not (path.parent / BAG_METADATA).is_file():
        return None
    others = [p.name for p in recording_files(path.parent) if p.name != path.name]
    return f"one part of a split bag: name the folder for {', '.join(others)} too" if others else None


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
    utf_16 = head.startswith(UTF_16_MARKS)
    is_text = utf_16 or b"\0" not in head.rstrip(b"\0")
    if is_text and head.decode("utf-16" if utf_16 else "utf-8-sig", "ignore").startswith("Format Version"):
        return "motive"
    if is_text and path.suffix.lower() in (".csv", ".txt", ".tsv"):
        return "table"
    place, table = ("byte 0", "mapped .csv or .parquet") if is_text else (f"byte {head.index(0)}", "table")
    raise InputRefused(path, place, "is no MCAP file, Motive CSV or table", f"name a .mcap, a Motive .csv or a {table}")


def find_commands_file(path: Path, commands: Path | None) -> Path | None:
    """The path of a Motive export's commands file: `commands`, else NAME.commands.csv beside it; None for others.

    Raises:
        UsageError: `commands` is named for a recording of another format, which holds its own.
    """
    if detect_format(path) == "motive":
        return commands or path.with_suffix(".commands.csv")
    if commands is not None:
        raise UsageError(f"--commands {commands}: {path.name} holds its own commands\n  next: leave --commands out")
    return None
