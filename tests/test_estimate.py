"""The EKF: its linearisation, its two engines, and its honesty on simulated takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bcid.errors import InputRefused
from bcid.estimate import blockwise, kernel, reference
from bcid.estimate.consistency import Truth
from bcid.estimate.events import build_chassis, build_timeline, hold_commands
from bcid.estimate.process import DELTA, N_STATE, THETA, Chassis, F, H, f, h
from bcid.estimate.run import check_against_truth, estimate_motion
from bcid.estimate.saving import load_estimate, save_estimate
from bcid.estimate.steering import identify_steering
from bcid.estimate.tune import identify_noise, tune_estimator
from bcid.estimate.tuning import Noise, Tuning
from bcid.recording.types import Recording, Stream
from bcid.vehicle import Vehicle
from bcid.virtual_lab import TUNING

CHASSIS = Chassis(0.54, 0.33, 0.155, 1.418, True)


def random_states(n: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    x = rng.normal(0.0, 0.4, (n, N_STATE))
    x[:, 3] = rng.uniform(0.05, 2.0, n)
    x[:, DELTA] = rng.uniform(-2.0, 2.0, n)
    return x


@pytest.mark.parametrize("driven", [True, False])
def test_jacobians_agree_with_differences(driven: bool) -> None:
    chassis = CHASSIS._replace(front_driven=driven)
    for x in random_states(20):
        for function, jacobian in (
            (lambda z: f(z, 0.5, chassis), F(x, 0.5, chassis)),
            (lambda z: h(z, chassis), H(x, chassis)),
        ):
            step = 1e-6
            numeric = np.column_stack(
                [(function(x + step * e) - function(x - step * e)) / (2 * step) for e in np.eye(N_STATE)]
            )
            np.testing.assert_allclose(jacobian, numeric, atol=2e-6)


def test_both_engines_agree(recording: Recording, vehicle: Vehicle, tuning: Tuning) -> None:
    """Compiled kernel and filterpy, filter and smoother, through gaps and a restart."""
    broken = replace(recording, breaks_s=(float(recording.poses.time_s[500]),))
    events = build_timeline(broken, vehicle, 0.1, 0.3, 0.155, 1.418).events
    cut = kernel.Events(*(a[:1200] for a in events[:5]), events.P_0)
    Q, R = tuning.noise.Q(), tuning.noise.R()
    compiled, plain = kernel.run_filter(cut, CHASSIS, Q, R), reference.run_filter(cut, CHASSIS, Q, R)
    np.testing.assert_allclose(compiled.x, plain.x, atol=1e-9)
    np.testing.assert_allclose(compiled.P, plain.P, atol=1e-9)
    np.testing.assert_allclose(compiled.nis, plain.nis, rtol=1e-6, atol=1e-6)
    assert compiled.log_likelihood == pytest.approx(plain.log_likelihood, rel=1e-9)
    for ours, theirs in zip(
        kernel.run_smoother(compiled, cut.restart), reference.run_smoother(plain, cut.restart), strict=True
    ):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)


def test_engines_agree_with_further_channels(recording: Recording, vehicle: Vehicle, tuning: Tuning) -> None:
    rng = np.random.default_rng(1)
    t = np.arange(0.013, 20.0, 0.05)
    channels = {
        "measured_steering_rad": Stream(t, 0.1 * rng.standard_normal((len(t), 1))),
        "yaw_rate_radps": Stream(t, 0.3 * rng.standard_normal((len(t), 1))),
        "wheel_speed_mps": Stream(t, np.abs(rng.standard_normal((len(t), 1)))),
    }
    events = build_timeline(replace(recording, channels=channels), vehicle, 0.1, 0.3, 0.155, 1.418).events
    cut = kernel.Events(*(a[:500] for a in events[:5]), events.P_0)
    assert (np.isfinite(cut.z).sum(axis=0) > 50).all()
    Q, R = tuning.noise.Q(), tuning.noise.R()
    compiled, plain = kernel.run_filter(cut, CHASSIS, Q, R), reference.run_filter(cut, CHASSIS, Q, R)
    np.testing.assert_allclose(compiled.x, plain.x, atol=1e-8)
    np.testing.assert_allclose(compiled.dof, plain.dof)


def test_a_measured_steering_angle_is_used(recording: Recording, vehicle: Vehicle, tuning: Tuning) -> None:
    t = np.arange(0.0, 59.0, 0.05)
    lying = replace(recording, channels={"measured_steering_rad": Stream(t, np.full((len(t), 1), 0.7))})
    precise = tuning.model_copy(update={"noise": tuning.noise.model_copy(update={"r_steering": 1e-4})})
    delta = estimate_motion(lying, vehicle, precise).kinematic[50:500, 3]
    assert np.median(np.abs(delta - 0.7)) < 0.05


def test_velocities_match_the_truth(recording: Recording, vehicle: Vehicle, tuning: Tuning, truth: Truth) -> None:
    """RMSE far below the motion's own size, NIS near its band, NEES of the filter about what its covariance says."""
    check = check_against_truth(recording, vehicle, tuning, 0.1, 0.3, truth)
    rmse = check.rmse.model_dump()
    assert max(rmse[n] for n in ("v_x", "v_y", "v_f")) < 0.015
    assert rmse["yaw_rate"] < 0.02
    assert max(rmse[n] for n in ("alpha_f", "alpha_r")) < 0.015
    estimate = estimate_motion(recording, vehicle, tuning)
    assert estimate.filter is not None
    assert 0.9 < estimate.filter.nis.mean_per_dof < 1.1
    # 3 when honest; white noise that has to cover transients is cautious between them
    assert 1.0 < check.nees_filter.mean < 3.5
    assert 0.5 < check.nees_smoother.mean < 3.0
    overconfident = tuning.model_copy(
        update={"noise": tuning.noise.model_copy(update={"q_v_f": 0.02, "q_beta_f": 0.02})}
    )
    assert check_against_truth(recording, vehicle, overconfident, 0.1, 0.3, truth).nees_filter.mean > 10.0


