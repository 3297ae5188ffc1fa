"""Which format a file has, by its content, and which files a recording consists of."""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import Literal

from bcid.errors import InputRefused, UsageError

Format = Literal["mcap", "motive", "table"]

MCAP_MAGIC = b"\x89MCAP0\r\n"
PARQUET_MAGIC = b"PAR1"
UTF_16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
METADATA = "metadata.yaml"  # beside the parts of a rosbag2 recording
_HEAD = 4096
LONGEST_NAME = 60  # characters of a name that cannot be one


def check_name(path: Path) -> None:
    """Raise `InputRefused` where no file can have such a name."""
    try:
        path.exists()
    except (OSError, ValueError) as error:
        name = str(path)[:LONGEST_NAME].replace("\0", "\\0")
        raise InputRefused(name, "file", f"is no usable name: {str(error)[:LONGEST_NAME]}", "check the path") from None


def check_file(path: Path) -> None:
    """Raise `InputRefused` unless `path` is a file with something in it."""
    check_name(path)
    if not path.exists():
        raise InputRefused(path, "file", "does not exist", "check the path")
    if not path.is_file():
        raise InputRefused(path, "file", "is not a regular file", "name a recording, not a folder or device")
    if path.stat().st_size == 0:
        raise InputRefused(path, "file", "is empty", "record or export the take again")


def _number(path: Path) -> int:
    """The number at the end of a part's name."""
    found = re.search(r"(\d+)$", path.stem)
    return int(found[1]) if found else 0


def parts_of(path: Path) -> list[Path]:
    """The files that a recording consists of: itself, or in order those of a split bag's folder."""
    check_name(path)
    bag = path.is_dir() and (path / METADATA).is_file()
    parts = [p for p in path.glob("*.mcap") if p.is_file()] if bag else []
    return sorted(parts, key=lambda p: (_number(p), p.name)) or [path]


def missing_parts(path: Path) -> str | None:
    """What of a split bag is not there, or was not named; None where nothing is known to lack."""
    if path.is_dir():
        stated = set(
            re.findall(r"[^\s\[\],'\"/]+\.mcap", (path / METADATA).read_text(encoding="utf-8", errors="replace"))
        )
        lacking = sorted(stated - {p.name for p in parts_of(path)})
        return f"a split bag whose {METADATA} names {', '.join(lacking)} too, which is not there" if lacking else None
    if path.suffix != ".mcap" or not (path.parent / METADATA).is_file():
        return None
    others = [p.name for p in parts_of(path.parent) if p.name != path.name]
    return f"one part of a split bag: name the folder for {', '.join(others)} too" if others else None


def format_of(path: Path) -> Format:
    """The recording's format.

    Raises:
        InputRefused: no such file, or none of the known formats.
    """
    path = parts_of(path)[0]
    check_file(path)
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if head.startswith(MCAP_MAGIC):
        return "mcap"
    if head.startswith(PARQUET_MAGIC):
        return "table"
    utf_16 = head.startswith(UTF_16)
    if b"\0" in head.rstrip(b"\0") and not utf_16:
        raise InputRefused(
            path,
            f"byte {head.index(0)}",
            "is no MCAP file, Motive CSV or table",
            "name a .mcap, a Motive .csv or a table",
        )
    text = head.decode("utf-16", "ignore") if utf_16 else head.decode("utf-8-sig", "ignore")
    if text.startswith("Format Version"):
        return "motive"
    if path.suffix.lower() in (".csv", ".txt", ".tsv"):
        return "table"
    raise InputRefused(
        path,
        "byte 0",
        "is no MCAP file, Motive CSV or table",
        "name a .mcap, a Motive .csv or a mapped .csv or .parquet",
    )


def is_parquet(path: Path) -> bool:
    """Whether a table is a Parquet file, by its first bytes."""
    with path.open("rb") as file:
        return file.read(len(PARQUET_MAGIC)) == PARQUET_MAGIC


def commands_of(path: Path, named: Path | None) -> Path | None:
    """The commands file that goes with the recording at `path`; None where the recording holds its own.

    Raises:
        UsageError: a commands file was named for a recording that holds its own.
    """
    if format_of(path) == "motive":
        return named or path.with_suffix(".commands.csv")
    if named is not None:
        raise UsageError(f"--commands {named}: {path.name} holds its own commands\n  next: leave --commands out")
    return None
