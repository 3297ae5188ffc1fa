"""Commands against the motion, clock and servo, on drives of five vehicles (tests/fleet.py, tests/spoiled.py)."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fleet import KINDS, Drive, draw_drive, shifted, turned_around, with_commands
from measure_checks import LIVELY, RESULTS, is_clean
from spoiled import SPOILED, another_take, name_first_cause
from typer.testing import CliRunner

from bcid.cli.app import app
from bcid.errors import InputRefused
from bcid.estimate.steering import identify_steering
from bcid.estimate.tuning import Noise as EstimatorNoise
from bcid.estimate.tuning import SteeringOrigin, Tuning
from bcid.pipeline.config import PipelineConfig
from bcid.pipeline.run import Pipeline
from bcid.recording.assemble import assemble_recording
from bcid.recording.checks.agreement import Feature, scan_lags
from bcid.recording.checks.health import assess_health
from bcid.recording.checks.raw_motion import moves_backward
from bcid.recording.checks.single_track import servo_angles
from bcid.recording.formats.raw import RawTake
from bcid.recording.neighbours import name_fitting_commands
from bcid.recording.read import read_recording
from bcid.vehicle import Vehicle, read_vehicle

VEHICLE = """\
name = "rc"
[body]
cog_to_front_m = 0.16
cog_to_rear_m = 0.15
drive = "rear"
[steering]
max_angle_rad = 0.45
max_rate_radps = 6.0
time_constant_s = 0.06
[columns]
time_s = "t"
x_m = "px"
y_m = "py"
yaw_rad = "psi"
steering_rad = "steer"
throttle_mps = "gas"
"""


@pytest.mark.parametrize("seed", range(20))
def test_a_clean_drive_is_a_go_without_a_warning(seed: int) -> None:
    """Five vehicles by four drivers, every other one with a vehicle file of four lines."""
    assert is_clean(draw_drive(seed), seed % 2 == 1) is None


@pytest.mark.parametrize("kind", ["rc", "f1tenth"])
def test_a_car_that_reverses_is_a_go(kind: str) -> None:
    drive = draw_drive(71, turned_around(KINDS[kind]), "targets", 60.0)
    assert drive.raw.command[:, 1].min() < -0.5
    assert is_clean(drive, False) is None


@pytest.mark.parametrize("name", list(SPOILED))
@pytest.mark.parametrize("seed", [3, 4])
def test_what_cannot_be_used_is_a_no_go_with_the_cause_first(name: str, seed: int) -> None:
    way = SPOILED[name]
    kinds = way.kinds or tuple(KINDS)
    drive = draw_drive(seed, kinds[seed % len(kinds)], LIVELY[seed % 3], 60.0)
    said = name_first_cause(way.make(drive, np.random.default_rng(seed)), drive, **way.vehicle(drive))
    assert said is not None
    assert re.search(way.cause, said), said


@pytest.mark.parametrize(("kind", "seed"), [("bumper", 60_020), ("f1tenth", 60_008), ("tricycle", 60_014)])
def test_in_laps_a_change_of_sign_is_not_half_a_lap_s_delay(kind: str, seed: int) -> None:
    drive, way = draw_drive(seed, kind, "laps"), SPOILED["steering's sign changes"]
    said = name_first_cause(way.make(drive, np.random.default_rng(seed)), drive)
    assert said is not None
    assert re.search(way.cause, said)


def test_a_late_wave_is_no_mirrored_axis() -> None:
    drive = draw_drive(61_055, "bumper", "waves")
    clock = assemble_recording(shifted(drive.raw, -4.375), drive.kind.vehicle(True)).clock
    assert clock.offset_ci95 is not None
    assert clock.offset_ci95[0] < 4.375 < clock.offset_ci95[1]


@pytest.mark.parametrize("late_s", [-4.2, -0.4, 0.3, 2.5])
@pytest.mark.parametrize(("kind", "minimal"), [("rc", False), ("bumper", False), ("tricycle", True)])
def test_a_clock_offset_of_seconds_is_found(late_s: float, kind: str, minimal: bool) -> None:
    drive = draw_drive(8, kind, "targets", 60.0)
    clock = assemble_recording(shifted(drive.raw, late_s), drive.kind.vehicle(minimal)).clock
    assert clock.offset_ci95 is not None
    assert clock.offset_ci95[0] < -late_s < clock.offset_ci95[1]
    assert clock.offset_ci95[1] - clock.offset_ci95[0] < 0.35


def test_offsets_are_told_without_double_negatives() -> None:
    drive = draw_drive(9, "rc", "targets", 60.0)
    for late_s, words in ((0.08, "ms late"), (-0.08, "ms early"), (2.0, "s late")):
        recording = assemble_recording(shifted(drive.raw, late_s), drive.kind.vehicle())
        (text,) = (i.detail for i in recording.irregularities if i.kind == "clock offset")
        assert words in text
        assert "-" not in text.partition(",")[0]


def test_a_stated_offset_of_the_wrong_sign_is_told() -> None:
    drive = draw_drive(10, "rc", "targets", 60.0)
    raw = shifted(drive.raw, 0.1)
    recording = assemble_recording(raw, drive.kind.vehicle(clock={"offset_s": 0.1}))
    (text,) = (i.detail for i in recording.irregularities if i.kind == "clock offset")
    assert "sign of offset_s is likely wrong" in text
    assert re.search(r"\[clock\] offset_s = -0\.(09|10)", text)


def test_the_servo_of_a_small_car_is_found_with_its_error() -> None:
    """Fixed windows of a larger car's size gave 0.15 s and 2.5 rad/s."""
    for seed in range(4):
        drive = draw_drive(40 + seed, "rc", "targets", 60.0)
        vehicle = drive.kind.vehicle(minimal=True)
        T_s, d, origin = identify_steering([assemble_recording(drive.raw, vehicle)], vehicle)
        assert (origin.T_s, origin.d, origin.rate_reached) == ("identified", "identified", True)
        assert T_s == pytest.approx(0.06, rel=0.1)
        assert d == pytest.approx(6.0, rel=0.1)
        assert origin.T_s_ci95 is not None
        assert origin.T_s_ci95[1] - origin.T_s_ci95[0] < 0.02
        tuning = Tuning(noise=EstimatorNoise(), T_s=T_s, d=d, steering=origin)
        assert "95 %" in tuning.describe_steering()[0][1]


