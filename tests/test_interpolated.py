"""Poses that straight lines have put between measured ones are told apart from measured ones, and from smooth paths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_heading import BUMPER, DART, RC, TRICYCLE, drive
from test_held import moving_row

from bcid.aliases import Floats
from bcid.recording.assemble import assemble_recording
from bcid.recording.checks.interpolated import drop_interpolated_poses
from bcid.recording.checks.pose_noise import rounding_step
from bcid.recording.checks.samples import Samples

NOISE_M = 1e-4


def winding_path(rate_hz: float, seconds: float = 60.0) -> Samples:
    """Noisy poses of a body that winds about at some 1 m/s, and stands for two seconds in between."""
    t = np.arange(0.0, seconds, 1.0 / rate_hz)
    way = t - np.clip(t - 20.0, 0.0, 2.0)
    pose = np.column_stack([2.0 * np.sin(0.5 * way), np.sin(0.9 * way), 0.3 * np.sin(way)])
    pose += np.random.default_rng(1).normal(0.0, NOISE_M, pose.shape) * (np.abs(t - 21.0) > 1.0)[:, None]
    return Samples(t, pose, [])


def filled_up(poses: Samples, rate_hz: float) -> Samples:
    """The poses at another rate, on straight lines between those that there are."""
    t = np.arange(poses.time_s[0], poses.time_s[-1], 1.0 / rate_hz)
    return Samples(t, np.column_stack([np.interp(t, poses.time_s, column) for column in poses.values.T]), [])


@pytest.mark.parametrize("digits", [None, 5, np.float32])
@pytest.mark.parametrize("rows", [5, 30, 200])
@pytest.mark.parametrize("seed", [BUMPER, RC, DART, TRICYCLE])
def test_a_gap_that_a_straight_line_fills_is_a_gap(seed: int, rows: int, digits: int | type | None) -> None:
    raw, _ = drive(seed)
    pose = raw.pose.copy()
    k = moving_row(raw.pose, raw.pose_time_s)
    inside = slice(k + 1, k + 1 + rows)
    for column in pose.T:
        column[inside] = np.linspace(column[k], column[k + 1 + rows], rows + 2)[1:-1]
    if digits is not None:
        pose = np.round(pose, digits) if isinstance(digits, int) else pose.astype(digits).astype(float)
    known = np.isfinite(pose).all(axis=1)
    found = drop_interpolated_poses(Samples(raw.pose_time_s[known], pose[known], []))
    (odd,) = found.irregularities
    assert (odd.kind, odd.action, odd.count) == ("pose gap filled", "excluded", rows)
    assert not np.isin(raw.pose_time_s[inside], found.time_s).any()


@pytest.mark.parametrize("times", [2, 3, 5, 12, 24])
def test_of_a_table_that_was_filled_up_the_measured_poses_count(times: int) -> None:
    measured = winding_path(20.0)
    table = filled_up(measured, 20.0 * times)
    found = drop_interpolated_poses(table)
    (odd,) = found.irregularities
    assert (odd.kind, odd.action) == ("pose interpolated", "fixed")
    assert "at 20 Hz" in odd.detail
    moving = np.abs(measured.time_s - 21.0) > 1.1
    kept = np.isin(measured.time_s.round(6), found.time_s.round(6))
    assert kept[moving][1:-1].all()
    # at rest as many count
    assert np.diff(found.time_s).max() < 0.11
    assert len(found.time_s) == pytest.approx(len(measured.time_s), abs=3)


def test_a_table_of_another_rate_without_the_measured_poses_is_told() -> None:
    table = filled_up(winding_path(30.0), 100.0)
    found = drop_interpolated_poses(table)
    (odd,) = found.irregularities
    assert (odd.kind, odd.action) == ("pose interpolated", "warning")
    assert "of which few are rows" in odd.detail
    assert found.values is table.values


@pytest.mark.parametrize("digits", [2, 3, 4, 6])
def test_digits_are_no_straight_lines(digits: int) -> None:
    poses = winding_path(100.0)
    poses = poses._replace(values=np.round(poses.values, digits))
    assert drop_interpolated_poses(poses).irregularities == []


@pytest.mark.parametrize("tick_m", [1.0 / 730.0, 0.1 * np.pi / 1024.0])
@pytest.mark.parametrize("turned_rad", [0.0, 0.2])
def test_ticks_are_no_straight_lines(tick_m: float, turned_rad: float) -> None:
    poses = winding_path(100.0)
    xy = np.round(poses.values[:, :2] / tick_m) * tick_m
    c, s = np.cos(turned_rad), np.sin(turned_rad)
    values = np.column_stack([xy @ [[c, s], [-s, c]], poses.values[:, 2]])
    assert drop_interpolated_poses(poses._replace(values=values)).irregularities == []


@pytest.mark.parametrize("speed_mps", [0.4, 0.41, 1.0])
def test_an_encoder_on_a_rail_draws_no_straight_lines(speed_mps: float) -> None:
    t = np.arange(0.0, 30.0, 0.01)
    x = np.round(speed_mps * t * 730.0) / 730.0
    poses = Samples(t, np.column_stack([0.8 * x, 0.6 * x, np.zeros_like(x)]), [])
    assert drop_interpolated_poses(poses).irregularities == []


def test_pixels_seen_in_perspective_are_no_straight_lines() -> None:
    poses = winding_path(100.0)
    pixel = np.round(300.0 * poses.values[:, :2])
    xy = pixel / 300.0 / (1.0 + 1e-6 * pixel[:, :1])
    assert (
        drop_interpolated_poses(poses._replace(values=np.column_stack([xy, poses.values[:, 2]]))).irregularities == []
    )


def with_filled_gap(poses: Samples, first: int, rows: int, by: Floats) -> Samples:
    """The poses with `rows` of them on a straight line over `by` (N,), from row `first` on."""
    values, inside = poses.values.copy(), np.arange(first, first + rows)
    for column in values.T:
        column[inside] = np.interp(by[inside], by[[first - 1, first + rows]], column[[first - 1, first + rows]])
    return poses._replace(values=values)


@pytest.mark.parametrize("by_time", [True, False])
def test_a_line_is_straight_by_time_or_by_row(by_time: bool) -> None:
    poses, random = winding_path(100.0), np.random.default_rng(5)
    t = poses.time_s + random.uniform(-2e-3, 2e-3, len(poses.time_s))
    at = np.column_stack([np.interp(t, poses.time_s, column) for column in poses.values.T])
    seen = Samples(t, at + random.normal(0.0, NOISE_M, at.shape), [])
    table = with_filled_gap(seen, 700, 40, t if by_time else np.arange(len(t), dtype=float))
    (odd,) = drop_interpolated_poses(table).irregularities
    assert (odd.kind, odd.count) == ("pose gap filled", 40)


def test_a_straight_stretch_of_a_path_whose_acceleration_is_noise_is_a_drive() -> None:
    acceleration = np.random.default_rng(6).normal(0.0, 3.0, (3000, 2))
    acceleration[1000:1050] = 0.0
    v = [1.0, 0.5] + np.cumsum(acceleration, axis=0) / 100.0
    pose = np.column_stack([np.cumsum(v, axis=0) / 100.0, np.zeros(3000)])
    assert drop_interpolated_poses(Samples(np.arange(3000) / 100.0, pose, [])).irregularities == []


def test_lines_between_uneven_poses_are_left_alone() -> None:
    measured, random = winding_path(100.0), np.random.default_rng(7)
    fixes = np.unique(np.cumsum(random.integers(6, 15, 900)))
    fixes = fixes[fixes < len(measured.time_s)]
    t = measured.time_s[: fixes[-1]]
    columns = [np.interp(t, measured.time_s[fixes], column) for column in measured.values[fixes].T]
    assert drop_interpolated_poses(Samples(t, np.column_stack(columns), [])).irregularities == []


def test_of_a_short_take_nothing_is_said() -> None:
    poses = with_filled_gap(winding_path(100.0), 20, 10, np.arange(6000, dtype=float))
    assert drop_interpolated_poses(Samples(poses.time_s[:55], poses.values[:55], [])).irregularities == []


def test_a_tracker_that_settles_at_rest_draws_no_straight_lines() -> None:
    poses = winding_path(100.0)
    at_rest = np.abs(poses.time_s - 21.0) < 1.0
    noise = np.random.default_rng(3).normal(0.0, 1e-7, (int(at_rest.sum()), 3))
    poses.values[at_rest] += noise
    assert drop_interpolated_poses(poses).irregularities == []


def straight_and_round(rate_hz: float) -> Floats:
    """Noiseless poses of a car of constant speed that goes straight for two seconds and turns for two, by turns."""
    t = np.arange(0.0, 40.0, 1.0 / rate_hz)
    yaw = np.r_[0.0, np.cumsum(np.where(t % 4.0 < 2.0, 0.0, 0.8))[:-1]] / rate_hz
    xy = np.cumsum(np.column_stack([np.cos(yaw), np.sin(yaw)]), axis=0) / rate_hz
    return np.column_stack([xy, yaw])


@pytest.mark.parametrize("turned_rad", [0.0, 0.2])
@pytest.mark.parametrize("jitter", [0.0, 0.05])
@pytest.mark.parametrize("rate_hz", [20.0, 50.0, 100.0, 240.0])
def test_a_noiseless_straight_drive_is_a_drive(rate_hz: float, jitter: float, turned_rad: float) -> None:
    pose = straight_and_round(rate_hz)
    at = np.arange(len(pose)) / rate_hz
    t = at + jitter / rate_hz * np.random.default_rng(4).uniform(-1.0, 1.0, len(at))
    seen = np.column_stack([np.interp(t, at, column) for column in pose.T]) if jitter else pose
    c, s = np.cos(turned_rad), np.sin(turned_rad)
    seen[:, :2] = seen[:, :2] @ [[c, s], [-s, c]]
    assert drop_interpolated_poses(Samples(t, seen, [])).irregularities == []


def test_a_recording_of_a_filled_up_table_has_the_rate_at_which_it_was_measured() -> None:
    raw, vehicle = drive(BUMPER)
    rate_hz = 1.0 / float(np.median(np.diff(raw.pose_time_s)))
    known = np.isfinite(raw.pose).all(axis=1)
    table = filled_up(Samples(raw.pose_time_s[known], raw.pose[known], []), 3.0 * rate_hz)
    found = assemble_recording(replace(raw, pose_time_s=table.time_s, pose=table.values, rate_hz=None), vehicle)
    assert found.rate_hz == pytest.approx(rate_hz, rel=0.02)
    assert any(odd.kind == "pose interpolated" and odd.action == "fixed" for odd in found.irregularities)


def test_the_step_that_numbers_are_written_in() -> None:
    values = np.random.default_rng(2).normal(0.0, 3.0, (200, 2))
    assert rounding_step(np.round(values, 3)) == pytest.approx(1e-3)
    assert rounding_step(1e-3 * np.round(1e3 * values, 2)) == pytest.approx(1e-5)
    assert 1e-8 < rounding_step(values.astype(np.float32).astype(float)) < 1e-5
    assert rounding_step(values) < 1e-13
