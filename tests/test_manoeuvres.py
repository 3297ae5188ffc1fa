"""Simulated takes, what to drive next, and what a plan makes visible."""

from __future__ import annotations

import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cars import CAR

from bcid.diagnosis.search.refits import refit_with_effects
from bcid.effects.constants import Constants
from bcid.effects.table import EFFECTS
from bcid.errors import PredictionDiverged
from bcid.experiment import discrimination as separation_module
from bcid.experiment.detectability import detectable_sizes
from bcid.experiment.discrimination import (
    find_discriminating_drive,
    measure_separation,
    segment_information,
    simulate_planned_drive,
)
from bcid.experiment.limits import EXPERIMENT_LIMITS
from bcid.experiment.manoeuvres import (
    ARENA,
    MAX_SPEED_MPS,
    STOP_S,
    Arena,
    PlannedDrive,
    feasible_drives,
    top_speed,
    write_commands,
)
from bcid.experiment.patterns import COMMAND_HZ, PATTERNS
from bcid.experiment.plan import NOMINAL_SCALES, REST_S, largest_throttle, nominal_car, plan_drives
from bcid.experiment.simulate import NO_NOISE, commands_only_take, draw_pushes, simulate_states, simulate_take
from bcid.likelihood.base_fit import fit_base
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.jacobian import parameter_jacobian
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.newton import evaluate_at
from bcid.likelihood.nuisance import linearise_nuisances, pose_residuals
from bcid.likelihood.prepare import scale_at_speed
from bcid.likelihood.refit import Fit
from bcid.likelihood.refit_state import RefitProblem
from bcid.likelihood.scales import Scales
from bcid.likelihood.take import KNOT_S, KNOTS, N_NUISANCE, SEGMENT_S, Take, concatenate_takes
from bcid.recording.formats.commands_file import read_commands_file
from bcid.vehicle import Body, Motor, Steering, Vehicle

LIMIT, TOP = 2.012, 2.033
SCALES = Scales(np.array([3e-4, 4e-4, 6e-4]), np.array([0.02, 0.015, 0.03]), np.array([0.7, 0.5, 0.0]))
BASE = Hypothesis((), CAR, LIMIT, Constants())

VEHICLES = {
    "bumper": Vehicle(
        name="bumper",
        body=Body(mass_kg=319.6, cog_to_front_m=0.54, cog_to_rear_m=0.33),
        steering=Steering(max_angle_rad=LIMIT, max_rate_radps=1.418),
        motor=Motor(reference_speed_mps=TOP),
    ),
    "fast": Vehicle(
        name="fast",
        body=Body(mass_kg=3.5, cog_to_front_m=0.16, cog_to_rear_m=0.17, drive="all", front_drive_share=0.4),
        steering=Steering(max_angle_rad=0.42),
        motor=Motor(reference_speed_mps=7.0),
    ),
    "force": Vehicle(
        name="force",
        body=Body(cog_to_front_m=0.08, cog_to_rear_m=0.09, drive="rear"),
        steering=Steering(max_angle_rad=0.35, time_constant_s=0.1),
        motor=Motor(law="force"),
    ),
}
every_vehicle = pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES)


