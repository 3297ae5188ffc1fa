"""One drive in many notations and with losses: what is kept of it has the values of the clean read to 1e-6."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from catalogue.lab import COLUMNS, NS0, Lab, Rows

from bcid.recording.read import read_recording
from bcid.vehicle import Vehicle

LOST = slice(400, 460)  # rows of the poses that the tracking lost: a second at 60 Hz
Written = tuple[Path, Vehicle, str]  # a file, its vehicle file, and the clean drive that it holds


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Lab:
    """The clean drive in every format."""
    return Lab(tmp_path_factory.mktemp("values"))


def in_table(change: Callable[[pd.DataFrame], Any], columns: dict[str, Any] | None = None, **how: Any) -> Any:
    """A way to write the drive as a table whose frame went through `change`, with other mapped columns."""

    def write(lab: Lab) -> Written:
        def changed(frame: pd.DataFrame) -> pd.DataFrame:
            made = change(frame)
            return frame if made is None else made

        more = {name: value for name, value in how.items() if name in ("mocap", "command")}
        options = {name: value for name, value in how.items() if name not in more}
        return lab.table(changed, "changed", **options), lab.veh(columns=COLUMNS | (columns or {}), **more), "table"

    return write


def lose(value: float) -> Callable[[pd.DataFrame], None]:
    """A change that writes `value` for all of a lost pose."""

    def change(frame: pd.DataFrame) -> None:
        frame.loc[frame.index[LOST], ["px", "py", "psi"]] = value

    return change


def scale(**factors: float) -> Callable[[pd.DataFrame], None]:
    """A change that multiplies columns."""

    def change(frame: pd.DataFrame) -> None:
        for name, factor in factors.items():
            frame[name] *= factor

    return change


def lose_in_export(lab: Lab) -> Written:
    """The export with zeros for lost poses, as some solvers write them."""

    def change(rows: Rows) -> None:
        for row in rows[7:][LOST]:
            row[2:9] = ["0.000000"] * 7

    return lab.motive(change), lab.vehicle, "motive"


def quote_all(lab: Lab) -> Written:
    """The export with quotes around every cell."""
    with lab.motive_file.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    path = lab.motive(lambda rows: None, "quoted")
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, quoting=csv.QUOTE_ALL).writerows(rows)
    return path, lab.vehicle, "motive"


def stamped(make: Callable[[int], Any]) -> Callable[[Lab], Written]:
    """A way to write the messages with stamps that `make` writes of ns since 1970."""

    def write(lab: Lab) -> Written:
        poses, commands = lab.poses(), lab.commands()
        for k, (_, message) in enumerate(poses):
            message["timestamp"] = make(NS0 + round(lab.T[k] * 1e9))
        for k, (_, message) in enumerate(commands):
            message["timestamp"] = make(NS0 + round(lab.TC[k] * 1e9))
        return lab.mcap(poses, commands, "stamps"), lab.vehicle, "mcap"

    return write


def lose_in_messages(lab: Lab) -> Written:
    """Messages with zeros for lost poses."""
    poses = lab.poses()
    for _, message in poses[LOST]:
        message["pose"]["position"] = dict.fromkeys("xyz", 0.0)
        message["pose"]["orientation"] = dict.fromkeys("xyzw", 0.0)
    return lab.mcap(poses, name="lost"), lab.vehicle, "mcap"


def in_bursts(lab: Lab) -> Written:
    """Messages that were logged ten at a time, with even stamps of their own."""
    poses = lab.poses()
    log = [poses[min(9 + 10 * (k // 10), len(poses) - 1)][0] + k % 10 for k in range(len(poses))]
    return lab.mcap([(at, m) for at, (_, m) in zip(log, poses, strict=True)], name="bursts"), lab.vehicle, "mcap"


def utc(ns: int) -> str:
    """A stamp as RFC 3339 writes it."""
    return f"{np.datetime64(ns, 'ns')}Z"


WAYS: dict[str, tuple[Callable[[Lab], Written], bool]] = {
    "table: lost poses as zeros": (in_table(lose(0.0)), True),
    "table: lost poses as -9999": (in_table(lose(-9999.0)), True),
    "table: lost poses as blanks": (in_table(lose(np.nan)), True),
    "table: mm by the vehicle file": (in_table(scale(px=1e3, py=1e3), mocap={"length_unit": "mm"}), False),
    "table: cm by a gain": (
        in_table(scale(px=1e2, py=1e2), {k: {"from": c, "gain": 0.01} for k, c in (("x_m", "px"), ("y_m", "py"))}),
        False,
    ),
    "table: degrees by a gain": (
        in_table(
            scale(psi=180.0 / np.pi, steer=180.0 / np.pi),
            {k: {"from": c, "gain": np.pi / 180.0} for k, c in (("yaw_rad", "psi"), ("steering_rad", "steer"))},
        ), False,
    ),
    "table: km/h and ms by a gain": (
        in_table(
            scale(gas=3.6, t=1e3),
            {"throttle_mps": {"from": "gas", "gain": 1.0 / 3.6}, "time_s": {"from": "t", "gain": 1e-3}},
        ), False,
    ),
    "table: yaw wrapped": (
        in_table(lambda f: f.assign(psi=np.arctan2(np.sin(f.psi), np.cos(f.psi)))), False,
    ),
    "table: semicolons and decimal commas": (in_table(lambda f: f, sep=";", decimal=","), False),
    "table: UTF-16": (in_table(lambda f: f, encoding="utf-16"), False),
    "motive: lost poses as zeros": (lose_in_export, True),
    "motive: every cell quoted": (quote_all, False),
    "mcap: lost poses as zeros": (lose_in_messages, True),
    "mcap: stamps of arrival in bursts": (in_bursts, False),
    "mcap: secs and nsecs": (stamped(lambda ns: {"secs": ns // 10**9, "nsecs": ns % 10**9}), False),
    "mcap: RFC 3339": (stamped(utc), False),
    "mcap: decimal text": (stamped(lambda ns: f"{ns // 10**9}.{ns % 10**9:09d}"), False),
    "mcap: whole nanoseconds": (stamped(lambda ns: ns), False),
}  # fmt: skip


@pytest.mark.parametrize("name", WAYS)
def test_what_is_read_has_the_clean_values(name: str, lab: Lab) -> None:
    write, loses = WAYS[name]
    path, vehicle, kind = write(lab)
    take, clean = read_recording(path, vehicle), lab.clean[kind]
    lost_s = lab.T[LOST] if loses else np.zeros(0)
    kept = np.array([not np.any(np.abs(lost_s - t) < 1e-3) for t in clean.poses.time_s])
    np.testing.assert_allclose(take.poses.time_s, clean.poses.time_s[kept], atol=1e-6)
    np.testing.assert_allclose(take.poses.values, clean.poses.values[kept], atol=1e-6)
    np.testing.assert_allclose(take.commands.time_s, clean.commands.time_s, atol=1e-6)
    np.testing.assert_allclose(take.commands.values, clean.commands.values, atol=1e-6)
