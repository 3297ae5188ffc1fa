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

WRITERS: dict[str, Callable[[Path, int, int], Path]] = {
    "motive": lambda folder, count, kB: write_large_motive(folder / f"{count}_{kB}.csv", count, 26 * kB),
    "mcap": lambda folder, count, kB: write_large_mcap(folder / f"{count}_{kB}.mcap", count, 1000 * kB * count),
}
"""Files by the number of their poses, and by how many kB of other data come with each."""
FEW, MANY = 6_000, 60_000
LITTLE, MUCH = 10, 20
MOST_BYTES_A_BYTE = 0.3
"""Resident bytes for each byte that is not the car's; read as text, a file takes seven times its size."""
MOST_BYTES_A_POSE = 900
"""Resident bytes for each pose of the car: some dozen numbers, and what is made of them on the way."""


@pytest.fixture(scope="module")
def car(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("large") / "vehicle.toml"
    path.write_text(VEHICLE, encoding="utf-8")
    return path


def measure_growth(car: Path, recordings: list[Path]) -> int:
    """By how many bytes the largest resident memory of a process grows from the first of two recordings to both."""
    command = [sys.executable, "-c", READ, str(car), *map(str, recordings)]
    shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    return 1024 * (int(shown[1]) - int(shown[0]))


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is measured as Linux counts it")
@pytest.mark.parametrize("kind", list(WRITERS))
def test_memory_does_not_grow_with_what_is_not_the_cars(kind: str, car: Path, tmp_path: Path) -> None:
    paths = [WRITERS[kind](tmp_path, FEW, kB) for kB in (LITTLE, MUCH)]
    sizes = [path.stat().st_size for path in paths]
    assert sizes[1] - sizes[0] > 50e6
    assert measure_growth(car, paths) < MOST_BYTES_A_BYTE * (sizes[1] - sizes[0])


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory is measured as Linux counts it")
@pytest.mark.parametrize("kind", list(WRITERS))
def test_a_pose_takes_little_memory(kind: str, car: Path, tmp_path: Path) -> None:
    paths = [WRITERS[kind](tmp_path, count, 1) for count in (FEW, MANY)]
    assert measure_growth(car, paths) < MOST_BYTES_A_POSE * (MANY - FEW)


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
