"""A clean drive, and ways to write it as recordings of every format with something wrong."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mcap.writer import CompressionType, Writer

from bcid.recording.read import read_recording
from bcid.simulation.car import REAL_EXTRAS, Plant, Sensor
from bcid.simulation.samples import VEHICLE, SampleTake, write_sample_take
from bcid.vehicle import Vehicle, read_vehicle

NS0 = 1_767_225_600_000_000_000
POSE, COMMAND = "/mocap/bumper_car/pose", "/bumper_car/command"
TYPES = ("foxglove.PoseInFrame", "bcid.Command")
COLUMNS = {"time_s": "t", "x_m": "px", "y_m": "py", "yaw_rad": "psi", "steering_rad": "steer", "throttle_mps": "gas"}

Floats = np.ndarray
Rows = list[list[str]]
Message = tuple[int, Any]  # log time in ns, content
Tries = Iterator[tuple[str, Path] | tuple[str, Path, Vehicle]]
"""What is tried: a label, a file, and the vehicle file where it is not the usual one."""


class Lab:
    """The drive as Motive export, MCAP file and table in one folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "car.toml").write_text(VEHICLE)
        self.vehicle = read_vehicle(folder / "car.toml")
        self.tabled = self.veh(columns=COLUMNS)
        self.motive_file, self.mcap_file = (
            write_sample_take(folder, SampleTake(name, kind, 30.0), Plant(**REAL_EXTRAS), Sensor(), 11)
            for name, kind in (("drive", "motive"), ("drive_m", "mcap"))
        )
        clean = read_recording(self.mcap_file, self.vehicle)
        self.T, self.P = clean.poses.time_s, clean.poses.values
        self.TC, self.C = clean.commands.time_s, clean.commands.values
        self.Q = about_z(self.P[:, 2])
        self.clean = {
            "mcap": clean, "motive": read_recording(self.motive_file, self.vehicle),
            "table": read_recording(self.table(lambda d: d), self.tabled),
        }  # fmt: skip

    def mid(self, a: float, b: float) -> Floats:
        """The poses from a to b (s)."""
        return (a <= self.T) & (b > self.T)

    def veh(self, **change: Any) -> Vehicle:
        """The vehicle file with other entries."""
        data = self.vehicle.model_dump(by_alias=True)
        for name, values in change.items():
            data[name] = {**(data[name] or {}), **values}
        return Vehicle.model_validate(data)

    def motive(
        self, change: Callable[[Rows], Any], name: str = "m",
        commands: Callable[[pd.DataFrame], pd.DataFrame] = lambda c: c,
    ) -> Path:  # fmt: skip
        """The Motive export whose rows went through `change`, and its commands through `commands`."""
        with self.motive_file.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
        rows = change(rows) or rows
        path = self.folder / f"{name}.csv"
        with path.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows(rows)
        beside = pd.read_csv(self.motive_file.with_suffix(".commands.csv"))
        commands(beside).to_csv(path.with_suffix(".commands.csv"), index=False)
        return path

    def two_files(self, name: str, export: bytes | None = None, commands: bytes | None = None) -> Path:
        """The Motive export and its commands file with other bytes."""
        path = self.folder / f"{name}.csv"
        path.write_bytes(self.motive_file.read_bytes() if export is None else export)
        beside = self.motive_file.with_suffix(".commands.csv").read_bytes()
        path.with_suffix(".commands.csv").write_bytes(beside if commands is None else commands)
        return path

    def bytes_file(self, name: str, data: bytes | bytearray) -> Path:
        """A file of these bytes."""
        (self.folder / name).write_bytes(data)
        return self.folder / name

    def table(self, change: Callable[[pd.DataFrame], pd.DataFrame], name: str = "t", **how: Any) -> Path:
        """The table that went through `change`."""
        u = self.C[np.maximum(np.searchsorted(self.TC, self.T, side="right") - 1, 0)]
        x, y, yaw = self.P.T
        frame = pd.DataFrame({"t": self.T, "px": x, "py": y, "psi": yaw, "steer": u[:, 0], "gas": u[:, 1]})
        change(frame).to_csv(self.folder / f"{name}.csv", index=False, **how)
        return self.folder / f"{name}.csv"

    def poses(self, t: Floats | None = None, p: Floats | None = None, q: Floats | None = None) -> list[Message]:
        """Pose messages, logged 8 ms late."""
        t, p, q = (self.T if t is None else t), (self.P if p is None else p), (self.Q if q is None else q)
        found = []
        for s, at, turn in zip(t, p, q, strict=True):
            ns = NS0 + round(s * 1e9)
            where = {"x": float(at[0]), "y": float(at[1]), "z": 0.3}
            pose = {"position": where, "orientation": dict(zip("xyzw", map(float, turn), strict=True))}
            found.append((ns + 8_000_000, {"timestamp": stamp(ns), "pose": pose}))
        return found

    def commands(self, t: Floats | None = None, c: Floats | None = None, stamped: bool = True) -> list[Message]:
        """Command messages."""
        t, c = (self.TC if t is None else t), (self.C if c is None else c)
        found = []
        for s, (u_s, u_m) in zip(t, c, strict=True):
            ns = NS0 + round(s * 1e9)
            own = {"timestamp": stamp(ns)} if stamped else {}
            found.append((ns, {**own, "steering_rad": float(u_s), "throttle_mps": float(u_m)}))
        return found

    def mcap(
        self, pose: list[Any] | None = None, command: list[Any] | None = None, name: str = "b", order: bool = True,
        extra: Callable[[Writer], None] = lambda w: None, types: tuple[str, str] = TYPES,
        encoding: tuple[str, str] = ("json", "json"),
        others: tuple[tuple[str, str, str, bytes, list[Any]], ...] = (), **how: Any,
    ) -> Path:  # fmt: skip
        """An MCAP file; `others` are further (topic, encoding, schema name or "", schema data, messages)."""
        path = self.folder / f"{name}.mcap"
        pose, command = (self.poses() if pose is None else pose), (self.commands() if command is None else command)
        topics = [
            (POSE, encoding[0], types[0], b"{}", pose), (COMMAND, encoding[1], types[1], b"{}", command), *others
        ]  # fmt: skip
        with path.open("wb") as file:
            w = Writer(file, **{"compression": CompressionType.ZSTD, "chunk_size": 65536, **how})
            w.start()
            entries = []
            for topic, kind, schema, data, rows in topics:
                channel = w.register_channel(
                    topic, kind, w.register_schema(schema, "jsonschema", data) if schema else 0
                )
                entries += [(log, channel, m) for log, m in rows]
            extra(w)
            for log, channel, m in sorted(entries, key=lambda e: e[0]) if order else entries:
                content = m if isinstance(m, bytes) else json.dumps(m).encode()
                w.add_message(channel, log_time=log, publish_time=log, data=content)
            w.finish()
        return path


