"""A recording as tidy tables for other programs: a row for each sample, a column for each quantity with its unit.

`NAME.csv` or `NAME.parquet` holds the poses, `NAME.commands.csv` the commands, as bcid reads them back, and
`NAME.CHANNEL.csv` each further channel.  Of several takes the first column says which.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path

from bcid.errors import UsageError
from bcid.files.outputs import MayReplace, refuse_to_overwrite, staged_outputs
from bcid.recording.types import Recording, Stream

POSE_COLUMNS = ("time_s", "x_m", "y_m", "yaw_rad")
COMMAND_COLUMNS = ("time_s", "steering_rad", "throttle_mps")
ENDINGS = (".csv", ".parquet")
OTHER_TABLE = "name another file with --table"


def names_folder(path: Path) -> bool:
    """Whether `path` names a folder of tables in parts: one that is there, or a name without ending."""
    return path.is_dir() or not path.suffix


def check_table_name(path: Path) -> None:
    """Raise `UsageError` unless `path` is a folder's, or its ending says which kind of table it is to be."""
    if path.suffix.lower() not in ENDINGS and not names_folder(path):
        raise UsageError(f"--table {path}: what kind of table is that?\n  next: name a .csv, a .parquet or a folder")


def write_tidy_tables(path: Path, recordings: Mapping[str, Recording], may_replace: MayReplace) -> list[Path]:
    """Write the poses of recordings, by their names, as the table `path`, all else beside it; returns what was written.

    Raises:
        UsageError: the ending of `path` is not that of a table.
        InputRefused: a file is there already that `may_replace` does not allow to replace.
    """
    check_table_name(path)
    tables: dict[str, tuple[tuple[str, ...], dict[str, Stream]]] = {}
    tables[path.name] = POSE_COLUMNS, {name: r.poses for name, r in recordings.items()}
    tables[_beside(path, "commands")] = COMMAND_COLUMNS, {name: r.commands for name, r in recordings.items()}
    for channel in dict.fromkeys(c for r in recordings.values() for c in r.channels):
        streams = {name: r.channels[channel] for name, r in recordings.items() if channel in r.channels}
        tables[_beside(path, channel)] = ("time_s", channel), streams
    targets = [path.parent / name for name in tables]
    refuse_to_overwrite(targets, may_replace, OTHER_TABLE)
    with staged_outputs(path.parent, may_replace, OTHER_TABLE) as staged:
        for name, (columns, streams) in tables.items():
            write = _write_parquet if path.suffix.lower() == ".parquet" else _write_csv
            write(staged / name, columns, streams, len(recordings) > 1)
    return targets


def _beside(path: Path, what: str) -> str:
    """The name of the table of `what` beside that of the poses: take.commands.csv beside take.csv."""
    return f"{path.stem}.{what}{path.suffix}"


def _write_csv(path: Path, columns: tuple[str, ...], streams: Mapping[str, Stream], names_takes: bool) -> None:
    """Write streams one below the other as CSV, every number to its last digit."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*["take"] * names_takes, *columns])
        for name, stream in streams.items():
            rows = zip(stream.time_s.tolist(), stream.values.tolist(), strict=True)
            writer.writerows([*[name] * names_takes, time_s, *values] for time_s, values in rows)


def _write_parquet(path: Path, columns: tuple[str, ...], streams: Mapping[str, Stream], names_takes: bool) -> None:
    """Write streams one below the other as Parquet."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq

    values = np.vstack([np.column_stack([s.time_s, s.values]) for s in streams.values()])
    table = {name: pa.array(np.ascontiguousarray(column)) for name, column in zip(columns, values.T, strict=True)}
    if names_takes:
        takes = [name for name, s in streams.items() for _ in range(len(s))]
        table = {"take": pa.array(takes).dictionary_encode(), **table}
    pq.write_table(pa.table(table), path, compression="zstd", write_page_checksum=True)
