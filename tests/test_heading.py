"""A yaw that jumps is told and left out, for a sample or for good; that of a car that drives, spins or bumps is not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from fleet import Drive, draw_drive

from bcid.aliases import Bools, Floats
from bcid.errors import InputRefused
from bcid.recording.assemble import mend_poses
from bcid.recording.checks.contacts import find_contacts, split_at_contacts
from bcid.recording.checks.heading import face_forward
from bcid.recording.checks.samples import Samples, clean_samples
from bcid.recording.checks.yaw_jumps import _undoes_one_of, find_yaw_jumps
from bcid.recording.formats.raw import RawTake
from bcid.recording.limits import HEADING
from bcid.recording.types import Recording, Stream
from bcid.vehicle import Vehicle

BUMPER, RC, DART, F1TENTH, TRICYCLE = range(5)  # seeds of the fleet
EVERY_DRIVE = range(60)


@cache
def drawn_drive(seed: int) -> Drive:
    """A clean drive of a minute, of the vehicle that the seed draws."""
    return draw_drive(seed, seconds=60.0)


def mended(raw: RawTake, vehicle: Vehicle) -> Recording:
    """The take after all checks of its poses, whatever its commands are."""
    poses, commands = (
        clean_samples(time_s, values, name, "take")
        for name, time_s, values in (
            ("pose", raw.pose_time_s, raw.pose), ("command", raw.command_time_s, raw.command),
        )
    )  # fmt: skip
    poses, breaks = mend_poses(poses, commands, vehicle, "take")
    pose = np.column_stack([poses.values[:, :2], np.unwrap(poses.values[:, 2])])
    rate = raw.rate_hz or 1.0 / float(np.median(np.diff(poses.time_s)))
    streams = Stream(poses.time_s, pose), Stream(commands.time_s, commands.values)
    odd = tuple(i for i in poses.irregularities if i.kind != "pose dropout")
    return split_at_contacts(Recording(raw.name, raw.sources, *streams, rate, 0.5, tuple(breaks), {}, odd))


def counts(recording: Recording) -> dict[str, int]:
    """How often each kind of irregularity was counted."""
    kinds = [i.kind for i in recording.irregularities]
    return {kind: sum(i.count for i in recording.irregularities if i.kind == kind) for kind in kinds}


def lost(recording: Recording, raw: RawTake) -> Bools:
    """Mask (N,) of the poses that were seen and are left out."""
    return np.asarray(np.isfinite(raw.pose).all(axis=1) & ~np.isin(raw.pose_time_s, recording.poses.time_s))


def drive(seed: int) -> tuple[RawTake, Vehicle]:
    """A clean drive of a minute."""
    drawn = drawn_drive(seed)
    return drawn.raw, drawn.kind.vehicle()


def turned(raw: RawTake, rows: Bools, rad: float) -> RawTake:
    """The take with the yaw turned in these rows."""
    return replace(raw, pose=raw.pose + np.outer(rows, [0.0, 0.0, rad]))


@pytest.mark.parametrize("degrees", [20.0, -60.0, 143.0])
@pytest.mark.parametrize("seed", [BUMPER, RC, F1TENTH, TRICYCLE])
def test_single_yaw_spikes_are_left_out(seed: int, degrees: float) -> None:
    raw, vehicle = drive(seed)
    rows = np.zeros(len(raw.pose), dtype=bool)
    rows[[300, 500, 700, 701, 900]] = True
    found = mended(turned(raw, rows, np.radians(degrees)), vehicle)
    np.testing.assert_array_equal(lost(found, raw), rows & np.isfinite(raw.pose).all(axis=1))
    assert counts(found) == {"yaw jump": lost(found, raw).sum()}
    assert found.breaks_s == ()


@pytest.mark.parametrize("seconds", [0.05, 0.5, 3.0])
@pytest.mark.parametrize("degrees", [20.0, 90.0, -143.0])
def test_a_yaw_that_is_off_for_a_while_is_left_out(degrees: float, seconds: float) -> None:
    raw, vehicle = drive(BUMPER)
    rows = (raw.pose_time_s > 30.0) & (raw.pose_time_s < 30.0 + seconds)
    found = mended(turned(raw, rows, np.radians(degrees)), vehicle)
    assert not (lost(found, raw) ^ (rows & np.isfinite(raw.pose).all(axis=1))).any()
    assert set(counts(found)) == {"yaw jump"}


@pytest.mark.parametrize("degrees", [20.0, -60.0, 143.0])
@pytest.mark.parametrize("from_s", [20.0, 40.0])
def test_a_mounting_that_changes_for_good_is_told_with_its_size(from_s: float, degrees: float) -> None:
    """The side that goes where its yaw points is kept, be it the shorter one."""
    raw, vehicle = drive(DART)
    rows = raw.pose_time_s > from_s
    found = mended(turned(raw, rows, np.radians(degrees)), vehicle)
    np.testing.assert_array_equal(lost(found, raw), rows & np.isfinite(raw.pose).all(axis=1))
    (told,) = found.irregularities
    assert told.kind == "mounting"
    assert f"at {raw.pose_time_s[rows][0]:.3f} s" in told.detail
    size = float(told.detail.split("yaw by ")[1].split()[0])
    assert size == pytest.approx(np.radians(degrees), abs=0.03)


def test_a_knocked_marker_is_no_contact() -> None:
    raw, vehicle = drive(BUMPER)
    pose = raw.pose + np.outer(raw.pose_time_s > 20.0, [0.01, -0.008, 0.12])
    found = mended(replace(raw, pose=pose), vehicle)
    assert set(counts(found)) == {"mounting"}
    assert lost(found, raw).sum() == (np.isfinite(raw.pose).all(axis=1) & (raw.pose_time_s <= 20.0)).sum()


def test_a_knock_that_moves_the_position_only_is_no_contact() -> None:
    raw, vehicle = drive(BUMPER)
    found = mended(replace(raw, pose=raw.pose + np.outer(raw.pose_time_s > 20.0, [0.02, -0.02, 0.0])), vehicle)
    (told,) = found.irregularities
    assert told.kind == "mounting"
    assert "the position steps by 0.02" in told.detail
    assert found.breaks_s
    assert find_contacts(found) == []


def test_a_mounting_that_changes_while_the_body_is_hidden_is_told() -> None:
    raw, vehicle = drive(BUMPER)
    hidden = (raw.pose_time_s > 20.0) & (raw.pose_time_s < 20.15)
    pose = np.where(hidden[:, None], np.nan, raw.pose + np.outer(raw.pose_time_s > 20.1, [0.0, 0.0, 1.0]))
    found = mended(replace(raw, pose=pose), vehicle)
    assert set(counts(found)) == {"mounting"}
    assert found.poses.time_s[-1] < 20.1


def test_axes_that_are_set_anew_split_the_take_and_nothing_is_left_out() -> None:
    """As in the log of a racing car whose localisation jumps: path and yaw turn together."""
    raw, vehicle = drive(F1TENTH)
    late = raw.pose_time_s > 25.0
    c, s = np.cos(0.4), np.sin(0.4)
    pose = raw.pose.copy()
    pose[late, :2] = pose[late, :2] @ np.array([[c, s], [-s, c]]) + [2.0, 3.0]
    pose[late, 2] += 0.4
    found = mended(replace(raw, pose=pose), vehicle)
    assert not lost(found, raw).any()
    assert found.breaks_s == (raw.pose_time_s[late & np.isfinite(raw.pose).all(axis=1)][0],)
    assert set(counts(found)) == {"pose jump", "yaw jump"}


@pytest.mark.parametrize("ratio", [1.37, 4.0])
@pytest.mark.parametrize("seed", [BUMPER, RC])
def test_a_wrapped_yaw_that_was_resampled_by_straight_lines_is_told_as_such(seed: int, ratio: float) -> None:
    raw, vehicle = drive(seed)
    seen = np.isfinite(raw.pose).all(axis=1)
    t, pose = raw.pose_time_s[seen], raw.pose[seen]
    again_s = np.arange(0.0, t[-1], (t[1] - t[0]) / ratio)
    wrapped = np.angle(np.exp(1j * pose[:, 2]))
    columns = [np.interp(again_s, t, column) for column in (*pose[:, :2].T, wrapped)]
    true = np.interp(again_s, t, np.unwrap(pose[:, 2]))
    wrong = np.abs(np.angle(np.exp(1j * (columns[2] - true)))) > 0.15
    made = replace(raw, pose=np.column_stack(columns), pose_time_s=again_s, rate_hz=None)
    found = mended(made, vehicle)
    assert wrong.any()
    assert lost(found, made)[wrong].all()
    assert lost(found, made).sum() < 2 * wrong.sum() + 5
    assert any("straight lines" in i.detail for i in found.irregularities if i.kind == "yaw wrap")


def test_one_nonsense_cell_is_left_out() -> None:
    raw, vehicle = drive(BUMPER)
    for value in (1e5, 357.0, -9999.0):
        pose = raw.pose.copy()
        pose[500, 2] = value
        found = mended(replace(raw, pose=pose), vehicle)
        assert np.flatnonzero(lost(found, raw)).tolist() == [500]


def test_a_yaw_that_jumps_all_the_time_is_refused() -> None:
    raw, vehicle = drive(BUMPER)
    rows = np.random.default_rng(1).random(len(raw.pose)) < 0.1
    with pytest.raises(InputRefused, match="faster than a car turns"):
        mended(turned(raw, rows, 2.0), vehicle)


@pytest.mark.parametrize("on_car", [True, False])
def test_another_body_for_a_while_is_left_out(on_car: bool) -> None:
    raw, vehicle = drive(BUMPER)
    rows = (raw.pose_time_s > 30.0) & (raw.pose_time_s < 32.0)
    heading = raw.pose[:, 2] if on_car else np.zeros(len(rows))
    aside = 0.4 * np.column_stack([np.cos(heading), np.sin(heading), np.zeros(len(rows))])
    found = mended(replace(raw, pose=raw.pose + rows[:, None] * aside), vehicle)
    np.testing.assert_array_equal(lost(found, raw), rows & np.isfinite(raw.pose).all(axis=1))
    assert set(counts(found)) == {"tracking", "pose jump"}


def with_noise(raw: RawTake, kind: str, seed: int) -> RawTake:
    """The take as another tracking would write it."""
    rng, pose = np.random.default_rng(seed), raw.pose
    if kind == "heavy":
        pose = pose + rng.standard_t(4, pose.shape) * [5e-4, 5e-4, 1e-3]
    elif kind == "strong":
        pose = pose + rng.standard_normal(pose.shape) * [1e-2, 1e-2, 2e-2]
    elif kind == "mm":
        pose = np.round(pose, 3)
    elif kind == "cm and degrees":
        pose = np.column_stack([np.round(pose[:, :2], 2), np.radians(np.round(np.degrees(pose[:, 2])))])
    return replace(raw, pose=pose)


@pytest.mark.parametrize("noise", ["as it is", "heavy", "strong", "mm", "cm and degrees"])
def test_clean_drives_of_five_vehicles_have_no_event(noise: str) -> None:
    """Whatever the noise, the digits, and the rate (25 to 240 Hz)."""
    told: dict[str, dict[str, int]] = {}
    for seed in EVERY_DRIVE:
        drawn = drawn_drive(seed)
        raw = with_noise(drawn.raw, noise, seed)
        every = 4 if seed % 2 and drawn.raw.rate_hz and drawn.raw.rate_hz >= 100.0 else 1
        thinned = replace(raw, pose=raw.pose[::every], pose_time_s=raw.pose_time_s[::every], rate_hz=None)
        if found := counts(mended(thinned, drawn.kind.vehicle())):
            told[drawn.label] = found
    # of digits this coarse, three can repeat by chance while a car moves
    few = {label: found for label, found in told.items() if found == {"frozen pose": 1}}
    assert told == (few if noise == "cm and degrees" else {})
    assert len(few) < 0.1 * len(EVERY_DRIVE)


def spinning_yaw(rate_hz: float, seed: int) -> tuple[Floats, Floats]:
    """Times and yaw of a 1:10 car that spins at up to 10 rad/s, either way within some tenths of a second."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 60.0, 1.0 / rate_hz)
    fine = np.arange(0.0, 60.0, 1e-3)
    wanted = np.repeat(rng.uniform(-10.0, 10.0, 60), 1000)
    rate = np.zeros(len(fine))
    for k in range(1, len(fine)):  # 2 mu g / L of grippy tyres
        rate[k] = rate[k - 1] + np.clip(wanted[k] - rate[k - 1], -0.06, 0.06)
    return t, np.interp(t, fine, 1e-3 * np.cumsum(rate)) + 1e-3 * rng.standard_normal(len(t))


