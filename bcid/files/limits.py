"""Limits of the file formats: sizes beyond which a file is refused unread."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FileLimits:
    """The largest files that are read into memory whole."""

    max_json_bytes: int = 1 << 26
    """The saved models have some hundred thousand bytes; a hundred times that is left.  Not yet justified further."""
    max_toml_bytes: int = 1 << 20
    """Vehicle files and pipelines are written by hand and have some thousand bytes.  Not yet justified further."""


LIMITS = FileLimits()
