"""Drives written as labs record them: Motive CSV with its commands file, or one MCAP file; truth apart."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np

from bcid.aliases import Floats
from bcid.files.parquet import write_columns
from bcid.simulation.drive import Drive

POSE_TOPIC = "/mocap/bumper_car/pose"
COMMAND_TOPIC = "/bumper_car/command"
BODY = "bumper_car"
EPOCH_NS = 1_767_225_600_000_000_000  # the simulated takes all begin at this instant
POSE_LATENCY_NS = 8_000_000  # what a pose takes to reach the recorder
HEIGHT_M = 0.35
TILT_RAD = 2e-3
TRUTH_UNITS = {
    "time": "s",
    "x": "m",
    "y": "m",
    "yaw": "rad",
    "v_x": "m/s",
    "v_y": "m/s",
    "yaw_rate": "rad/s",
    "delta": "rad",
}


def _quaternions(yaw: Floats, rng: np.random.Generator) -> Floats:
    """Y-up orientations (N, 4) in x, y, z, w: yaw about Y after a small tilt of the chassis."""
    tilt_x, tilt_z = 0.5 * TILT_RAD * rng.standard_normal((2, len(yaw)))
    sin_h, cos_h = np.sin(0.5 * yaw), np.cos(0.5 * yaw)
    product = np.column_stack([cos_h * tilt_x + sin_h * tilt_z, sin_h, cos_h * tilt_z - sin_h * tilt_x, cos_h])
    return np.asarray(product / np.linalg.norm(product, axis=1, keepdims=True))


def write_motive(path: Path, drive: Drive, rate_hz: float, seed: int) -> None:
    """NAME.csv as Motive 3 exports it (format 1.24, Y up, meters) and NAME.commands.csv beside it."""
    rng = np.random.default_rng([seed, 1])
    n = len(drive.frame)
    quaternion = _quaternions(drive.pose[:, 2], rng)
    height = HEIGHT_M + 5e-4 * rng.standard_normal(n)
    position = np.column_stack([drive.pose[:, 0], height, -drive.pose[:, 1]])
    marker_error = 2e-4 + 5e-5 * np.abs(rng.standard_normal(n))
    body_id = "5CDD43C6912211E942374A447B10D786"
    first = {
        "Format Version": "1.24", "Take Name": path.stem, "Take Notes": "simulated by bcid",
        "Capture Frame Rate": f"{rate_hz:.6f}", "Export Frame Rate": f"{rate_hz:.6f}",
        "Capture Start Time": "2026-01-01 12.00.00.000 AM", "Capture Start Frame": "0",
        "Total Frames in Take": str(n), "Total Exported Frames": str(n),
        "Rotation Type": "Quaternion", "Length Units": "Meters", "Coordinate Space": "Global",
    }  # fmt: skip
    measures = ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\r\n")
        rows.writerow([cell for pair in first.items() for cell in pair])
        rows.writerow([])
        rows.writerow(["", "Type", *["Rigid Body"] * 8])
        rows.writerow(["", "Name", *[BODY] * 8])
        rows.writerow(["", "ID", *[body_id] * 8])
        rows.writerow(["", "", *measures])
        rows.writerow(["Frame", "Time (Seconds)", "X", "Y", "Z", "W", "X", "Y", "Z", ""])
        for k in range(n):
            cells = [*quaternion[k], *position[k], marker_error[k]]
            seen = np.isfinite(drive.pose[k, 0])
            rows.writerow(
                [drive.frame[k], f"{drive.frame[k] / rate_hz:.6f}", *(f"{c:.6f}" if seen else "" for c in cells)]
            )
    with path.with_suffix(".commands.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["time_s", "steering_rad", "throttle_mps"])
        for t, (steer, throttle) in zip(drive.command_time, drive.command, strict=True):
            rows.writerow([f"{t:.3f}", f"{steer:.6f}", f"{throttle:.6f}"])


_POSE_SCHEMA = {
    "title": "foxglove.PoseInFrame",
    "type": "object",
    "properties": {
        "timestamp": {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}},
        "frame_id": {"type": "string"},
        "pose": {"type": "object"},
    },
}
_COMMAND_SCHEMA = {
    "title": "bcid.Command",
    "type": "object",
    "properties": {
        "timestamp": {"type": "object"},
        "steering_rad": {"type": "number"},
        "throttle_mps": {"type": "number"},
    },
}


def write_mcap(path: Path, drive: Drive, rate_hz: float, seed: int) -> None:
    """One MCAP file: poses as foxglove.PoseInFrame and commands as JSON, both stamped, Z up."""
    from mcap.writer import CompressionType, Writer

    rng = np.random.default_rng([seed, 2])
    late = POSE_LATENCY_NS + rng.integers(0, 2_000_000, len(drive.frame))
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(library="bcid simulation")
        topics = {}
        for topic, name, schema in (
            (POSE_TOPIC, "foxglove.PoseInFrame", _POSE_SCHEMA),
            (COMMAND_TOPIC, "bcid.Command", _COMMAND_SCHEMA),
        ):
            schema_id = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            topics[topic] = writer.register_channel(topic, "json", schema_id)
        entries = []
        for k in np.flatnonzero(np.isfinite(drive.pose[:, 0])):
            stamp = EPOCH_NS + round(drive.frame[k] * 1e9 / rate_hz)
            entries.append((stamp + int(late[k]), stamp, POSE_TOPIC, _pose_message(stamp, drive.pose[k])))
        for t, (steer, throttle) in zip(drive.command_time, drive.command, strict=True):
            stamp = EPOCH_NS + round(t * 1e9)
            command = {"steering_rad": round(steer, 6), "throttle_mps": round(throttle, 6)}
            entries.append((stamp, stamp, COMMAND_TOPIC, {"timestamp": _stamp(stamp), **command}))
        for log_time, stamp, topic, message in sorted(entries, key=lambda e: e[0]):
            data = json.dumps(message, separators=(",", ":")).encode()
            writer.add_message(topics[topic], log_time=log_time, publish_time=stamp, data=data)
        writer.finish()  # type: ignore[no-untyped-call]


def _stamp(ns: int) -> dict[str, int]:
    return {"sec": ns // 1_000_000_000, "nsec": ns % 1_000_000_000}


def _pose_message(stamp: int, pose: Floats) -> dict[str, object]:
    x, y, yaw = (float(v) for v in pose)
    turn = {"x": 0.0, "y": 0.0, "z": round(float(np.sin(0.5 * yaw)), 8), "w": round(float(np.cos(0.5 * yaw)), 8)}
    place = {"x": round(x, 6), "y": round(y, 6), "z": HEIGHT_M}
    return {"timestamp": _stamp(stamp), "frame_id": "floor", "pose": {"position": place, "orientation": turn}}


def write_truth(path: Path, drive: Drive) -> None:
    """The true motion at 10 Hz, apart from the recording: only the estimator's own check reads it."""
    write_columns(path, drive.truth, TRUTH_UNITS)
