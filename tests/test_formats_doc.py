"""Every example of docs/formats.md is what a logger writes of a drive, and is read as that drive."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from making import circling_take

from bcid.recording.read import read_raw_take
from bcid.vehicle import Vehicle

DOC = Path(__file__).parents[1] / "docs" / "formats.md"
CAR = {
    "name": "car",
    "body": {"cog_to_front_m": 0.54, "cog_to_rear_m": 0.33},
    "steering": {"max_angle_rad": 2.0},
}
T = np.arange(400) / 100.0
YAW = 0.6 * T
X, Y = np.sin(YAW) / 0.6, (1.0 - np.cos(YAW)) / 0.6
QZ, QW = np.sin(YAW / 2), np.cos(YAW / 2)
T_C = np.arange(40) / 10.0
STEER = 0.5 + 0.01 * np.arange(40)
GAS = 1.2


def _joined(k: int) -> str:
    pose = f"{1780000000 + k // 100},{k % 100 * 10_000_000},{X[k]:.6f},{Y[k]:.6f},{YAW[k]:.6f},,"
    row = k // 10
    command = f"\n{1780000000 + k // 100},{k % 100 * 10_000_000 + 3_000_000},,,,{STEER[row]:.4f},{GAS:.4f}"
    return pose + (command if k % 10 == 0 else "")


COMMANDS: dict[str, Callable[[int], str]] = {
    "A commands file as it is expected": lambda k: f"{T_C[k]:.3f},{STEER[k]:.4f},{GAS:.4f}",
    "A commands file of another logger": lambda k: f"{100 * k};{np.degrees(STEER[k]):.4f};0.7000".replace(".", ","),
    "Commands stamped by a clock": lambda k: (
        f"2026-05-04T14:15:{30 + (125 + 100 * k) // 1000:02d}.{(125 + 100 * k) % 1000:03d}Z,{STEER[k]:.4f},{GAS:.4f}"
    ),
    "Commands without a header": lambda k: f"{T_C[k]:.3f},{GAS:.4f},{STEER[k]:.4f}",
}
"""How a row of each commands file is written."""

TABLES: dict[str, Callable[[int], str]] = {
    "Poses and commands in the same rows": lambda k: (
        f"{T[k]:.3f},{X[k]:.6f},{Y[k]:.6f},{YAW[k]:.6f},{STEER[k // 10]:.4f},{GAS:.4f}"
    ),
    "Streams in rows of their own": _joined,
    "Quaternions, and positions in mm with Y up": lambda k: (
        f"{T[k]:.3f},{1e3 * X[k]:.3f},450.000,{-1e3 * Y[k]:.3f},0.000000,{QZ[k]:.6f},0.000000,{QW[k]:.6f},"
        f"{STEER[k // 10]:.4f},{GAS:.4f}"
    ),
    "A trajectory (TUM) with a commands file": lambda k: (
        f"{1780000000 + T[k]:.3f} {X[k]:.6f} {Y[k]:.6f} 0.300000 0.000000 0.000000 {QZ[k]:.6f} {QW[k]:.6f}"
    ),
    "Two header rows and a row of units (Vicon)": lambda k: (
        f"{k + 1},0,0.0,0.0,{np.degrees(YAW[k]):.5f},{1e3 * X[k]:.3f},{1e3 * Y[k]:.3f},450.0,"
        f"{STEER[k // 10]:.4f},{GAS:.4f}"
    ),
}
"""How a row of each table is written."""


def examples() -> dict[str, tuple[str, str]]:
    """The vehicle file's part and the first lines of the file of each example, by its title."""
    found = {}
    for part in DOC.read_text(encoding="utf-8").split("\n### ")[1:]:
        title, _, body = part.partition("\n")
        blocks = dict(re.findall(r"```(toml|csv)\n(.*?)```", body.split("\n## ")[0], re.DOTALL))
        if "csv" in blocks:
            found[title] = (blocks.get("toml", ""), blocks["csv"])
    return found