def about_z(yaw: Floats) -> Floats:
    """Quaternions x, y, z, w of turns about Z."""
    return np.column_stack([0 * yaw, 0 * yaw, np.sin(yaw / 2), np.cos(yaw / 2)])


def stamp(ns: int) -> dict[str, int]:
    """A message's stamp."""
    return {"sec": int(ns) // 10**9, "nsec": int(ns) % 10**9}


def cells(change: Callable[[Floats], Any]) -> Callable[[Rows], None]:
    """A change of a Motive table's numbers (N, 8): quaternion x y z w, position x y z, marker error."""

    def on_rows(rows: Rows) -> None:
        body = rows[7:]
        x = np.array([[float(c) if c else np.nan for c in r[2:10]] for r in body])
        made = change(x)
        for r, line in zip(body, x if made is None else made, strict=True):
            r[2:10] = ["" if np.isnan(c) else f"{c:.6f}" for c in line]

    return on_rows


def texts(at: list[int], column: int, text: str) -> Callable[[Rows], None]:
    """A text in one column of some of a Motive table's rows."""

    def on_rows(rows: Rows) -> None:
        for i in at:
            rows[7 + i][column] = text

    return on_rows


def keyed(key: str, value: str) -> Callable[[Rows], None]:
    """Another value in a Motive export's first row."""

    def on_rows(rows: Rows) -> None:
        rows[0][rows[0].index(key) + 1] = value

    return on_rows
