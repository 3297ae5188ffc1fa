"""Many recordings as tables in parts, a part for each recording, which other programs read as one table.

    FOLDER/poses/recording=NAME/part-0.parquet        time_s, x_m, y_m, yaw_rad
    FOLDER/commands/recording=NAME/part-0.parquet     time_s, steering_rad, throttle_mps
    FOLDER/CHANNEL/recording=NAME/part-0.parquet      time_s, CHANNEL

The folder's name gives the column `recording`, as Hive has it: pandas, polars, DuckDB and Spark read FOLDER/poses as
one table, and for a query of one recording only its file.  Signs of a name that have a meaning there read like %2F.
One recording is in memory at a time.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from urllib.parse import quote

from bcid.files.outputs import MayReplace, refuse_to_overwrite, staged_outputs
from bcid.pipeline.tidy_tables import COMMAND_COLUMNS, OTHER_TABLE, POSE_COLUMNS
from bcid.recording.saving import RecordingSummary, load_recording
from bcid.recording.types import Recording, Stream

PART = "part-0.parquet"
UNITS = {
    "time_s": "s", "x_m": "m", "y_m": "m", "yaw_rad": "rad", "steering_rad": "rad",
    "throttle_mps": "m/s, or a brake share below zero", "measured_steering_rad": "rad", "yaw_rate_radps": "rad/s",
    "wheel_speed_mps": "m/s", "brake_share": "1",
}  # fmt: skip
"""Units of the columns, which stand in the metadata of each column, too."""
ROW_GROUP = 1 << 18  # rows that a reader takes in at a time


def write_partitioned_tables(folder: Path, recordings: Mapping[str, Path], may_replace: MayReplace) -> list[Path]:
    """Write ingested recordings as tables in parts into `folder`; returns the folders of the tables.

    `recordings` are the folders that `save_recording` wrote, by the recordings' names.  Other recordings that are in
    `folder` already stay there.

    Raises:
        InputRefused: a part is there already that `may_replace` does not allow to replace.
    """
    channels = {name: RecordingSummary.read(saved / "recording.json").channels for name, saved in recordings.items()}
    parts = [
        folder / table / _partition(name) / PART
        for name in recordings for table in ("poses", "commands", *channels[name])
    ]  # fmt: skip
    refuse_to_overwrite(parts, may_replace, OTHER_TABLE)
    tables = dict[str, None]()
    with staged_outputs(folder, may_replace, OTHER_TABLE) as staged:
        for name, saved in recordings.items():
            for table, (columns, stream) in _tables_of(load_recording(saved)).items():
                path = staged / table / _partition(name) / PART
                path.parent.mkdir(parents=True)
                _write_part(path, columns, stream)
                tables[table] = None
    return [folder / table for table in tables]


def _partition(name: str) -> str:
    """The folder of a recording's part, which says the value of the column `recording`.

    >>> _partition("a/drive[0:60]")
    'recording=a%2Fdrive%5B0%3A60%5D'
    """
    return f"recording={quote(name, safe=' ')}"


def _tables_of(recording: Recording) -> dict[str, tuple[tuple[str, ...], Stream]]:
    """The columns and samples of a recording's poses, commands and channels, by the tables' names."""
    channels = {name: (("time_s", name), stream) for name, stream in recording.channels.items()}
    return {"poses": (POSE_COLUMNS, recording.poses), "commands": (COMMAND_COLUMNS, recording.commands), **channels}


def _write_part(path: Path, columns: tuple[str, ...], stream: Stream) -> None:
    """Write a stream, its times and its values (N, n), as Parquet with the unit of each column in its metadata."""
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq

    values = [stream.time_s, *stream.values.T]
    fields = [pa.field(name, pa.float64(), metadata={"unit": UNITS.get(name, "SI")}) for name in columns]
    table = pa.Table.from_arrays([pa.array(np.ascontiguousarray(v)) for v in values], schema=pa.schema(fields))
    pq.write_table(table, path, row_group_size=ROW_GROUP, compression="zstd", write_page_checksum=True)