def test_a_rate_limit_that_is_never_reached_is_not_identified() -> None:
    drive = draw_drive(41, "rc", "waves", 60.0)
    vehicle = drive.kind.vehicle(minimal=True)
    T_s, d, origin = identify_steering([assemble_recording(drive.raw, vehicle)], vehicle)
    assert (origin.T_s, origin.d, origin.rate_reached, origin.d_ci95) == ("identified", "default", False, None)
    assert T_s == pytest.approx(0.06, rel=0.15)
    told = Tuning(noise=EstimatorNoise(), T_s=T_s, d=d, steering=origin).describe_steering()
    assert ("steering", "never driven to its rate limit, which is not identified") in told


def test_nothing_is_identified_where_nothing_turns() -> None:
    drive = draw_drive(42, "rc", "targets", 60.0)
    vehicle = drive.kind.vehicle(minimal=True)
    still = with_commands(drive.raw, lambda t, u: u * [0.0, 1.0])
    _, _, origin = identify_steering([assemble_recording(still, vehicle)], vehicle)
    assert origin == SteeringOrigin(T_s="default", d="default")


def hints(drive: Drive, **changes: object) -> list[str]:
    """What is said of a drive's vehicle file with `changes`."""
    recording = assemble_recording(drive.raw, drive.kind.vehicle(**changes))
    return [i.detail for i in recording.irregularities if i.kind in ("vehicle file", "scale")]


def test_a_wrong_word_in_a_vehicle_file_gets_a_hint() -> None:
    drive = draw_drive(20, "bumper", "targets", 60.0)
    assert hints(drive) == []
    assert "exchanged" in hints(drive, body={"cog_to_front_m": 0.33, "cog_to_rear_m": 0.54})[0]
    assert "wheelbase" in hints(drive, body={"cog_to_front_m": 1.08, "cog_to_rear_m": 0.66})[-1]
    assert "marker_offset_m" in hints(drive, mocap={"marker_offset_m": (0.3, 0.1)})[0]
    assert "front axle" in hints(drive, body={"drive": "rear"})[0]
    assert "reference_speed_mps" in hints(drive, motor={"reference_speed_mps": 1.0})[0]


def test_advice_on_the_yaw_offset_adds_to_the_stated_one() -> None:
    drive = draw_drive(21, "bumper", "targets", 90.0)
    turned = replace(drive.raw, pose=np.add(drive.raw.pose, [0.0, 0.0, 0.3]))
    recording = assemble_recording(turned, drive.kind.vehicle(mocap={"yaw_offset_rad": 0.2}))
    (text,) = (i.detail for i in recording.irregularities if i.kind == "yaw offset")
    found = re.search(r"yaw_offset_rad = (-?[\d.]+)", text)
    assert found
    assert float(found[1]) == pytest.approx(0.3, abs=0.03)


