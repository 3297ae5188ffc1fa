"""Takes with gaps and with clocks that jump: gaps are no fault of commands, units or clocks; a jump of one clock is."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from fleet import KINDS, Drive, draw_drive
from measure_checks import is_clean

from bcid.recording.assemble import assemble_recording
from bcid.recording.checks.health import assess_health
from bcid.recording.checks.known import commands_known_at, poses_known_at
from bcid.recording.checks.pose_noise import white_noise_sd
from bcid.recording.checks.samples import clean_samples, find_set_backs
from bcid.recording.formats.raw import RawTake


def without(raw: RawTake, start_s: float, stop_s: float, poses: bool, commands: bool) -> RawTake:
    """The take without its poses, or its commands, between two times (s)."""
    keep, obeyed = (((t < start_s) | (t > stop_s)) for t in (raw.pose_time_s, raw.command_time_s))
    if poses:
        raw = replace(raw, pose_time_s=raw.pose_time_s[keep], pose=raw.pose[keep])
    if commands:
        raw = replace(raw, command_time_s=raw.command_time_s[obeyed], command=raw.command[obeyed])
    return raw


def ahead(raw: RawTake, at_s: float, by_s: float, poses: bool = True, commands: bool = True) -> RawTake:
    """The take whose clocks go `by_s` (s) ahead at a time (s)."""
    return replace(
        raw,
        pose_time_s=raw.pose_time_s + by_s * poses * (raw.pose_time_s >= at_s),
        command_time_s=raw.command_time_s + by_s * commands * (raw.command_time_s >= at_s),
    )


def blanked(raw: RawTake, rng: np.random.Generator) -> RawTake:
    """The take with blank cells in 2 % of its poses and of its commands."""
    pose, command = raw.pose.copy(), raw.command.copy()
    for values in (pose, command):
        rows = np.flatnonzero(rng.random(len(values)) < 0.02)
        values[rows, rng.integers(values.shape[1], size=len(rows))] = np.nan
    return replace(raw, pose=pose, command=command)


def with_gaps(drive: Drive, rng: np.random.Generator) -> RawTake:
    """The take with one to four kinds of gaps at random."""
    raw, end_s = drive.raw, float(drive.raw.pose_time_s[-1])
    for way in rng.permutation(4)[: rng.integers(1, 5)]:
        at_s = rng.uniform(5.0, end_s - 5.0)
        if way == 0:
            raw = without(raw, at_s, at_s + rng.uniform(0.3, min(20.0, 0.12 * end_s)), poses=True, commands=False)
        elif way == 1:
            raw = without(raw, at_s, at_s + rng.uniform(1.0, 5.0), poses=False, commands=True)
        elif way == 2:
            raw = ahead(raw, at_s, 10.0 ** rng.uniform(-0.5, 3.0))
        else:
            raw = blanked(raw, rng)
    return raw


@pytest.mark.parametrize("seed", range(100, 115))
def test_gaps_are_no_fault_of_commands_units_or_clocks(seed: int) -> None:
    drive = draw_drive(seed, seconds=60.0 + 10.0 * (seed % 5))
    gappy = replace(drive, raw=with_gaps(drive, np.random.default_rng(seed)))
    assert is_clean(gappy, seed % 2 == 1) is None


@pytest.mark.parametrize("kind", ["bumper", "rc"])
def test_a_pause_of_both_recordings_is_no_part_of_the_take(kind: str) -> None:
    drive = draw_drive(7, kind, "targets", 60.0)
    assert is_clean(replace(drive, raw=ahead(drive.raw, 25.0, 700.0)), False) is None
    vehicle = drive.kind.vehicle()
    lost = assess_health(assemble_recording(without(drive.raw, 20.0, 40.0, True, False), vehicle), vehicle)
    assert re.search(r"the pose is known in 6\d%", lost.sentence)


@pytest.mark.parametrize("by_s", [0.3, 1.2, 5.0])
@pytest.mark.parametrize("of_poses", [True, False])
@pytest.mark.parametrize("kind", list(KINDS))
def test_a_clock_that_jumps_alone_is_told_with_its_place(kind: str, by_s: float, of_poses: bool) -> None:
    drive = draw_drive(9, kind, "targets", 60.0)
    raw = ahead(drive.raw, 35.0, by_s, poses=of_poses, commands=not of_poses)
    recording = assemble_recording(raw, drive.kind.vehicle())
    (text,) = (i.detail for i in recording.irregularities if i.action == "no-go")
    told = re.match(r"one of the clocks jumps between (\d+) and (\d+) s, .* come ([\d.]+) s (earlier|later)", text)
    assert told, text
    assert 30.0 < float(told[1]) <= 35.0 + by_s
    # the servo is known a while after the gap that the commands leave
    assert 35.0 <= float(told[2]) < 41.0 + by_s
    assert float(told[3]) == pytest.approx(by_s, abs=0.11)
    assert told[4] == ("earlier" if of_poses else "later")
    assert recording.clock.reason == "one of the clocks jumps or drifts"


def test_a_drift_is_no_jump() -> None:
    drive = draw_drive(0, "bumper", "targets", 120.0)
    raw = replace(drive.raw, command_time_s=drive.raw.command_time_s * 1.005)
    said = [i.kind for i in assemble_recording(raw, drive.kind.vehicle()).irregularities]
    assert "clock jump" not in said
    assert "clock offset" in said or "clock drift" in said


def test_what_lies_over_a_gap_has_no_noise() -> None:
    rng = np.random.default_rng(0)
    values, known = rng.standard_normal(1000), np.ones(1000, dtype=bool)
    values[200:900], known[200:900] = 0.0, False
    assert white_noise_sd(values, known) == pytest.approx(1.0, rel=0.2)
    assert white_noise_sd(values, np.zeros(1000, dtype=bool)) == 0.0


def test_neither_poses_nor_commands_are_known_over_their_gaps() -> None:
    drive = draw_drive(11, "bumper", "targets", 60.0)
    raw = without(without(drive.raw, 20.0, 22.0, True, False), 40.0, 43.0, False, True)
    vehicle, t = drive.kind.vehicle(), np.arange(1.0, 58.0, 0.1)
    recording = assemble_recording(raw, vehicle)
    poses = poses_known_at(recording, t, 0.5)
    assert not poses[(t > 19.6) & (t < 22.4)].any()
    for late_s in (0.0, 2.0):
        known = commands_known_at(recording, vehicle, t, late_s)
        # the servo runs at 1.4 rad/s: it is known again when it can have come from the other side
        assert not known[(t > 40.3 + late_s) & (t < 44.5 + late_s)].any()
        assert known[(t > 5.0) & (t < 39.9 + late_s)].all()
        assert known[(t > 46.3 + late_s)].all()


def test_samples_of_a_clock_that_was_set_back_are_left_out() -> None:
    time_s = np.arange(600) / 60.0
    set_back = time_s - 0.07 * (time_s >= 5.0)
    values = np.column_stack([time_s, time_s])
    cleaned = clean_samples(set_back, values, "pose", "a.csv")
    (told,) = cleaned.irregularities
    assert (told.kind, told.action) == ("pose clock", "excluded")
    assert "set back by 0.070 s" in told.detail
    assert (np.diff(cleaned.values[:, 0]) > 0.0).all()
    assert cleaned.time_s[(cleaned.time_s > 4.94) & (cleaned.time_s < 4.98)].size == 0


def test_samples_that_only_came_late_are_sorted() -> None:
    time_s = np.arange(600) / 60.0
    late = np.r_[0:100, 105:110, 100:105, 110:600]
    assert find_set_backs(time_s[late]) == []
    cleaned = clean_samples(time_s[late], time_s[late, None], "pose", "a.csv")
    assert [(i.kind, i.action) for i in cleaned.irregularities] == [("pose order", "fixed")]
    np.testing.assert_array_equal(cleaned.time_s, time_s)


@pytest.mark.parametrize("by_s", [0.05, 0.08])
def test_a_clock_set_back_is_no_mounting_that_changed(by_s: float) -> None:
    drive = draw_drive(9, "bumper", "targets", 60.0, pose_hz=60.0)
    recording = assemble_recording(ahead(drive.raw, 30.0, -by_s), drive.kind.vehicle())
    assert [i.kind for i in recording.irregularities if i.action == "excluded"] == ["pose dropout", "pose clock"]
    assert any(29.9 < at < 30.1 for at in recording.breaks_s)
    assert [i for i in recording.irregularities if i.action == "no-go"] == []
