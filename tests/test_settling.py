"""Where predictions are linearised: about the initial state and the pushes that are likeliest in each segment."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from concealed import concealing

from bcid.likelihood.lane_rollout import segment_layout
from bcid.likelihood.marginal import student_log_densities
from bcid.likelihood.newton import derivatives_at, evaluate_at, slope_and_curvature, tangent_at
from bcid.likelihood.nuisance import about_no_pushes, linearise_nuisances, pose_residuals, posterior_step
from bcid.likelihood.predict import predict_poses
from bcid.likelihood.refit import Fit
from bcid.likelihood.refit_state import RefitProblem, RefitState, build_state, promised_to_all
from bcid.likelihood.scales import Scales
from bcid.likelihood.take import KNOTS, N_NUISANCE, N_START, Take, pad_with_zero_pushes
from bcid.likelihood.tangent_steps import SETTLED_NATS, damped_step

PUSHES = (0.8, 0.8, 2.0)  # m/s^2, m/s^2, rad/s^2


@pytest.fixture(scope="module")
def base() -> tuple[Fit, Take]:
    return concealing(60.0)


@pytest.fixture(scope="module")
def pushed_drive(base: tuple[Fit, Take]) -> tuple[Fit, Take, np.ndarray]:
    """The fitted car's own poses under large pushes, and initial states and pushes."""
    fit, take = base
    start = fit.start.copy()
    drawn = np.random.default_rng(4).standard_normal((take.segments, 3 * KNOTS))
    start[:, N_START:] = drawn * np.tile(PUSHES, KNOTS)
    inputs = fit.hypothesis.prediction_inputs(fit.phi, take)
    poses = np.asarray(predict_poses(segment_layout(take), start, *inputs.kernel_arguments))
    noise = np.random.default_rng(5).standard_normal(poses.shape) * fit.scales.r
    return fit, take._replace(pose=poses + noise), start


def settle(fit: Fit, take: Take, phi: np.ndarray, start: np.ndarray) -> RefitState:
    """A refit's state at `phi`, initial states and pushes moved from `start` to where they are likeliest."""
    problem = RefitProblem(take, fit.hypothesis, fit.hypothesis.prior(phi))
    return evaluate_at(problem, phi, start, Scales(fit.scales.r, np.array(PUSHES)), 0)


def test_a_linear_prediction_has_the_same_residual_about_any_pushes() -> None:
    rng = np.random.default_rng(1)
    first, A, r = np.array([0, 7, 20]), rng.standard_normal((20, 3, N_NUISANCE)), rng.standard_normal((20, 3))
    start = rng.standard_normal((2, N_NUISANCE))
    pushed = r - np.einsum("ncp,np->nc", A[:, :, N_START:], np.repeat(start[:, N_START:], [7, 13], axis=0))
    np.testing.assert_allclose(about_no_pushes(pushed, A, start, first), r, atol=1e-12)


def test_a_step_leads_initial_states_on_and_pushes_to_their_means() -> None:
    start, z = np.full((1, N_NUISANCE), 2.0), np.full((1, N_NUISANCE), 3.0)
    whole = (start + posterior_step(start, z))[0]
    assert (set(whole[:N_START]), set(whole[N_START:])) == ({5.0}, {3.0})