def table(raw: RawTake, path: Path) -> Path:
    """A take as a table of poses with the commands that hold."""
    rows = np.maximum(np.searchsorted(raw.command_time_s, raw.pose_time_s, side="right") - 1, 0)
    seen = np.isfinite(raw.pose[:, 0])
    columns = np.column_stack([raw.pose_time_s, raw.pose, raw.command[rows]])[seen]
    np.savetxt(path, columns, delimiter=",", header="t,px,py,psi,steer,gas", comments="", fmt="%.6f")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two takes, of which `mixed.csv` holds the poses of one and the commands of the other, and a vehicle file."""
    place = tmp_path_factory.mktemp("takes")
    (place / "rc.toml").write_text(VEHICLE)
    drive = draw_drive(30, "rc", "targets", 60.0, pose_hz=100.0)
    table(drive.raw, place / "right.csv")
    table(another_take(drive, np.random.default_rng(1)), place / "mixed.csv")
    table(draw_drive(31, "rc", "targets", 60.0).raw, place / "third.csv")
    return place


def test_the_file_whose_commands_fit_is_named(folder: Path) -> None:
    vehicle, path = read_vehicle(folder / "rc.toml"), folder / "mixed.csv"
    recording = name_fitting_commands(path, read_recording(path, vehicle), vehicle)
    said = assess_health(recording, vehicle)
    assert not said.go
    assert "another take's" in said.sentence
    assert "right.csv" in said.sentence
    assert "third.csv" not in said.sentence
    right = read_recording(folder / "right.csv", vehicle)
    assert name_fitting_commands(folder / "right.csv", right, vehicle) == right


def test_fit_and_diagnose_refuse_what_the_check_calls_a_no_go(folder: Path, tmp_path: Path) -> None:
    words = [str(folder / "mixed.csv"), "--vehicle", str(folder / "rc.toml"), "--out", str(tmp_path)]
    for command in (["fit", "-m", "newton-euler"], ["diagnose"], ["ingest", "--check"]):
        without_out = words[:3] if "--check" in command else words
        ended = CliRunner().invoke(app, [*command, *without_out])
        assert isinstance(ended.exception, InputRefused), command
        assert ended.exception.exit_code == 4
    config = PipelineConfig(
        source="x", vehicle=folder / "rc.toml", training=[folder / "mixed.csv"], workspace=tmp_path
    )  # fmt: skip
    with pytest.raises(InputRefused, match=r"another take's[\s\S]*right.csv[\s\S]*--ignore-health"):
        Pipeline(config).refuse_unusable(config.training)
    Pipeline(config.model_copy(update={"ignore_health": True})).refuse_unusable(config.training)


def test_a_scan_over_lags_is_a_regression_at_each() -> None:
    rng = np.random.default_rng(0)
    f, g, y = rng.standard_normal((3, 300))
    use, known = np.ones(300, dtype=bool), np.ones(300, dtype=bool)
    use[:20] = known[250:] = False
    scan = scan_lags(y, use, [Feature(f, None), Feature(f, g)], known)
    for lag in (-40, 0, 31):
        rows = np.array([t for t in range(300) if use[t] and 0 <= t - lag < 300 and known[t - lag]])
        X = np.column_stack([f[rows], f[rows] * g[rows - lag]])
        base = y[rows] - X[:, :1] @ np.linalg.lstsq(X[:, :1], y[rows], rcond=None)[0]
        left = y[rows] - X @ np.linalg.lstsq(X, y[rows], rcond=None)[0]
        share = scan.share[scan.lags == lag][0]
        assert share == pytest.approx(1.0 - (left @ left) / (base @ base), abs=1e-6)


def test_a_servo_moves_between_commands_of_any_time() -> None:
    command_s, u_s = np.array([0.0, 0.137, 0.5]), np.array([0.0, 0.4, -0.4])
    coarse, fine = np.arange(0.0, 1.0, 0.1), np.arange(0.0, 1.0, 0.001)
    a, b = (servo_angles(command_s, u_s, t, 0.06, 6.0, 0.02) for t in (coarse, fine))
    np.testing.assert_allclose(a, np.interp(coarse, fine, b), atol=1e-9)


def test_forward_is_the_side_of_the_body_s_axis_or_of_most_motion() -> None:
    way = np.r_[np.full(60, 0.1), np.full(40, np.pi + 0.1)]
    assert moves_backward(way, np.ones(100)).mean() == 0.4
    assert moves_backward(way + 1.5, np.ones(100)).mean() == 0.4
    assert moves_backward(np.full(9, np.pi), np.ones(9)).all()


def test_real_drives_are_go(recordings_folder: Path) -> None:
    vehicles = {
        name: read_vehicle(Path(__file__).parents[1] / "pipelines" / name / "vehicle.toml")
        for name in ("dart", "f1tenth")
    }
    for name, pattern in (("dart", "dart/*/*.csv"), ("f1tenth", "f1tenth_ini/physical/*.csv")):
        for path in sorted(recordings_folder.glob(pattern)):
            recording = read_recording(path, vehicles[name])
            assert [i.detail for i in recording.irregularities if i.action == "no-go"] == [], path.name


def test_the_committed_figures_support_the_limits() -> None:
    """`python tests/measure_checks.py` renews them."""
    figures = json.loads(RESULTS.read_text(encoding="utf-8"))
    assert figures["clean"]["go_without_a_warning"] == figures["clean"]["drives"] >= 100
    assert all(f["right_cause"] >= 0.9 * f["takes"] for f in figures["spoiled"].values())
    assert len(figures["spoiled"]) >= 20
    assert figures["clocks"]["exact_called_off"] == 0
    assert figures["clocks"]["inside_95"] >= 0.9 * figures["clocks"]["told"]
    assert figures["servo"]["T_s_inside_95"] >= 0.9 * figures["servo"]["takes"]
    assert figures["servo"]["d_inside_95"] >= 0.9 * figures["servo"]["d_identified"]


def test_a_vehicle_of_the_fleet_is_read_as_written() -> None:
    assert isinstance(KINDS["rc"].vehicle(), Vehicle)
