"""What is no measurement is never fitted: held, flipped, tipped and doubled poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from bcid.errors import InputRefused
from bcid.recording.assemble import assemble_recording
from bcid.recording.checks.attitude import check_up_axis, checked_yaw, find_lifted_samples
from bcid.recording.formats.raw import RawTake
from bcid.recording.read import read_raw_take
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle


@pytest.fixture(scope="module")
def raw(takes: dict[str, Path], vehicle: Vehicle) -> RawTake:
    return read_raw_take(takes["mcap"], vehicle)


def told(recording: Recording, kind: str) -> int:
    """How often an irregularity was counted."""
    return sum(i.count for i in recording.irregularities if i.kind == kind)


def test_a_pose_that_the_tracking_holds_is_left_out(raw: RawTake, vehicle: Vehicle) -> None:
    throttle = np.searchsorted(raw.command_time_s, raw.pose_time_s, side="right") - 1
    on = raw.command[throttle, 1] > 0.3
    first = next(k for k in range(1000, len(on)) if on[k : k + 60].all())
    pose = raw.pose.copy()
    pose[first : first + 60] = pose[first]
    found = assemble_recording(replace(raw, pose=pose), vehicle)
    assert told(found, "frozen pose") == 59
    assert not np.isin(raw.pose_time_s[first + 1 : first + 60], found.poses.time_s).any()
    assert told(assemble_recording(raw, vehicle), "frozen pose") == 0


def test_a_pose_that_is_held_to_the_end_is_left_out(raw: RawTake, vehicle: Vehicle) -> None:
    row = np.searchsorted(raw.command_time_s, raw.pose_time_s, side="right") - 1
    on = raw.command[np.maximum(row, 0), 1] > 0.3
    last = next(k for k in range(len(on) - 1, 0, -1) if on[k - 60 : k].all())
    cut = replace(raw, pose=raw.pose[:last].copy(), pose_time_s=raw.pose_time_s[:last])
    cut.pose[last - 60 :] = cut.pose[last - 60]
    assert told(assemble_recording(cut, vehicle), "frozen pose") == 59


def test_a_car_that_stands_is_not_frozen(raw: RawTake, vehicle: Vehicle) -> None:
    """To the last digit, as a simulator's log may say it, but with the throttle off."""
    pose, command = raw.pose.copy(), raw.command.copy()
    pose[:120] = pose[120]  # no jump at the end of it
    command[raw.command_time_s < raw.pose_time_s[125]] = 0.0
    found = assemble_recording(replace(raw, pose=pose, command=command), vehicle)
    assert told(found, "frozen pose") == 0
    assert len(found.poses) == len(raw.pose)


def test_a_clock_that_is_set_back_is_refused_and_late_samples_are_not(raw: RawTake, vehicle: Vehicle) -> None:
    back = raw.pose_time_s.copy()
    back[1500:] -= 0.4
    with pytest.raises(InputRefused, match=r"steps back by 0\.3\d+ s .* times twice"):
        assemble_recording(replace(raw, pose_time_s=back), vehicle)
    order = np.arange(len(raw.pose))
    order[[700, 703]] = order[[703, 700]]
    mixed = assemble_recording(replace(raw, pose_time_s=raw.pose_time_s[order], pose=raw.pose[order]), vehicle)
    assert told(mixed, "pose order") > 0
    np.testing.assert_array_equal(mixed.poses.time_s, assemble_recording(raw, vehicle).poses.time_s)


def test_a_yaw_turned_round_for_a_while_is_left_out(raw: RawTake, vehicle: Vehicle) -> None:
    pose = raw.pose.copy()
    pose[800:900, 2] += np.pi
    found = assemble_recording(replace(raw, pose=pose), vehicle)
    assert told(found, "yaw flip") == 100
    good = assemble_recording(raw, vehicle).poses
    kept = np.isin(good.time_s, found.poses.time_s)
    np.testing.assert_allclose(found.poses.values, good.values[kept], atol=1e-9)


def channels(raw: RawTake, vehicle: Vehicle, **made: tuple[str, float]) -> RawTake:
    """The take with channels that are what the poses say, times a factor."""
    yaw, l_f = raw.pose[:, 2], vehicle.body.cog_to_front_m
    ahead = raw.pose[:, :2] + l_f * np.column_stack([np.cos(yaw), np.sin(yaw)])  # the front wheel
    known = {
        "yaw_rate": np.gradient(np.unwrap(raw.pose[:, 2]), raw.pose_time_s),
        "speed": np.hypot(*np.gradient(ahead, raw.pose_time_s, axis=0).T),
        "angle": np.interp(raw.pose_time_s, raw.command_time_s, raw.command[:, 0]),
    }
    smooth = {k: np.convolve(v, np.ones(15) / 15.0, "same") for k, v in known.items()}
    return replace(raw, channels={n: (raw.pose_time_s, f * smooth[k]) for n, (k, f) in made.items()})


