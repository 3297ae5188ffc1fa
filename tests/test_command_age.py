"""Commands that a recorder reads at its own rate are old when they are logged: found from how the car turns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fleet import draw_drive, shifted
from pydantic import ValidationError

from bcid.recording.assemble import assemble_recording
from bcid.recording.checks.command_age import CommandAge, reading_period, take_off_age
from bcid.recording.formats.raw import RawTake
from bcid.recording.types import Irregularity, Recording, Stream

READ = 0.1
"""Time (s) between two commands of the drives, and nearly that between two readings."""


def read_anew(raw: RawTake, every_s: float, first_s: float) -> RawTake:
    """The take as a recorder logs it that reads the latest command every so often."""
    read_s = np.arange(raw.command_time_s[0] + first_s, raw.command_time_s[-1], every_s)
    latest = np.searchsorted(raw.command_time_s, read_s, side="right") - 1
    return replace(raw, command_time_s=read_s, command=raw.command[latest])


def said_of_age(recording: Recording) -> list[Irregularity]:
    return [odd for odd in recording.irregularities if odd.kind == "command age"]


@pytest.mark.parametrize(
    ("kind", "seed", "slower"), [("rc", 15, 0.003), ("rc", 37, -0.002), ("bumper", 13, 0.0025), ("dart", 22, -0.003)]
)
def test_the_age_is_found_and_taken_off_where_the_file_states_the_reading(kind: str, seed: int, slower: float) -> None:
    drive = draw_drive(seed, kind=kind)
    raw = read_anew(drive.raw, READ * (1.0 + slower), 0.4 * READ)
    (warning,) = said_of_age(assemble_recording(raw, drive.kind.vehicle()))
    assert warning.action == "warning"
    assert "commands_read_every_s = 0.1" in warning.detail
    recording = assemble_recording(raw, drive.kind.vehicle(clock={"commands_read_every_s": READ}))
    (told,) = said_of_age(recording)
    assert told.action == "fixed"
    assert "saw" in told.detail
    # what is in force at any time, against what was sent: the log as it is differs for half a period at each change
    sent = Stream(drive.raw.command_time_s, drive.raw.command)
    grid = np.arange(5.0, drive.raw.pose_time_s[-1] - 5.0, 0.005)
    logged, taken = Stream(raw.command_time_s, raw.command), recording.commands
    off = [float(np.mean(np.abs(s.held_at(grid)[:, 0] - sent.held_at(grid)[:, 0]))) for s in (logged, taken)]
    assert off[1] < 0.3 * off[0]


@pytest.mark.parametrize("seed", [13, 15, 20, 62])
def test_commands_that_are_stamped_when_they_are_sent_are_not_old(seed: int) -> None:
    drive = draw_drive(seed)
    for raw in (drive.raw, shifted(drive.raw, 0.04)):
        assert said_of_age(assemble_recording(raw, drive.kind.vehicle())) == []


def test_half_a_period_is_taken_off_where_the_file_states_the_reading_and_the_turning_shows_no_saw() -> None:
    drive = draw_drive(15, kind="rc", seconds=12.0)
    recording = assemble_recording(drive.raw, drive.kind.vehicle(clock={"commands_read_every_s": READ}))
    (told,) = said_of_age(recording)
    assert told.action == "fixed"
    assert "half of that" in told.detail
    assert recording.commands.time_s == pytest.approx(drive.raw.command_time_s - 0.5 * READ)


@pytest.mark.parametrize("jumps", [False, True])
def test_a_clock_that_drifts_or_jumps_makes_no_saw(jumps: bool) -> None:
    drive = draw_drive(15, kind="rc")
    t = drive.raw.command_time_s
    later = READ * (t > 0.4 * t[-1]) if jumps else READ * t / t[-1]
    assert said_of_age(assemble_recording(replace(drive.raw, command_time_s=t + later), drive.kind.vehicle())) == []


def test_an_age_that_is_not_taken_off_is_told_once() -> None:
    drive = draw_drive(15, kind="rc")
    raw = read_anew(drive.raw, READ * 1.003, 0.4 * READ)
    kinds = [odd.kind for odd in assemble_recording(raw, drive.kind.vehicle()).irregularities]
    assert kinds.count("command age") == 1
    assert not {"clock offset", "clock drift"} & set(kinds)


def test_a_brake_is_as_old_as_the_commands_beside_it() -> None:
    brake = Stream(np.arange(0.0, 5.0, READ), np.zeros((50, 1)))
    recording = replace(_recording(brake), channels={"brake_share": brake, "wheel_speed": brake})
    taken = take_off_age(recording, CommandAge(READ, 0.0, 0.5))
    assert taken.channels["brake_share"].time_s == pytest.approx(brake.time_s - 0.5 * READ)
    assert taken.channels["wheel_speed"] is brake


def test_a_measured_speed_has_no_age_of_commands() -> None:
    vehicle = draw_drive(15, kind="rc").kind.vehicle
    with pytest.raises(ValidationError, match="the throttle is a measured speed"):
        vehicle(motor={"law": "measured-speed"}, clock={"commands_read_every_s": READ})


@pytest.mark.parametrize("beat_hz", [0.02, -0.02])
def test_commands_keep_their_order_where_the_saw_falls_back(beat_hz: float) -> None:
    age = CommandAge(READ, beat_hz, 0.3)
    time_s = np.arange(0.0, 200.0, 0.01)
    values = np.column_stack([np.floor(time_s / READ), np.zeros(len(time_s))])
    taken = take_off_age(_recording(Stream(time_s, values)), age).commands
    assert (np.diff(taken.time_s) > 0.0).all()
    assert (np.diff(taken.values[:, 0]) >= 0.0).all()
    late = time_s[:, None] - age.at(time_s)[:, None]
    assert np.isin(taken.time_s, late).all()
    assert age.at(time_s).max() < READ
    assert age.at(time_s).min() >= 0.0


def test_the_period_of_reading_is_that_of_the_shortest_steps_between_changes() -> None:
    rng = np.random.default_rng(3)
    read_s = READ * np.arange(600) + 0.004 * rng.standard_normal(600)
    values = np.repeat(rng.standard_normal((200, 2)), 3, axis=0)  # a driver changes his mind every third reading
    values[::7] += 0.1
    rows = np.arange(0.0, 59.0, 0.01)  # of a table, which holds each reading until the next
    held = Stream(rows, values[np.maximum(np.searchsorted(read_s, rows, side="right") - 1, 0)])
    assert reading_period(held) == pytest.approx(READ, abs=0.011)
    assert reading_period(Stream(rows, np.zeros((len(rows), 2)))) == np.inf


def _recording(commands: Stream) -> Recording:
    """A recording of which only the commands matter."""
    return Recording("drive", (), Stream(np.arange(3.0), np.zeros((3, 3))), commands, 100.0, 0.5)