def test_a_damped_step_solves_the_damped_equations(pushed_drive: tuple[Fit, Take, np.ndarray]) -> None:
    """M and the slope found from the poses' derivatives; undamped it is the whole step."""
    fit, take, _ = pushed_drive
    problem = RefitProblem(take, fit.hypothesis, fit.hypothesis.prior(fit.phi))
    scales = Scales(fit.scales.r, np.array(PUSHES))
    at = linearise_nuisances(take, fit.hypothesis.prediction_inputs(fit.phi, take), fit.start)
    state = build_state(problem, fit.phi, fit.start, scales, at.r, at.A, 0)
    damping = np.linspace(0.0, 3.0, take.segments)
    stepped = damped_step(state.start, state.terms, damping)
    np.testing.assert_array_equal(stepped[0], posterior_step(state.start, state.terms.z)[0])
    for s in (1, take.segments // 2, take.segments - 1):
        own = slice(take.first[s], take.first[s + 1])
        A, r = (at.A[own] / scales.r[:, None]).reshape(-1, N_NUISANCE), (at.r[own] / scales.r).ravel()
        precision = scales.nuisance_precision()
        M, slope = A.T @ A + precision, A.T @ r - precision @ state.start[s]
        expected = np.linalg.solve(M + damping[s] * np.diag(np.diag(M)), slope)
        np.testing.assert_allclose(stepped[s], expected, rtol=1e-5, atol=1e-9)


def test_segments_settle_under_the_pushes_that_were_there(pushed_drive: tuple[Fit, Take, np.ndarray]) -> None:
    """From none: what is left of the poses is their noise, and no step promises more."""
    fit, take, true = pushed_drive
    state = settle(fit, take, fit.phi, fit.start)
    assert np.mean(promised_to_all(state.terms, state.start) < SETTLED_NATS) > 0.95
    r = pose_residuals(take, fit.hypothesis.prediction_inputs(fit.phi, take), state.start)
    assert np.sqrt(np.mean(r**2, axis=0)) == pytest.approx(fit.scales.r, rel=0.3)
    found, there = state.start[:, N_START:], true[:, N_START:]
    assert np.corrcoef(found.ravel(), there.ravel())[0, 1] > 0.95


def test_a_car_that_spins_is_followed_from_its_poses_alone(pushed_drive: tuple[Fit, Take, np.ndarray]) -> None:
    """Its rear tyres hold a tenth: where it is after a second says nothing of where it began until it is followed."""
    fit, take, pushed = pushed_drive
    car = fit.car()
    phi = fit.hypothesis.phi_of(car._replace(F_r_max=0.1 * car.F_r_max), [])
    inputs = fit.hypothesis.prediction_inputs(phi, take)
    poses = np.asarray(predict_poses(segment_layout(take), pushed, *inputs.kernel_arguments))
    spinning = take._replace(pose=poses + np.random.default_rng(5).standard_normal(poses.shape) * fit.scales.r)
    spinning = spinning._replace(start=pad_with_zero_pushes(rough_beginnings(spinning)))
    found, true = (settle(fit, spinning, phi, start) for start in (spinning.start, pushed))
    # on some machines, why is not known, a segment or two of 36 stop a few nats below where the truth leads
    assert np.mean(promised_to_all(found.terms, found.start) < SETTLED_NATS) > 0.9
    likelihoods = [student_log_densities(state.terms).sum() for state in (found, true)]
    assert likelihoods[0] == pytest.approx(likelihoods[1], abs=1.0)
    np.testing.assert_array_less(found.terms.chi2, 2.0 * found.terms.numbers)


def rough_beginnings(take: Take) -> np.ndarray:
    """The initial states (S, N_START) that straight lines through the first poses of each segment give."""
    begun = np.zeros((take.segments, N_START))
    for s, (first, after) in enumerate(pairwise(take.first.tolist())):
        time_s = take.seen_rows.time_s[first:after] + take.zero_s[s] - take.begin_s[s]
        x, y, yaw = (np.polyfit(time_s[:5], take.pose[first : first + 5, c], 1) for c in range(3))
        c, sn = np.cos(yaw[1]), np.sin(yaw[1])
        begun[s] = x[1], y[1], yaw[1], c * x[0] + sn * y[0], c * y[0] - sn * x[0], yaw[0]
    return begun


@pytest.mark.parametrize("share", [1.0 / 3.0, 0.5, 1.0])
def test_the_beginnings_of_a_take_are_its_first_rows(base: tuple[Fit, Take], share: float) -> None:
    take = base[1]
    begun = take.beginnings(share)
    kept = np.concatenate(
        [np.arange(a, a + np.ceil(share * (b - a)), dtype=int) for a, b in pairwise(take.first.tolist())]
    )
    np.testing.assert_array_equal(begun.pose, take.pose[kept])
    np.testing.assert_array_equal(begun.seen_rows.time_s, take.seen_rows.time_s[kept])
    np.testing.assert_allclose(np.bincount(begun.row, begun.share), 1.0)
    fit = base[0]
    whole = pose_residuals(take, fit.hypothesis.prediction_inputs(fit.phi, take), fit.start)
    part = pose_residuals(begun, fit.hypothesis.prediction_inputs(fit.phi, begun), fit.start)
    np.testing.assert_array_equal(part, whole[kept])


def test_pushes_that_do_not_belong_are_left(base: tuple[Fit, Take]) -> None:
    """As those that stood in for what a hypothesis has now."""
    fit, take = base
    off = fit.start.copy()
    off[:, N_START:] = 4.0 * np.tile(PUSHES, KNOTS)
    states = [settle(fit, take, fit.phi, start) for start in (fit.start, off)]
    each = [student_log_densities(state.terms) for state in states]
    np.testing.assert_allclose(each[1], each[0], atol=0.5)


def test_slopes_of_a_model_that_lacks_much_are_those_of_the_likelihood(
    pushed_drive: tuple[Fit, Take, np.ndarray],
) -> None:
    """Derivatives of predictions without the pushes that are there had the wrong sign for half of the parameters."""
    fit, take, _ = pushed_drive
    problem = RefitProblem(take, fit.hypothesis, fit.hypothesis.prior(fit.phi))
    phi = fit.phi.copy()
    phi[[fit.hypothesis.log_parameters.index(s) for s in ("K_t", "C_f", "C_r")]] += (0.1, -0.1, 0.1)
    state = settle(fit, take, phi, fit.start)
    state = settle(fit, take, phi, state.start)
    J = derivatives_at(problem, tangent_at(problem, state), state)
    slope, curvature = slope_and_curvature(problem, state, J)
    sd = 1.0 / np.sqrt(np.diag(curvature))
    for symbol in ("K_t", "C_f", "C_r"):
        j = fit.hypothesis.log_parameters.index(symbol)
        ends = []
        for sign in (1.0, -1.0):
            moved = phi.copy()
            moved[j] += sign * 0.3 * sd[j]
            ends.append(settle(fit, take, moved, state.start).worth)
        assert (ends[0] - ends[1]) / 0.6 == pytest.approx(slope[j] * sd[j], rel=0.3, abs=0.5)
