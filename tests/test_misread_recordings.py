"""Recordings whose numbers are another quantity than they are taken for are told with what they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid.aliases import Floats
from bcid.errors import InputRefused
from bcid.recording.assemble import assemble_recording
from bcid.recording.checks.limits import AGREEMENT as LIMITS
from bcid.recording.checks.pose_verdict import _judge_yaw_gain
from bcid.recording.cuts import read_named_recording
from bcid.recording.formats.raw import RawTake
from bcid.recording.read import read_raw_take
from bcid.recording.types import Irregularity
from bcid.vehicle import Vehicle, read_vehicle

LOGS = Path(__file__).parents[1] / "sample_logs"


@pytest.fixture(scope="module")
def sample() -> tuple[RawTake, Vehicle]:
    vehicle = read_vehicle(LOGS / "bumper_car.toml")
    return read_raw_take(LOGS / "validation.csv", vehicle, LOGS / "validation.commands.csv"), vehicle


def irregularities(raw: RawTake, vehicle: Vehicle, kind: str) -> list[Irregularity]:
    """Those of a kind that are told of a take."""
    return [odd for odd in assemble_recording(raw, vehicle).irregularities if odd.kind == kind]


def with_yaw(raw: RawTake, change: Callable[[Floats], Floats]) -> RawTake:
    """The take with another yaw."""
    known, pose = np.isfinite(raw.pose[:, 2]), raw.pose.copy()
    pose[known, 2] = change(np.unwrap(pose[known, 2]))
    return replace(raw, pose=pose)


@pytest.mark.parametrize(
    ("factor", "gain"), [(0.5, "2"), (2.0, "0.5"), (1.0 / (2.0 * np.pi), "6.28")], ids=["half", "twice", "turns"]
)
def test_a_yaw_of_another_gain_is_told_with_it(factor: float, gain: str, sample: tuple[RawTake, Vehicle]) -> None:
    raw, vehicle = sample
    (verdict,) = irregularities(with_yaw(raw, lambda yaw: factor * yaw), vehicle, "poses")
    assert verdict.action == "no-go"
    assert "times as far as the path" in verdict.detail
    assert f"map it with gain = {gain}," in verdict.detail


def test_what_is_said_of_a_yaw_s_gain_undoes_it() -> None:
    path = 0.1 * np.cumsum(np.random.default_rng(0).normal(size=400)) / 3.0
    path += np.linspace(0.0, 0.3, 400)
    for slope, gain in ((-1.6, "-0.625"), (-0.5, "-2"), (0.3, "3.33"), (0.5, "2")):
        verdict = _judge_yaw_gain(slope * path, path)
        assert verdict is not None
        assert f"map it with gain = {gain}," in verdict
    assert _judge_yaw_gain(1.1 * path, path) is None


@pytest.mark.parametrize("seed", [10, 14, 17, 20])
def test_a_wheel_that_is_steered_beyond_a_right_angle_does_not_make_a_good_yaw_wrong(seed: int) -> None:
    """Its car slips by more than a radian, so that yaw and path need not turn alike: a line has a slope of 1.4 to 2."""
    rng, step_s, wheelbase, speed = np.random.default_rng(seed), 0.02, 1.2, 1.5
    noise = rng.normal(size=6000)
    wanders = np.zeros(len(noise))
    for k in range(1, len(noise)):
        wanders[k] = (1.0 - 0.5 * step_s) * wanders[k - 1] + np.sqrt(step_s) * noise[k]
    steering = np.clip(1.2 * wanders, -2.0, 2.0)
    turn = speed * np.sin(steering) / wheelbase
    yaw, v_x, v_y = np.cumsum(turn) * step_s, speed * np.cos(steering), 0.5 * wheelbase * turn
    x = np.cumsum(v_x * np.cos(yaw) - v_y * np.sin(yaw)) * step_s
    y = np.cumsum(v_x * np.sin(yaw) + v_y * np.cos(yaw)) * step_s
    rows = slice(None, None, round(LIMITS.course_s / step_s))
    path_turn = np.diff(np.unwrap(np.arctan2(np.diff(y[rows]), np.diff(x[rows]))))
    yaw_turn = np.diff(0.5 * (yaw[rows][1:] + yaw[rows][:-1]))
    assert _judge_yaw_gain(yaw_turn, path_turn) is None


@pytest.mark.parametrize("offset", [0.0, 0.5])
def test_a_yaw_that_turns_as_the_path_does_is_no_other_quantity(offset: float, sample: tuple[RawTake, Vehicle]) -> None:
    raw, vehicle = sample
    assert not irregularities(with_yaw(raw, lambda yaw: yaw + offset), vehicle, "poses")


SMALL_CAR = """\
name = "small"
[body]
cog_to_front_m = 0.16
cog_to_rear_m = 0.17
mass_kg = 3.0
drive = "rear"
[steering]
max_angle_rad = 0.45
[motor]
reference_speed_mps = 2.0
[columns]
time_s = "t"
x_m = "x"
y_m = "y"
yaw_rad = "yaw"
steering_rad = "steer"
throttle_mps = "throttle"
"""


def drive_small_car(seconds: float) -> Floats:
    """Rows [t, x, y, yaw, steering, speed] at 100 Hz, at the centre of gravity of a car that rolls without slip."""
    rng = np.random.default_rng(5)
    time_s = np.arange(0.0, seconds, 0.01)
    waves = [rng.uniform(0.1, 0.5, 4), rng.uniform(0.0, 6.0, 4)]
    steering = 0.35 * np.mean([np.sin(2 * np.pi * f * time_s + at) for f, at in zip(*waves, strict=True)], axis=0) * 1.7
    speed = 1.0 + 0.4 * np.sin(0.4 * time_s)
    slip = np.arctan(0.17 / 0.33 * np.tan(steering))
    yaw = np.cumsum(speed * np.sin(slip) / 0.17) * 0.01
    x, y = (np.cumsum(speed * f(yaw + slip)) * 0.01 for f in (np.cos, np.sin))
    noise = rng.normal(size=(3, len(time_s))) * np.array([[3e-4], [3e-4], [1e-3]])
    return np.column_stack([time_s, x + noise[0], y + noise[1], yaw + noise[2], steering, speed])


def test_a_body_that_is_mounted_backwards_is_told_before_its_commands_are_judged(tmp_path: Path) -> None:
    """The car seems to turn right where the command says left, and another sign of the command would be wrong."""
    (tmp_path / "small.toml").write_text(SMALL_CAR, encoding="utf-8")
    vehicle, rows = read_vehicle(tmp_path / "small.toml"), drive_small_car(80.0)
    for offset in (0.0, np.pi):
        rows[:, 3] += offset
        np.savetxt(tmp_path / "t.csv", rows, delimiter=",", header="t,x,y,yaw,steer,throttle", comments="")
        recording = assemble_recording(read_raw_take(tmp_path / "t.csv", vehicle), vehicle)
        verdicts = [odd for odd in recording.irregularities if odd.action == "no-go"]
        if offset == 0.0:
            assert not verdicts
    (verdict,) = verdicts
    assert verdict.kind == "poses"
    stated = float(verdict.detail.split("set mocap.yaw_offset_rad = ")[1].split(",")[0])
    assert stated % (2.0 * np.pi) == pytest.approx(np.pi, abs=0.05)


@pytest.mark.parametrize("value", [-9999.0, 99.0])
def test_a_placeholder_is_no_steering_command(value: float, sample: tuple[RawTake, Vehicle]) -> None:
    raw, vehicle = sample
    command = raw.command.copy()
    command[200:220, 0] = value
    command[300:305, 0] = 4.0  # asked for by a controller that winds up: full lock
    told, locked = irregularities(replace(raw, command=command), vehicle, "steering command")
    assert (locked.action, locked.count) == ("fixed", 5)
    assert (told.action, told.count) == ("excluded", 20)
    used = assemble_recording(replace(raw, command=command), vehicle).commands.values
    assert np.abs(used[:, 0]).max() == 4.0


def test_a_steering_column_in_degrees_is_refused_as_a_whole(sample: tuple[RawTake, Vehicle]) -> None:
    raw, vehicle = sample
    with pytest.raises(InputRefused, match="degrees"):
        assemble_recording(replace(raw, command=raw.command * [180.0 / np.pi, 1.0]), vehicle)


@pytest.mark.parametrize(("factor", "said"), [(3.6, "3."), (100.0, "times the speed"), (1.0, None)])
def test_a_measured_speed_in_another_unit_is_refused(
    factor: float, said: str | None, sample: tuple[RawTake, Vehicle]
) -> None:
    """The throttle of this car is the speed of its front wheel, here that of the poses."""
    raw, vehicle = sample
    driven = vehicle.model_copy(update={"motor": vehicle.motor.model_copy(update={"law": "measured-speed"})})
    apart_s = np.gradient(raw.pose_time_s)
    l_f, yaw = vehicle.body.cog_to_front_m, raw.pose[:, 2]
    wheel_at = raw.pose[:, :2] + l_f * np.column_stack([np.cos(yaw), np.sin(yaw)])
    speed = np.hypot(*(np.gradient(wheel_at[:, k]) / apart_s for k in (0, 1)))
    smooth = np.convolve(speed, np.full(15, 1.0 / 15.0), mode="same")
    throttle = factor * np.interp(raw.command_time_s, raw.pose_time_s, smooth)
    wheel = replace(raw, command=np.column_stack([raw.command[:, 0], throttle]))
    if said is None:
        assert not [odd for odd in assemble_recording(wheel, driven).irregularities if "speed of the car" in odd.detail]
        return
    with pytest.raises(InputRefused, match=r"throttle_mps: is [\d.e+]+ times the speed of the car") as refused:
        assemble_recording(wheel, driven)
    assert said in str(refused.value)


def test_a_cut_counts_from_the_earliest_row_wherever_it_stands(tmp_path: Path) -> None:
    """Databases export the newest row first."""
    time_s = 1.7e9 + np.arange(0.0, 60.0, 0.02)
    x, turn = np.sin(0.3 * (time_s - 1.7e9)), 0.4 * np.sin(0.5 * (time_s - 1.7e9))
    rows = [f"{t:.3f},{a:.5f},{b:.5f},{c:.5f},0.1,0.5" for t, a, b, c in zip(time_s, x, 0.5 * x, turn, strict=True)]
    head = "t,x,y,yaw,steer,throttle"
    vehicle = tmp_path / "v.toml"
    vehicle.write_text(
        (LOGS / "bumper_car.toml").read_text(encoding="utf-8").split("[columns]")[0]
        + '\n[columns]\ntime_s = "t"\nx_m = "x"\ny_m = "y"\nyaw_rad = "yaw"\nsteering_rad = "steer"\n'
        'throttle_mps = "throttle"\n',
        encoding="utf-8",
    )
    seen = list[Any]()
    zero = ["0.000," + rows[700].split(",", 1)[1]]  # a clock that was not set yet
    orders = {
        "oldest": rows, "newest": rows[::-1], "odd": [rows[1500], *rows[:1500], *rows[1501:]],
        "zero": [*rows[:2500], *zero, *rows[2500:]],
    }  # fmt: skip
    for name, order in orders.items():
        file = tmp_path / f"{name}.csv"
        file.write_text("\n".join([head, *order]) + "\n", encoding="utf-8")
        poses = read_named_recording(Path(f"{file}[10:30]"), read_vehicle(vehicle)).poses
        seen.append((poses.values[0], poses.values[-1], len(poses.values)))
    for other in seen[1:]:
        np.testing.assert_allclose(other[0], seen[0][0], atol=1e-9)
        np.testing.assert_allclose(other[1], seen[0][1], atol=1e-9)
        assert other[2] == seen[0][2]


def test_commands_that_are_sent_on_change_hold(tmp_path: Path) -> None:
    """A stick that is moved for a second in every four, and sent while it is."""
    (tmp_path / "small.toml").write_text(SMALL_CAR, encoding="utf-8")
    vehicle, rows = read_vehicle(tmp_path / "small.toml"), drive_small_car(60.0)
    lines, held = ["t,x,y,yaw,steer,throttle"], rows[0, 4]
    for k, (t, x, y, yaw, steer, throttle) in enumerate(rows.tolist()):
        lines.append(f"{t:.4f},{x},{y},{yaw},,")
        if k % 2 == 0 and t % 4.0 < 1.0:
            held = steer
            lines.append(f"{t + 0.002:.4f},,,,{held},")
        if k % 2 == 0:
            lines.append(f"{t + 0.004:.4f},,,,,{throttle}")
    (tmp_path / "t.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    raw = read_raw_take(tmp_path / "t.csv", vehicle)
    assert np.isfinite(raw.command).all()


def test_two_bodies_of_one_name_are_refused(tmp_path: Path) -> None:
    text = (LOGS / "validation.csv").read_text(encoding="utf-8").splitlines()
    twice = [
        line if row == 0 else ",".join([line, *line.split(",")[2:]])
        for row, line in enumerate(text[: 7 + 500])
    ]  # fmt: skip
    file = tmp_path / "take.csv"
    file.write_text("\n".join(twice) + "\n", encoding="utf-8")
    vehicle = read_vehicle(LOGS / "bumper_car.toml")
    with pytest.raises(InputRefused, match="is there twice"):
        read_raw_take(file, vehicle, LOGS / "validation.commands.csv")


def test_a_half_of_a_command_that_falls_silent_holds_no_longer_than_commands_do(tmp_path: Path) -> None:
    """Steering and throttle in rows of their own: the steering's node is away for six seconds."""
    (tmp_path / "small.toml").write_text(SMALL_CAR, encoding="utf-8")
    vehicle, rows = read_vehicle(tmp_path / "small.toml"), drive_small_car(60.0)
    lines = ["t,x,y,yaw,steer,throttle"]
    for k, (t, x, y, yaw, steer, throttle) in enumerate(rows.tolist()):
        lines.append(f"{t:.4f},{x},{y},{yaw},,")
        if k % 2 == 0 and not 20.0 < t < 26.0:
            lines.append(f"{t + 0.002:.4f},,,,{steer},")
        if k % 2 == 0:
            lines.append(f"{t + 0.004:.4f},,,,,{throttle}")
    (tmp_path / "t.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    recording = assemble_recording(read_raw_take(tmp_path / "t.csv", vehicle), vehicle)
    (gap,) = [odd for odd in recording.irregularities if odd.kind == "command gap"]
    assert "the longest 5.5" in gap.detail
    held = recording.commands.time_s
    assert not ((held > 20.6) & (held < 25.9)).any()
