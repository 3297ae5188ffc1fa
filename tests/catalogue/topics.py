"""Rows 29, 30 and 32 to 36 of the catalogue of bad input: topics, types and trees."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer

from catalogue.lab import COMMAND, NS0, POSE, Floats, Lab, Tries, cells
from catalogue.rows import row


@row(29)
def _(lab: Lab) -> Tries:
    yield "mcap: topic misspelt", lab.mcap_file, lab.veh(topics={"pose": "/mocap/bumpercar/pose"})
    both = lab.veh(topics={"pose": "/mocap/bumpercar/pose", "command": "/comand"})
    yield "mcap: both topics misspelt", lab.mcap_file, both


@row(30)
def _(lab: Lab) -> Tries:
    yield "mcap: pose topic is sensor_msgs/Imu", lab.mcap(types=("sensor_msgs/Imu", "bcid.Command"))
    yield "mcap: command topic is a PoseInFrame", lab.mcap_file, lab.veh(topics={"command": POSE})
    yield (
        "mcap: command sensor_msgs/Joy",
        lab.mcap(
            None,
            [
                (
                    log,
                    {
                        "header": {"stamp": {"sec": log // 10**9, "nanosec": log % 10**9}},
                        "axes": [m["steering_rad"], m["throttle_mps"]],
                    },
                )
                for log, m in lab.commands()
            ],
            types=("foxglove.PoseInFrame", "sensor_msgs/Joy"),
        ),
    )
    yield (
        "   with fields axes.0, axes.1",
        lab.folder / "b.mcap",
        lab.veh(topics={"command_fields": {"steering_rad": "axes.0", "throttle_mps": "axes.1"}}),
    )


@row(32)
def _(lab: Lab) -> Tries:
    zeros = lab.commands(lab.TC + 0.02, 0 * lab.C)
    yield "mcap: 2nd publisher sends zeros (same channel)", lab.mcap(None, [*lab.commands(), *zeros])
    yield (
        "mcap: 2nd channel on the topic sends zeros",
        lab.mcap(others=((COMMAND, "json", "bcid.Command", b"{}", zeros),)),
    )
    p = lab.P.copy()
    p[:, 0] += 1.5
    weak = lab.commands(lab.TC + 0.02, lab.C * [1, 1] + [0.3, 0])
    yield "mcap: 2nd channel sends + 0.3 rad", lab.mcap(others=((COMMAND, "json", "bcid.Command", b"{}", weak),))
    yield (
        "mcap: 2nd channel sends the same 20 ms late",
        lab.mcap(others=((COMMAND, "json", "bcid.Command", b"{}", lab.commands(lab.TC + 0.02)),)),
    )
    near = np.add(lab.P, [0.1, 0, 0])
    yield "mcap: two bodies 0.1 m apart", lab.mcap([*lab.poses(), *lab.poses(lab.T + 0.008, near)])
    k = np.arange(len(lab.T)) % 6 == 0
    yield (
        "mcap: 2nd pose publisher at 10 Hz, 0.1 m apart",
        lab.mcap([*lab.poses(), *lab.poses(lab.T[k] + 0.008, near[k], lab.Q[k])]),
    )
    yield "mcap: two bodies 1.5 m apart on the pose topic", lab.mcap([*lab.poses(), *lab.poses(lab.T + 0.008, p)])
    yield (
        "   second at rest",
        lab.mcap([*lab.poses(), *lab.poses(lab.T + 0.008, 0 * lab.P + lab.P[0], 0 * lab.Q + lab.Q[0])]),
    )


@row(33)
def _(lab: Lab) -> Tries:
    yield "mcap: encoding flatbuffer", lab.mcap(encoding=("flatbuffer", "json"))
    yield "mcap: encoding empty", lab.mcap(encoding=("", "json"))
    yield "mcap: cdr without schema", lab.mcap(types=("", "bcid.Command"), encoding=("cdr", "json"))
    yield "mcap: cdr, schema known, jsonschema", lab.mcap(encoding=("cdr", "json"))
    yield "mcap: JSON pose without schema", lab.mcap(types=("", "bcid.Command"))
    yield "mcap: JSON command without schema", lab.mcap(types=("foxglove.PoseInFrame", ""))
    yield "mcap: unknown compression", swapped(lab.mcap(name="lz"), b"zstd", b"brot")


def swapped(path: Path, old: bytes, new: bytes, count: int = -1) -> Path:
    path.write_bytes(path.read_bytes().replace(old, new, count))
    return path


@row(34)
def _(lab: Lab) -> Tries:
    yield "mcap: two schema names on the pose topic", lab.mcap(others=((POSE, "json", "other.Pose", b"{}", []),))
    yield "   second has messages", lab.mcap(others=((POSE, "json", "other.Pose", b"{}", lab.poses(lab.T + 0.004)),))
    yield (
        "mcap: same name, other definition",
        lab.mcap(others=((POSE, "json", "foxglove.PoseInFrame", b'{"a":1}', lab.poses(lab.T + 0.004)),)),
    )
    yield (
        "mcap: same name, other encoding (cdr)",
        lab.mcap(others=((POSE, "cdr", "foxglove.PoseInFrame", b'{"a":1}', []),)),
    )


def tf(lab: Lab, frames: list[tuple[str, str, Floats, Floats]]) -> list[tuple[int, dict[str, Any]]]:
    """Messages of /tf with these edges (parent, child, position, quaternion)."""
    found = []
    for i, s in enumerate(lab.T):
        ns = NS0 + round(s * 1e9)
        items = [
            {
                "header": {"stamp": {"sec": ns // 10**9, "nanosec": ns % 10**9}, "frame_id": parent},
                "child_frame_id": child,
                "transform": {
                    "translation": {"x": float(p[i][0]), "y": float(p[i][1]), "z": 0.0},
                    "rotation": dict(zip("xyzw", map(float, q[i]), strict=True)),
                },
            }
            for parent, child, p, q in frames
        ]
        found.append((ns, {"transforms": items}))
    return found


@row(35)
def _(lab: Lab) -> Tries:
    tft = ("tf2_msgs/TFMessage", "bcid.Command")
    one, unit = np.column_stack([1 + 0 * lab.T, 0 * lab.T]), np.tile([0.0, 0, 0, 1], (len(lab.T), 1))
    yield (
        "tf: world->odom (1 m) -> bumper_car",
        lab.mcap(tf(lab, [("world", "odom", one, unit), ("odom", "bumper_car", lab.P, lab.Q)]), types=tft),
    )
    moving = np.column_stack([0.5 * np.sin(lab.T), 0 * lab.T])
    yield (
        "tf: odom itself moves in the world",
        lab.mcap(
            tf(
                lab,
                [
                    ("world", "odom", moving, unit),
                    ("odom", "bumper_car", lab.P - np.column_stack([moving, 0 * lab.T]), lab.Q),
                ],
            ),
            types=tft,
        ),
    )
    yield (
        "tf: cycle a->b->a",
        lab.mcap(tf(lab, [("bumper_car", "odom", one, unit), ("odom", "bumper_car", lab.P, lab.Q)]), types=tft),
    )
    yield (
        "tf: broken, two roots",
        lab.mcap(tf(lab, [("world", "odom", one, unit), ("elsewhere", "bumper_car", lab.P, lab.Q)]), types=tft),
    )
    yield (
        "tf: two parents for the child",
        lab.mcap(tf(lab, [("a", "bumper_car", lab.P, lab.Q), ("b", "bumper_car", lab.P + 1, lab.Q)]), types=tft),
    )
    yield "tf: the child's name absent", lab.mcap(tf(lab, [("a", "cart", lab.P, lab.Q)]), types=tft)


@row(36)
def _(lab: Lab) -> Tries:
    empty = lab.folder / "empty.csv"
    empty.touch()
    yield "0 bytes", empty
    yield "motive: header only", lab.motive(lambda rows: rows[:7])
    yield "motive: first line only", lab.motive(lambda rows: rows[:1])
    yield "commands: header only", lab.motive(lambda r: None, commands=lambda c: c[:0])
    yield "table: header only", lab.table(lambda d: d[:0]), lab.tabled
    magic = lab.folder / "magic.mcap"
    magic.write_bytes(b"\x89MCAP0\r\n")
    yield "mcap: magic only", magic
    yield "mcap: no topics", lab.mcap([], [], name="none")
    nothing = lab.folder / "nothing.mcap"
    with nothing.open("wb") as f:
        w = Writer(f)
        w.start()
        w.finish()
    yield "mcap: header and footer only", nothing
    blank = lab.folder / "blank.csv"
    blank.write_text("\n\n\n")
    yield "table: blank lines only", blank, lab.tabled
    yield "motive: every row blank", lab.motive(cells(lambda x: x * np.nan))
