"""Real logs that nobody here made, through ingest and estimate with vehicle files of their own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bcid.errors import InputRefused
from bcid.estimate.run import estimate_motion
from bcid.estimate.tune import tune_estimator
from bcid.recording.formats.csv_text import read_csv_text
from bcid.recording.formats.motive import read_motive_poses
from bcid.recording.formats.motive_header import read_motive_header
from bcid.recording.read import read_recording
from bcid.vehicle import Vehicle, read_vehicle

VEHICLES = {
    "dart": Path(__file__).parents[1] / "pipelines" / "dart" / "vehicle.toml",
    "f1tenth": Path(__file__).parents[1] / "pipelines" / "f1tenth" / "vehicle.toml",
}

DRIVES = {
    "dart mcap": ("dart", "mcap/derived_from_real/dart_0916_100101_json.mcap", 68.0),
    "dart csv": (
        "dart", "dart/82_huge_datest_for_gp_fitting/car_1_Datarecording_09_16_2024_10_01_01.csv", 68.0,
    ),
    "dart csv, other take": (
        "dart", "dart/82_huge_datest_for_gp_fitting/car_1_Datarecording_09_25_2024_09_50_18.csv", 130.0,
    ),
    "f1tenth csv": ("f1tenth", "f1tenth_ini/physical/2025-10-10_04-59-59_sysid_const_steer.csv", 24.0),
}  # fmt: skip


@pytest.mark.parametrize("name", list(DRIVES))
def test_a_real_drive_is_ingested_and_estimated(name: str, recordings_folder: Path) -> None:
    vehicle_name, path, seconds = DRIVES[name]
    vehicle = read_vehicle(VEHICLES[vehicle_name])
    recording = read_recording(recordings_folder / path, vehicle)
    assert recording.duration_s == pytest.approx(seconds, rel=0.1)
    tuning = tune_estimator([recording], vehicle, 0.1, 0.3, {})
    estimate = estimate_motion(recording, vehicle, tuning)
    assert np.isfinite(estimate.twist).all()
    assert 0.5 < estimate.filter.nis.mean_per_dof < 2.0
    # the twist, turned into the world, is what the poses do: measured by the poses' own differences
    yaw, twist = estimate.pose[:, 2], estimate.twist
    speed = np.hypot(twist[:, 0], twist[:, 1])
    step = np.hypot(*np.diff(estimate.pose[:, :2], axis=0).T) / 0.1
    together = np.diff(estimate.segment) == 0
    middle = 0.5 * (speed[1:] + speed[:-1])
    assert np.median(np.abs(step - middle)[together]) < max(0.05, 0.1 * np.median(speed))
    turned = np.diff(yaw)[together] / 0.1
    assert np.median(np.abs(turned - (0.5 * (twist[1:, 2] + twist[:-1, 2]))[together])) < 0.1


def test_mcap_and_csv_of_the_same_drive_agree(recordings_folder: Path) -> None:
    vehicle = read_vehicle(VEHICLES["dart"])
    one, other = (read_recording(recordings_folder / DRIVES[n][1], vehicle) for n in ("dart mcap", "dart csv"))
    t = np.linspace(5.0, 60.0, 500)
    for channel in range(3):
        a, b = (np.interp(t, r.poses.time_s, r.poses.values[:, channel]) for r in (one, other))
        np.testing.assert_allclose(a, b, atol=2e-3)


def test_the_pose_jump_of_the_f1tenth_log_is_found(recordings_folder: Path) -> None:
    """4.43 m between two poses (notes on the recordings)."""
    vehicle = read_vehicle(VEHICLES["f1tenth"])
    recording = read_recording(recordings_folder / DRIVES["f1tenth csv"][1], vehicle)
    jumps = [i for i in recording.irregularities if i.kind == "pose jump"]
    assert any("4.4" in i.detail for i in jumps)
    assert len(recording.breaks_s) == len(jumps)


MOTIVE = {
    "v1.22_euler_two_bodies_markers_60of240Hz__rigid-body-motion.csv": ("RigidBody 01", "mm", 227, 60.0),
    "v1.23_quat_metres_single_body__kronium.csv": ("drone", None, 11539, 120.0),
    "v1.24_quat_2bodies_markers_240Hz__kronium.csv": ("shimonsWall", None, 435, 240.0),
}


@pytest.mark.parametrize("name", list(MOTIVE))
def test_real_motive_exports_parse(name: str, recordings_folder: Path, vehicle: Vehicle) -> None:
    body, unit, frames, rate = MOTIVE[name]
    mocap = vehicle.mocap.model_copy(update={"rigid_body": body, "length_unit": unit})
    path = recordings_folder / "motive_csv" / name
    raw = read_motive_poses(path, vehicle.model_copy(update={"mocap": mocap}))
    assert len(raw.pose) == frames
    assert raw.rate_hz == rate
    blank = ~np.isfinite(raw.pose).all(axis=1)
    if "1.23" in name:  # a drone: what flies is told as lifted, beside the 149 dropouts
        lines = path.read_text(encoding="utf-8-sig").splitlines()[-frames:]
        lost = np.array([",," in line for line in lines])
        assert int((np.diff(lost.astype(int)) == 1).sum()) == 149
        assert blank[lost].all()
        assert "lifted" in {i.kind for i in raw.irregularities}
    else:
        assert not blank.any()
    assert np.abs(raw.pose[~blank, :2]).max() < 20.0


def test_an_export_without_assets_is_refused(recordings_folder: Path, vehicle: Vehicle) -> None:
    with pytest.raises(InputRefused, match="no rigid body"):
        read_motive_poses(recordings_folder / "motive_csv" / "v1.23_no_assets__ha5dzs.csv", vehicle)


def test_the_bodies_of_an_export_are_listed(recordings_folder: Path, vehicle: Vehicle) -> None:
    path = recordings_folder / "motive_csv" / "v1.24_quat_2bodies_markers_240Hz__kronium.csv"
    assert read_motive_header(read_csv_text(path)).rigid_body_names() == ["shimonsWall", "wall_2"]
    with pytest.raises(InputRefused, match="shimonsWall, wall_2"):
        read_motive_poses(path, vehicle)


def test_a_log_without_commands_is_refused(recordings_folder: Path, vehicle: Vehicle) -> None:
    data = vehicle.model_dump(by_alias=True) | {"topics": {"pose": "/odom", "command": "/cmd_vel"}}
    with pytest.raises(InputRefused, match=r"topic /cmd_vel.*not in the file"):
        read_recording(
            recordings_folder / "mcap" / "third_party" / "evo_nav2_turtlebot.mcap", Vehicle.model_validate(data)
        )
