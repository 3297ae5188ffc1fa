"""Drives written as labs record them: Motive CSV with its commands file, or one MCAP file; truth apart."""

import csv
import json
from pathlib import Path

import numpy as np

from bcid.aliases import Floats
from bcid.simulation.drive import Drive

BODY = "bumper_car"
POSE_TOPIC = f"/mocap/{BODY}/pose"
EPOCH_NS = 1_767_225_600_000_000_000  # the simulated takes all begin at this instant
POSE_LATENCY_NS = 8_000_000  # what a pose takes to reach the recorder
HEIGHT_M = 0.35
TILT_RAD = 2e-3


def _tilted_quaternions(yaw: Floats, rng: np.random.Generator) -> Floats:
    """Unit quaternions (N, 4), in x, y, z, w with Y up, of a yaw (N,) (rad) about Y and small random tilts."""
    tilt_x, tilt_z = 0.5 * TILT_RAD * rng.standard_normal((2, len(yaw)))
    sin_h, cos_h = np.sin(0.5 * yaw), np.cos(0.5 * yaw)
    product = np.column_stack([cos_h * tilt_x + sin_h * tilt_z, sin_h, cos_h * tilt_z - sin_h * tilt_x, cos_h])
    return np.asarray(product / np.linalg.norm(product, axis=1, keepdims=True))


def write_motive_take(path: Path, drive: Drive, rate_hz: float, seed: int) -> None:
    """Write a drive as Motive 3 exports it (CSV format 1.24, Y up, metres) to `path`, with its commands beside it.

    Commands go to NAME.commands.csv; `rate_hz` is the frame rate, and `seed` draws tilt, height and marker error.
    """
    rng = np.random.default_rng([seed, 1])
    n = len(drive.frame)
    quaternion = _tilted_quaternions(drive.pose[:, 2], rng)
    height = HEIGHT_M + 5e-4 * rng.standard_normal(n)
    position = np.column_stack([drive.pose[:, 0], height, -drive.pose[:, 1]])
    marker_error = 2e-4 + 5e-5 * np.abs(rng.standard_normal(n))
    header = {
        "Format Version": "1.24", "Take Name": path.stem, "Take Notes": "simulated by bcid",
        "Capture Frame Rate": f"{rate_hz:.6f}", "Export Frame Rate": f"{rate_hz:.6f}",
        "Capture Start Time": "2026-01-01 12.00.00.000 AM", "Capture Start Frame": "0",
        "Total Frames in Take": str(n), "Total Exported Frames": str(n),
        "Rotation Type": "Quaternion", "Length Units": "Meters", "Coordinate Space": "Global",
    }  # fmt: skip
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\r\n")
        rows.writerow([cell for pair in header.items() for cell in pair])
        rows.writerow([])
        for name, value in (("Type", "Rigid Body"), ("Name", BODY), ("ID", "5CDD43C6912211E942374A447B10D786")):
            rows.writerow(["", name, *[value] * 8])
        rows.writerow(["", "", *["Rotation"] * 4, *["Position"] * 3, "Mean Marker Error"])
        rows.writerow(["Frame", "Time (Seconds)", "X", "Y", "Z", "W", "X", "Y", "Z", ""])
        for frame, cells in zip(drive.frame, np.column_stack([quaternion, position, marker_error]), strict=True):
            seen = np.isfinite(cells[4])
            rows.writerow([frame, f"{frame / rate_hz:.6f}", *(f"{c:.6f}" if seen else "" for c in cells)])
    with path.with_suffix(".commands.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["time_s", "steering_rad", "throttle_mps"])
        for t, (steer, throttle) in zip(drive.command_time, drive.command, strict=True):
            rows.writerow([f"{t:.3f}", f"{steer:.6f}", f"{throttle:.6f}"])


_TIMESTAMP_SCHEMA = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_POSE_SCHEMA = {
    "title": "foxglove.PoseInFrame", "type": "object",
    "properties": {"timestamp": _TIMESTAMP_SCHEMA, "frame_id": {"type": "string"}, "pose": {"type": "object"}},
}  # fmt: skip
_NUMBER = {"type": "number"}
_COMMAND_SCHEMA = {
    "title": "bcid.Command", "type": "object",
    "properties": {"timestamp": {"type": "object"}, "steering_rad": _NUMBER, "throttle_mps": _NUMBER},
}  # fmt: skip


def write_mcap_take(path: Path, drive: Drive, rate_hz: float, seed: int, body: str = BODY) -> None:
    """Write a drive as an MCAP file: foxglove.PoseInFrame poses, JSON commands, Z up; `seed` draws pose delays.

    The topics are /mocap/BODY/pose and /BODY/command, of the car's name `body`.
    """
    from mcap.writer import CompressionType, Writer

    rng = np.random.default_rng([seed, 2])
    late = POSE_LATENCY_NS + rng.integers(0, 2_000_000, len(drive.frame))
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(library="bcid simulation")
        topics, pose_topic, command_topic = {}, f"/mocap/{body}/pose", f"/{body}/command"
        for topic, name, schema in (
            (pose_topic, "foxglove.PoseInFrame", _POSE_SCHEMA),
            (command_topic, "bcid.Command", _COMMAND_SCHEMA),
        ):
            schema_id = writer.register_schema(name, "jsonschema", json.dumps(schema).encode())
            topics[topic] = writer.register_channel(topic, "json", schema_id)
        entries = []
        for k in np.flatnonzero(np.isfinite(drive.pose[:, 0])):
            stamp = EPOCH_NS + round(drive.frame[k] * 1e9 / rate_hz)
            entries.append((stamp + int(late[k]), stamp, pose_topic, _pose_message(stamp, drive.pose[k])))
        for t, (steer, throttle) in zip(drive.command_time, drive.command, strict=True):
            stamp = EPOCH_NS + round(t * 1e9)
            command = {"steering_rad": round(steer, 6), "throttle_mps": round(throttle, 6)}
            entries.append((stamp, stamp, command_topic, {"timestamp": _timestamp(stamp), **command}))
        for log_time, stamp, topic, message in sorted(entries, key=lambda e: e[0]):
            data = json.dumps(message, separators=(",", ":")).encode()
            writer.add_message(topics[topic], log_time=log_time, publish_time=stamp, data=data)
        writer.finish()  # type: ignore[no-untyped-call]


def _timestamp(ns: int) -> dict[str, int]:
    """A time in ns as the seconds and nanoseconds ("sec", "nsec") of a foxglove message."""
    return {"sec": ns // 1_000_000_000, "nsec": ns % 1_000_000_000}


def _pose_message(stamp: int, pose: Floats) -> dict[str, object]:
    """A pose (x, y, yaw) in m and rad, stamped at `stamp` (ns), as the JSON of a foxglove.PoseInFrame."""
    x, y, yaw = (float(v) for v in pose)
    turn = {"x": 0.0, "y": 0.0, "z": round(float(np.sin(0.5 * yaw)), 8), "w": round(float(np.cos(0.5 * yaw)), 8)}
    place = {"x": round(x, 6), "y": round(y, 6), "z": HEIGHT_M}
    return {"timestamp": _timestamp(stamp), "frame_id": "floor", "pose": {"position": place, "orientation": turn}}