@pytest.mark.parametrize("rate_hz", [25.0, 60.0, 240.0])
def test_a_spin_is_no_jump(rate_hz: float) -> None:
    for seed in range(5):
        t, yaw = spinning_yaw(rate_hz, seed)
        assert not len(find_yaw_jumps(t, yaw, 0.3).rows)
        assert not len(find_yaw_jumps(t, np.angle(np.exp(1j * yaw)), 0.3).rows)


def test_a_contact_that_turns_the_car_is_no_jump_of_its_yaw() -> None:
    """The rate changes at once, the yaw does not."""
    t = np.arange(0.0, 20.0, 1.0 / 60.0)
    yaw = np.where(t < 10.0, 0.5 * t, 5.0 - 4.0 * (t - 10.0)) + 1e-3 * np.random.default_rng(1).standard_normal(len(t))
    assert not len(find_yaw_jumps(t, yaw, 0.87).rows)


def test_two_spikes_within_one_sample_are_told_apart() -> None:
    t = np.arange(0.0, 20.0, 0.01)
    yaw = 0.8 * np.sin(t)
    yaw[[800, 802]] += 1.0
    jumps = find_yaw_jumps(t, yaw, 0.87)
    assert jumps.rows.tolist() == [800, 801, 802, 803]
    np.testing.assert_allclose(jumps.sizes, [1.0, -1.0, 1.0, -1.0], atol=0.01)


