"""Poses that repeat to the last digit: left out where the car moved on, kept where it stood or digits are coarse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_heading import BUMPER, DART, RC, TRICYCLE, counts, drive, lost, mended

from bcid.aliases import Floats
from bcid.recording.assemble import assemble_recording
from bcid.recording.checks.held import drop_frozen_poses, drop_held_poses
from bcid.recording.checks.pose_noise import white_noise, written_digits
from bcid.recording.checks.samples import Samples


def moving_row(pose: Floats, time_s: Floats, after_s: float = 10.0) -> int:
    """The first row after some seconds from which the car moves at half its top speed for a second."""
    speed = np.hypot(*np.gradient(pose[:, :2], time_s, axis=0).T)
    fast = (speed > 0.5 * np.nanquantile(speed, 0.9)) & (time_s > after_s)
    return next(k for k in np.flatnonzero(fast) if fast[k : k + 60].all())


@pytest.mark.parametrize("digits", [None, 3])
@pytest.mark.parametrize("samples", [1, 2, 7, 40])
@pytest.mark.parametrize("seed", [BUMPER, RC, DART, TRICYCLE])
def test_a_moving_body_never_measures_the_same_twice(seed: int, samples: int, digits: int | None) -> None:
    raw, vehicle = drive(seed)
    pose = raw.pose.copy() if digits is None else np.round(raw.pose, digits)
    rows = []
    for after_s in (10.0, 25.0, 40.0):
        k = moving_row(raw.pose, raw.pose_time_s, after_s)
        pose[k + 1 : k + 1 + samples] = pose[k]
        rows += list(range(k + 1, k + 1 + samples))
    found = mended(replace(raw, pose=pose), vehicle)
    assert np.flatnonzero(lost(found, raw)).tolist() == rows
    assert counts(found) == {"frozen pose": len(rows)}


def test_what_is_held_after_a_jump_is_left_out_with_its_first_pose() -> None:
    raw, vehicle = drive(BUMPER)
    k, pose = moving_row(raw.pose, raw.pose_time_s), raw.pose.copy()
    pose[k : k + 20] = pose[k] + [2.0, 1.0, 0.0]
    found = mended(replace(raw, pose=pose), vehicle)
    assert np.flatnonzero(lost(found, raw)).tolist() == list(range(k, k + 20))


def start_and_stop(rate_hz: float, stands_s: float = 1.0) -> tuple[Floats, Floats, Floats]:
    """Times, noiseless poses and throttle of a simulated car that starts from rest, stops, stands and goes on."""
    t = np.arange(0.0, 30.0, 1.0 / rate_hz)
    fine = np.arange(0.0, 30.0, 1e-3)
    throttle = np.where((fine < 1.0) | ((fine > 14.0) & (fine < 15.0 + stands_s)), 0.0, 1.0)
    v = np.zeros(len(fine))
    for k in range(1, len(fine)):
        v[k] = np.clip(v[k - 1] + (2e-3 if throttle[k] else -3e-3), 0.0, 1.2)
    yaw = 1e-3 * np.cumsum(0.4 * v)
    xy = 1e-3 * np.cumsum(np.column_stack([v * np.cos(yaw), v * np.sin(yaw)]), axis=0)
    pose = np.column_stack([np.interp(t, fine, column) for column in (*xy.T, yaw)])
    return t, pose, np.interp(t, fine, throttle).round()


@pytest.mark.parametrize("rate_hz", [20.0, 60.0, 240.0])
@pytest.mark.parametrize("stands_s", [0.0, 0.5, 5.0])
@pytest.mark.parametrize("digits", [None, 3])
def test_a_car_that_stands_in_a_noiseless_simulation_is_kept(
    rate_hz: float, stands_s: float, digits: int | None
) -> None:
    t, pose, throttle = start_and_stop(rate_hz, stands_s)
    poses = Samples(t, pose if digits is None else np.round(pose, digits), [])
    commands = Samples(t, np.column_stack([0.0 * t, throttle]), [])
    kept = drop_frozen_poses(drop_held_poses(poses), commands)
    np.testing.assert_array_equal(kept.time_s, t)
    assert kept.irregularities == []


@pytest.mark.parametrize("speed", [0.02, 0.1, 0.2])
@pytest.mark.parametrize("digits", [3, 2])
def test_a_slow_car_in_coarse_digits_is_measured(speed: float, digits: int) -> None:
    t = np.arange(0.0, 40.0, 1.0 / 240.0)
    yaw = 0.3 * np.sin(0.5 * t)
    xy = speed / 240.0 * np.cumsum(np.column_stack([np.cos(yaw), np.sin(yaw)]), axis=0)
    for noise in (0.0, 5e-4):
        rough = np.column_stack([xy, yaw]) + noise * np.random.default_rng(1).standard_normal((len(t), 3))
        poses = Samples(t, np.round(rough, digits), [])
        assert (np.diff(poses.values, axis=0) == 0.0).all(axis=1).any() or speed > 0.1
        kept = drop_frozen_poses(drop_held_poses(poses), Samples(t, np.ones((len(t), 2)), []))
        assert len(kept.time_s) == len(t)
        assert kept.irregularities == []


@pytest.mark.parametrize("ratio", [1.2, 1.5, 2.0, 3.0])
def test_a_table_of_a_higher_rate_is_read_at_the_rate_of_its_poses(ratio: float) -> None:
    raw, vehicle = drive(BUMPER)
    seen = np.isfinite(raw.pose).all(axis=1)
    t = np.arange(0.0, 59.0, raw.pose_time_s[1] / ratio)
    whole = np.column_stack([np.interp(raw.pose_time_s, raw.pose_time_s[seen], c) for c in raw.pose[seen].T])
    row = np.searchsorted(raw.pose_time_s, t + 1e-9, side="right") - 1
    table = replace(raw, pose_time_s=t, pose=whole[row], rate_hz=1.0 / t[1])
    found = assemble_recording(table, vehicle)
    kinds = {i.kind: i.action for i in found.irregularities}
    assert kinds["pose held"] == "fixed"
    assert "frozen pose" not in kinds
    assert found.rate_hz == pytest.approx(1.0 / raw.pose_time_s[1], rel=0.03)
    assert len(found.poses) == pytest.approx(len(raw.pose), rel=0.03)


def test_a_yaw_that_stays_while_the_path_turns_is_left_out() -> None:
    raw, vehicle = drive(BUMPER)
    t = raw.pose_time_s
    circle = np.column_stack([2.0 * np.sin(0.5 * t), 2.0 - 2.0 * np.cos(0.5 * t), 0.5 * t])
    circle += 5e-4 * np.random.default_rng(1).standard_normal(circle.shape)
    rows = (t > 20.0) & (t < 23.0)
    circle[rows, 2] = circle[np.argmax(rows), 2]
    made = replace(raw, pose=circle)
    found = mended(made, vehicle)
    assert counts(found)["frozen yaw"] == rows.sum() - 1
    assert lost(found, made).sum() == rows.sum() - 1


def test_noise_and_digits_are_read_off_the_poses() -> None:
    t = np.arange(0.0, 60.0, 0.01)
    path = np.column_stack([2.0 * np.sin(0.5 * t), 2.0 * np.cos(0.5 * t), np.angle(np.exp(0.7j * t))])
    sd = [1e-3, 2e-3, 5e-3]
    noisy = path + np.random.default_rng(1).standard_normal(path.shape) * sd
    np.testing.assert_allclose(white_noise(noisy), sd, rtol=0.05)
    np.testing.assert_array_equal(written_digits(noisy), [0.0, 0.0, 0.0])
    np.testing.assert_allclose(written_digits(np.round(noisy, 3)), 1e-3, rtol=1e-6)
