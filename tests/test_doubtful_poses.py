"""What is no measurement is never fitted: held, flipped, tipped and doubled poses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bcid.errors import InputRefused
from bcid.recording.assemble import assemble
from bcid.recording.quaternions import judged_yaw
from bcid.recording.raw import RawTake
from bcid.recording.read import read_raw
from bcid.recording.types import Recording
from bcid.vehicle import Vehicle


@pytest.fixture(scope="module")
def raw(takes: dict[str, Path], vehicle: Vehicle) -> RawTake:
    return read_raw(takes["mcap"], vehicle)


def told(recording: Recording, kind: str) -> int:
    """How often an irregularity was counted."""
    return sum(i.count for i in recording.irregularities if i.kind == kind)


def test_a_pose_that_the_tracking_holds_is_left_out(raw: RawTake, vehicle: Vehicle) -> None:
    throttle = np.searchsorted(raw.command_time_s, raw.pose_time_s, side="right") - 1
    on = raw.command[throttle, 1] > 0.3
    first = next(k for k in range(1000, len(on)) if on[k : k + 60].all())
    pose = raw.pose.copy()
    pose[first : first + 60] = pose[first]
    found = assemble(replace(raw, pose=pose), vehicle)
    assert told(found, "frozen pose") == 59
    assert not np.isin(raw.pose_time_s[first + 1 : first + 60], found.poses.time_s).any()
    assert told(assemble(raw, vehicle), "frozen pose") == 0


def test_a_car_that_stands_is_not_frozen(raw: RawTake, vehicle: Vehicle) -> None:
    """To the last digit, as a simulator's log may say it, but with the throttle off."""
    pose, command = raw.pose.copy(), raw.command.copy()
    pose[:120] = pose[0]
    command[raw.command_time_s < raw.pose_time_s[125]] = 0.0
    found = assemble(replace(raw, pose=pose, command=command), vehicle)
    assert told(found, "frozen pose") == 0
    assert len(found.poses) == len(raw.pose)


def test_a_clock_that_is_set_back_is_refused_and_late_samples_are_not(raw: RawTake, vehicle: Vehicle) -> None:
    back = raw.pose_time_s.copy()
    back[1500:] -= 0.4
    with pytest.raises(InputRefused, match=r"steps back by 0\.3\d+ s .* times twice"):
        assemble(replace(raw, pose_time_s=back), vehicle)
    order = np.arange(len(raw.pose))
    order[[700, 703]] = order[[703, 700]]
    mixed = assemble(replace(raw, pose_time_s=raw.pose_time_s[order], pose=raw.pose[order]), vehicle)
    assert told(mixed, "pose order") > 0
    np.testing.assert_array_equal(mixed.poses.time_s, assemble(raw, vehicle).poses.time_s)


def test_a_yaw_turned_round_for_a_while_is_left_out(raw: RawTake, vehicle: Vehicle) -> None:
    pose = raw.pose.copy()
    pose[800:900, 2] += np.pi
    found = assemble(replace(raw, pose=pose), vehicle)
    assert told(found, "yaw flip") == 100
    good = assemble(raw, vehicle).poses
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
    found = assemble(take, vehicle)
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
        assemble(channels(raw, vehicle, **{name: made}), vehicle)
    assert error.value.place == name


def test_a_channel_of_something_else_is_told(raw: RawTake, vehicle: Vehicle) -> None:
    noise = np.random.default_rng(1).standard_normal(len(raw.pose_time_s))
    found = assemble(replace(raw, channels={"yaw_rate_radps": (raw.pose_time_s, noise)}), vehicle)
    assert told(found, "channel") == 1


def test_an_export_that_lacks_frames_is_told(takes: dict[str, Path], vehicle: Vehicle, tmp_path: Path) -> None:
    whole = takes["motive"].read_text().splitlines(keepends=True)
    stated = whole[0].split("Total Exported Frames,")
    if len(stated) < 2:
        whole[0] = whole[0].rstrip() + f",Total Exported Frames,{len(whole) - 7}\n"
    (tmp_path / "cut.csv").write_text("".join(whole[:-300]))
    commands = takes["motive"].with_suffix(".commands.csv")
    kinds = {i.kind: i.count for i in read_raw(tmp_path / "cut.csv", vehicle, commands).irregularities}
    assert kinds["frames missing"] >= 300
    assert "frames missing" not in {i.kind for i in read_raw(takes["motive"], vehicle, commands).irregularities}


TIME = np.arange(2000) / 100.0
YAW = 0.7 * TIME
XYZW = np.column_stack([np.zeros((2000, 2)), np.sin(0.5 * YAW), np.cos(0.5 * YAW)])


def judged(xyzw: np.ndarray) -> tuple[np.ndarray, dict[str, int]]:
    yaw, odd = judged_yaw(xyzw, "Z", TIME, Path("t.mcap"))
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


def test_a_body_in_a_hand_is_read_as_it_is() -> None:
    """Exports of what is no car are read; nothing says which way up it is."""
    from scipy.spatial.transform import Rotation

    yaw, odd = judged(Rotation.random(2000, random_state=1).as_quat())
    assert "tipped over" not in odd
    assert np.isfinite(yaw).all()
