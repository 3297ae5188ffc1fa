"""Times of reading a Motive export and an MCAP file beside pyarrow, pandas and the package mcap, which verify less."""

import json
import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bcid.aliases import Floats
from bcid.bench.limits import SPEED
from bcid.bench.timing import Skipped, TimedPeer, Timing, Work, require, time_against_peers
from bcid.recording.read import read_raw_take
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import Drive, simulate_drive
from bcid.simulation.writing import POSE_TOPIC, write_mcap_take, write_motive_take
from bcid.virtual_lab import simulated_vehicle

# of a Motive export and of an MCAP file, each of which takes long enough to time
MOTIVE_S, MCAP_S, RATE_HZ = 6000.0, 600.0, 60.0
# Rows above the table of a Motive export, and its columns of x and z.
HEAD_ROWS, COLUMNS = 7, (6, 8)
# Poses in a file are rounded to 1e-6 m.
ROUNDED = 2e-6


def time_reading(repeats: int) -> Iterator[Timing | Skipped]:
    """Yield timings of reading 100 minutes of poses at 60 Hz from a Motive export, and ten from an MCAP file of JSON.

    Ours refuses or tells whatever is wrong with rows, cells, checksums and stamps; the peers only take the numbers out.
    Times are medians of max(3, repeats // 3) turns; `difference` is the largest of positions (m).
    """
    sensor, turns = Sensor(dropouts_per_minute=0.0), max(3, repeats // 3)
    long, short = (simulate_drive(Plant(), sensor, length_s, 1) for length_s in (MOTIVE_S, MCAP_S))
    with tempfile.TemporaryDirectory() as folder:
        yield from _time_motive(Path(folder) / "take.csv", long, turns)
        yield from _time_mcap(Path(folder) / "take.mcap", short, turns)


def _read_positions(path: Path) -> Floats:
    """Positions x, y (N, 2) in m that our reader gives of the recording at `path`."""
    return read_raw_take(path, simulated_vehicle()).pose[:, :2]


def _time_motive(path: Path, drive: Drive, turns: int) -> Iterator[Timing | Skipped]:
    """Yield timings of reading `drive` from a Motive export at `path`, against pyarrow and pandas."""
    write_motive_take(path, drive, RATE_HZ, 1)
    megabytes = 1e-6 * path.stat().st_size
    peers = {
        "pyarrow": TimedPeer(partial(_read_by_pyarrow, path), None, ROUNDED),
        "pandas": TimedPeer(partial(_read_by_pandas, path), None, ROUNDED),
    }
    longest_ms = 1e3 * megabytes / SPEED.slowest_motive_mb_s
    work = partial(_read_positions, path)
    yield from time_against_peers(f"Motive CSV, {megabytes:.1f} MB", work, peers, turns, longest_ms)


def _read_by_pyarrow(path: Path) -> Work:
    """The positions of a Motive export by pyarrow: the call that gives them (N, 2)."""
    require("pyarrow")
    from pyarrow import csv

    options = csv.ReadOptions(skip_rows=HEAD_ROWS, autogenerate_column_names=True, use_threads=False)

    def read() -> Floats:
        table = csv.read_csv(path, options)
        x, z = (table.column(i).to_numpy() for i in COLUMNS)
        return np.column_stack([x, -z])

    return read


def _read_by_pandas(path: Path) -> Work:
    """The positions of a Motive export by pandas: the call that gives them (N, 2)."""
    require("pandas")
    import pandas as pd

    def read() -> Floats:
        table = pd.read_csv(path, skiprows=HEAD_ROWS, header=None, skip_blank_lines=False)
        return np.column_stack([table[COLUMNS[0]], -table[COLUMNS[1]]])

    return read


def _time_mcap(path: Path, drive: Drive, turns: int) -> Iterator[Timing | Skipped]:
    """Yield the timing of reading `drive` from an MCAP file of JSON messages at `path`, against the package mcap."""
    write_mcap_take(path, drive, RATE_HZ, 1)
    count = len(drive.frame) + len(drive.command)
    peers = {"mcap + json": TimedPeer(partial(_read_by_mcap, path), None, ROUNDED)}
    longest_ms = 1e-3 * SPEED.longest_message_us * count
    yield from time_against_peers(
        f"MCAP JSON, {count} messages", partial(_read_positions, path), peers, turns, longest_ms
    )


def _read_by_mcap(path: Path) -> Work:
    """The positions of an MCAP file by the package mcap and Python's json: the call that gives them (N, 2)."""
    require("mcap")
    from mcap.reader import make_reader

    def read() -> Any:
        out = []
        with path.open("rb") as file:
            for _, channel, message in make_reader(file).iter_messages():
                decoded = json.loads(message.data)
                if channel.topic == POSE_TOPIC:
                    place = decoded["pose"]["position"]
                    out.append((place["x"], place["y"]))
        return np.array(out)

    return read