@pytest.mark.parametrize("quarters", [-1, 0, 1, 2])
def test_a_body_without_a_forward_is_turned_the_way_the_car_goes(quarters: int) -> None:
    raw, vehicle = drive(BUMPER)
    seen = np.isfinite(raw.pose).all(axis=1)
    poses = Samples(raw.pose_time_s[seen], np.add(raw.pose[seen], [0.0, 0.0, quarters * np.pi / 2]), [])
    commands = Samples(raw.command_time_s, raw.command, [])
    off = face_forward(poses, commands, vehicle).values[:, 2] - raw.pose[seen, 2]
    np.testing.assert_allclose(np.exp(1j * off), 1.0, atol=1e-9)
    stated = vehicle.model_copy(update={"mocap": vehicle.mocap.model_copy(update={"yaw_offset_rad": 0.1})})
    assert face_forward(poses, commands, stated) is poses


def test_samples_of_a_few_poses_are_returned_as_they_are() -> None:
    few = Samples(np.arange(8) * 0.1, np.column_stack([np.arange(8.0), np.zeros(8), np.zeros(8)]), [])
    poses, breaks = mend_poses(few, Samples(np.zeros(1), np.zeros((1, 2)), []), drawn_drive(0).kind.vehicle(), "take")
    np.testing.assert_array_equal(poses.values, few.values)
    assert breaks == []


def test_a_long_take_of_many_jumps_needs_little_memory() -> None:
    """Every tenth sample of half an hour at 120 Hz jumps and comes back: pairs of all with all would take gigabytes."""
    rng = np.random.default_rng(0)
    sizes, jumps = rng.normal(size=200_000), rng.normal(size=20_000)
    undone = _undoes_one_of(sizes, jumps)
    for i in range(0, len(sizes), 4001):
        near = np.abs(sizes[i] + jumps) < HEADING.max_return_misfit * np.abs(jumps)
        assert not undone[i] or near.any()
    assert undone.mean() > 0.9
    assert not _undoes_one_of(sizes, np.empty(0)).any()