def test_truth_is_joined_by_time(recording: Recording, vehicle: Vehicle, tuning: Tuning, truth: Truth) -> None:
    at_10_hz, at_20_hz = (check_against_truth(recording, vehicle, tuning, p, 0.3, truth) for p in (0.1, 0.05))
    assert at_20_hz.rmse.v_x == pytest.approx(at_10_hz.rmse.v_x, rel=1e-3)
    with pytest.raises(InputRefused, match="grid time"):
        check_against_truth(recording, vehicle, tuning, 0.1, 0.3, truth._replace(time_s=truth.time_s + 0.03))


def test_the_smoother_beats_the_filter(recording: Recording, vehicle: Vehicle, tuning: Tuning, truth: Truth) -> None:
    line = build_timeline(recording, vehicle, 0.1, 0.3, 0.155, 1.418)
    chassis = build_chassis(vehicle, tuning.T_s, tuning.d)
    filtered = kernel.run_filter(line.events, chassis, tuning.noise.Q(), tuning.noise.R())
    smoothed, _ = kernel.run_smoother(filtered, line.events.restart)
    rows = np.rint(line.events.time_s[line.grid] / 0.1).astype(int)
    v_f = truth.kinematic[rows, 0]
    error = [float(np.sqrt(np.mean((x[line.grid, 3] - v_f) ** 2))) for x in (filtered.x, smoothed)]
    assert error[1] < 0.8 * error[0]


def test_the_smoothed_heading_moves_the_pose(recording: Recording, vehicle: Vehicle, tuning: Tuning) -> None:
    """Errata 4 and 5: the estimated twist, turned into the world, is the smoothed pose's derivative."""
    e = estimate_motion(recording, vehicle, tuning)
    yaw = e.pose[:, 2]
    world = np.column_stack(
        [
            np.cos(yaw) * e.twist[:, 0] - np.sin(yaw) * e.twist[:, 1],
            np.sin(yaw) * e.twist[:, 0] + np.cos(yaw) * e.twist[:, 1],
        ]
    )
    inside = (np.diff(e.segment) == 0)[1:] & (np.diff(e.segment) == 0)[:-1]
    numeric = (e.pose[2:, :2] - e.pose[:-2, :2]) / 0.2
    assert np.sqrt(np.mean((numeric - world[1:-1])[inside] ** 2)) < 0.02


