"""What real drives contain and no check may take for a fault; and faults that simple drives must not hide."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from making import circling_take

from bcid.errors import InputRefused
from bcid.recording.assemble import assemble_recording
from bcid.recording.checks.attitude import check_up_axis, find_lifted_samples
from bcid.recording.formats.raw import RawTake
from bcid.recording.read import read_raw_take
from bcid.recording.types import Recording, SourceFile
from bcid.vehicle import Vehicle


def told(recording: Recording) -> set[str]:
    return {i.kind for i in recording.irregularities}


def driven(v: np.ndarray, yaw_rate: np.ndarray, rate_hz: float, command_s: np.ndarray, command: np.ndarray) -> RawTake:
    """A take of a car that goes straight ahead at `v` (m/s), seen to 0.2 mm."""
    t = np.arange(len(v)) / rate_hz
    yaw = np.cumsum(yaw_rate) / rate_hz
    xy = np.cumsum(np.column_stack([v * np.cos(yaw), v * np.sin(yaw)]), axis=0) / rate_hz
    noise = 2e-4 * np.random.default_rng(1).standard_normal((len(t), 3))
    return RawTake(
        "drive", (SourceFile("drive.csv", "", "table-csv"),), t, np.column_stack([xy, yaw]) + noise, command_s, command
    )


def slalom(levels: float) -> RawTake:
    """Steering to and fro every 2 s, logged when it changes."""
    rate, n = 60.0, 60 * 60
    t = np.arange(n) / rate
    side = np.where((t // 2.0) % 2 == 0, 1.0, -1.0) * (1.0 + levels * ((t // 2.0) % 7) / 7.0)
    switches = np.arange(0.0, 60.0, 2.0)
    at = np.searchsorted(t, switches + 1e-9)
    at = np.minimum(at, n - 1)
    command = np.column_stack([0.3 * side[at], np.full(len(at), 1.2)])
    return driven(np.ones(n), 0.35 * side, rate, switches, command)


@pytest.mark.parametrize("levels", [0.0, 0.5])
def test_a_slalom_logged_on_change_is_one_driver(levels: float, vehicle: Vehicle) -> None:
    patient = vehicle.model_copy(update={"command": vehicle.command.model_copy(update={"max_hold_s": 5.0})})
    assert not {"tracking", "pose jump"} & told(assemble_recording(slalom(levels), patient))


@pytest.mark.parametrize("every", [3, 6, 12])
def test_poses_that_a_table_holds_are_read_once(every: int, takes: dict[str, Path], vehicle: Vehicle) -> None:
    raw = read_raw_take(takes["mcap"], vehicle)
    first = np.arange(len(raw.pose)) // every * every
    found = assemble_recording(replace(raw, pose=raw.pose[first]), vehicle)
    assert "pose held" in told(found)
    assert len(found.poses) == pytest.approx(len(raw.pose) / every, rel=0.02)
    assert not {"tracking", "pose jump", "frozen pose"} & told(found)


@pytest.mark.parametrize("rate_hz", [5.0, 10.0])
def test_hard_starts_at_low_rates_are_no_jumps(rate_hz: float, vehicle: Vehicle) -> None:
    n = int(60 * rate_hz)
    t = np.arange(n) / rate_hz
    v = np.clip(8.0 * (t % 6.0) - 8.0, 0.0, 2.0) * (t % 6.0 < 3.0)
    command_s = np.arange(0.0, 60.0, 0.1)
    command = np.column_stack([0.0 * command_s, np.where((command_s % 6.0 > 1.0) & (command_s % 6.0 < 3.0), 2.0, 0.0)])
    raw = driven(v, 0.0 * v, rate_hz, command_s, command)
    assert "pose jump" not in told(assemble_recording(raw, vehicle))


def test_a_car_that_pushes_against_a_wall_is_not_held_by_the_tracking(vehicle: Vehicle) -> None:
    n = 60 * 40
    t = np.arange(n) / 60.0
    v = np.where((t > 15.0) & (t < 21.0), 0.0, 1.0)
    command_s = np.arange(0.0, 40.0, 0.05)
    raw = driven(v, 0.2 * v, 60.0, command_s, np.column_stack([0.2 + 0 * command_s, 1.2 + 0 * command_s]))
    rounded = replace(raw, pose=np.round(raw.pose, 3))
    rounded.pose[(t > 15.0) & (t < 21.0)] = rounded.pose[np.argmax(t > 15.0)]
    kinds = told(assemble_recording(rounded, vehicle))
    assert not {"frozen pose", "tracking"} & kinds
    assert "pose stands" in kinds


def test_a_hill_and_a_ramp_are_driven_over() -> None:
    t = np.arange(6000) / 60.0
    xy = np.column_stack([50.0 * np.sin(0.06 * t), 30.0 * np.cos(0.05 * t)])
    hill = 2.0 * np.exp(-((xy - [20.0, 10.0]) ** 2).sum(axis=1) / 100.0)
    ramp = 0.06 * np.clip((xy[:, 0] + 20.0) / 0.5, 0.0, 1.0) * (xy[:, 0] < -10.0)
    for height in (hill, ramp):
        assert not find_lifted_samples(xy, height, t)[0].any()


def test_a_car_carried_for_a_while_leaves_the_up_axis_alone() -> None:
    x = np.linspace(0.0, 20.0, 2000)
    world = np.column_stack([x, np.zeros(2000), np.zeros(2000)])
    world[500:660, 1] = 0.9
    check_up_axis(world, "Y", Path("take.csv"))


@pytest.mark.parametrize(
    ("factor", "says"),
    [((1.0, -1.0, 1.0), "mirrored|turns right"), ((1.0, 1.0, -1.0), "turns right"), ((50.0, 50.0, 1.0), "mm or cm")],
)
def test_a_circle_hides_no_sign_and_no_unit(
    factor: tuple[float, float, float], says: str, vehicle: Vehicle, tmp_path: Path
) -> None:
    path = circling_take(tmp_path, seconds=40.0)
    raw = read_raw_take(path, vehicle)
    assemble_recording(raw, vehicle)
    with pytest.raises(InputRefused, match=says):
        assemble_recording(replace(raw, pose=raw.pose * factor), vehicle)


def test_a_circle_with_inverted_steering_is_refused(vehicle: Vehicle, tmp_path: Path) -> None:
    raw = read_raw_take(circling_take(tmp_path, seconds=40.0), vehicle)
    with pytest.raises(InputRefused, match="turns right"):
        assemble_recording(replace(raw, command=raw.command * [-1.0, 1.0]), vehicle)


def test_a_flip_that_stays_leaves_the_side_that_drives_forward(takes: dict[str, Path], vehicle: Vehicle) -> None:
    raw = read_raw_take(takes["mcap"], vehicle)
    late = len(raw.pose) * 2 // 5
    pose = raw.pose.copy()
    pose[late:, 2] += np.pi
    found, clean = assemble_recording(replace(raw, pose=pose), vehicle), assemble_recording(raw, vehicle)
    kept = np.isin(clean.poses.time_s, found.poses.time_s)
    np.testing.assert_allclose(found.poses.values, clean.poses.values[kept], atol=1e-9)
    assert len(found.poses) < 0.45 * len(clean.poses)


@pytest.mark.parametrize("digits", [2, 1])
def test_rounded_stamps_are_told_as_such(digits: int, takes: dict[str, Path], vehicle: Vehicle) -> None:
    raw = read_raw_take(takes["mcap"], vehicle)
    twice = replace(raw, pose_time_s=np.round(raw.pose_time_s * (0.5 if digits == 2 else 1.0), digits))
    with pytest.raises(InputRefused, match="stamps rounded"):
        assemble_recording(twice, vehicle)
