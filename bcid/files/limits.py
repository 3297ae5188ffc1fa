"""Limits of files: sizes beyond which one is refused unread, and the age of what killed runs left."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FileLimits:
    """The largest files that are read into memory whole, and how long a file may be unfinished."""

    max_json_bytes: int = 1 << 26
    """The saved models have some hundred thousand bytes; a hundred times that is left.  Not yet justified further."""
    max_toml_bytes: int = 1 << 20
    """Vehicle files and pipelines are written by hand and have some thousand bytes.  Not yet justified further."""
    max_name_bytes: int = 255
    """Bytes of a file's or a folder's name: no file system in use allows more."""
    max_path_bytes: int = 4096
    """Bytes of a path with all its folders: Linux allows no more."""
    max_table_numbers: int = 1 << 26
    """Numbers in a Parquet table of ours, 512 MiB: a take of ten hours at 240 Hz has nine million rows of poses."""

    max_run_s: float = 24 * 3600.0
    """Age from which unfinished files are those of a killed run: no stage takes a day.  Not yet justified further."""


LIMITS = FileLimits()
