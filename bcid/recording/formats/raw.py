"""What a reader hands on: streams as they stand in the file, before anything is judged or mended."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from bcid.aliases import Floats
from bcid.recording.formats.detect import check_file
from bcid.recording.types import Irregularity, Source


@dataclass(frozen=True)
class RawTake:
    """Unjudged streams in SI on the floor's axes; blank samples are NaN rows."""

    name: str
    sources: tuple[Source, ...]
    pose_time_s: Floats  # (N,)
    pose: Floats  # (N, 3) of the tracked body
    command_time_s: Floats  # (M,)
    command: Floats  # (M, 2)
    rate_hz: float | None = None  # where the file states one
    channels: Mapping[str, tuple[Floats, Floats]] = field(default_factory=dict)
    irregularities: tuple[Irregularity, ...] = ()
    splits_s: tuple[float, ...] = ()  # pose times at which a new stretch begins, whatever the poses show


def source_of(path: Path, kind: str) -> Source:
    """The file's identity.

    Raises:
        InputRefused: when there is no such file or it is none.
    """
    check_file(path)
    with path.open("rb") as file:
        return Source(str(path), hashlib.file_digest(file, "sha256").hexdigest(), kind)