def test_gaps_are_predicted_through_and_end_segments(recording: Recording, vehicle: Vehicle, tuning: Tuning) -> None:
    keep = (recording.poses.time_s < 20.0) | (recording.poses.time_s > 21.0)
    holed = replace(recording, poses=Stream(recording.poses.time_s[keep], recording.poses.values[keep]))
    whole, cut = (estimate_motion(r, vehicle, tuning) for r in (recording, holed))
    assert not ((cut.time_s > 20.05) & (cut.time_s < 20.95)).any()
    assert len(cut.segments()) == len(whole.segments()) + 1
    late = cut.time_s > 22.0
    np.testing.assert_allclose(cut.twist[late], whole.twist[np.isin(whole.time_s, cut.time_s[late])], atol=0.02)


def test_a_jump_restarts_the_filter(recording: Recording, vehicle: Vehicle, tuning: Tuning) -> None:
    moved = recording.poses.values.copy()
    later = recording.poses.time_s >= 30.0
    moved[later, :2] += [3.0, -4.0]
    jumped = replace(recording, poses=Stream(recording.poses.time_s, moved), breaks_s=(30.0,))
    whole, cut = (estimate_motion(r, vehicle, tuning) for r in (recording, jumped))
    assert len(cut.segments()) == len(whole.segments()) + 1
    shared = np.isin(whole.time_s, cut.time_s) & (np.abs(whole.time_s - 30.0) > 1.0)
    np.testing.assert_allclose(cut.twist[np.abs(cut.time_s - 30.0) > 1.0], whole.twist[shared], atol=0.02)


def test_yaw_may_wind_up(recording: Recording, vehicle: Vehicle, tuning: Tuning) -> None:
    wound = recording.poses.values + np.array([0.0, 0.0, 20.0 * np.pi])
    again = replace(recording, poses=Stream(recording.poses.time_s, wound))
    one, other = (estimate_motion(r, vehicle, tuning) for r in (recording, again))
    np.testing.assert_allclose(one.twist, other.twist, atol=1e-7)


def test_a_command_is_held_and_grows_old() -> None:
    commands = Stream(np.array([0.0, 1.0]), np.array([[0.1, 1.0], [0.2, 2.0]]))
    values, age = hold_commands(commands, np.array([-0.5, 0.0, 0.99, 1.0, 3.0]))
    np.testing.assert_array_equal(values[:, 0], [0.1, 0.1, 0.1, 0.2, 0.2])
    np.testing.assert_allclose(age, [np.inf, 0.0, 0.99, 0.0, 2.0])


def test_noise_is_found_by_likelihood(recording: Recording, vehicle: Vehicle) -> None:
    """The simulated motion capture has 0.5 mm and 1 mrad."""
    events = build_timeline(recording, vehicle, 0.1, 0.3, 0.155, 1.418).events
    noise, edge = identify_noise([events], CHASSIS, Noise(), [])
    assert edge == []
    assert noise.r_position == pytest.approx(5e-4, rel=0.1)
    assert noise.r_yaw == pytest.approx(1e-3, rel=0.1)
    assert identify_noise([events], CHASSIS, Noise(), list(Noise.model_fields)) == (Noise(), [])


def test_steering_constants_are_identified_where_absent(recording: Recording, vehicle: Vehicle) -> None:
    steering = vehicle.steering.model_copy(update={"time_constant_s": None, "max_rate_radps": None})
    tuning = tune_estimator([recording], vehicle.model_copy(update={"steering": steering}), 0.1, 0.3, {})
    assert tuning.steering.T_s == tuning.steering.d == "identified"
    assert tuning.steering.rate_reached
    assert tuning.d == pytest.approx(1.418, rel=0.1)
    assert tuning.T_s == pytest.approx(0.155, abs=0.05)


