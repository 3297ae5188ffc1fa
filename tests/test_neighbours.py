"""Which files beside a recording are looked at for the commands of its motion, and by which clock."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fleet import draw_drive
from test_commands_and_motion import VEHICLE, table

from bcid.errors import InputRefused
from bcid.recording import neighbours
from bcid.recording.assemble import assemble_recording
from bcid.recording.formats.detect import MCAP_MAGIC
from bcid.recording.neighbours import find_fitting_commands
from bcid.recording.types import Stream
from bcid.vehicle import Vehicle, read_vehicle


@pytest.fixture
def looked_at(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of what is opened as a neighbour, none of which can be read."""
    names = list[str]()

    def refuse(path: Path, vehicle: Vehicle, commands: Path | None = None) -> Any:
        names.append((commands or path).name)
        raise InputRefused(path, "file", "is no recording", "none")

    monkeypatch.setattr(neighbours, "read_raw_take", refuse)
    return names


def find(path: Path, own: str = "") -> Path | None:
    """What is found beside a recording whose commands stand in the file `own`."""
    recording: Any = SimpleNamespace(sources=(SimpleNamespace(path=own or path.name, format="mcap"),))
    vehicle: Any = None
    return find_fitting_commands(path, recording, vehicle)


def bag(folder: Path, size: int = 100) -> Path:
    """A folder of a bag whose part has this size."""
    folder.mkdir()
    (folder / "metadata.yaml").write_text("relative_file_paths:\n  - part_0.mcap\n")
    (folder / "part_0.mcap").write_bytes(MCAP_MAGIC)
    with (folder / "part_0.mcap").open("r+b") as file:
        file.truncate(size)
    return folder


def test_beside_a_bag_s_folder_only_such_folders_are_read(tmp_path: Path, looked_at: list[str]) -> None:
    path = bag(tmp_path / "take")
    bag(tmp_path / "other")
    bag(tmp_path / "huge", neighbours.LIMITS.max_neighbour_bytes + 1)
    (tmp_path / "pictures").mkdir()
    (tmp_path / "notes").write_text("of the day")
    (tmp_path / "film.mp4").write_bytes(bytes(1000))
    assert find(path) is None
    assert looked_at == ["other"]


def test_a_folder_is_known_by_a_dot(
    tmp_path: Path, looked_at: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    path = bag(tmp_path / "take")
    bag(tmp_path / "other")
    monkeypatch.chdir(path)
    assert find(Path(), "part_0.mcap") is None
    assert looked_at == ["other"]


def test_a_suffix_is_no_pattern(tmp_path: Path, looked_at: list[str]) -> None:
    for name in ("take.[cm]", "other.[cm]", "third.c", "fourth.m", "fifth", "sixth.[cm].old"):
        (tmp_path / name).write_bytes(MCAP_MAGIC)
    assert find(tmp_path / "take.[cm]") is None
    assert looked_at == ["other.[cm]"]


def test_files_that_vanish_are_passed_over(
    tmp_path: Path, looked_at: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:  # fmt: skip
    for name in ("take.mcap", "other.mcap"):
        (tmp_path / name).write_bytes(MCAP_MAGIC)
    (tmp_path / "gone.mcap").symlink_to(tmp_path / "nowhere")
    monkeypatch.setattr(Path, "is_file", lambda self: True)
    assert find(tmp_path / "take.mcap") is None
    assert looked_at == ["other.mcap"]


def test_the_clock_s_offset_counts_for_neighbours_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands by a clock that is ahead by more than a take: unless moved, they meet none of its motion."""
    (tmp_path / "rc.toml").write_text(f"{VEHICLE}[clock]\noffset_s = -1000.0\n")
    drive = draw_drive(30, "rc", "targets", 20.0, pose_hz=100.0)
    for name in ("take", "other"):
        table(drive.raw, tmp_path / f"{name}.csv")
    commands = list[Stream]()
    monkeypatch.setattr(neighbours, "prepare_turning", lambda changed, vehicle: commands.append(changed.commands))
    recording = assemble_recording(drive.raw, drive.kind.vehicle())
    assert find_fitting_commands(tmp_path / "take.csv", recording, read_vehicle(tmp_path / "rc.toml")) is None
    own_s = drive.raw.pose_time_s[np.isfinite(drive.raw.pose[:, 0])]
    np.testing.assert_allclose(commands[0].time_s, own_s - 1000.0, atol=1e-5)
