"""The recordings of a fleet: those that are named, and those that lie in folders that are named."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from bcid.errors import InputRefused
from bcid.recording.formats.detect import COMMANDS_ENDING, detect_format
from bcid.recording.formats.rosbag import BAG_METADATA

RECORDING_SUFFIXES = (".mcap", ".csv", ".parquet", ".db3", ".bag")
"""How recordings are called: a file of such a name that cannot be read as one is damaged, and not something else."""


class FoundLogs(NamedTuple):
    """The recordings of a fleet, and what was passed over beside them: files that are none, and folders."""

    logs: list[Path]
    passed_over: list[Path]


def find_logs(paths: Sequence[Path], labels: Path | None = None) -> FoundLogs:
    """The recordings that `paths` name: files, ROS 2 bags, and folders, whose recordings are told by their content.

    Of a folder the files and bags that lie directly in it are looked at, in the order of their names.  Commands files,
    hidden files and the table `labels` are left out, and a recording that is named twice counts once.

    Raises:
        InputRefused: a folder holds no recording.
    """
    logs, passed_over = list[Path](), list[Path]()
    for path in paths:
        if not path.is_dir() or _is_bag(path):
            logs.append(path)
            continue
        inside = [p for p in sorted(path.iterdir()) if not _is_left_out(p, labels)]
        recordings = [p for p in inside if _is_bag(p) or (p.is_file() and _is_recording(p))]
        if not recordings:
            raise InputRefused(
                path, "logs", "holds no recording", "name a folder in which recordings lie, not above it"
            )
        logs += recordings
        passed_over += [p for p in inside if p not in recordings]
    return FoundLogs(list({path.absolute(): path for path in logs}.values()), passed_over)


def _is_left_out(path: Path, labels: Path | None) -> bool:
    """Whether something in a folder of logs is hidden, a commands file, or the table `labels`."""
    is_labels = labels is not None and path.resolve() == labels.resolve()
    return path.name[0] == "." or path.name.endswith(COMMANDS_ENDING) or is_labels


def _is_bag(path: Path) -> bool:
    """Whether a path is the folder of a ROS 2 bag."""
    return (path / BAG_METADATA).is_file()


def _is_recording(file: Path) -> bool:
    """Whether a file is a recording by its content, or, damaged as it may be, by its name."""
    if file.suffix.lower() in RECORDING_SUFFIXES:
        return True
    try:
        detect_format(file)
    except (InputRefused, OSError):
        return False
    return True