def test_what_the_vehicle_file_gives_is_not_identified(recording: Recording, vehicle: Vehicle) -> None:
    assert identify_steering([recording], vehicle)[:2] == pytest.approx((0.155, 1.418))


def test_an_estimate_survives_the_disk(recording: Recording, vehicle: Vehicle, tuning: Tuning, tmp_path: Path) -> None:
    e = estimate_motion(recording, vehicle, tuning)
    save_estimate(e, tmp_path)
    again = load_estimate(tmp_path)
    for name in ("time_s", "segment", "pose", "twist", "kinematic", "command", "twist_sd", "kinematic_sd"):
        np.testing.assert_array_equal(getattr(e, name), getattr(again, name))
    assert again.filter == e.filter
    assert again.tuning == e.tuning == tuning


def test_the_heading_of_a_long_gap_stays_finite(vehicle: Vehicle, tuning: Tuning, recording: Recording) -> None:
    """Half a minute without a pose: the prediction must not run away."""
    keep = (recording.poses.time_s < 10.0) | (recording.poses.time_s > 40.0)
    holed = replace(recording, poses=Stream(recording.poses.time_s[keep], recording.poses.values[keep]))
    e = estimate_motion(holed, vehicle, tuning)
    assert np.isfinite(e.twist).all()
    assert np.abs(e.pose[:, :2]).max() < 20.0
    assert THETA == 2


def test_noise_is_found_where_the_car_moves(recording: Recording, vehicle: Vehicle) -> None:
    """A minute of standstill before the drive must not teach the filter that nothing ever moves."""
    t, pose = recording.poses.time_s, recording.poses.values
    rng = np.random.default_rng(0)
    still = np.arange(0.0, 60.0, 1.0 / 60.0)
    rest = pose[0] + rng.standard_normal((len(still), 3)) * [5e-4, 5e-4, 1e-3]
    waited = replace(
        recording,
        poses=Stream(np.r_[still, t + 60.0], np.vstack([rest, pose])),
        commands=Stream(
            np.r_[still[::3], recording.commands.time_s + 60.0],
            np.vstack([np.zeros((len(still[::3]), 2)), recording.commands.values]),
        ),
    )
    events = [build_timeline(r, vehicle, 0.1, 0.3, 0.155, 1.418).events for r in (recording, waited)]
    alone, after = (identify_noise([e], CHASSIS, Noise(), [])[0] for e in events)
    assert after.q_v_f == pytest.approx(alone.q_v_f, rel=0.3)
    assert after.q_beta_f == pytest.approx(alone.q_beta_f, rel=0.3)


@pytest.mark.parametrize("shift_s", [4e-8, -4e-8])
def test_stamps_finer_than_the_events_are_not_late(
    shift_s: float, recording: Recording, vehicle: Vehicle, tuning: Tuning
) -> None:
    """Nanosecond stamps: a command may not wait for the next event because of rounding."""
    finer = replace(recording, commands=Stream(recording.commands.time_s + shift_s, recording.commands.values))
    one, other = (estimate_motion(r, vehicle, tuning).kinematic[:, 3] for r in (recording, finer))
    np.testing.assert_allclose(one[5:], other[5:], atol=1e-5)


def test_the_steering_goes_on_through_a_lost_pose(recording: Recording, vehicle: Vehicle, tuning: Tuning) -> None:
    """delta follows from the commands alone: a restart of the pose must not touch it."""
    whole = estimate_motion(recording, vehicle, tuning)
    broken = replace(recording, breaks_s=tuple(recording.poses.time_s[400:3200:400].tolist()))
    cut = estimate_motion(broken, vehicle, tuning)
    same = np.isin(whole.time_s, cut.time_s)
    np.testing.assert_allclose(cut.kinematic[:, 3], whole.kinematic[same, 3], atol=0.03)