def whole_file(title: str, row: Callable[[int], str], count: int) -> str:
    """The file of `count` rows of which the docs show the first lines."""
    shown = examples()[title][1]
    head = shown.partition(row(0).split("\n")[0])[0]
    text = head + "".join(row(k) + "\n" for k in range(count))
    assert text.startswith(shown)
    return text


def vehicle_of(title: str) -> Vehicle:
    """The car with the part of its vehicle file that the docs show."""
    settings = tomllib.loads(examples()[title][0])
    mocap = {"rigid_body": "bumper_car", **settings.pop("mocap", {})}
    return Vehicle.model_validate({**CAR, "mocap": mocap, **settings})


def test_every_example_is_tried() -> None:
    assert list(examples()) == [*COMMANDS, *TABLES]


@pytest.mark.parametrize("title", list(COMMANDS))
def test_a_commands_file_is_read_as_the_docs_show(title: str, tmp_path: Path) -> None:
    path = circling_take(tmp_path, seconds=4.0)
    text = whole_file(title, COMMANDS[title], len(T_C))
    path.with_suffix(".commands.csv").write_text(text, encoding="utf-8")
    take = read_raw_take(path, vehicle_of(title))
    np.testing.assert_allclose(take.command_time_s, T_C, atol=1e-6)
    np.testing.assert_allclose(take.command, np.column_stack([STEER, np.full_like(STEER, GAS)]), atol=1e-5)


@pytest.mark.parametrize("title", list(TABLES))
def test_a_table_is_read_as_the_docs_show(title: str, tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    path.write_text(whole_file(title, TABLES[title], len(T)), encoding="utf-8")
    commands = "".join(COMMANDS["A commands file as it is expected"](k) + "\n" for k in range(len(T_C)))
    path.with_suffix(".commands.csv").write_text(f"time_s,steering_rad,throttle_mps\n{commands}", encoding="utf-8")
    take = read_raw_take(path, vehicle_of(title))
    np.testing.assert_allclose(take.pose_time_s, T, atol=1e-6)
    np.testing.assert_allclose(take.pose, np.column_stack([X, Y, YAW]), atol=1e-5)
    late_s = 0.003 if title == "Streams in rows of their own" else 0.0
    row = np.searchsorted(T_C + late_s, take.command_time_s + 1e-6, side="right") - 1
    assert set(row) == set(range(len(T_C)))
    np.testing.assert_allclose(take.command[:, 0], STEER[row], atol=1e-4)
    np.testing.assert_allclose(take.command[:, 1], GAS, atol=1e-6)


def test_the_motive_export_of_the_docs_is_read_as_the_drive_it_is_of(tmp_path: Path) -> None:
    """Its head, with a drive's rows below it: Motive's x is ours, its z points to our right, its y up."""
    text = re.search(r"```text\n(Format Version.*?)```", DOC.read_text(encoding="utf-8"), re.DOTALL)
    assert text is not None
    head = text[1].splitlines()[:7]
    # frames come at the rate that the head states
    t = np.arange(400) / 120.0
    yaw = 0.6 * t
    x, y, qz, qw = np.sin(yaw) / 0.6, (1.0 - np.cos(yaw)) / 0.6, np.sin(yaw / 2), np.cos(yaw / 2)
    rows = [f"{k},{t[k]:.6f},0.0,{qz[k]:.8f},0.0,{qw[k]:.8f},{x[k]:.8f},0.35,{-y[k]:.8f}" for k in range(len(t))]
    (tmp_path / "drive.csv").write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")
    (tmp_path / "drive.commands.csv").write_text(
        "\n".join(["time_s,steering_rad,throttle_mps", *(f"{t:.3f},0.5,1.2" for t in T_C)]) + "\n", encoding="utf-8"
    )
    take = read_raw_take(tmp_path / "drive.csv", Vehicle.model_validate(CAR), None)
    assert take.pose[:, :2] == pytest.approx(np.column_stack([x, y]), abs=1e-6)
    assert take.pose[:, 2] == pytest.approx(yaw, abs=1e-6)
