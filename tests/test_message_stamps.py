"""Stamps of messages in the notations that loggers write, and what is no stamp."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from test_pose_messages import BARE_COMMANDS, POSE, TIME, car, pose, same_drive, written
from test_readers import json_mcap

from bcid.errors import InputRefused
from bcid.recording.formats.message_stamps import PlainStamp, UnreadableStamp, parse_stamp, resolve_stamps
from bcid.recording.read import read_raw_take
from bcid.vehicle import Vehicle

NS = 1_780_000_000_123_456_789
S = NS // 10**9


@pytest.mark.parametrize(
    "stamp",
    [
        {"sec": S, "nanosec": 123_456_789}, {"sec": S, "nsec": 123_456_789}, {"secs": S, "nsecs": 123_456_789},
        {"seconds": S, "nanos": 123_456_789}, "2026-05-28T20:26:40.123456789Z", "2026-05-28 20:26:40.123456789",
        "2026-05-28T22:26:40.123456789+02:00", "2026-05-28T15:56:40,123456789-0430",
    ],
)  # fmt: skip
def test_notations_that_say_their_unit(stamp: Any) -> None:
    assert parse_stamp(stamp) == NS


def test_a_float_of_seconds_beside_no_nanoseconds_counts_whole() -> None:
    assert parse_stamp({"sec": 1780000000.25, "nanosec": 0}) == 1_780_000_000_250_000_000
    assert parse_stamp({"sec": S, "usec": 5}) == S * 10**9 + 5000


@pytest.mark.parametrize("nothing", [None, {}])
def test_nothing_is_no_stamp(nothing: Any) -> None:
    assert parse_stamp(nothing) is None


@pytest.mark.parametrize(
    "stamp",
    [
        True, float("inf"), float("nan"), 10**400, "1e400", "1e999999999", "yesterday", "20:26:40",
        "2026-13-01T00:00:00Z", {"sec": True, "nanosec": 0}, {"sec": "5", "nanosec": 0}, {"nanosec": 5},
        {"sec": 1, "nsec": 2, "nanosec": 2}, [1, 2], {"sec": float("inf"), "nanosec": 0},
        {"sec": 1, "nanosec": 1_500_000_000}, {"sec": 1, "nanosec": -5}, {"secs": 1, "nsecs": 10**9},
        {"sec": 1, "usec": 1_000_000}, {"seconds": 1, "nanos": -1},
    ],
)  # fmt: skip
def test_what_is_no_stamp_is_refused(stamp: Any) -> None:
    with pytest.raises(UnreadableStamp, match="in no notation that is read"):
        parse_stamp(stamp)


@pytest.mark.parametrize("unit", [1, 10**3, 10**6, 10**9])
@pytest.mark.parametrize("zero_ns", [0, NS])
def test_the_unit_of_plain_numbers_is_seen_in_their_span(unit: int, zero_ns: int) -> None:
    ns = [zero_ns + k * 10**9 for k in range(40)]
    stamps = [PlainStamp(t // unit) if unit < 10**9 else PlainStamp(t / unit) for t in ns]
    found = resolve_stamps(stamps, [t + 5 * 10**6 for t in ns], "/pose", Path("t.mcap"))
    assert all(abs(a - b) <= max(unit, 300) for a, b in zip(found, ns, strict=True) if a is not None)


def test_plain_numbers_without_a_unit_are_refused() -> None:
    stamps = [PlainStamp(k * 1000.0 * 100) for k in range(40)]  # 100 times as long as the log, and no dates
    with pytest.raises(InputRefused, match="in which unit"):
        resolve_stamps(stamps, [k * 10**9 for k in range(40)], "/pose", Path("t.mcap"))


def text(t: float) -> str:
    return f"2026-05-28T20:26:{t:012.9f}Z"


NOTATIONS = {
    "text of a number": lambda t: f"{1780000000 + t:.9f}", "ns": lambda t: NS + round(t * 1e9), "ISO": text,
    "ms": lambda t: 1e3 * (1780000000 + t), "ROS 1": lambda t: {"secs": int(t), "nsecs": round(t % 1 * 1e9)},
}  # fmt: skip


@pytest.mark.parametrize("name", list(NOTATIONS))
def test_a_take_is_read_in_every_notation_though_logged_late(name: str, vehicle: Vehicle, tmp_path: Path) -> None:
    """Log times of the poses lag; only the stamps are right."""
    write = NOTATIONS[name]
    poses = [(t + 0.15, {"header": {"stamp": write(t)}, "pose": pose(row)}) for t, row in zip(TIME, POSE, strict=True)]
    commands = [(t, {"header": {"stamp": write(t)}, **m}) for t, m in BARE_COMMANDS]
    path = json_mcap(
        tmp_path / "t.mcap", {"/pose": ("geometry_msgs/PoseStamped", poses), "/command": ("own", commands)}
    )
    raw = read_raw_take(path, car(vehicle))
    same_drive(raw)
    assert raw.command_time_s[0] == pytest.approx(0.0, abs=1e-6)
    assert raw.irregularities == ()


def test_a_stamp_in_no_notation_is_refused_by_its_message_and_not_needed_by_log_times(
    vehicle: Vehicle, tmp_path: Path
) -> None:
    path = written(tmp_path, "geometry_msgs/PoseStamped",
                   lambda t, r: {"header": {"stamp": {"sec": 10**400, "nanosec": 0}}, "pose": pose(r)})  # fmt: skip
    with pytest.raises(InputRefused, match=r'/pose, message 1 .*no notation(.|\n)*topics\.time = "log"'):
        read_raw_take(path, car(vehicle))
    same_drive(read_raw_take(path, car(vehicle, time="log")))
