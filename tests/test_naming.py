"""What a diagnosis finds in simulated takes: refits, disturbances, the scan for places, the screen and the search."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from cars import CAR
from concealed import concealing

from bcid.diagnosis.base_parameters import without_trust
from bcid.diagnosis.locate.pushes import STATE_NAMES, Disturbances, estimate_disturbances
from bcid.diagnosis.locate.scan_statistic import knot_energies, scan_circles, scan_windows
from bcid.diagnosis.search.name_search import Naming, name_effects
from bcid.diagnosis.search.refits import named_effects, refit_with_effects
from bcid.diagnosis.search.screen import screen_effects, simulate_trials
from bcid.effects.constants import Constants
from bcid.effects.corrections import CORRECTIONS, MEASURED_SPEED, RAW_COMMANDS
from bcid.effects.entry import VehicleScale
from bcid.effects.table import EFFECTS, ENTRIES
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning
from bcid.likelihood import nuisance, refit_state
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.jacobian import parameter_jacobian
from bcid.likelihood.marginal import robust_weights, score_and_information, segment_moments, student_log_densities
from bcid.likelihood.newton import bounded_newton_step
from bcid.likelihood.nuisance import AboutNuisances, about_no_pushes, pose_residuals
from bcid.likelihood.prediction_inputs import PredictionInputs
from bcid.likelihood.prepare import (
    fit_base,
)
from bcid.likelihood.projection import linearise_fit, project_out_fit
from bcid.likelihood.refit import Fit, evaluate_fixed, refit
from bcid.likelihood.scale_estimate import estimate_scales
from bcid.likelihood.scales import Scales
from bcid.likelihood.take import KNOT_S, KNOTS, SEGMENT_S, Take, cut_segments
from bcid.physics.car import Car
from bcid.proof.blind.cases import BlindCase
from bcid.proof.blind.run_cases import run_blind_case
from bcid.recording.read import read_recording
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.drive import ROUGHNESS_TIME_S
from bcid.simulation.samples import SampleTake as Order
from bcid.simulation.samples import write_sample_take
from bcid.vehicle import Vehicle
from bcid.virtual_lab import TUNING, record_drive

BASE = Hypothesis((), CAR, 2.012, Constants())
SCALES = Scales(np.array([5e-4, 5e-4, 1e-3]), np.array([0.02, 0.02, 0.02]))
BUMPER_CAR = VehicleScale()
ROUGH = Plant(rough_force=3.0, rough_moment=1.5)
SECONDS = 120.0


class Maker:
    """Makes takes of a plant and what a diagnosis finds in them."""

    def __init__(self, folder: Path, vehicle: Vehicle, tuning: Tuning) -> None:
        self.folder, self.vehicle, self.tuning = folder, vehicle, tuning

    def take(self, plant: Plant, seed: int, sensor: Sensor | None = None) -> Take:
        path = write_sample_take(self.folder, Order(f"take{seed}", "motive", SECONDS), plant, sensor or Sensor(), seed)
        recording = read_recording(path, self.vehicle)
        return cut_segments(recording, estimate_motion(recording, self.vehicle, self.tuning))

    def found(self, plant: Plant, seed: int, sensor: Sensor | None = None) -> tuple[Take, Naming]:
        take = self.take(plant, seed, sensor)
        return take, name_effects(fit_base(take, BASE, SCALES).best, take)


@pytest.fixture(scope="module")
def maker(tmp_path_factory: pytest.TempPathFactory, vehicle: Vehicle, tuning: Tuning) -> Maker:
    return Maker(tmp_path_factory.mktemp("naming"), vehicle, tuning)


@pytest.fixture(scope="module")
def null_take(maker: Maker) -> Take:
    return maker.take(ROUGH, 1)


@pytest.fixture(scope="module")
def null_fit(null_take: Take) -> Fit:
    return fit_base(null_take, BASE, SCALES).best


# --- refits ------------------------------------------------------------------------------------------------------


def test_motor_and_drag_are_found_from_far_and_near(vehicle: Vehicle) -> None:
    """In slow circles motor and drag share a valley: their ratio is plain, their size shown by small accelerations."""
    circles = BlindCase("circles", 0, (), driver="circles", duration_s=240.0, seed=4)
    recording = record_drive(circles.simulate(), circles.rate_hz, vehicle)
    take = cut_segments(recording, estimate_motion(recording, vehicle, TUNING))
    near = refit(take, BASE, BASE.phi_of(CAR), take.start, SCALES)
    far = refit(take, BASE, BASE.phi_of(CAR._replace(K_t=500.0, R_1=80.0)), take.start, SCALES)
    for found, there in zip((far.car().K_t, far.car().R_1), (near.car().K_t, near.car().R_1), strict=True):
        assert found == pytest.approx(there, rel=0.09)  # two standard errors
    assert near.car().K_t == pytest.approx(CAR.K_t, rel=0.09)


@pytest.mark.slow
def test_slow_circles_of_a_car_that_lacks_nothing_show_nothing() -> None:
    """Initial states are soon forgotten there: a model is no better for forgetting them sooner (a nat a segment)."""
    answer = run_blind_case(BlindCase("circles", 7, (), driver="circles", seed=9))
    assert answer["verdict"] == "nothing-found", (answer["findings"], answer["remainder"])


@pytest.mark.slow
def test_slow_circles_name_nothing_for_what_initial_states_explain() -> None:
    """Where yaw is noisier than places are, tyres had lagged, for 166 nats; what is left is near the gate."""
    answer = run_blind_case(BlindCase("circles", 917, (), driver="circles", seed=1795562593))
    assert answer["findings"] == []
    assert answer["remainder"]["nats"] < 20.0


def test_the_base_refit_recovers_the_car(null_fit: Fit) -> None:
    car, se = null_fit.car(), np.sqrt(np.diag(null_fit.covariance))
    for j, symbol in enumerate(BASE.log_parameters):
        apart = np.log(getattr(car, symbol) / getattr(CAR, symbol))
        assert abs(apart) < 5.0 * se[j], symbol
        assert se[j] < 0.05 or symbol == "F_r_max"  # the rear tyres never slide


def test_a_first_car_far_off_is_no_hindrance(null_fit: Fit, null_take: Take) -> None:
    """Inertia, stiffness and grip as one-step predictions on noisy twists may give them."""
    wrong = CAR._replace(I_z=400.0, C_f=12000.0, C_r=2000.0, F_f_max=150.0, F_r_max=300.0)
    again = fit_base(null_take, replace(BASE, nominal=wrong), SCALES).best
    assert again.log_likelihood == pytest.approx(null_fit.log_likelihood, abs=3.0)


def test_parameters_that_are_held_are_no_better_than_fitted_ones(null_fit: Fit, null_take: Take) -> None:
    """They stay, what they start from is found; at the fitted ones it comes to the same."""
    phi = BASE.phi_of(CAR._replace(C_f=1.2 * CAR.C_f))
    off = evaluate_fixed(null_take, BASE, phi, SCALES)
    np.testing.assert_array_equal(off.phi, phi)
    assert off.log_likelihood < null_fit.log_likelihood - 100.0
    same = evaluate_fixed(null_take, null_fit.hypothesis, null_fit.phi, SCALES)
    assert same.log_likelihood == pytest.approx(null_fit.log_likelihood, abs=5.0)


def test_a_step_out_of_the_numbers_is_no_step(null_fit: Fit, null_take: Take, monkeypatch: pytest.MonkeyPatch) -> None:
    """A refit goes on with shorter ones, or stays where it is."""
    linearise, asked, stiffest = nuisance.linearise_nuisances, list[float](), 0.998 * null_fit.car().C_f

    def spun(take: Take, setting: PredictionInputs, start: np.ndarray) -> np.ndarray:
        asked.append(setting.car.C_f)
        r = pose_residuals(take, setting, start)
        return r * np.inf if setting.car.C_f > stiffest else r

    def spun_too(take: Take, setting: PredictionInputs, start: np.ndarray) -> AboutNuisances:
        at = linearise(take, setting, start)
        return at._replace(r=at.r * np.inf) if setting.car.C_f > stiffest else at

    monkeypatch.setattr(nuisance, "linearise_nuisances", spun_too)
    for module in nuisance, refit_state:
        monkeypatch.setattr(module, "pose_residuals", spun)
    fit = refit(null_take, null_fit.hypothesis, null_fit.phi - 0.005, null_fit.start, null_fit.scales)
    assert max(asked) > stiffest
    assert np.isfinite(fit.log_likelihood)
    assert fit.car().C_f <= stiffest


def test_no_tyre_is_beyond_any_tyre() -> None:
    low, high = BASE.bounds()
    phi = BASE.phi_of(CAR)
    assert ((low < phi) & (phi < high)).all()
    stiffest = BASE.car(np.minimum(BASE.phi_of(CAR._replace(C_f=1e9, C_r=1e9, I_z=1e-9)), high))
    assert stiffest.C_f == pytest.approx(100.0 * CAR.m)
    odd = replace(BASE, nominal=CAR._replace(C_r=200.0 * CAR.m))  # a first car beyond stays within its own bounds
    assert (odd.phi_of(odd.nominal) <= odd.bounds()[1] + 1e-12).all()


@pytest.mark.slow
@pytest.mark.parametrize("raw", [True, False])
def test_a_raw_command_s_gain_may_be_off(null_take: Take, raw: bool) -> None:
    """Three per cent too much in every command: of a raw one it is the gain; of an angle it has no name.

    The servo's greatest rate and angle are in the units of the command.
    """
    scaled = null_take._replace(command=null_take.command * [1.0 / 1.03, 1.0, 1.0])
    servo = BASE.nominal._replace(d=BASE.nominal.d / 1.03)
    hypothesis = replace(BASE, raw_commands=raw, nominal=servo, angle_limit=BASE.angle_limit / 1.03)
    found = name_effects(fit_base(scaled, hypothesis, SCALES).best, scaled)
    if raw:
        assert found.best.hypothesis.effects == ("steering_scale",)
        assert found.best.effect_estimates()["steering_scale__g"][0] == pytest.approx(0.03, abs=0.001)
        assert found.unknown_nats < found.nulls.gate
    else:
        assert "steering_scale" not in found.best.hypothesis.entries
        assert found.gains == {}
        assert found.unknown_nats > 500.0
        assert next(iter(found.rest.seen.channel_nats())) == "steering"


def test_the_scales_are_those_of_the_take(null_fit: Fit, null_take: Take) -> None:
    """Three poses make a row, so noise is a root of three smaller; a push is what the rough floor does."""
    sensor = Sensor()
    noise = np.array([sensor.position_noise, sensor.position_noise, sensor.yaw_noise]) / np.sqrt(3.0)
    left = len(null_take.pose) - 5 * null_take.segments  # numbers per channel that no start or push takes up
    np.testing.assert_allclose(null_fit.scales.r, noise, rtol=4.0 / np.sqrt(2.0 * left))
    rough = np.array([ROUGH.rough_force, ROUGH.rough_force, ROUGH.rough_moment]) / [CAR.m, CAR.m, CAR.I_z]
    u = KNOT_S / ROUGHNESS_TIME_S
    mean_over_a_knot = np.sqrt(2.0 / u * (1.0 - (1.0 - np.exp(-u)) / u))
    knots = KNOTS * null_take.segments
    assert (null_fit.scales.q > mean_over_a_knot * rough * (1.0 - 4.0 / np.sqrt(2.0 * knots))).all()
    assert (null_fit.scales.q < rough * (1.0 + 4.0 / np.sqrt(2.0 * knots))).all()
    # of means over neighbouring knots of a floor whose roughness decays by exp(-t / ROUGHNESS_TIME_S)
    lasting = (1.0 - np.exp(-u)) ** 2 / u**2 / mean_over_a_knot**2
    assert null_fit.scales.rho[0] == pytest.approx(lasting, abs=0.3)  # pushes are hardly larger than what poses show


def log_likelihood_at(fit: Fit, take: Take, phi: np.ndarray) -> float:
    r = pose_residuals(take, fit.hypothesis.prediction_inputs(phi, take), fit.start)
    return float(
        student_log_densities(estimate_scales(segment_moments(r, fit.tangent.A, take.first), fit.scales, 0)[1]).sum()
    )


def test_a_refit_ends_at_a_maximum_as_curved_as_it_says(null_fit: Fit, null_take: Take) -> None:
    """Two standard errors either way along any axis of the covariance cost two nats."""
    values, axes = np.linalg.eigh(null_fit.covariance)
    shown = values < 0.1  # elsewhere the weak prior speaks with the take
    top = log_likelihood_at(null_fit, null_take, null_fit.phi)
    assert shown.sum() > 5
    for move in (axes * np.sqrt(values)).T[shown]:
        up, down = (top - log_likelihood_at(null_fit, null_take, null_fit.phi + s * move) for s in (2.0, -2.0))
        assert 0.5 * (up + down) == pytest.approx(2.0, rel=0.2)
        assert abs(up - down) / 8.0 < 0.5  # the top is within half a standard error


def test_a_refit_ends_there_from_elsewhere(null_fit: Fit, null_take: Take) -> None:
    nudge = 0.1 * np.random.default_rng(0).standard_normal(len(null_fit.phi))
    scales = Scales(3.0 * null_fit.scales.r, 3.0 * null_fit.scales.q)
    again = refit(null_take, BASE, null_fit.phi + nudge, null_take.start, scales)
    assert again.log_likelihood == pytest.approx(null_fit.log_likelihood, abs=1.0)
    np.testing.assert_allclose(again.phi, null_fit.phi, atol=0.5 * np.sqrt(np.diag(null_fit.covariance)).max())


def test_steering_that_is_not_known_is_found(null_take: Take) -> None:
    wrong = CAR._replace(T_s=0.18, d=1.3)
    fit = fit_base(null_take, replace(BASE, nominal=wrong, unknown_steering=("T_s", "d")), SCALES).best
    for symbol in ("T_s", "d"):
        se = np.sqrt(
            fit.covariance[fit.hypothesis.log_parameters.index(symbol), fit.hypothesis.log_parameters.index(symbol)]
        )
        assert abs(np.log(getattr(fit.car(), symbol) / getattr(CAR, symbol))) < 5.0 * se
        assert se < 0.01


@pytest.mark.parametrize("name", ["yaw_scrub", "rear_rolling_viscous", "steering_offset", "motor_sag"])
def test_what_is_not_there_gains_nothing(name: str, null_fit: Fit, null_take: Take) -> None:
    """An effect that is off earns about half a nat, its estimate covers zero, and the fit is none the worse."""
    fit = refit_with_effects(null_fit, null_take, (name,), [0.5 * EFFECTS[name].parameters[0].size])
    assert -1.0 < fit.log_likelihood - null_fit.log_likelihood < 8.0
    ((value, se),) = fit.effect_estimates().values()
    assert abs(value) < 4.0 * se


@pytest.mark.parametrize(
    ("names", "start"),
    [
        (("motor_lag",), (0.03,)),
        (("yaw_scrub", "quadratic_drag"), (13.0, 11.0)),
        (("pose_latency", "steering_lag"), (0.01, 0.004)),
    ],
)  # fmt: skip
def test_more_effects_explain_no_less(
    names: tuple[str, ...], start: tuple[float, ...], null_fit: Fit, null_take: Take
) -> None:
    """With every effect off a larger hypothesis is the base model, so its refit ends no lower."""
    fit = refit_with_effects(null_fit, null_take, names, start)
    assert fit.log_likelihood > null_fit.log_likelihood - 1.0


def test_a_delay_costs_no_likelihood(maker: Maker) -> None:
    """The same drive with the same noise, its poses on time and 10 ms late."""
    prompt, late = (maker.take(ROUGH, 6, Sensor(pose_latency=tau)) for tau in (0.0, 0.01))
    base = fit_base(late, BASE, SCALES).best
    fit = refit_with_effects(base, late, ("pose_latency",), [0.01])
    assert fit.log_likelihood == pytest.approx(fit_base(prompt, BASE, SCALES).best.log_likelihood, abs=20.0)
    ((value, se),) = fit.effect_estimates().values()
    assert abs(value - 0.01) < 4.0 * se


def test_a_fit_is_immutable(null_fit: Fit) -> None:
    assert replace(null_fit, log_likelihood=0.0).log_likelihood == 0.0
    with pytest.raises(AttributeError):
        null_fit.log_likelihood = 1.0  # type: ignore[misc]


def with_more_drag(times: float) -> Car:
    """The car with R_1 so many of the standard deviations too high by which a simulation is trusted to 2 %."""
    simulated, k = BASE.trust_simulation([], 0.02).trusted_simulation, len(BASE.log_parameters)
    assert simulated is not None
    return CAR._replace(R_1=CAR.R_1 + times * simulated.sd[k] * float(BASE.drag_units[0]))


def test_a_trusted_parameter_that_is_bent_pulls_back(null_take: Take, null_fit: Fit) -> None:
    """At its maximum the objective has no slope along the fit's own parameters: a trial's is the likelihood's alone.

    Against the dense slope of `products`; a score test that projects the likelihood's slope out would forget the pull.
    """
    stiff = CAR._replace(C_f=1.05 * CAR.C_f, R_1=with_more_drag(2.0).R_1)
    fit = refit(
        null_take,
        replace(BASE, nominal=stiff).trust_simulation([], 0.02),
        null_fit.phi,
        null_fit.start,
        null_fit.scales,
    )
    columns = fit.tangent.J[:, :, [len(BASE.log_parameters)]]  # another drag, beside R_1, which is bent
    found = project_out_fit(linearise_fit(fit, null_take), columns)
    r = pose_residuals(null_take, fit.hypothesis.prediction_inputs(fit.phi, null_take), fit.start)
    r = about_no_pushes(r, fit.tangent.A, fit.start, null_take.first)
    _, e = estimate_scales(segment_moments(r, fit.tangent.A, null_take.first), fit.scales, 0)
    g, _ = score_and_information(r, fit.tangent.A, columns, null_take.first, fit.scales.r, e.root)
    likelihood = float((robust_weights(e) @ g)[0])
    information = np.sqrt(found.G[0, 0])
    assert abs(found.tension @ found.pulls[:, 0]) / information > 1.0  # the pull is no small matter here
    assert found.slope(slice(0, 1))[0] / information == pytest.approx(likelihood / information, abs=0.3)


def test_what_a_take_alone_shows_is_told_without_the_trust_in_a_simulation(null_take: Take, null_fit: Fit) -> None:
    """Beside a simulation that is off, and trusted to a few standard errors, the take alone is as fitted freely."""
    free_se = np.sqrt(np.diag(null_fit.covariance))
    off = CAR._replace(C_f=1.01 * CAR.C_f, K_t=1.005 * CAR.K_t, F_r_max=1.01 * CAR.F_r_max)
    hypothesis = replace(BASE, nominal=off).trust_simulation([], 0.003)
    fit = refit(null_take, hypothesis, null_fit.phi, null_fit.start, null_fit.scales)
    drawn = (fit.phi - null_fit.phi) / free_se
    change, se = without_trust(fit)
    alone = (fit.phi + change - null_fit.phi) / free_se
    well_known = free_se < 0.2
    assert np.abs(drawn[well_known]).max() > 1.0
    assert np.abs(alone[well_known]).max() < 0.5
    np.testing.assert_allclose(se[well_known], free_se[well_known], rtol=0.3)


def test_what_meets_a_bound_stays_there_and_the_rest_goes_on() -> None:
    """The step within bounds is where the quadratic is least on the bound, not the free step cut off."""
    curvature, slope = np.array([[2.0, 1.9], [1.9, 2.0]]), np.array([1.0, -1.0])
    bounds = np.array([-0.5, -0.1]), np.array([0.5, 0.1])
    after = bounded_newton_step(np.zeros(2), slope, curvature, bounds)
    tried = np.linspace(-0.5, 0.5, 2001)
    values = [slope @ [a, -0.1] - 0.5 * np.array([a, -0.1]) @ curvature @ [a, -0.1] for a in tried]
    assert after[1] == -0.1
    assert after[0] == pytest.approx(tried[int(np.argmax(values))], abs=1e-3)


# --- disturbances ------------------------------------------------------------------------------------------------


def test_disturbances_of_a_null_are_as_large_as_expected(null_fit: Fit, null_take: Take) -> None:
    found = estimate_disturbances(null_fit, null_take)
    K = KNOTS * null_take.segments
    assert found.push.shape == found.strength.shape == (K, 3)
    np.testing.assert_allclose((found.strength**2).mean(axis=0), 1.0, atol=4.0 * np.sqrt(2.0 / K))
    assert set(found.states) == set(STATE_NAMES)
    assert (np.diff(found.time_s) > 0.0).all()
    np.testing.assert_array_equal(found.segment, np.arange(K) // KNOTS)
    np.testing.assert_allclose(
        found.time_s % SEGMENT_S, np.tile(KNOT_S * (np.arange(KNOTS) + 0.5), K // KNOTS), atol=1e-6
    )


def test_a_missing_slope_is_a_push_down_it(null_fit: Fit, null_take: Take) -> None:
    """With a slope the other way in the model, the pushes are the true one, in metres per second squared."""
    tilted = BASE.with_effects("floor_slope")
    wide = replace(null_fit, scales=Scales(null_fit.scales.r, np.full(3, 0.2)))
    before = estimate_disturbances(wide, null_take)
    after = estimate_disturbances(
        replace(wide, hypothesis=tilted, phi=tilted.phi_of(null_fit.car(), [-0.05, 0.02])), null_take
    )
    change, heading = after.push - before.push, before.states["theta"]
    cos, sin = np.cos(heading), np.sin(heading)
    world = np.column_stack([cos * change[:, 0] - sin * change[:, 1], sin * change[:, 0] + cos * change[:, 1]])
    np.testing.assert_allclose(np.median(world, axis=0), [0.05, -0.02], atol=0.003)


# --- places and times --------------------------------------------------------------------------------------------


def driven(seed: int, segments: int = 80) -> Disturbances:
    """Disturbances of nothing along a drive that wanders over a floor of 8 m by 5 m."""
    rng = np.random.default_rng(seed)
    K = KNOTS * segments
    steps = np.cumsum(rng.normal(0.0, 0.5, (K, 2)), axis=0)
    place = np.abs((steps + 50.0) % [16.0, 10.0] - [8.0, 5.0])
    still = dict.fromkeys(STATE_NAMES, np.zeros(K)) | {"p_x": place[:, 0], "p_y": place[:, 1]}
    strength = rng.standard_normal((K, 3))
    return Disturbances(KNOT_S * (np.arange(K) + 0.5), np.arange(K) // KNOTS, 0.01 * strength, strength, still)


def test_energy_is_one_where_nothing_is() -> None:
    of = driven(0)
    assert knot_energies(of).mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / (3 * len(of.time_s))))
    assert knot_energies(of._replace(strength=1e3 * of.strength)).max() < 100.0


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_planted_place_is_located(seed: int) -> None:
    of, centre, radius = driven(seed), np.array([4.0, 2.5]), 1.0
    inside = np.hypot(of.states["p_x"] - centre[0], of.states["p_y"] - centre[1]) < radius
    found, p = scan_circles(of._replace(strength=np.where(inside[:, None], 3.0, 1.0) * of.strength), BUMPER_CAR)
    assert p < 0.01
    assert np.hypot(found[0].x - centre[0], found[0].y - centre[1]) < 0.5 * radius
    assert 0.5 * radius <= found[0].radius <= 1.7 * radius
    assert [c.statistic for c in found] == sorted((c.statistic for c in found), reverse=True)


def test_a_place_is_as_wide_as_suits_the_vehicle() -> None:
    """Ten times as fast, a car drives ten times as far between two knots."""
    of = driven(0)
    wide = of._replace(states=of.states | {s: 10.0 * of.states[s] for s in ("p_x", "p_y")})
    inside = np.hypot(wide.states["p_x"] - 40.0, wide.states["p_y"] - 25.0) < 10.0
    wide = wide._replace(strength=np.where(inside[:, None], 3.0, 1.0) * of.strength)
    found, p = scan_circles(wide, VehicleScale(1.0, 1.0, 0.1))
    assert p < 0.01
    assert np.hypot(found[0].x - 40.0, found[0].y - 25.0) < 5.0
    narrow = scan_circles(wide, BUMPER_CAR)  # the bumper car's circles hardly ever hold two knots there
    assert narrow[1] > 0.05


def test_a_planted_time_is_located() -> None:
    of = driven(3)
    late = (of.time_s > 70.0) & (of.time_s < 90.0)
    window, p = scan_windows(of._replace(strength=np.where(late[:, None], 2.0, 1.0) * of.strength))
    assert p < 0.01
    assert window.begin_s == pytest.approx(70.0, abs=6.0)
    assert window.end_s == pytest.approx(90.0, abs=6.0)


@pytest.mark.parametrize("look", [partial(scan_circles, units=BUMPER_CAR), scan_windows])
def test_p_values_of_nothing_are_uniform(look: object) -> None:
    from scipy.stats import kstest

    p = [look(driven(100 + seed, 40))[1] for seed in range(30)]  # type: ignore[operator]
    assert kstest(p, "uniform").pvalue > 1e-3


# --- screen and search -------------------------------------------------------------------------------------------


def test_the_screen_covers_the_vocabulary_and_nothing_stands_out_of_a_null(null_fit: Fit, null_take: Take) -> None:
    trials = simulate_trials(null_fit, null_take)
    found = screen_effects(null_fit, null_take, trials)
    names = [c.effect for c in found]
    assert len(names) == len(set(names))
    assert set(EFFECTS) <= set(names) <= set(EFFECTS) | set(CORRECTIONS)
    assert len(EFFECTS) == 42
    for candidate in found:
        assert len(candidate.values) == len(null_fit.hypothesis.entries[candidate.effect].parameters)
    scores = [c.score for c in found]
    assert scores == sorted(scores, reverse=True)
    assert min(scores) >= 0.0
    fewer = screen_effects(null_fit, null_take, trials.without(("yaw_scrub", "clock_drift")))
    assert set(names) - {c.effect for c in fewer} == {"yaw_scrub", "clock_drift"}


def test_a_null_take_names_nothing(null_fit: Fit, null_take: Take) -> None:
    found = name_effects(null_fit, null_take)
    assert named_effects(found.best) == ()
    assert found.gains == {}
    assert found.unknown_nats == 0.0
    assert found.best is found.corrected is found.base
    assert found.before.nats < 0.5 * found.nulls.gate


@pytest.mark.parametrize(
    ("name", "size", "look_alike", "plant", "sensor"),
    [
        ("rear_rolling_coulomb", 20.0, "rear_rolling_viscous", {"rear_rolling_coulomb": 20.0}, {}),
        ("motor_lag", 0.08, "motor_delay", {"motor_lag": 0.08}, {}),
        ("steering_side_gain", 0.03, "steering_offset", {"steering_side_gain": 0.03}, {}),
        ("body_yaw_misalignment", 0.03, "steering_offset", {}, {"body_yaw_misalignment": 0.03}),
        ("pose_latency", 0.03, "steering_delay", {}, {"pose_latency": 0.03}),
    ],
)
def test_a_concealed_effect_is_named_alone(
    name: str, size: float, look_alike: str, plant: dict[str, float], sensor: dict[str, float], maker: Maker
) -> None:
    take, found = maker.found(ROUGH._replace(**plant), 3, Sensor(**sensor))
    assert named_effects(found.best) == (name,)
    value, se = found.best.effect_estimates()[EFFECTS[name].fields[0]]
    assert abs(value - size) < 4.0 * se
    assert se < 0.05 * size
    assert found.gains[name] > 2.0 * found.gate_of(name)
    assert (
        found.gains[name] <= found.best.penalised_log_likelihood - found.without[name].penalised_log_likelihood + 1e-9
    )
    assert found.unknown_nats == 0.0
    other = refit_with_effects(found.base, take, (look_alike,), [EFFECTS[look_alike].parameters[0].size])
    assert found.best.penalised_log_likelihood > other.penalised_log_likelihood + 20.0


@pytest.mark.parametrize(
    ("x", "y", "seed"),
    [
        (0.0, 1.0, 9),
        pytest.param(-2.0, 0.0, 8, marks=pytest.mark.proof),
        pytest.param(1.0, 0.5, 8, marks=pytest.mark.proof),
    ],
)
def test_a_slippery_patch_is_found_with_its_place(x: float, y: float, seed: int, maker: Maker) -> None:
    """Within a third of its radius, and no place that explains much more is missed."""
    patch = dict(
        zip(("slippery_patch", *(f"slippery_patch_{n}" for n in ("x", "y", "radius"))), (0.4, x, y, 1.0), strict=True)
    )
    take, found = maker.found(ROUGH._replace(**patch), seed)
    assert named_effects(found.best) == ("slippery_patch",)
    at = {f.partition("__")[2]: v for f, (v, _) in found.best.effect_estimates().items() if f.startswith("slippery")}
    assert at["D"] == pytest.approx(0.4, abs=0.05)
    assert np.hypot(at["x"] - x, at["y"] - y) < 0.33
    assert at["radius"] == pytest.approx(1.0, abs=0.33)
    truth = refit_with_effects(found.base, take, ("slippery_patch",), list(patch.values()))
    assert truth.penalised_log_likelihood < found.best.penalised_log_likelihood + 20.0


def test_a_base_model_s_own_flaws_are_no_effects(maker: Maker) -> None:
    """Two rear wheels, falling grip and another slip speed are taken up by the corrections, and nothing is named."""
    _, found = maker.found(ROUGH._replace(rear_track=0.6, tyre_fall=0.3, slip_speed=0.85), 7)
    assert named_effects(found.best) == ()
    assert set(found.best.hypothesis.effects) == set(CORRECTIONS) - {*RAW_COMMANDS, *MEASURED_SPEED, "motor_fade"}
    assert found.best.penalised_log_likelihood > found.base.penalised_log_likelihood + 100.0
    values = found.best.effect_estimates()
    for field, truth in (("two_rear_wheels__t", 0.6), ("slip_speed__d", -0.15)):
        value, se = values[field]
        assert abs(value - truth) < 4.0 * se, field
    assert 0.3 < values["tyre_fall__f"][0] < 0.6  # the simulation's grip falls faster


def test_a_trusted_parameter_makes_little_room(null_take: Take, null_fit: Fit) -> None:
    """What an effect does counts where a simulation knows the parameter that could do the same; free, hardly at all.

    The column is what R_1 does itself.
    """
    known, own = replace(BASE, nominal=null_fit.car()).trust_simulation([], 0.02), len(BASE.log_parameters)
    fits = [refit(null_take, of, null_fit.phi, null_fit.start, null_fit.scales) for of in (BASE, known)]
    found = [project_out_fit(linearise_fit(fit, null_take), fit.tangent.J[:, :, [own]]) for fit in fits]
    assert found[1].G[0, 0] > 100.0 * max(found[0].G[0, 0], 1.0)


def test_a_parameter_at_its_end_makes_no_room(null_take: Take, null_fit: Fit) -> None:
    """What an effect does counts in full where the parameter that could do the same goes no farther."""
    trusted = BASE.trust_simulation([], 0.3)
    phi, own = null_fit.phi.copy(), BASE.log_parameters.index("C_f")
    phi[own] = trusted.bounds()[1][own]
    ends = [replace(null_fit, hypothesis=trusted, phi=p) for p in (null_fit.phi, phi)]
    found = [project_out_fit(linearise_fit(fit, null_take), fit.tangent.J[:, :, [own]]) for fit in ends]
    assert found[1].G[0, 0] > 100.0 * max(found[0].G[0, 0], 1.0)


def test_a_lag_that_a_simulation_knows_to_be_none_is_felt_as_a_small_one(null_take: Take, null_fit: Fit) -> None:
    """It is trusted by less than any difference, and below it no effect is; and to have a lag at all is a jump."""
    known = replace(BASE, assumed=("motor_lag",)).trust_simulation([0.0], 1e-4).with_effects()
    own = range(known.size - 1, known.size)
    low, high = known.bounds()
    assert low[-1] == 0.0 < high[-1]

    def answer(size: float) -> np.ndarray:
        phi = known.phi_of(null_fit.car(), [size * known.effect_units()[0]])
        r = pose_residuals(null_take, known.prediction_inputs(phi, null_take), null_fit.start)
        return parameter_jacobian(null_take, known, phi, null_fit.start, r, own)

    none, small = answer(0.0), answer(0.05)
    assert np.linalg.norm(none - small) < 0.3 * np.linalg.norm(small)


@pytest.mark.parametrize("size", [1.0, 2.0])
def test_a_refit_finds_a_lag_from_none(size: float) -> None:
    true = size * ENTRIES["tyre_relaxation"].parameters[0].size
    base, take = concealing(60.0, tyre_relaxation=true)
    more, phi = base.hypothesis.add_effect("tyre_relaxation", base.phi, [0.0])
    found = refit(take, more, phi, base.start, base.scales)
    sigma, se = found.effect_estimates()["tyre_relaxation__sigma"]
    assert sigma == pytest.approx(true, abs=4.0 * se)
    assert se < 0.2 * true
