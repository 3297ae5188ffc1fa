"""Which format a file has, by its content, and which files a recording consists of."""

from __future__ import annotations

import codecs
import glob
import re
from pathlib import Path
from typing import Literal

from bcid.errors import InputRefused, UsageError

Format = Literal["mcap", "motive", "table"]

MCAP_MAGIC = b"\x89MCAP0\r\n"
PARQUET_MAGIC = b"PAR1"
_HEAD = 4096


def check_file(path: Path) -> None:
    """Raise `InputRefused` unless `path` is a file with something in it."""
    try:
        there, file = path.exists(), path.is_file()
    except (OSError, ValueError) as error:
        raise InputRefused(path, "file", f"is no usable name: {error}"[:200], "check the path") from None
    if not there:
        raise InputRefused(path, "file", "does not exist", "check the path")
    if not file:
        raise InputRefused(path, "file", "is not a regular file", "name a recording, not a folder or device")
    if path.stat().st_size == 0:
        raise InputRefused(path, "file", "is empty", "record or export the take again")


def _number(path: Path) -> int:
    """The number at the end of a part's name."""
    found = re.search(r"(\d+)$", path.stem)
    return int(found[1]) if found else 0


def parts_of(path: Path) -> list[Path]:
    """The files that a recording consists of: itself, or in order those of a split bag's folder."""
    parts = [p for p in path.glob("*.mcap") if p.is_file()] if path.is_dir() else []
    return sorted(parts, key=lambda p: (_number(p), p.name)) or [path]


def missing_parts(path: Path) -> str | None:
    """What of a split bag is not there, or was not named; None where nothing is known to lack."""
    parts = parts_of(path)
    if path.is_dir():
        numbers = {_number(p) for p in parts}
        lacking = sorted(set(range(max(numbers) + 1)) - numbers)
        return f"of a split bag, part {', '.join(map(str, lacking))} is not there" if lacking else None
    begins = re.sub(r"\d+$", "", path.stem)
    others = [p.name for p in path.parent.glob(f"{glob.escape(begins)}*.mcap") if re.sub(r"\d+$", "", p.stem) == begins]
    if path.suffix != ".mcap" or not (path.parent / "metadata.yaml").is_file() or len(others) < 2:
        return None
    return f"is one of {len(others)} parts of a split bag: name the folder for all of them"


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
    utf_16 = head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
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