def test_channels_that_follow_the_motion_are_kept(raw: RawTake, vehicle: Vehicle) -> None:
    take = channels(raw, vehicle, yaw_rate_radps=("yaw_rate", 1.02), wheel_speed_mps=("speed", 1.0),
                    measured_steering_rad=("angle", 0.95))  # fmt: skip
    found = assemble_recording(take, vehicle)
    assert set(found.channels) == {"yaw_rate_radps", "wheel_speed_mps", "measured_steering_rad"}
    assert told(found, "channel") == 0


@pytest.mark.parametrize(
    ("name", "made", "says"),
    [
        ("yaw_rate_radps", ("yaw_rate", 57.3), "degrees"), ("yaw_rate_radps", ("yaw_rate", -1.0), "inverted"),
        ("measured_steering_rad", ("angle", -1.0), "inverted"), ("measured_steering_rad", ("angle", 57.3), "degrees"),
        ("wheel_speed_mps", ("speed", 1000.0), "mm"),
    ],
)  # fmt: skip
def test_a_channel_in_other_units_is_refused(
    name: str, made: tuple[str, float], says: str, raw: RawTake, vehicle: Vehicle
) -> None:
    with pytest.raises(InputRefused, match=says) as error:
        assemble_recording(channels(raw, vehicle, **{name: made}), vehicle)
    assert error.value.place == name


def test_a_channel_of_something_else_is_told(raw: RawTake, vehicle: Vehicle) -> None:
    noise = np.random.default_rng(1).standard_normal(len(raw.pose_time_s))
    found = assemble_recording(replace(raw, channels={"yaw_rate_radps": (raw.pose_time_s, noise)}), vehicle)
    assert told(found, "channel") == 1