def random_commands(seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """A drive that wakes most effects, without walls."""
    rng = np.random.default_rng(0)
    n = round(seconds * COMMAND_HZ)
    pieces = n // 15 + 1
    hold = rng.integers(15, 50, pieces)
    far = rng.random(pieces) < 0.2
    steering = np.where(far, 1.9 * np.sign(rng.standard_normal(pieces)), 0.8 * rng.standard_normal(pieces))
    share = rng.random(pieces)
    throttle = np.where(share < 0.6, TOP, np.where(share < 0.85, rng.uniform(0.6, TOP, pieces), -0.4))
    command = np.column_stack([np.clip(steering, -2.0, 2.0), throttle])
    return np.arange(n) / COMMAND_HZ, np.repeat(command, hold, axis=0)[:n]


COMMANDS = random_commands(120.0)


def taken(
    hypothesis: Hypothesis, phi: np.ndarray, scales: Scales, rate_hz: float = 30.0, seed: int = 1, seconds: float = 90.0
) -> Take:
    setting = hypothesis.prediction_inputs(phi, commands_only_take(*COMMANDS, seconds))
    return simulate_take(setting, *COMMANDS, seconds, scales, rate_hz, seed, np.zeros(6))


def holding(name: str, *values: float) -> tuple[Hypothesis, np.ndarray]:
    hypothesis = BASE.with_effects(name)
    return hypothesis, hypothesis.phi_of(CAR, values)


def unfitted(hypothesis: Hypothesis, phi: np.ndarray) -> Any:
    """An explanation of which nothing but the base parameters is refitted, and they are known by their prior alone."""
    known = LIKELIHOOD_LIMITS.base_prior_sd**2 * np.eye(hypothesis.base_size)
    return SimpleNamespace(hypothesis=hypothesis, phi=phi, scales=SCALES, covariance=known)


@pytest.mark.parametrize("rate_hz", [120.0, 30.0, 10.0])
def test_a_still_take_is_the_prediction(rate_hz: float) -> None:
    hypothesis, phi = holding("steering_backlash", 0.02)
    take = taken(hypothesis, phi, NO_NOISE, rate_hz)
    assert take.segments == 60
    assert (np.diff(take.first_stamp) == round(SEGMENT_S * rate_hz)).all()
    assert (np.diff(take.first) == round(SEGMENT_S * min(rate_hz, 20.0))).all()
    np.testing.assert_allclose(np.bincount(take.row, take.share), 1.0)
    assert np.abs(pose_residuals(take, hypothesis.prediction_inputs(phi, take), take.start)).max() < 1e-9


def test_the_measurement_is_in_the_take() -> None:
    """A tracked point ahead of the CoG is seen there."""
    hypothesis, phi = holding("marker_offset", 0.1, 0.0)
    off, on = taken(BASE, BASE.phi_of(CAR), NO_NOISE), taken(hypothesis, phi, NO_NOISE)
    yaw = off.pose[:, 2]
    np.testing.assert_allclose(
        on.pose[:, :2] - off.pose[:, :2], 0.1 * np.column_stack([np.cos(yaw), np.sin(yaw)]), atol=1e-3
    )


def test_the_noise_is_as_large_as_it_says() -> None:
    phi = BASE.phi_of(CAR)
    still, noisy = (taken(BASE, phi, Scales(r, np.zeros(3)), 120.0, seconds=120.0) for r in (np.zeros(3), SCALES.r))
    np.testing.assert_allclose((noisy.pose - still.pose).std(axis=0), SCALES.r, rtol=0.07)  # 5 sd of 2400 rows
    setting = BASE.prediction_inputs(phi, still)
    # over one knot from rest a push is v = a t: the velocity after the first knot has sd q times its time
    end = round(KNOT_S / setting.chain.h)
    first = [simulate_states(setting, KNOT_S, SCALES, seed, np.zeros(6))[end, 3:] for seed in range(200)]
    at_rest = simulate_states(setting, KNOT_S, NO_NOISE, 0, np.zeros(6))[end, 3:]
    assert np.std(np.array(first) - at_rest, axis=0)[0] == pytest.approx(KNOT_S * SCALES.q[0], rel=0.25)


def test_pushes_are_as_large_and_last_as_they_say() -> None:
    drawn = draw_pushes(4000, SCALES, 5)
    np.testing.assert_allclose(drawn.std(axis=0), SCALES.q, rtol=0.08)
    for lag in (1, 2):
        found = [np.corrcoef(column[:-lag], column[lag:])[0, 1] for column in drawn.T]
        np.testing.assert_allclose(found, SCALES.rho**lag, atol=0.06)


def test_a_seed_is_a_take() -> None:
    phi = BASE.phi_of(CAR)
    one, same, other = (taken(BASE, phi, SCALES, seed=s, seconds=15.0) for s in (1, 1, 2))
    np.testing.assert_array_equal(one.pose, same.pose)
    assert not np.allclose(one.pose, other.pose)


@pytest.mark.parametrize("rate_hz", [30.0, 10.0])
def test_the_base_refit_recovers_scales_and_car(rate_hz: float) -> None:
    take = taken(BASE, BASE.phi_of(CAR), SCALES, rate_hz, seconds=120.0)
    fit = fit_base(take, BASE, Scales(np.full(3, 1e-3), np.full(3, 0.05))).best
    np.testing.assert_allclose(fit.scales.r, SCALES.r, rtol=0.1)
    np.testing.assert_allclose(fit.scales.q, SCALES.q, rtol=0.25)
    if rate_hz > 20.0:  # of fewer poses side forces, which tyres take up within a knot, show no correlation
        np.testing.assert_allclose(fit.scales.rho, SCALES.rho, atol=0.25)
    for symbol in ("F_m_max", "K_t", "K_b", "I_z", "C_f", "C_r", "F_f_max"):
        assert getattr(fit.car(), symbol) == pytest.approx(getattr(CAR, symbol), rel=0.03), symbol


@every_vehicle
def test_every_manoeuvre_fits_the_arena(vehicle: Vehicle) -> None:
    car, limit, top = nominal_car(vehicle), vehicle.steering.max_angle_rad, largest_throttle(vehicle)
    drives = feasible_drives(car, limit, top)
    assert {d.name for d in drives} == {p.__name__.replace("_", "-") for p in PATTERNS}
    hypothesis = Hypothesis((), car, limit, Constants())
    for drive in drives:
        assert EXPERIMENT_LIMITS.min_drive_s <= drive.seconds - STOP_S <= EXPERIMENT_LIMITS.max_drive_s
        assert (np.abs(drive.command[:, 0]) <= limit).all(), drive.name
        assert ((drive.command[:, 1] >= -1.0) & (drive.command[:, 1] <= top)).all(), drive.name
        take, setting = simulate_planned_drive(drive, hypothesis, hypothesis.phi_of(car))
        assert (np.abs(take.pose[:, :2]) <= ARENA.reach + 1e-6).all(), drive.name
        path = simulate_states(setting, drive.seconds, NO_NOISE, 0, np.r_[drive.start, 0.0, 0.0, 0.0])
        assert np.hypot(path[-1, 3], path[-1, 4]) < 0.1, drive.name  # it stands at the end
        assert np.hypot(path[:, 3], path[:, 4]).max() > 0.25 * min(top_speed(car, top), 2.5), drive.name


def test_what_does_not_fit_is_left_out() -> None:
    small, wide = (feasible_drives(CAR, LIMIT, TOP, Arena(side, side, 0.5)) for side in (3.4, 8.0))
    assert 0 < len(small) < len(wide)
    assert feasible_drives(CAR, LIMIT, TOP, Arena(1.0, 1.0, 0.5)) == []
    truth, rival = unfitted(*holding("yaw_scrub", 13.0)), unfitted(BASE, BASE.phi_of(CAR))
    assert find_discriminating_drive(truth, rival, TOP, Arena(1.0, 1.0, 0.5)) is None


def test_information_is_the_dense_algebra() -> None:
    """Against R + A Q A^T written out, the initial states with a prior too wide to matter."""
    phi = BASE.phi_of(CAR)
    take, setting = simulate_planned_drive(feasible_drives(CAR, LIMIT, TOP)[0], BASE, phi)
    take = take.part(np.array([4, 9]))
    r = pose_residuals(take, setting, take.start)
    J = parameter_jacobian(take, BASE, phi, take.start, r, range(BASE.base_size))
    A = linearise_nuisances(take, setting, take.start).A
    found = segment_information(take, setting, SCALES, J)
    prior = np.zeros((N_NUISANCE, N_NUISANCE))
    prior[:6, :6] = 1e4 * np.eye(6)
    for i, j, c in itertools.product(range(KNOTS), range(KNOTS), range(3)):
        prior[6 + 3 * i + c, 6 + 3 * j + c] = SCALES.q[c] ** 2 * SCALES.rho[c] ** abs(i - j)
    for s in range(2):
        rows = slice(take.first[s], take.first[s + 1])
        As, Js = A[rows].reshape(-1, N_NUISANCE), J[rows].reshape(-1, J.shape[2])
        S = np.diag(np.tile(SCALES.r**2, len(As) // 3)) + As @ prior @ As.T
        expected = Js.T @ np.linalg.solve(S, Js)
        np.testing.assert_allclose(found[s], expected, rtol=1e-3, atol=1e-4 * np.abs(expected).max())


def test_coasting_and_turning_tell_rolling_from_air_drag_and_a_steady_circle_does_not() -> None:
    drives = {d.name: d for d in feasible_drives(CAR, LIMIT, TOP)}
    rolling, air = unfitted(*holding("rear_rolling_viscous", 17.0)), unfitted(*holding("quadratic_drag", 11.0))
    score = {
        name: measure_separation(drives[name], rolling, air).score()
        for name in ("coast-down", "steady-circles-fast", "full-lock")
    }
    assert score["coast-down"] > 3.0 * score["steady-circles-fast"]
    assert score["full-lock"] > score["steady-circles-fast"]
    best = find_discriminating_drive(rolling, air, TOP)
    assert best is not None
    assert best.score >= max(score.values()) - 1e-9
    assert best.repeats >= 1
    for word in ("rear rolling viscous", "quadratic drag", "v_x", "speed", "m/s"):
        assert word in best.why


def test_a_difference_is_that_from_where_each_explanation_comes_nearest() -> None:
    """It is what the likelihood of a simulated drive loses; from one initial state it would be five times that."""
    drive = next(d for d in feasible_drives(CAR, LIMIT, TOP) if d.name == "coast-down")
    truth, rival = unfitted(BASE, BASE.phi_of(CAR)), unfitted(*holding("front_coulomb_friction", 180.0))
    take, _ = simulate_planned_drive(drive, truth.hypothesis, truth.phi, truth.scales, seed=3)
    chi2 = [
        evaluate_at(
            RefitProblem(take, f.hypothesis, f.hypothesis.prior(f.phi)), f.phi, take.start, truth.scales, em_steps=0
        ).terms.chi2.sum()
        for f in (truth, rival)
    ]
    assert measure_separation(drive, truth, rival).square == pytest.approx(chi2[1] - chi2[0], rel=0.15)


def test_a_score_is_what_base_parameters_leave() -> None:
    """None for the same explanation or a shifted base; more drives show more; a wide prior is no prior."""
    drive = next(d for d in feasible_drives(CAR, LIMIT, TOP) if d.name == "throttle-steps")
    one = unfitted(*holding("yaw_scrub", 13.0))
    assert measure_separation(drive, one, one).score() == pytest.approx(0.0, abs=1e-9)
    shifted = one.hypothesis.phi_of(CAR._replace(C_f=CAR.C_f * 1.01), [13.0])
    moved = measure_separation(drive, one, unfitted(one.hypothesis, shifted))
    assert 0.0 <= moved.score() < 0.05 * 0.5 * moved.square
    apart = measure_separation(drive, one, unfitted(BASE, BASE.phi_of(CAR)))
    assert 0.0 < apart.score(1) < apart.score(2) < 2.5 * apart.score(1)
    np.testing.assert_allclose(apart.known, np.eye(BASE.base_size) / LIKELIHOOD_LIMITS.base_prior_sd**2)
    assert find_discriminating_drive(one, one, TOP) is None


@pytest.fixture(scope="module")
def rivals() -> tuple[Fit, Fit]:
    """Two explanations fitted to one take."""
    hypothesis, phi = holding("rear_rolling_viscous", 17.0)
    take = taken(hypothesis, phi, NOMINAL_SCALES, seed=3)
    base = fit_base(take, BASE, NOMINAL_SCALES).best
    return refit_with_effects(base, take, ("rear_rolling_viscous",), [10.0]), refit_with_effects(
        base, take, ("yaw_scrub",), [10.0]
    )


def test_a_drive_that_a_car_does_not_last_is_passed_over(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a take of seconds allows may leave the numbers on a drive of a minute."""
    rolling, air = unfitted(*holding("rear_rolling_viscous", 17.0)), unfitted(*holding("quadratic_drag", 11.0))
    best = find_discriminating_drive(rolling, air, TOP)
    assert best is not None
    usual, tried = separation_module.measure_separation, list[str]()

    def unstable(drive: PlannedDrive, *explanations: Any) -> Any:
        tried.append(drive.name)
        if drive.name == best.name:
            raise PredictionDiverged
        return usual(drive, *explanations)

    monkeypatch.setattr(separation_module, "measure_separation", unstable)
    second = find_discriminating_drive(rolling, air, TOP)
    assert best.name in tried
    assert second is not None
    assert second.name != best.name
    assert second.score <= best.score


def test_rival_fits_count_what_their_take_knows(rivals: tuple[Fit, Fit]) -> None:
    best = find_discriminating_drive(*rivals, TOP)
    assert best is not None
    drive = next(d for d in feasible_drives(rivals[0].car(), LIMIT, TOP) if d.name == best.name)
    one, other = rivals
    alone = unfitted(one.hypothesis, one.phi)
    alone.scales = one.scales
    together = measure_separation(drive, one, other)
    assert together.square == pytest.approx(measure_separation(drive, alone, other).square)
    assert together.score() == pytest.approx(best.score)
    assert together.known.shape == (rivals[0].hypothesis.size,) * 2
    assert together.score(best.repeats) >= LIKELIHOOD_LIMITS.usual_gate_nats


def test_commands_survive_their_file(tmp_path: Path) -> None:
    best = find_discriminating_drive(unfitted(*holding("yaw_scrub", 13.0)), unfitted(BASE, BASE.phi_of(CAR)), TOP)
    assert best is not None
    path = tmp_path / "next.commands.csv"
    write_commands(path, best.command_s, best.command)
    read = read_commands_file(path)
    np.testing.assert_allclose(read.command_time_s, best.command_s, atol=1e-9)
    np.testing.assert_allclose(read.command, best.command, atol=1e-5)
    assert (read.channels, read.irregularities) == ({}, ())
    assert np.diff(read.command_time_s).max() <= 0.5


@pytest.mark.parametrize("name", ["rear_rolling_viscous", "steering_delay"])
def test_the_smallest_detectable_size_is_that(name: str) -> None:
    """Twice the size is found by a refit, a fifth is not; in 90 s of driving."""
    take = taken(BASE, BASE.phi_of(CAR), NOMINAL_SCALES, seed=5)
    sizes = detectable_sizes(BASE, BASE.phi_of(CAR), NOMINAL_SCALES, take, [name])[name]
    assert sizes is not None
    ((size, unit),) = sizes.values()
    assert unit == EFFECTS[name].parameters[0].unit
    for share, seen in ((2.0, True), (0.2, False)):
        hypothesis, phi = holding(name, share * size)
        there = taken(hypothesis, phi, NOMINAL_SCALES, seed=7)
        base = fit_base(there, BASE, NOMINAL_SCALES).best
        fit = refit_with_effects(base, there, (name,), [0.5 * size])
        assert (
            fit.penalised_log_likelihood - base.penalised_log_likelihood > LIKELIHOOD_LIMITS.usual_gate_nats
        ) is seen, (
            share,
            fit.penalised_log_likelihood - base.penalised_log_likelihood,
        )


def test_detectable_speaks_of_each_amplitude_and_of_what_is_not_excited() -> None:
    standing = (COMMANDS[0], np.zeros_like(COMMANDS[1]))
    setting = BASE.prediction_inputs(BASE.phi_of(CAR), commands_only_take(*standing, 30.0))
    rest = simulate_take(setting, *standing, 30.0, NOMINAL_SCALES, 30.0, 0, np.zeros(6))
    names = ["rear_rolling_viscous", "rough_patch", "motor_power_limit", "steering_side_gain"]
    assert detectable_sizes(BASE, BASE.phi_of(CAR), NOMINAL_SCALES, rest, names) == dict.fromkeys(names)
    moving = taken(BASE, BASE.phi_of(CAR), NOMINAL_SCALES, seconds=45.0)
    found = detectable_sizes(BASE, BASE.phi_of(CAR), NOMINAL_SCALES, moving, ["floor_slope", "mass_change"])
    assert sorted(found["floor_slope"] or {}) == ["g_x", "g_y"]
    assert list(found["mass_change"] or {}) == ["d"]
    held = BASE.with_effects("floor_slope")
    assert detectable_sizes(held, held.phi_of(CAR), NOMINAL_SCALES, moving, ["floor_slope"]) == {}


def test_a_change_on_the_way_shows_in_several_recordings_as_in_one() -> None:
    """A time counts from where its own recording begins."""
    early = COMMANDS[0] < 45.0  # or they would run into the next drive
    given = COMMANDS[0][early], COMMANDS[1][early]
    setting = BASE.prediction_inputs(BASE.phi_of(CAR), commands_only_take(*given, 45.0))
    drives = [simulate_take(setting, *given, 45.0, NOMINAL_SCALES, 30.0, seed, np.zeros(6)) for seed in (1, 2, 3, 4)]
    found = detectable_sizes(BASE, BASE.phi_of(CAR), NOMINAL_SCALES, concatenate_takes(drives), ["mass_change"])[
        "mass_change"
    ]
    alone = detectable_sizes(BASE, BASE.phi_of(CAR), NOMINAL_SCALES, drives[0], ["mass_change"])["mass_change"]
    assert found is not None
    assert alone is not None
    assert found["d"][0] == pytest.approx(0.5 * alone["d"][0], rel=0.2)  # four times as much is known


def test_more_noise_hides_more() -> None:
    take = taken(BASE, BASE.phi_of(CAR), NOMINAL_SCALES, seconds=45.0)
    loud = Scales(3.0 * NOMINAL_SCALES.r, 3.0 * NOMINAL_SCALES.q)
    noisy = taken(BASE, BASE.phi_of(CAR), loud, seconds=45.0)
    quiet_size, loud_size = (
        (detectable_sizes(BASE, BASE.phi_of(CAR), s, t, ["yaw_scrub"])["yaw_scrub"] or {})["c"][0]
        for s, t in ((NOMINAL_SCALES, take), (loud, noisy))
    )
    assert loud_size == pytest.approx(3.0 * quiet_size, rel=0.25)


def test_a_plan_shows_what_is_asked(tmp_path: Path) -> None:
    asked = ["rear_rolling_viscous", "steering_delay", "floor_slope", "motor_sag"]
    made = plan_drives(CAR, Constants(), LIMIT, asked, max_throttle=TOP)
    assert made.missing == {}
    for name in asked:
        for p in EFFECTS[name].parameters:
            assert (made.detectable_sizes[name] or {})[p.symbol][0] <= p.size
    end = 0.0
    for part in made.parts:
        assert part.begin_s == pytest.approx(end + (REST_S if end else 0.0))
        rows = slice(round(part.begin_s * COMMAND_HZ), round((part.begin_s + part.drive.seconds) * COMMAND_HZ))
        np.testing.assert_array_equal(made.command[rows], part.drive.command)
        assert (np.abs(part.drive.start[:2]) <= ARENA.reach).all()
        end = part.begin_s + part.drive.seconds
    assert made.minutes == pytest.approx(end / 60.0)
    path = tmp_path / "plan.csv"
    write_commands(path, made.command_s, made.command)
    np.testing.assert_allclose(read_commands_file(path).command, made.command, atol=1e-5)


def test_a_plan_names_the_impossible() -> None:
    """A slow car never comes near its front wheel's grip; a narrow floor takes no manoeuvre."""
    made = plan_drives(CAR, Constants(), LIMIT, ["friction_circle", "yaw_scrub"], max_throttle=0.6)
    assert made.missing == {"friction_circle": "no manoeuvre that fits excites it"}
    assert made.detectable_sizes["friction_circle"] is None
    nowhere = plan_drives(CAR, Constants(), LIMIT, ["yaw_scrub"], TOP, Arena(1.0, 1.0, 0.5))
    assert nowhere.missing == {"yaw_scrub": "no manoeuvre fits the arena"}
    assert nowhere.minutes == 0.0


@pytest.mark.parametrize(("name", "never"), [("force", {"friction_circle", "motor_regeneration"}), ("fast", set())])
def test_what_a_vehicle_cannot_have_is_told_and_not_planned_for(name: str, never: set[str]) -> None:
    """The first is driven at its rear wheels, by a throttle that sets a force."""
    car = nominal_car(VEHICLES[name])
    asked = ["friction_circle", "motor_regeneration", "yaw_scrub"]
    made = plan_drives(car, Constants(), 0.4, asked, largest_throttle(VEHICLES[name]), Arena(8.0, 8.0, 0.5))
    told = {e for e, why in made.missing.items() if why == "this vehicle cannot have it"}
    assert told == never
    assert set(made.detectable_sizes) == set(asked)
    assert all(made.detectable_sizes[e] is None for e in never)


def test_drift_takes_longer_than_drag() -> None:
    drag, drift = (plan_drives(CAR, Constants(), LIMIT, [n], max_throttle=TOP) for n in ("yaw_scrub", "clock_drift"))
    assert drag.missing == drift.missing == {}
    assert drift.minutes > 2.0 * drag.minutes


def test_the_nominal_car_is_the_vehicle_file_s() -> None:
    bumper, fast, force = (nominal_car(v) for v in VEHICLES.values())
    for symbol in ("I_z", "C_f", "C_r", "F_f_max", "F_r_max", "K_t", "K_b", "F_m_max", "R_1", "R_2"):
        assert getattr(bumper, symbol) == pytest.approx(getattr(CAR, symbol), rel=0.1), symbol
    assert (bumper.d, bumper.T_s, bumper.front_share, bumper.sets_force) == (1.418, 0.15, 1.0, 0.0)
    assert (fast.m, fast.front_share, fast.l_f) == (3.5, 0.4, 0.16)
    assert (force.m, force.front_share, force.T_s, force.sets_force) == (1.0, 0.0, 0.1, 1.0)
    assert (fast.T_s, fast.d) == (0.15, 2.0)  # which its file omits
    slow = VEHICLES["fast"].model_copy(update={"steering": Steering(max_angle_rad=0.42, time_constant_s=0.2)})
    assert (nominal_car(slow).T_s, nominal_car(slow).d) == (0.2, 2.0)
    assert top_speed(force, largest_throttle(VEHICLES["force"])) > 1.0
    assert (
        top_speed(force._replace(K_t=30.0, K_v=1e-3, R_1=0.0, R_2=0.0), 1.0) == MAX_SPEED_MPS
    )  # nothing holds it back


def test_a_plan_s_largest_throttle_is_the_vehicle_file_s_or_the_usual_one() -> None:
    unstated = VEHICLES["bumper"].model_copy(update={"motor": Motor()})
    throttles = [largest_throttle(vehicle) for vehicle in (*VEHICLES.values(), unstated)]
    assert throttles == [TOP, 7.0, 1.0, 2.0]  # m/s, but 1 where the throttle sets a force


def test_sizes_are_asked_for_as_they_suit_the_vehicle() -> None:
    assert scale_at_speed(CAR, top_speed(CAR, 2.3)) == pytest.approx((1.0, 1.0, 1.0, 1.0), rel=0.03)
    fast = nominal_car(VEHICLES["fast"])
    units = scale_at_speed(fast, top_speed(fast, 7.0))
    assert units.kg == pytest.approx(3.5 / 319.6)
    assert units.m / units.s == pytest.approx(top_speed(fast, 7.0) / 1.9)
