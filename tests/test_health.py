"""`bcid ingest --check`: go or no-go, and why."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from making import circling_take
from test_mcap import broken_at
from typer.testing import CliRunner

from bcid.cli.app import app
from bcid.errors import BcidError, PartLost
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning
from bcid.recording.assemble import assemble_recording
from bcid.recording.checks.health import assess_health
from bcid.recording.formats.raw import RawTake
from bcid.recording.read import read_raw_take, read_recording
from bcid.recording.types import Recording, Stream
from bcid.vehicle import Vehicle, read_vehicle


def test_a_usual_take_is_a_go(recording: Recording, vehicle: Vehicle) -> None:
    found = assess_health(recording, vehicle)
    assert found.go
    assert found.sentence.startswith("go: ")
    assert found.figures is not None
    assert found.figures.pose_coverage > 0.95
    assert found.figures.command_coverage > 0.95
    assert 0.8 * recording.duration_s < found.figures.moving_s <= recording.duration_s
    assert found.not_excited == ()


def test_what_is_driven_in_one_circle_is_known_in_part_only(tmp_path: Path, vehicle: Vehicle) -> None:
    found = assess_health(read_recording(circling_take(tmp_path, seconds=60.0), vehicle), vehicle)
    assert found.go
    assert [text.partition(":")[0] for text in found.not_excited] == ["other speeds", "braking"]
    assert "K_b" in found.sentence
    assert "C_f" not in found.sentence


def test_a_take_that_is_worth_nothing_is_no_go(recording: Recording, vehicle: Vehicle) -> None:
    """Standing; mostly lost; without commands; straight on."""
    time, pose = recording.poses.time_s, recording.poses.values

    def said(**changed: Stream) -> str:
        found = assess_health(replace(recording, **changed), vehicle)
        assert not found.go
        return found.sentence

    assert "moves for 0 s only" in said(poses=Stream(time, np.tile(pose[0], (len(pose), 1))))
    lost = (np.arange(len(time)) // 60) % 3 == 0
    assert "the pose is known in 3" in said(poses=Stream(time[lost], pose[lost]))
    few = recording.commands
    assert "commands are known in" in said(commands=Stream(few.time_s[::40], few.values[::40]))
    straight = Stream(few.time_s, few.values * [0.02, 1.0])
    gone = np.r_[0.0, np.cumsum(np.hypot(*np.diff(pose[:, :2], axis=0).T))]
    line = Stream(time, np.column_stack([gone, 0.0 * gone, 0.0 * gone]))
    assert "straight driving only" in said(commands=straight, poses=line)


def test_a_bump_is_told_and_stands_apart(takes: dict[str, Path], vehicle: Vehicle, tuning: Tuning) -> None:
    raw = read_raw_take(takes["mcap"], vehicle)
    row = len(raw.pose) // 2
    at = raw.pose_time_s[row]
    pose = raw.pose.copy()
    pose[row:, 0] += 1.2 * np.minimum(raw.pose_time_s[row:] - at, 1.0)  # its velocity changes at once, twice
    recording = assemble_recording(replace(raw, pose=pose), vehicle)
    told = [i for i in recording.irregularities if i.kind == "contact"]
    assert [i.action for i in told] == ["excluded", "excluded"]
    assert any("contact" in text and "m/s²" in text for text in assess_health(recording, vehicle).findings)
    found = estimate_motion(recording, vehicle, tuning)
    before, behind = (found.segment[np.searchsorted(found.time_s, at + gap)] for gap in (-0.3, 0.3))
    assert before != behind


def test_all_recordings_are_told_whatever_is_wrong_with_one(
    tmp_path: Path, takes: dict[str, Path], vehicle_file: Path
) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(takes["mcap"].read_bytes()[:-400])
    none = tmp_path / "none.mcap"
    words = ["ingest", str(bad), str(takes["mcap"]), str(none), "--check", "--vehicle", str(vehicle_file)]
    done = CliRunner().invoke(app, [*words, "--format", "json"])
    told = json.loads(done.stdout)["recordings"]
    assert len({frozenset(t) for t in told}) == 1  # the same keys, whether it is refused or not
    assert [t["go"] for t in told] == [False, True, False]
    assert [p["source"] for t in told for p in t["problems"]] == [str(bad), str(none)]
    assert isinstance(done.exception, BcidError)
    assert done.exception.exit_code == 4
    for part in ("bad.mcap", "cut", "none.mcap", "does not exist"):
        assert part in str(done.exception)
    human = CliRunner().invoke(app, words)
    assert "no-go: refused" in human.stdout
    assert "  go: " in human.stdout
    assert not (tmp_path / "workspace").exists()


def test_check_needs_a_vehicle(tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["ingest", str(tmp_path / "a.mcap"), "--check"])
    assert "vehicle" in str(done.exception)


@pytest.mark.parametrize("words", [["ingest", "--check"]])
def test_the_plan_s_recordings_are_checked_where_none_is_named(
    words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(Path(__file__).parent.parent)
    told = json.loads(CliRunner().invoke(app, [*words, "--format", "json"]).stdout)["recordings"]
    assert len(told) == 5
    assert all(t["go"] for t in told)


@pytest.fixture(scope="module")
def sample() -> tuple[RawTake, Vehicle]:
    logs = Path(__file__).parents[1] / "sample_logs"
    vehicle = read_vehicle(logs / "bumper_car.toml")
    return read_raw_take(logs / "validation.csv", vehicle, logs / "validation.commands.csv"), vehicle


@pytest.mark.parametrize("offset", [0.0, 0.08, -0.05, 0.6, -1.57])
def test_a_body_that_sits_askew_is_told_with_its_angle(offset: float, sample: tuple[RawTake, Vehicle]) -> None:
    raw, vehicle = sample
    found = assess_health(assemble_recording(replace(raw, pose=np.add(raw.pose, [0.0, 0.0, offset])), vehicle), vehicle)
    assert found.figures is not None
    seen = found.figures.yaw_offset_rad
    assert seen is not None
    assert seen.low < offset < seen.high
    assert seen.high - seen.low < 0.03
    assert any("yaw_offset_rad" in text for text in found.findings) == (offset != 0.0)
    assert not any("clock" in text for text in found.findings)  # which it looks like


def test_a_check_of_what_lost_a_part_ends_with_three(
    takes: dict[str, Path], vehicle_file: Path, tmp_path: Path
) -> None:
    path = broken_at(0.5, takes["mcap"], tmp_path / "t.mcap")
    words = ["ingest", "--check", str(path), "--vehicle", str(vehicle_file), "--allow-partial"]
    ended = CliRunner().invoke(app, words)
    assert isinstance(ended.exception, PartLost)
    assert "t.mcap" in str(ended.exception)