def test_an_export_that_lacks_frames_is_told(takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    whole = takes["motive"].read_text().splitlines(keepends=True)
    stated = whole[0].split("Total Exported Frames,")
    if len(stated) < 2:
        whole[0] = whole[0].rstrip() + f",Total Exported Frames,{len(whole) - 7}\n"
    (tmp_path / "cut.csv").write_text("".join(whole[:-300]))
    commands = takes["motive"].with_suffix(".commands.csv")
    kinds = {i.kind: i.count for i in read_raw_take(tmp_path / "cut.csv", vehicle, commands).irregularities}
    assert kinds["frames missing"] >= 300
    assert "frames missing" not in {i.kind for i in read_raw_take(takes["motive"], vehicle, commands).irregularities}


TIME = np.arange(2000) / 100.0
YAW = 0.7 * TIME
XYZW = np.column_stack([np.zeros((2000, 2)), np.sin(0.5 * YAW), np.cos(0.5 * YAW)])


def judged(xyzw: np.ndarray) -> tuple[np.ndarray, dict[str, int]]:
    yaw, odd = checked_yaw(xyzw, "Z", TIME, Path("t.mcap"))
    return yaw, {i.kind: i.count for i in odd}


def test_good_quaternions_are_a_yaw() -> None:
    yaw, odd = judged(XYZW)
    np.testing.assert_allclose(np.unwrap(yaw), YAW, atol=1e-12)
    assert odd == {}
    flipped = XYZW * np.where(np.arange(2000) == 900, -1.0, 1.0)[:, None]
    yaw, odd = judged(flipped)
    np.testing.assert_allclose(np.unwrap(yaw), YAW, atol=1e-12)
    assert odd == {"quaternion sign": 2}


def test_lengths_are_mended_left_out_or_refused() -> None:
    yaw, odd = judged(1.0004 * XYZW)
    np.testing.assert_allclose(np.unwrap(yaw), YAW, atol=1e-12)
    assert odd == {"quaternion length": 2000}
    few = XYZW.copy()
    few[50:60] *= 1.3
    few[70] = 0.0
    yaw, odd = judged(few)
    assert odd == {"quaternion": 11}
    assert np.isnan(yaw[[50, 59, 70]]).all()
    assert np.isfinite(yaw).sum() == 1989
    few[100:140] *= 1.3
    with pytest.raises(InputRefused, match="not of unit length"):
        judged(few)


def test_w_first_is_refused() -> None:
    with pytest.raises(InputRefused, match="w first"):
        judged(np.roll(XYZW, 1, axis=1))


@pytest.mark.parametrize("leaning", [0.0, 0.3])
def test_a_car_off_its_wheels_is_left_out(leaning: float) -> None:
    """Even where the body was defined at an angle to the floor."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_quat(XYZW) * Rotation.from_euler("x", leaning)
    tipped = turns * Rotation.from_euler("x", np.where((TIME > 5.0) & (TIME < 6.0), 1.4, 0.0)[:, None])
    yaw, odd = judged(tipped.as_quat())
    rows = (TIME > 5.0) & (TIME < 6.0)
    assert odd.get("tipped over") == rows.sum()
    assert np.isnan(yaw[rows]).all()
    assert np.isfinite(yaw[~rows]).all()


def wobbling_car() -> tuple[np.ndarray, Any]:
    """Yaw of a car, and its attitude, Z up, while it rolls and pitches by a degree."""
    from scipy.spatial.transform import Rotation

    rng = np.random.default_rng(4)
    roll, pitch = 0.02 * np.array([np.sin(3.0 * TIME + p) for p in rng.uniform(0.0, 6.0, 2)])
    return YAW, Rotation.from_euler("ZYX", np.column_stack([YAW, pitch, roll]))


@pytest.mark.parametrize("up_axis", ["Y", "Z"])
@pytest.mark.parametrize(
    "mounted",
    [(0.0, 0.0, 0.0), (0.0, 0.0, 3.14), (0.0, 0.6, 0.0), (0.0, -1.2, 0.3), (0.0, 1.42, 0.0), (0.0, np.pi / 2, 0.0),
     (0.0, -np.pi / 2, 1.0), (0.5, 0.0, np.pi / 2)],
)  # fmt: skip
def test_the_yaw_is_that_of_a_level_direction_however_the_body_was_defined(
    mounted: tuple[float, float, float], up_axis: Literal["Y", "Z"]
) -> None:
    """Turned, leaning, upside down, on its side, or with X up: roll and pitch hardly enter the yaw."""
    from scipy.spatial.transform import Rotation

    yaw, car = wobbling_car()
    turns = car * Rotation.from_euler("ZYX", mounted)
    if up_axis == "Y":
        turns = Rotation.from_euler("x", -np.pi / 2) * turns
    seen, odd = checked_yaw(turns.as_quat(), up_axis, TIME, Path("t.mcap"))
    off = np.angle(np.exp(1j * (seen - yaw)))
    off = np.angle(np.exp(1j * (off - np.angle(np.exp(1j * off).mean()))))
    assert np.abs(off).max() < 2e-3
    x_is_up = abs(abs(mounted[1]) - np.pi / 2) < 0.1
    assert ("body axes" in {i.kind for i in odd}) == x_is_up


def test_rotations_about_another_axis_than_the_one_that_is_up_are_refused() -> None:
    with pytest.raises(InputRefused, match="turns about the Z axis"):
        checked_yaw(XYZW, "Y", TIME, Path("t.csv"))


def test_a_body_in_a_hand_is_read_as_it_is() -> None:
    """Exports of what is no car are read; nothing says which way up it is."""
    from scipy.spatial.transform import Rotation

    yaw, odd = judged(Rotation.random(2000, random_state=1).as_quat())
    assert "tipped over" not in odd
    assert np.isfinite(yaw).all()


def driven(raw: RawTake, least: int = 240) -> int:
    """The first row after 10 s from which the throttle is on for `least` rows."""
    row = np.searchsorted(raw.command_time_s, raw.pose_time_s, side="right") - 1
    on = raw.command[np.maximum(row, 0), 1] > 0.1
    return next(k for k in range(600, len(on)) if on[k : k + least].all())


@pytest.mark.parametrize("jump_in", [True, False])
def test_a_ghost_that_stands_while_the_car_is_driven_is_left_out(jump_in: bool, raw: RawTake, vehicle: Vehicle) -> None:
    """As in the DART lap whose body swaps to a static one; or held where it was, but for the noise, then a jump."""
    k = driven(raw)
    pose = raw.pose.copy()
    still = np.array([3.0, -2.0, 0.3]) if jump_in else pose[k]
    pose[k : k + 240] = still + 2e-4 * np.random.default_rng(1).standard_normal((240, 3))
    found = assemble_recording(replace(raw, pose=pose), vehicle)
    times = raw.pose_time_s[k + 10 : k + 240]
    assert not np.isin(times, found.poses.time_s).any()
    assert 230 <= told(found, "tracking") <= 270  # held, it also stands for a while before
    assert told(found, "pose jump") == (2 if jump_in else 1)
    assert found.breaks_s


def test_single_outliers_are_left_out_and_the_rest_kept(raw: RawTake, vehicle: Vehicle) -> None:
    pose = raw.pose.copy()
    pose[[300, 900, 901]] += [0.4, 0.2, 0.0]
    found, clean = assemble_recording(replace(raw, pose=pose), vehicle), assemble_recording(raw, vehicle)
    assert told(found, "tracking") == 3
    kept = np.isin(clean.poses.time_s, found.poses.time_s)
    assert (~kept).sum() == 3
    np.testing.assert_allclose(found.poses.values, clean.poses.values[kept], atol=1e-9)
    assert told(clean, "tracking") == 0
    assert told(clean, "pose jump") == 0


def test_two_bodies_in_turn_are_refused(raw: RawTake, vehicle: Vehicle) -> None:
    both = np.repeat(raw.pose, 2, axis=0)
    both[1::2, 0] += 0.1
    times = np.repeat(raw.pose_time_s, 2)
    times[1::2] += 0.008
    with pytest.raises(InputRefused, match="alternate"):
        assemble_recording(replace(raw, pose=both, pose_time_s=times), vehicle)


def test_two_sources_of_commands_in_turn_are_refused(raw: RawTake, vehicle: Vehicle) -> None:
    both = np.repeat(raw.command, 2, axis=0)
    both[1::2] = 0.0
    times = np.repeat(raw.command_time_s, 2)
    times[1::2] += 0.02
    with pytest.raises(InputRefused, match="alternate"):
        assemble_recording(replace(raw, command=both, command_time_s=times), vehicle)


def test_a_block_of_rows_that_comes_twice_is_read_once(raw: RawTake, vehicle: Vehicle) -> None:
    order = np.r_[: len(raw.pose), 400:460]
    found = assemble_recording(replace(raw, pose=raw.pose[order], pose_time_s=raw.pose_time_s[order]), vehicle)
    clean = assemble_recording(raw, vehicle)
    np.testing.assert_array_equal(found.poses.values, clean.poses.values)
    assert told(found, "pose duplicate") == told(clean, "pose duplicate") + 60


def floor(tilt: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, floor positions and heights of a car that keeps to a plane, seen with 1 mm noise."""
    rng = np.random.default_rng(3)
    t = np.arange(3000) / 100.0
    xy = np.column_stack([3.0 * np.sin(0.4 * t), 2.0 * np.cos(0.3 * t)])
    return t, xy, 0.3 + xy @ [tilt, -tilt] + 1e-3 * rng.standard_normal(len(t))


@pytest.mark.parametrize("tilt", [0.0, 0.02, 0.2])
def test_what_leaves_the_floor_is_seen_on_any_floor(tilt: float) -> None:
    t, xy, height = floor(tilt)
    up, odd = find_lifted_samples(xy, height, t)
    assert not up.any()
    assert odd == []
    height[1000:1500] += np.concatenate([np.linspace(0, 0.9, 100), np.full(300, 0.9), np.linspace(0.9, 0, 100)])
    up, odd = find_lifted_samples(xy, height, t)
    assert up[1010:1490].all()
    assert up.sum() < 500
    assert odd[0].count == up.sum()


def test_an_axis_that_is_not_up_is_refused() -> None:
    _, xy, height = floor()
    world = np.column_stack([xy[:, 0], height, -xy[:, 1]])  # Y up
    check_up_axis(world, "Y", Path("take.csv"))
    with pytest.raises(InputRefused, match='up_axis = "Y"'):
        check_up_axis(world, "Z", Path("take.csv"))
    line = np.column_stack([xy[:, 0], height, np.zeros(len(xy))])
    check_up_axis(line, "Y", Path("take.csv"))  # straight along X: which axis is up is not seen


def test_clocks_that_are_surely_apart_are_told(takes: dict[str, Path], vehicle: Vehicle) -> None:
    raw = read_raw_take(takes["motive"], vehicle)
    for late in (0.0, 0.08):
        found = assemble_recording(replace(raw, command_time_s=raw.command_time_s - late), vehicle)
        assert told(found, "clock offset") == (1 if late else 0)


def test_a_car_that_is_faster_than_its_motor_is_told(raw: RawTake, vehicle: Vehicle) -> None:
    assert told(assemble_recording(raw, vehicle), "scale") == 0
    assert told(assemble_recording(replace(raw, pose=raw.pose * [2.0, 2.0, 1.0]), vehicle), "scale") == 1
