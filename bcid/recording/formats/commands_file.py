"""The commands file beside a Motive export: `time_s,steering_rad,throttle_mps`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.recording.formats.csv_text import read_text
from bcid.recording.formats.raw import source_of
from bcid.recording.formats.tables import numbers, read_csv
from bcid.recording.types import COMMANDS, Irregularity, Source
from bcid.vehicle import CHANNELS

REQUIRED = ("time_s", "steering_rad", "throttle_mps")


def read_commands(
    path: Path,
) -> tuple[Source, Floats, Floats, dict[str, tuple[Floats, Floats]], tuple[Irregularity, ...]]:
    """Source, times (M,), commands (M, 2), further channels, and what was odd.

    Raises:
        InputRefused: missing file or column, or a cell that is no number.
    """
    if not path.exists():
        raise InputRefused(
            path,
            "commands file",
            "does not exist",
            "put the commands beside the export as NAME.commands.csv, or name them with --commands",
        )
    source, text = source_of(path, COMMANDS), read_text(path)
    table = read_csv(text)
    present = [c for c in CHANNELS if c in table.columns]
    column = numbers(table, [*REQUIRED, *present], path, f"the header must read {','.join(REQUIRED)}")
    if table.empty:
        raise InputRefused(path, "line 2", "holds a header and no commands", "record the commands again")
    command = np.column_stack([column[c] for c in REQUIRED[1:]])
    channels = {c: (column["time_s"], column[c]) for c in present}
    extra = [str(c) for c in table.columns if c not in (*REQUIRED, *CHANNELS)]
    odd = Irregularity("unknown column", "warning", len(extra), f"{path.name} line 1", ", ".join(extra))
    return source, column["time_s"], command, channels, (*text.odd, *((odd,) if extra else ()))
