"""Recordings of any size, written quickly: the logs of a whole afternoon, of which one car is a small part.

The Motive export holds the car's rigid body, its markers, and the bodies and markers of others; the MCAP file poses,
commands, and the frames of a camera.  The car drives with changing speed and steering, without slip.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from bcid.aliases import Floats
from bcid.simulation.writing import BODY, EPOCH_NS

RATE_HZ, COMMAND_RATE_HZ = 240.0, 20.0
LENGTHS_M = (0.54, 0.33)  # from the centre of gravity to the front and the rear axle, of the simulated car
BLOCK_ROWS = 20_000  # that are written at a time
MARKER_CELLS = 4  # X, Y, Z and quality of a marker of a body
BODY_CELLS = 8  # of the tracked body: rotation, position and marker error

VEHICLE = """
name = "bumper-car"
[body]
mass_kg = 319.6
cog_to_front_m = 0.54
cog_to_rear_m = 0.33
drive = "front"
rear_track_m = 0.60
[steering]
max_angle_rad = 2.012
max_rate_radps = 1.418
time_constant_s = 0.155
[motor]
reference_speed_mps = 2.033
[mocap]
rigid_body = "bumper_car"
up_axis = "Y"
[topics]
pose = "/pose"
command = "/command"
"""
"""The vehicle file of the car that drives here."""


def drive_commands(time_s: Floats) -> Floats:
    """Steering angle (rad) and speed (m/s), as commanded and driven without delay (N, 2), at times (N,) in s."""
    steering = 0.25 + 0.2 * np.sin(0.41 * time_s) + 0.05 * np.sin(1.3 * time_s)
    return np.column_stack([steering, 1.2 + 0.3 * np.sin(0.23 * time_s)])


def drive_poses(time_s: Floats, start: Floats) -> Floats:
    """Poses x, y, yaw (N, 3) of the rear-driven car at evenly spaced times (N,) in s, the first of which is `start`."""
    steering, speed = drive_commands(time_s).T
    step = np.diff(time_s)
    slip = np.arctan(LENGTHS_M[1] * np.tan(steering) / sum(LENGTHS_M))
    front = speed * np.cos(steering)
    turned = np.r_[0.0, np.cumsum((front * np.tan(steering) / sum(LENGTHS_M))[:-1] * step)]
    yaw = start[2] + turned
    course = yaw + slip
    velocity = np.column_stack([np.cos(course), np.sin(course)]) * (front / np.cos(slip))[:, None]
    way = np.vstack([np.zeros(2), np.cumsum(velocity[:-1] * step[:, None], axis=0)])
    return np.column_stack([start[:2] + way, yaw])


def _blocks_of_poses(count: int, rate_hz: float) -> list[tuple[int, Floats]]:
    """The first frame and the poses (n, 3) of each block of a drive of `count` frames."""
    blocks, start = [], np.zeros(3)
    for first in range(0, count, BLOCK_ROWS):
        frames = np.arange(first, min(first + BLOCK_ROWS, count) + 1)
        poses = drive_poses(frames / rate_hz, start)
        blocks.append((first, poses[:-1]))
        start = poses[-1]
    return blocks


def write_large_motive(path: Path, count: int, others: int, rate_hz: float = RATE_HZ) -> Path:
    """A Motive export of `count` frames, of the car and of `others` markers, with its commands beside it.

    A row has 10 + 4 `others` cells, some nine bytes each.
    """
    rng = np.random.default_rng(3)
    cells = MARKER_CELLS * others
    kinds = ["Rigid Body"] * BODY_CELLS + ["Rigid Body Marker"] * cells
    names = [BODY] * BODY_CELLS + [f"other:Marker{k // MARKER_CELLS}" for k in range(cells)]
    measures = ["Rotation"] * 4 + ["Position"] * 3 + ["Mean Marker Error"]
    measures += (["Position"] * 3 + ["Marker Quality"]) * others
    axes = ["X", "Y", "Z", "W", "X", "Y", "Z", "", *["X", "Y", "Z", ""] * others]
    keys = {
        "Format Version": "1.24", "Take Name": path.stem, "Capture Frame Rate": f"{rate_hz:.6f}",
        "Export Frame Rate": f"{rate_hz:.6f}", "Total Exported Frames": str(count), "Rotation Type": "Quaternion",
        "Length Units": "Meters", "Coordinate Space": "Global",
    }  # fmt: skip
    head = [
        ",".join(cell for pair in keys.items() for cell in pair), "", ",".join(["", "Type", *kinds]),
        ",".join(["", "Name", *names]), ",".join(["", "ID", *["0"] * len(kinds)]), ",".join(["", "", *measures]),
        ",".join(["Frame", "Time (Seconds)", *axes]),
    ]  # fmt: skip
    tails = ["".join(f",{c:.6f}" for c in 5.0 * rng.standard_normal(cells)) + "\r\n" for _ in range(64)]
    row = ("%d,%.6f" + ",%.6f" * BODY_CELLS).__mod__
    with path.open("w", newline="", encoding="utf-8") as file:
        file.write("\r\n".join([*head, ""]))
        for first, poses in _blocks_of_poses(count, rate_hz):
            n, half = len(poses), 0.5 * poses[:, 2]
            zero, height = 1e-3 * rng.standard_normal((n, 2)), 0.35 + 5e-4 * rng.standard_normal(n)
            quaternion = np.column_stack([zero[:, 0], np.sin(half), zero[:, 1], np.cos(half)])
            quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
            x, y = (poses[:, :2] + 2e-4 * rng.standard_normal((n, 2))).T
            error = 2e-4 + 5e-5 * np.abs(rng.standard_normal(n))
            table = np.column_stack([quaternion, x, height, -y, error]).tolist()
            lines = (row((k, k / rate_hz, *cells)) + tails[k % len(tails)] for k, cells in enumerate(table, first))
            file.write("".join(lines))
    _write_commands(path.with_suffix(".commands.csv"), count / rate_hz)
    return path


def _write_commands(path: Path, length_s: float) -> None:
    """Write the commands of a drive of `length_s` as a commands file."""
    time_s = np.arange(int(length_s * COMMAND_RATE_HZ)) / COMMAND_RATE_HZ
    rows = np.column_stack([time_s, drive_commands(time_s)])
    np.savetxt(path, rows, "%.6f", ",", header="time_s,steering_rad,throttle_mps", comments="")


POSE_DEFINITION = (
    "std_msgs/Header header\ngeometry_msgs/Pose pose\n{line}MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\n"
    "geometry_msgs/Quaternion orientation\n{line}MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
    "{line}MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n"
    "{line}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    "{line}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
).format(line="=" * 80 + "\n")
COMMAND_DEFINITION = (
    "std_msgs/Header header\nackermann_msgs/AckermannDrive drive\n{line}MSG: ackermann_msgs/AckermannDrive\n"
    "float32 steering_angle\nfloat32 steering_angle_velocity\nfloat32 speed\nfloat32 acceleration\nfloat32 jerk\n"
    "{line}MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    "{line}MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
).format(line="=" * 80 + "\n")
HEADER = struct.Struct("<4sIII4s")  # of a message in CDR: encoding, stamp, and the frame "map"
HEAD = b"\0\1\0\0"


def write_large_mcap(path: Path, count: int, file_bytes: int, rate_hz: float = RATE_HZ, as_json: bool = False) -> Path:
    """An MCAP file of about `file_bytes` with `count` poses (ROS 2's, or JSON), commands, and frames of a camera."""
    import json

    from mcap.writer import CompressionType, Writer

    rng = np.random.default_rng(4)
    image = rng.bytes(1 << 21)
    every = max(1, int(rate_hz / 30.0))
    frame_bytes = max(0, min(len(image), int((file_bytes - 170 * count) / max(1, count // every))))
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 22, compression=CompressionType.NONE)
        writer.start(library="bcid tests")
        pose_type, command_type = "geometry_msgs/msg/PoseStamped", "ackermann_msgs/msg/AckermannDriveStamped"
        kind = ("jsonschema", "json") if as_json else ("ros2msg", "cdr")
        definitions = {"/pose": (pose_type, POSE_DEFINITION), "/command": (command_type, COMMAND_DEFINITION)}
        channels = {
            topic: writer.register_channel(
                topic, kind[1], writer.register_schema(name, kind[0], b"{}" if as_json else text.encode())
            )
            for topic, (name, text) in definitions.items()
        }
        camera = writer.register_channel("/camera", "raw", writer.register_schema("image", "", b""))
        every_command = round(rate_hz / COMMAND_RATE_HZ)
        for first, poses in _blocks_of_poses(count, rate_hz):
            noisy = poses[:, :2] + 2e-4 * rng.standard_normal((len(poses), 2))
            driven = drive_commands((first + np.arange(len(poses))) / rate_hz)
            for k, ((x, y), yaw, (steering, speed)) in enumerate(zip(noisy, poses[:, 2], driven, strict=True), first):
                ns = EPOCH_NS + round(k * 1e9 / rate_hz)
                stamp, turn = divmod(ns, 1_000_000_000), (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
                if as_json:
                    header = {"header": {"stamp": {"sec": stamp[0], "nanosec": stamp[1]}, "frame_id": "map"}}
                    place, quaternion = zip("xyz", (x, y, 0.35), strict=True), zip("xyzw", turn, strict=True)
                    pose = {"position": dict(place), "orientation": dict(quaternion)}
                    data = json.dumps({**header, "pose": pose}).encode()
                    command = {"steering_angle": steering, "speed": speed}
                    driving = json.dumps({**header, "drive": command}).encode()
                else:
                    header_bytes = HEADER.pack(HEAD, *stamp, 4, b"map\0")
                    data = header_bytes + struct.pack("<7d", x, y, 0.35, *turn)
                    driving = header_bytes + struct.pack("<5f", steering, 0.0, speed, 0.0, 0.0)
                writer.add_message(channels["/pose"], ns + 2_000_000, data, ns)
                if k % every_command == 0:
                    writer.add_message(channels["/command"], ns, driving, ns)
                if k % every == 0 and frame_bytes:
                    writer.add_message(camera, ns, image[:frame_bytes], ns)
        writer.finish()  # type: ignore[no-untyped-call]
    return path