@pytest.mark.parametrize("size", [997, 2000, 1 << 20])
def test_blocks_of_any_size_give_the_same_estimate_to_the_last_bit(
    recording: Recording, vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    broken = replace(recording, breaks_s=(float(recording.poses.time_s[1500]), float(recording.poses.time_s[2200])))
    line = build_timeline(broken, vehicle, 0.1, 0.3, TUNING.T_s, TUNING.d)
    task = build_chassis(vehicle, TUNING.T_s, TUNING.d), TUNING.noise.Q(), TUNING.noise.R()
    filtered = kernel.run_filter(line.events, *task)
    x, P = kernel.run_smoother(filtered, line.events.restart)
    monkeypatch.setattr(blockwise, "BLOCK_EVENTS", size)
    forward = blockwise.run_forward(line.events, line.grid, *task)
    assert len(forward.starts) == -(-len(line.events.time_s) // size)
    assert forward.log_likelihood == filtered.log_likelihood
    smoothed = blockwise.run_backward(forward, line.grid)
    one = (forward.nis, forward.dof, forward.x, forward.P, *smoothed)
    other = (filtered.nis, filtered.dof, *(moments[line.grid] for moments in (filtered.x, filtered.P, x, P)))
    for a, b in zip(one, other, strict=True):
        assert a.tobytes() == b.tobytes()


def test_a_filter_that_has_lost_the_car_begins_anew(
    recording: Recording, vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its covariance may cease to be one where the front wheel spins; the smoother would carry NaN to the start."""
    whole, run_forward, calls = estimate_motion(recording, vehicle, TUNING), blockwise.run_forward, list[Any]()

    def loses_it(events: kernel.Events, *rest: Any) -> blockwise.ForwardPass:
        found = run_forward(events, *rest)
        calls.append(events)
        middle = len(found.nis) // 2
        if len(calls) == 1:
            found.nis[middle] = -1.0
        elif len(calls) == 2:
            found.nis[middle + 100] = np.nan
        return found

    monkeypatch.setattr(blockwise, "run_forward", loses_it)
    estimate = estimate_motion(recording, vehicle, TUNING)
    half = len(calls[0].time_s) // 2
    lost_s = [float(calls[0].time_s[half]), float(calls[1].time_s[half + 100])]
    assert list(estimate.filter.restarts_s) == lost_s
    assert calls[2].restart.sum() == calls[0].restart.sum() + 2
    assert len(estimate.segments()) == len(whole.segments()) + 2
    assert np.isfinite(estimate.twist).all()
    assert whole.filter.restarts_s == ()
    assert whole.filter.describe_restarts() == ""
    assert estimate.filter.describe_restarts().endswith(f"restarted at {lost_s[0]:.1f} s, {lost_s[1]:.1f} s")


def test_what_the_filter_cannot_follow_is_refused(
    recording: Recording, vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    run_forward = blockwise.run_forward

    def always(events: kernel.Events, *rest: Any) -> blockwise.ForwardPass:
        found = run_forward(events, *rest)
        return found._replace(nis=np.where(np.arange(len(found.nis)) == 50 + events.restart.sum(), np.nan, found.nis))

    monkeypatch.setattr(blockwise, "run_forward", always)
    with pytest.raises(InputRefused, match="loses the car"):
        estimate_motion(recording, vehicle, TUNING)


def test_what_is_no_covariance_carries_nothing_back(recording: Recording, vehicle: Vehicle) -> None:
    """Two takes of the blind test had a NaN in every row before one such event."""
    line = build_timeline(recording, vehicle, 0.1, 0.3, TUNING.T_s, TUNING.d)
    chassis = build_chassis(vehicle, TUNING.T_s, TUNING.d)
    filtered = kernel.run_filter(line.events, chassis, TUNING.noise.Q(), TUNING.noise.R())
    k = len(filtered.nis) // 2
    whole = kernel.run_smoother(filtered, line.events.restart)[0]
    filtered.P_prior[k, 4, 4] = -1e-7
    x, P = kernel.run_smoother(filtered, line.events.restart)
    assert np.isfinite(x).all()
    assert np.isfinite(P).all()
    np.testing.assert_array_equal(x[k:], whole[k:])
    np.testing.assert_array_equal(x[k - 1], filtered.x[k - 1])
    assert np.abs(x - whole)[: k // 2].max() < 1e-6  # long before it, nothing is lost
