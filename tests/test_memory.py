"""The memory that reading takes grows with the poses of one car, not with the bytes of the file."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from large_recordings import VEHICLE, write_large_mcap, write_large_motive

from bcid.errors import InputRefused
from bcid.recording.formats import csv_text
from bcid.recording.read import read_raw_take
from bcid.vehicle import read_vehicle

READ = """
import re, sys
from pathlib import Path
from bcid.recording.formats.detect import find_commands_file
from bcid.recording.read import read_raw_take
from bcid.vehicle import read_vehicle

for name in sys.argv[2:]:
    path = Path(name)
    read_raw_take(path, read_vehicle(Path(sys.argv[1])), find_commands_file(path, None))
    # a process's ru_maxrss counts that of the process that started it, too
    print(re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())[1])
"""

WRITERS: dict[str, Callable[[Path, int], Path]] = {
    "motive": lambda folder, count: write_large_motive(folder / f"{count}.csv", count, 40),
    "mcap": lambda folder, count: write_large_mcap(folder / f"{count}.mcap", count, 1500 * count),
}
SMALL, LARGE = 6_000, 30_000  # poses; a pose comes with 1.5 kB
MOST_BYTES_A_BYTE = 0.8
"""Resident bytes for each byte of a file whose poses are a small part; read as text, it takes seven times its size."""


@pytest.fixture(scope="module")
def car(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("large") / "vehicle.toml"
    path.write_text(VEHICLE, encoding="utf-8")
    return path


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is measured as Linux counts it")
@pytest.mark.parametrize("kind", list(WRITERS))
def test_memory_does_not_grow_with_what_is_not_the_cars(kind: str, car: Path, tmp_path: Path) -> None:
    paths = [WRITERS[kind](tmp_path, count) for count in (SMALL, LARGE)]
    command = [sys.executable, "-c", READ, str(car), *map(str, paths)]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    grown = 1024 * (int(shown[1]) - int(shown[0]))
    sizes = [path.stat().st_size for path in paths]
    assert sizes[1] > 40e6
    assert grown < MOST_BYTES_A_BYTE * (sizes[1] - sizes[0])


def test_a_motive_export_of_plain_numbers_may_have_any_size(
    car: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_large_motive(tmp_path / "take.csv", 600, 1)
    commands = path.with_suffix(".commands.csv")
    monkeypatch.setattr(csv_text, "LIMITS", replace(csv_text.LIMITS, max_bytes=50_000))
    assert len(read_raw_take(path, read_vehicle(car), commands).pose_time_s) == 600
    # a text among the numbers, and the file is read whole
    path.write_text(path.read_text(encoding="utf-8").replace("\n300,", '\n"300",'), encoding="utf-8")
    with pytest.raises(InputRefused, match="50000 are the most"):
        read_raw_take(path, read_vehicle(car), commands)
