"""The likelihood that a diagnosis rests on: its linear algebra, its scales, its segments and its sensitivities."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from cars import CAR
from scipy.linalg import null_space
from scipy.stats import multivariate_t

from bcid.compiled.lanes import LANES
from bcid.effects.car import BodyState
from bcid.effects.constants import Constants
from bcid.effects.motion import integrate_body
from bcid.effects.table import EFFECTS, ENTRIES
from bcid.errors import PredictionDiverged
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning
from bcid.estimate.types import Estimate
from bcid.experiment.simulate import observe_states
from bcid.likelihood import following
from bcid.likelihood.following import answer_parameters, follow_parameters, move_initial_states
from bcid.likelihood.hypothesis import Hypothesis
from bcid.likelihood.jacobian import EFFECT_STEP, parameter_jacobian
from bcid.likelihood.lane_rollout import segment_layout
from bcid.likelihood.lane_start import first_lags_of_one, steps_of_recording
from bcid.likelihood.limits import LIKELIHOOD_LIMITS, SEGMENT_LIMITS
from bcid.likelihood.marginal import (
    NU,
    MarginalTerms,
    checked_marginal_terms,
    eliminate_nuisance,
    robust_weights,
    score_and_information,
    segment_moments,
    student_log_densities,
)
from bcid.likelihood.newton import derivatives_at, evaluate_at, tangent_at
from bcid.likelihood.nuisance import (
    linearise_nuisances,
    linearise_residuals,
    pose_residuals,
)
from bcid.likelihood.predict import pose_sensitivities, predict_poses
from bcid.likelihood.prediction_inputs import PredictionInputs
from bcid.likelihood.prepare import effect_constants
from bcid.likelihood.refit import evaluate_fixed, refit
from bcid.likelihood.refit_state import Effort, build_state
from bcid.likelihood.refit_state import RefitProblem as Fitted
from bcid.likelihood.scale_estimate import autoregression, estimate_scales
from bcid.likelihood.scales import Scales
from bcid.likelihood.score_test import affected_segments
from bcid.likelihood.take import (
    GROUP_S,
    KNOT_S,
    KNOTS,
    N_NUISANCE,
    N_START,
    SEGMENT_S,
    Take,
    concatenate_takes,
    cut_segments,
    drop_standing,
    drop_unknown_beginning,
)
from bcid.likelihood.triangles import cholesky_factor, inverse_of_triangle, log_determinant, solve_triangular
from bcid.recording.read import read_recording
from bcid.recording.types import Recording, Stream
from bcid.vehicle import Vehicle

LIMIT = 2.012
N_POSE_AND_FORWARD = 3  # where v_x stands among free parts
BASE = Hypothesis((), CAR, LIMIT, Constants())
RICH = BASE.with_effects("steering_lag", "steering_delay", "rough_patch")
RICH_VALUES = (0.02, 0.009, 60.0, 1.0, 0.5, 1.5)
both_hypotheses = pytest.mark.parametrize(("hypothesis", "values"), [(BASE, ()), (RICH, RICH_VALUES)])


# --- linear algebra ----------------------------------------------------------------------------------------------


class Problem(NamedTuple):
    """Residuals that follow the model, and columns of no meaning."""

    residual: np.ndarray  # (N, 3)
    A: np.ndarray  # (N, 3, N_NUISANCE)
    J: np.ndarray  # (N, 3, n)
    first: np.ndarray  # (S + 1,)
    scales: Scales

    def eliminated(self) -> MarginalTerms:
        return eliminate_nuisance(
            segment_moments(self.residual, self.A, self.first), self.scales.r, self.scales.nuisance_precision()
        )


def lasting_covariance(q: np.ndarray, rho: np.ndarray) -> np.ndarray:
    """Covariance (3 KNOTS, 3 KNOTS) of pushes of which each is correlated with those after it by rho, rho^2 ..."""
    apart = np.abs(np.subtract.outer(np.arange(KNOTS), np.arange(KNOTS)))
    out = np.zeros((KNOTS, 3, KNOTS, 3))
    for c in range(3):
        out[:, c, :, c] = q[c] ** 2 * rho[c] ** apart
    return out.reshape(3 * KNOTS, 3 * KNOTS)


def random_problem(segments: int = 4, n: int = 5) -> Problem:
    """Student's t segments: each one's noise and pushes are larger or smaller than the rest's together."""
    rng = np.random.default_rng(0)
    counts = rng.integers(8, 14, segments)
    first = np.r_[0, np.cumsum(counts)].astype(np.int64)
    N = int(first[-1])
    scales = Scales(np.array([0.01, 0.02, 0.03]), np.array([0.02, 0.05, 0.01]), np.array([0.4, 0.5, 0.2]))
    A, J = rng.standard_normal((N, 3, N_NUISANCE)), rng.standard_normal((N, 3, n))
    root = np.linalg.cholesky(lasting_covariance(scales.q, scales.rho))
    free = rng.standard_normal((segments, N_NUISANCE - N_START)) @ root.T
    z = np.column_stack([rng.standard_normal((segments, N_START)), free])
    noise = scales.r * rng.standard_normal((N, 3))
    larger = np.sqrt(NU / rng.chisquare(NU, segments)).repeat(counts)
    residual = larger[:, None] * (noise + np.einsum("ncf,nf->nc", A, z.repeat(counts, axis=0)))
    return Problem(residual, A, J, first, scales)


class Dense(NamedTuple):
    """One segment written out."""

    r: np.ndarray
    X: np.ndarray  # columns of the initial state
    pushes: np.ndarray  # columns of the pushes
    J: np.ndarray
    Q: np.ndarray
    S: np.ndarray
    of_start: np.ndarray  # covariance of the initial state found by least squares
    P: np.ndarray
    alike: np.ndarray  # what makes numbers alike: one over their noise, of geometric mean one


def dense(problem: Problem, s: int) -> Dense:
    rows = slice(problem.first[s], problem.first[s + 1])
    r, A = problem.residual[rows].ravel(), problem.A[rows].reshape(-1, N_NUISANCE)
    X, pushes = A[:, :N_START], A[:, N_START:]
    Q = lasting_covariance(problem.scales.q, problem.scales.rho)
    S = np.diag(np.tile(problem.scales.r**2, len(r) // 3)) + pushes @ Q @ pushes.T
    inverse = np.linalg.inv(S)
    of_start = np.linalg.inv(X.T @ inverse @ X)
    P = inverse - inverse @ X @ of_start @ X.T @ inverse
    noise = np.tile(problem.scales.r, len(r) // 3)
    alike = np.exp(np.log(noise).mean()) / noise
    return Dense(r, X, pushes, problem.J[rows].reshape(len(r), -1), Q, S, of_start, P, alike)


def test_elimination_is_the_dense_algebra() -> None:
    problem = random_problem()
    e = problem.eliminated()
    for s in range(len(problem.first) - 1):
        d = dense(problem, s)
        assert e.chi2[s] == pytest.approx(d.r @ d.P @ d.r, rel=1e-8)
        X = d.alike[:, None] * d.X
        log_det = np.linalg.slogdet(d.S)[1] - np.linalg.slogdet(d.of_start)[1] - np.linalg.slogdet(X.T @ X)[1]
        assert e.log_det[s] == pytest.approx(log_det, rel=1e-9)
        assert e.numbers[s] == len(d.r) - N_START


def test_how_far_a_model_lets_an_initial_state_go_does_not_make_it_likelier() -> None:
    """The same initial states in other units, or ones that are forgotten a hundred times sooner."""
    problem = random_problem()
    turned = np.random.default_rng(3).standard_normal((N_START, N_START))
    for change in (turned, np.diag([1.0, 1.0, 1.0, 1.0, 0.01, 0.01])):
        A = problem.A.copy()
        A[:, :, :N_START] = A[:, :, :N_START] @ change
        likelihood = student_log_densities(problem._replace(A=A).eliminated())
        np.testing.assert_allclose(likelihood, student_log_densities(problem.eliminated()), rtol=1e-6)


def test_which_motions_a_start_explains_makes_no_model_likelier() -> None:
    """Metres and radians have noise of their own sizes; as long as pushes are small beside it, any columns will do."""
    problem = random_problem()
    quiet = problem._replace(scales=problem.scales._replace(q=np.full(3, 1e-9)))
    other = quiet._replace(A=np.random.default_rng(5).standard_normal(quiet.A.shape) * [[[1.0], [3.0], [0.1]]])
    np.testing.assert_allclose(other.eliminated().log_det, quiet.eliminated().log_det, rtol=1e-9)


def test_the_posterior_is_generalised_least_squares() -> None:
    """The initial state as one finds it with the pushes among the noise, the pushes as one expects them then."""
    problem = random_problem()
    e = problem.eliminated()
    for s in range(len(problem.first) - 1):
        d = dense(problem, s)
        inverse = np.linalg.inv(d.S)
        start = d.of_start @ d.X.T @ inverse @ d.r
        pushes = d.Q @ d.pushes.T @ inverse @ (d.r - d.X @ start)
        np.testing.assert_allclose(e.z[s], np.r_[start, pushes], rtol=1e-7, atol=1e-12)
        V = np.empty((N_NUISANCE, N_NUISANCE))
        V[:N_START, :N_START] = d.of_start
        V[N_START:, N_START:] = d.Q - d.Q @ d.pushes.T @ d.P @ d.pushes @ d.Q
        V[:N_START, N_START:] = -d.of_start @ d.X.T @ inverse @ d.pushes @ d.Q
        V[N_START:, :N_START] = V[:N_START, N_START:].T
        np.testing.assert_allclose(e.V[s], V, atol=1e-9 * np.abs(V).max())
        A = np.column_stack([d.X, d.pushes])
        left, unsure = (d.r - A @ e.z[s]).reshape(-1, 3), np.diag(A @ V @ A.T).reshape(-1, 3)
        np.testing.assert_allclose(e.rest[s], (left**2).sum(axis=0), rtol=1e-6)
        np.testing.assert_allclose(e.spread[s], unsure.sum(axis=0), rtol=1e-7)


def test_slopes_and_information_are_the_dense_algebra() -> None:
    problem = random_problem()
    root = problem.eliminated().root
    g, G = score_and_information(problem.residual, problem.A, problem.J, problem.first, problem.scales.r, root)
    for s in range(len(problem.first) - 1):
        d = dense(problem, s)
        np.testing.assert_allclose(g[s], d.J.T @ d.P @ d.r, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(G[s], d.J.T @ d.P @ d.J, rtol=1e-7, atol=1e-6)


def test_what_a_start_explains_counts_for_nothing() -> None:
    """Any motion of the initial states leaves the likelihood alone, and has no slope itself."""
    problem = random_problem()
    e = problem.eliminated()
    start = np.random.default_rng(1).standard_normal((len(problem.first) - 1, N_START))
    shift = np.einsum("ncf,nf->nc", problem.A[:, :, :N_START], start.repeat(np.diff(problem.first), axis=0))
    moved = problem._replace(residual=problem.residual + shift).eliminated()
    np.testing.assert_allclose(moved.chi2, e.chi2, rtol=1e-6)
    np.testing.assert_allclose(moved.z[:, :N_START] - e.z[:, :N_START], start, rtol=1e-6)
    starts = problem.A[:, :, :N_START]
    g, G = score_and_information(problem.residual, problem.A, starts, problem.first, problem.scales.r, e.root)
    assert np.abs(g).max() < 1e-6
    assert np.abs(G).max() < 1e-6


def test_the_density_is_student_s_t() -> None:
    """Of the error contrasts: numbers that no initial state changes."""
    problem = random_problem()
    for s, log_density in enumerate(student_log_densities(problem.eliminated())):
        d = dense(problem, s)
        contrasts = d.alike[:, None] * null_space((d.alike[:, None] * d.X).T)
        law = multivariate_t(shape=contrasts.T @ d.S @ contrasts, df=NU)
        expected = law.logpdf(contrasts.T @ d.r)
        assert log_density == pytest.approx(expected, rel=1e-8)


def test_a_bad_segment_weighs_little() -> None:
    problem = random_problem()
    bad = slice(problem.first[1], problem.first[2])
    problem.residual[bad] += np.random.default_rng(1).standard_normal(problem.residual[bad].shape)
    w = robust_weights(problem.eliminated())
    assert w[1] < 0.01 * np.delete(w, 1).min()


def test_the_likeliest_autoregression_is_that_of_the_density() -> None:
    """By a search over its density, of drawn stretches; one that alternates counts as one that does not last."""
    rng = np.random.default_rng(2)
    for rho, q in ((0.0, 1.0), (0.3, 2.0), (0.8, 0.1), (-0.5, 1.0)):
        apart = np.abs(np.subtract.outer(np.arange(KNOTS), np.arange(KNOTS)))
        drawn = rng.standard_normal((400, KNOTS)) @ np.linalg.cholesky(q**2 * rho**apart).T
        products = drawn.T @ drawn / len(drawn)

        def cost(at: np.ndarray, products: np.ndarray = products, apart: np.ndarray = apart) -> float:
            S = at[0] * at[1] ** apart
            return float(np.linalg.slogdet(S)[1] + np.trace(np.linalg.solve(S, products)))

        variance, found = (each[0] for each in autoregression(products[None], np.full(1, 0.95)))
        near = np.clip(found + np.array([-0.02, 0.02]), 0.0, 0.95)
        grid = [np.array([v * variance, r]) for v in (0.98, 1.0, 1.02) for r in near]
        assert cost(np.array([variance, found])) <= min(map(cost, grid)) + 1e-6
        assert found == pytest.approx(max(rho, 0.0), abs=0.08)
        assert autoregression(products[None], np.full(1, 0.2))[1][0] == pytest.approx(min(found, 0.2), abs=1e-6)


def test_em_ends_where_the_likelihood_is_stationary() -> None:
    """In the units of the noise that it finds, which stand; and on its way there the likelihood never falls.

    The scales that it finds are the problem's.
    """
    problem = random_problem(segments=60)
    of = segment_moments(problem.residual, problem.A, problem.first)

    def of_start(r: np.ndarray) -> np.ndarray:
        alike = np.exp(2.0 * np.log(r).mean()) / r**2
        return np.linalg.slogdet(np.einsum("c,scij->sij", alike, of.AA)[:, :N_START, :N_START])[1]

    def total(at: np.ndarray) -> float:
        tried = Scales(np.exp(at[:3]), np.exp(at[3:6]), at[6:])
        e = eliminate_nuisance(of, tried.r, tried.nuisance_precision())
        return float(
            student_log_densities(e._replace(log_det=e.log_det + of_start(tried.r) - of_start(scales.r))).sum()
        )

    scales, path = Scales(3.0 * problem.scales.r, 0.2 * problem.scales.q), []
    for _ in range(60):
        scales, e = estimate_scales(of, scales, 1)
        path.append(float(student_log_densities(e).sum()))
    assert (np.diff(path) > -1e-6).all()
    for _ in range(500):  # beyond where many steps at once would call it settled
        scales, _ = estimate_scales(of, scales, 1)
    end, h = np.r_[np.log(np.r_[scales.r, scales.q]), scales.rho], 1e-3
    there = total(end)
    for j, truth in enumerate(np.r_[np.log(np.r_[problem.scales.r, problem.scales.q]), problem.scales.rho]):
        up, down = (total(end + sign * h * np.eye(9)[j]) for sign in (1.0, -1.0))
        slope, curvature = (up - down) / (2.0 * h), -(up - 2.0 * there + down) / h**2
        assert curvature > 0.0
        assert abs(slope) < 1e-3 * np.sqrt(curvature)  # a thousandth of a standard error away
        assert abs(end[j] - truth) < 4.0 / np.sqrt(curvature)


# --- takes -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def estimate(recording: Recording, vehicle: Vehicle, tuning: Tuning) -> Estimate:
    return estimate_motion(recording, vehicle, tuning)


@pytest.fixture(scope="module")
def take(recording: Recording, estimate: Estimate) -> Take:
    return cut_segments(recording, estimate)


@pytest.fixture(scope="module")
def part(take: Take) -> Take:
    """Segments with full lock, reversing and the patch among them."""
    return take.part(np.arange(4, 24, 2))


def test_segments_cover_the_take(take: Take) -> None:
    assert take.segments == pytest.approx(60.0 / SEGMENT_S, abs=2)
    for s in range(take.segments):
        stamps = take.stamp_s[take.first_stamp[s] : take.first_stamp[s + 1]]
        assert (np.diff(stamps) > 0).all()
        assert stamps[0] >= take.begin_s[s] - 1e-6
        assert stamps[-1] < take.begin_s[s] + SEGMENT_S
        rows = take.row[take.first_stamp[s] : take.first_stamp[s + 1]]
        assert rows[0] == take.first[s]
        assert rows[-1] == take.first[s + 1] - 1


def test_a_row_is_the_mean_of_a_group(take: Take, recording: Recording) -> None:
    """Every pose at 60 Hz counts once, with its neighbours within 0.05 s."""
    at = np.searchsorted(recording.poses.time_s - recording.poses.time_s[0], take.stamp_s)
    poses, counts = recording.poses.values[at], np.bincount(take.row)
    np.testing.assert_allclose(take.pose, _means(take, poses), rtol=0, atol=1e-12)
    np.testing.assert_allclose(take.share, 1.0 / counts[take.row])
    assert (np.diff(take.row) >= 0).all()
    assert np.mean(counts == 3) > 0.95
    groups = np.split(take.stamp_s, np.flatnonzero(np.diff(take.row)) + 1)
    assert max(np.ptp(g) for g in groups) < GROUP_S


def _means(of: Take, values: np.ndarray) -> np.ndarray:
    """Means (N, 3) over the rows of `of`."""
    return np.column_stack([np.bincount(of.row, values[:, c]) for c in range(3)]) / np.bincount(of.row)[:, None]


@both_hypotheses
def test_the_prediction_of_a_mean_is_the_mean_of_predictions(
    take: Take, hypothesis: Hypothesis, values: tuple[float, ...]
) -> None:
    each = segment_layout(take)._replace(
        row=np.arange(len(take.stamp_s)), share=np.ones(len(take.stamp_s)), first=take.first_stamp
    )
    setting = hypothesis.prediction_inputs(hypothesis.phi_of(CAR, values), take)
    one_by_one = predict_poses(each, take.start, *setting.kernel_arguments)
    together = predict_poses(segment_layout(take), take.start, *setting.kernel_arguments)
    np.testing.assert_allclose(together, _means(take, one_by_one), rtol=0, atol=1e-12)


def test_slow_poses_are_one_to_a_row(recording: Recording, estimate: Estimate) -> None:
    poses = recording.poses
    slow = cut_segments(replace(recording, poses=Stream(poses.time_s[::6], poses.values[::6]), rate_hz=10.0), estimate)
    assert slow.segments == pytest.approx(60.0 / SEGMENT_S, abs=2)
    np.testing.assert_array_equal(slow.row, np.arange(len(slow.stamp_s)))
    np.testing.assert_array_equal(slow.share, 1.0)
    np.testing.assert_array_equal(slow.first_stamp, slow.first)
    at = np.searchsorted(poses.time_s - poses.time_s[0], slow.stamp_s)
    np.testing.assert_array_equal(slow.pose, poses.values[at])


def test_a_part_is_its_segments(take: Take) -> None:
    chosen = np.array([3, 7])
    part = take.part(chosen)
    setting = BASE.prediction_inputs(BASE.phi_of(CAR), take)
    r, whole = pose_residuals(part, setting, part.start), pose_residuals(take, setting, take.start)
    rows = np.concatenate([np.arange(take.first[s], take.first[s + 1]) for s in chosen])
    np.testing.assert_array_equal(r, whole[rows])


@pytest.mark.parametrize("chosen", [[3, 7, 5], [0], []])
def test_the_rows_of_some_segments_are_theirs_in_their_order(take: Take, chosen: list[int]) -> None:
    rows = [row for s in chosen for row in range(take.first[s], take.first[s + 1])]
    some = np.array(chosen, dtype=np.int64)
    assert take.rows(some).tolist() == rows
    assert np.diff(take.part(some).first).tolist() == [take.first[s + 1] - take.first[s] for s in chosen]


def test_what_stands_still_is_left_out(take: Take) -> None:
    pose = take.pose.copy()
    for s, moves in ((2, 0.0), (5, 1e-3), (8, 0.05)):  # metres: at rest, trembling, and creeping
        a, b = take.first[s], take.first[s + 1]
        pose[a:b] = pose[a]
        pose[a:b, 0] += np.linspace(0.0, moves, b - a)
    turning = slice(take.first[11], take.first[12])
    pose[turning] = pose[take.first[11]]
    pose[turning, 2] += np.linspace(0.0, 0.1, turning.stop - turning.start)
    kept = drop_standing(take._replace(pose=pose), 0.87)
    still = set(np.round(take.begin_s, 6)) - set(np.round(kept.begin_s, 6))
    assert {round(take.begin_s[s], 6) for s in (2, 5)} <= still
    assert not {round(take.begin_s[s], 6) for s in (8, 11)} & still
    assert drop_standing(take._replace(pose=np.zeros_like(pose)), 0.87).segments == 0


@pytest.mark.parametrize(
    ("name", "values"),
    [("rough_patch", [60.0, 1.0, 0.5, 0.9]), ("slippery_patch", [0.6, 1.0, 0.5, 1.2]), ("mass_change", [0.2, 30.0])],
)
def test_what_an_effect_cannot_change_need_not_be_predicted(take: Take, name: str, values: list[float]) -> None:
    more = BASE.with_effects(name)
    setting = BASE.prediction_inputs(BASE.phi_of(CAR), take)
    r = pose_residuals(take, setting, take.start)
    change = r - pose_residuals(take, more.prediction_inputs(more.phi_of(CAR, values), take), take.start)
    at = {p.symbol: v for p, v in zip(more.entries[name].parameters, values, strict=True)}
    chosen = affected_segments(take, take.pose - r, at)
    others = np.setdiff1d(np.arange(take.segments), chosen)
    assert 0 < len(chosen) < take.segments
    assert np.abs(change[take.rows(chosen)]).max() > 1e-3
    np.testing.assert_array_equal(change[take.rows(others)], 0.0)


def joined_and_apart(take: Take, path: Path, vehicle: Vehicle, tuning: Tuning) -> tuple[Take, Take]:
    """`take` joined with the one at `path`, and the latter's segments that are kept."""
    recording = read_recording(path, vehicle)
    other = cut_segments(recording, estimate_motion(recording, vehicle, tuning))
    later = drop_unknown_beginning(other, CAR.T_s, CAR.d, LIMIT)
    return concatenate_takes([take, later]), later


def test_joined_takes_hold_both(take: Take, takes: dict[str, Path], vehicle: Vehicle, tuning: Tuning) -> None:
    whole, later = joined_and_apart(take, takes["other"], vehicle, tuning)
    assert whole.segments == take.segments + later.segments
    assert whole.T >= take.T + later.T
    for times in (whole.stamp_s, whole.command_s, whole.step):
        assert (np.diff(times) > 0).all()
    np.testing.assert_array_equal(whole.part(np.arange(take.segments, whole.segments)).pose, later.pose)
    ahead = whole.begin_s[-1] - later.begin_s[-1]
    np.testing.assert_allclose(whole.stamp_s[len(take.stamp_s) :], later.stamp_s + ahead)
    np.testing.assert_allclose(whole.command_s[len(take.command_s) :], later.command_s + ahead)


@pytest.mark.parametrize(
    ("effects", "values"),
    [((), ()), (("motor_sag", "mass_change"), (0.3, 0.15, 20.0)), (("clock_drift",), (1e-3,))],
)
def test_joined_takes_are_predicted_as_each_alone(
    effects: tuple[str, ...], values: tuple[float, ...], take: Take, takes: dict[str, Path], vehicle: Vehicle,
    tuning: Tuning,
) -> None:  # fmt: skip
    """What acts over time counts from each recording's own beginning."""
    whole, later = joined_and_apart(take, takes["other"], vehicle, tuning)
    hypothesis = BASE.with_effects(*effects)
    phi = hypothesis.phi_of(CAR, values)
    r = [pose_residuals(t, hypothesis.prediction_inputs(phi, t), t.start) for t in (take, later, whole)]
    np.testing.assert_allclose(r[2], np.concatenate(r[:2]), rtol=0, atol=1e-5)


@pytest.mark.parametrize("stood", [-1.5, 0.4])
def test_where_the_wheel_stood_before_the_first_command_does_not_matter(take: Take, stood: float) -> None:
    """Predicted as if a command before all others had steered it there, or as if the first one always had held."""
    known = drop_unknown_beginning(take, CAR.T_s, CAR.d, LIMIT)
    assert 0 < take.segments - known.segments <= 4
    before = np.r_[take.command_s[0] - 1e-3, take.command_s]
    command = np.vstack([[stood, 0.0, 0.0], take.command])
    steered = {"command_s": before, "command": command, "command_zero_s": 0.0 * before}
    setting = BASE.prediction_inputs(BASE.phi_of(CAR), take)
    other = BASE.prediction_inputs(BASE.phi_of(CAR), take._replace(**steered))
    angles = [s.kernel_arguments[0].delta for s in (setting, other)]
    begin = round(known.begin_s[0] / (0.5 * take.h))
    assert np.abs(angles[0] - angles[1])[:begin].max() > 100 * LIKELIHOOD_LIMITS.unknown_wheel_angle_rad
    assert np.abs(angles[0] - angles[1])[begin:].max() <= LIKELIHOOD_LIMITS.unknown_wheel_angle_rad


def test_commands_before_the_first_pose_forget_nothing(take: Take) -> None:
    """The chain begins with the poses."""
    early = np.r_[take.command_s[0] - 60.0, take.command_s]
    longer = take._replace(command_s=early, command=np.vstack([take.command[:1], take.command]))
    known = drop_unknown_beginning(longer, CAR.T_s, CAR.d, LIMIT)
    np.testing.assert_array_equal(known.step, drop_unknown_beginning(take, CAR.T_s, CAR.d, LIMIT).step)


def test_predictions_join_the_estimate(take: Take) -> None:
    """With nearly the true constants the poses of a segment are predicted to centimetres from the estimated start."""
    r = pose_residuals(take, BASE.prediction_inputs(BASE.phi_of(CAR), take), take.start)
    assert np.sqrt((r[:, :2] ** 2).mean()) < 0.03
    assert np.sqrt((r[:, 2] ** 2).mean()) < 0.03


def square_of(root: np.ndarray) -> np.ndarray:
    return root.T @ root


@pytest.mark.parametrize("condition", [1.0, 1e6, 1e12])
def test_forms_are_inverted(condition: float) -> None:
    """The logarithm to N_NUISANCE roundings, of as many pivots: how a machine's BLAS orders its sums is its own."""
    rng = np.random.default_rng(1)
    turned = np.linalg.qr(rng.standard_normal((N_NUISANCE, N_NUISANCE)))[0]
    sizes = np.geomspace(1.0, condition, N_NUISANCE)
    L = cholesky_factor((turned * sizes) @ turned.T)
    np.testing.assert_allclose(square_of(inverse_of_triangle(L)), (turned / sizes) @ turned.T, atol=1e-15 * condition)
    assert log_determinant(L) == pytest.approx(np.log(sizes).sum(), abs=N_NUISANCE * np.finfo(float).eps * condition)


@pytest.mark.parametrize("no_form", [-1.0, 0.0, np.inf, np.nan])
def test_what_is_no_form_has_no_value(no_form: float) -> None:
    M = np.eye(N_NUISANCE)
    M[4, 4] = no_form
    L = cholesky_factor(M)
    for value in (inverse_of_triangle(L)[4:, 4], log_determinant(L), *solve_triangular(L, np.ones(N_NUISANCE))):
        assert np.isnan(value).all()


def test_what_is_hardly_shown_does_not_spoil_a_sum_of_squares() -> None:
    """A segment in which a car stands hardly shows a part of its initial state, and nearly all of it is explained."""
    rng = np.random.default_rng(2)
    n, rows = N_NUISANCE, 90
    A = 1e3 * np.linalg.qr(rng.standard_normal((rows, n)))[0] * np.geomspace(1.0, 1e-6, n)
    A = A @ np.linalg.qr(rng.standard_normal((n, n)))[0]
    z, noise = rng.standard_normal(n), rng.standard_normal(rows)
    r = A @ (z / np.linalg.norm(A @ z)) * 2e3 + noise
    M, b = A.T @ A, A.T @ r
    L = cholesky_factor(M)
    y, _ = solve_triangular(L, b)
    exact = np.sum((r - A @ np.linalg.lstsq(A, r, rcond=None)[0]) ** 2)
    assert r @ r - y @ y == pytest.approx(exact, abs=0.1)
    assert abs(r @ r - b @ square_of(inverse_of_triangle(L)) @ b - exact) > 1.0  # as it was computed


# --- sensitivities -----------------------------------------------------------------------------------------------


def pushed(take: Take, start: np.ndarray, pushes: np.ndarray, setting: PredictionInputs) -> np.ndarray:
    """Mean poses (N, 3) of all rows, every segment under its `pushes` (S, KNOTS, 3): one car after the other."""
    out, chain = np.zeros((take.first[-1], 3)), setting.chain
    for s in range(take.segments):
        own = chain._replace(t_0=chain.t_0 - take.zero_s[s])
        b, each = BodyState(*start[s, :N_START]), take.steps // KNOTS
        driving, acting = (own, take.length_s[s]), (setting.car, setting.switches, setting.constants)
        lags = first_lags_of_one(b, take.step[s], steps_of_recording(take.step[s], own), *driving, *acting)
        true = integrate_body(b, lags, take.step[s], take.steps, *driving, pushes[s], each, *acting)[:, :6].copy()
        mine = slice(take.first_stamp[s], take.first_stamp[s + 1])
        seen = observe_states(take.stamp_s[mine] - take.begin_s[s], true, setting)
        np.add.at(out, take.row[mine], take.share[mine, None] * seen)
    return out


@pytest.mark.parametrize("name", sorted(ENTRIES))
def test_segments_abreast_are_each_a_car_of_its_own(part: Take, name: str) -> None:
    """Whatever the effect, at rest and under pushes; the number of segments fills no whole number of vectors."""
    own_law = {"motor_fade": {"sets_force": 1.0, "K_v": 20.0}, "throttle_timing": {"follows_wheel": 1.0}}
    car = CAR._replace(**own_law.get(name, {}))
    base = replace(BASE, raw_commands=True, nominal=car)
    own, few = base.entries[name].parameters, part
    values = AT_PLACES.get(name, [30.0 if p.symbol == "t_s" else 2.0 if p.is_place else 3.0 * p.size for p in own])
    hypothesis = base.with_effects(name)
    setting = hypothesis.prediction_inputs(hypothesis.phi_of(base.nominal, values), few)
    assert few.segments > LANES
    assert few.segments % LANES
    for start in (few.start, shoved(few)):
        push = start[:, N_START:].reshape(-1, KNOTS, 3) * [CAR.m, CAR.m, CAR.I_z]
        each = pushed(few, start, push, setting)
        abreast = predict_poses(segment_layout(few), start, *setting.kernel_arguments)
        # a car that spins lets rounding grow: as far as a start that is 1e-14 off leads
        beside = predict_poses(segment_layout(few), start + 1e-14, *setting.kernel_arguments)
        assert (np.abs(abreast - each) <= 1e-8 + np.abs(beside - abreast)).all()
        some = np.array([1, few.segments - 1])  # whoever drives beside it, to the last bit
        beside = predict_poses(segment_layout(few.part(some)), start[some], *setting.kernel_arguments)
        np.testing.assert_array_equal(beside, abreast[few.rows(some)])


def misses(columns: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """By how much every column (N, 3, n) differs at most, as a share of its own largest number."""
    worst, largest = (np.abs(x).max(axis=(0, 1)) for x in (columns - expected, expected))
    return np.where(worst > 0.0, worst / np.maximum(largest, 1e-12), 0.0)


def agree(columns: np.ndarray, expected: np.ndarray) -> bool:
    """Whether the columns are the differences `expected`: to 5 % where the car's law has a kink, else far better."""
    apart = misses(columns, expected)
    return bool(apart.max() < 0.05 and np.median(apart) < 2e-3)


def shoved(take: Take, q: tuple[float, float, float] = (0.3, 0.3, 1.0)) -> np.ndarray:
    """The take's nuisance parameters (S, N_NUISANCE) with pushes of the sizes `q` in every knot."""
    start = take.start.copy()
    start[:, N_START:] = np.random.default_rng(4).standard_normal((take.segments, 3 * KNOTS)) * np.tile(q, KNOTS)
    return start


@both_hypotheses
def test_free_sensitivities_are_central_differences(
    part: Take, hypothesis: Hypothesis, values: tuple[float, ...]
) -> None:
    """At rest, and under pushes."""
    setting, of, h = hypothesis.prediction_inputs(hypothesis.phi_of(CAR, values), part), segment_layout(part), 1e-4
    for start in (part.start, shoved(part)):
        A = pose_sensitivities(of, start, *setting.kernel_arguments)
        columns = []
        for step in np.eye(N_NUISANCE):
            up, down = (predict_poses(of, start + sign * h * step, *setting.kernel_arguments) for sign in (1.0, -1.0))
            columns.append((up - down) / (2.0 * h))
        assert agree(A, np.stack(columns, axis=2))


AT_PLACES = {"slippery_patch": (0.4, 1.0, 0.5, 1.5), "tether_pull": (20.0, 0.0, 0.0, 1.0), "floor_slope": (0.2, -0.1)}


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_initial_poses_move_as_the_car_would_drive_there(part: Take, name: str) -> None:
    """Under whatever effect: its trajectory as one, unless places or headings differ."""
    own = BASE.entries[name].parameters
    values = AT_PLACES.get(name, [2.0 if p.is_place else 5.0 * p.size for p in own])
    hypothesis, few = BASE.with_effects(name), part.part(np.arange(0, part.segments, 8))
    setting, of, h = hypothesis.prediction_inputs(hypothesis.phi_of(CAR, values), few), segment_layout(few), 1e-4
    A = pose_sensitivities(of, few.start, *setting.kernel_arguments)[:, :, :3]
    columns = []
    for step in np.eye(N_NUISANCE)[:3]:
        up, down = (predict_poses(of, few.start + sign * h * step, *setting.kernel_arguments) for sign in (1.0, -1.0))
        columns.append((up - down) / (2.0 * h))
    assert agree(A, np.stack(columns, axis=2))


def test_pushes_are_wrenches_by_mass_and_inertia(part: Take) -> None:
    setting, of = BASE.prediction_inputs(BASE.phi_of(CAR), part), segment_layout(part)
    push = np.resize([[0.1, -0.2, 0.3], [0.0, 0.1, -0.5], [0.2, 0.0, 0.1]], (KNOTS, 3))
    start = part.start.copy()
    start[:, N_START:] = push.ravel()
    all_alike = np.broadcast_to(push * [CAR.m, CAR.m, CAR.I_z], (part.segments, KNOTS, 3))
    there = pushed(part, part.start, all_alike, setting)
    np.testing.assert_allclose(predict_poses(of, start, *setting.kernel_arguments), there, rtol=0.0, atol=1e-12)
    assert np.abs(there - predict_poses(of, part.start, *setting.kernel_arguments)).max() > 0.01


def test_a_push_acts_in_its_own_time(part: Take) -> None:
    """Not before it begins; and a push of 1 m/s^2 for the time h of a knot moves the car by some h^2/2.

    The last row that ends with the knot is the mean of GROUP_S, half of that before its end.
    """
    A = pose_sensitivities(
        segment_layout(part), part.start, *BASE.prediction_inputs(BASE.phi_of(CAR), part).kernel_arguments
    )
    begin = part.begin_s.repeat(np.diff(part.first_stamp))
    last = np.bincount(part.row, part.stamp_s - begin) / np.bincount(part.row)
    for knot in range(KNOTS):
        own = A[:, :, N_START + 3 * knot : N_START + 3 * knot + 2]
        np.testing.assert_array_equal(own[last < KNOT_S * knot - GROUP_S], 0.0)
        after = (last > KNOT_S * (knot + 1) - GROUP_S) & (last < KNOT_S * (knot + 1))
        assert np.hypot(*own[after][:, :2, 0].T).max() == pytest.approx(0.5 * (KNOT_S - 0.5 * GROUP_S) ** 2, rel=0.3)


LOUD = Scales(np.array([5e-4, 5e-4, 1e-3]), np.array([0.3, 0.3, 1.0]))


def quietly(take: Take) -> tuple[Take, Fitted, np.ndarray]:
    """The base model's own poses with a little noise, the problem at its parameters, and these."""
    phi = BASE.phi_of(CAR)
    noise = np.random.default_rng(5).standard_normal(take.pose.shape) * LOUD.r
    made = take._replace(
        pose=np.asarray(
            predict_poses(segment_layout(take), take.start, *BASE.prediction_inputs(phi, take).kernel_arguments)
        )
        + noise
    )
    return made, Fitted(made, BASE, BASE.prior(phi)), phi


def test_a_segment_that_is_thrown_off_holds_no_other_where_it_is(part: Take) -> None:
    """All begin 5 cm/s off, and what is left of one asks for a car at 60 m/s."""
    take, of, phi = quietly(part)
    start = take.start + 0.05 * (np.arange(N_NUISANCE) == N_POSE_AND_FORWARD)
    at = linearise_residuals(take, BASE.prediction_inputs(phi, take), start)
    now = build_state(of, phi, start, LOUD, at.r, at.A, 0)
    z = now.terms.z.copy()
    z[3, N_POSE_AND_FORWARD] += 60.0
    there = move_initial_states(of, now._replace(terms=now.terms._replace(z=z)))
    others = np.arange(take.segments) != 3
    np.testing.assert_array_equal(there.start[3], start[3])
    np.testing.assert_allclose(there.start[others, :N_START], (start + now.terms.z)[others, :N_START])
    assert (student_log_densities(there.terms) > student_log_densities(now.terms) - SEGMENT_LIMITS.max_loss_nats).all()
    np.testing.assert_allclose(there.r, of.residuals(phi, there.start), atol=1e-12)


# --- initial states that go along with the parameters --------------------------------------------------------------


def test_initial_states_and_pushes_take_up_what_they_can_of_a_change(part: Take) -> None:
    """They move as the likeliest ones do when the residual changes, and what they have yet to earn stays to earn."""
    take, of, phi = quietly(part)
    rng = np.random.default_rng(6)
    off = np.r_[np.full(N_START, 1e-3), np.full(N_NUISANCE - N_START, 0.03)]
    start = take.start + off * rng.standard_normal(take.start.shape)
    at = linearise_residuals(take, BASE.prediction_inputs(phi, take), start)
    now = build_state(of, phi, start, LOUD, at.r, at.A, 0)
    J, step = rng.normal(0.0, 0.01, (*at.r.shape, BASE.size)), 1e-6 * rng.standard_normal(BASE.size)
    answers = answer_parameters(of, now, J)
    then = build_state(of, phi, start, LOUD, at.r - 1e6 * J @ step, at.A, 0)
    np.testing.assert_allclose(1e6 * answers @ step, then.terms.z - now.terms.z, rtol=1e-6, atol=1e-9)
    there, r = follow_parameters(of, now, phi + step, answers)
    np.testing.assert_allclose(there, start + answers @ step)
    np.testing.assert_allclose(r, of.residuals(phi + step, there), atol=1e-12)
    held, _ = follow_parameters(of, now, phi, answers)
    np.testing.assert_array_equal(held, start)


@pytest.mark.parametrize("lost", [False, True])
def test_a_segment_that_is_misled_stays_where_it_began(part: Take, lost: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its initial state would go 60 m/s too fast; it goes along all the same where its prediction is lost otherwise."""
    take, of, phi = quietly(part)
    now = evaluate_at(of, phi, take.start, LOUD, 0)
    answers = answer_parameters(of, now, derivatives_at(of, tangent_at(of, now), now))
    answers[3, N_POSE_AND_FORWARD, 1] += 6e4
    after = phi + 1e-3 * (np.arange(BASE.size) == 1)
    if lost:
        monkeypatch.setattr(following.nuisance, "pose_residuals", lambda part, *_: np.full_like(part.pose, np.nan))
    there, r = follow_parameters(of, now, after, answers)
    others = np.arange(take.segments) != 3
    assert (there[3] != now.start[3]).any() == lost
    np.testing.assert_array_equal(there[others], (now.start + answers @ (after - phi))[others])
    monkeypatch.undo()
    np.testing.assert_allclose(r, of.residuals(after, there), atol=1e-9)


def test_a_segment_that_has_strayed_begins_anew_alone(part: Take) -> None:
    take, of, phi = quietly(part)
    start = take.start.copy()
    start[3, :N_START] += [3.0, -2.0, 1.5, 4.0, -4.0, 3.0]
    near, strayed = evaluate_at(of, phi, take.start, LOUD, 0), evaluate_at(of, phi, start, LOUD, 0)
    each = [student_log_densities(state.terms) for state in (near, strayed)]
    assert each[1][3] == pytest.approx(each[0][3], abs=1.0)
    others = np.arange(take.segments) != 3
    np.testing.assert_array_equal(strayed.start[others], near.start[others])
    rows = np.repeat(others, np.diff(take.first))
    np.testing.assert_array_equal(strayed.A[rows], near.A[rows])
    setting = BASE.prediction_inputs(phi, take)
    np.testing.assert_allclose(strayed.r, pose_residuals(take, setting, strayed.start), atol=1e-12)
    # derivatives are those there, or make the segment as likely as those would
    anew = build_state(of, phi, strayed.start, LOUD, strayed.r, linearise_nuisances(take, setting, strayed.start).A, 0)
    np.testing.assert_allclose(each[1], student_log_densities(anew.terms), atol=0.01)


def test_a_segment_that_does_not_tell_its_initial_state_is_out_of_the_numbers(part: Take) -> None:
    r, A = np.zeros((len(part.pose), 3)), np.ones((len(part.pose), 3, N_NUISANCE))
    with pytest.raises(PredictionDiverged, match="rounding"):
        estimate_scales(segment_moments(r, A, part.first), Scales(np.ones(3), np.full(3, np.inf)), 0)


def test_parameters_as_they_stand_are_as_likely_as_a_refit_without_a_step(part: Take) -> None:
    setting = BASE.prediction_inputs(BASE.phi_of(CAR), part)
    pose = np.asarray(predict_poses(segment_layout(part), shoved(part), *setting.kernel_arguments))
    take = part._replace(pose=pose)
    phi = BASE.phi_of(CAR._replace(C_f=1.1 * CAR.C_f))
    stands = evaluate_fixed(take, BASE, phi, LOUD)
    again = refit(take, BASE, phi, stands.start, stands.scales, Effort(tangents=0))
    np.testing.assert_allclose(stands.per_segment, again.per_segment, atol=0.1)
    # from initial states that have not settled a refit is less likely, if anything
    refitted = refit(take, BASE, phi, take.start, LOUD, Effort(tangents=0))
    assert -0.1 < stands.log_likelihood - refitted.log_likelihood < 10.0
    np.testing.assert_array_equal(stands.phi, phi)


@both_hypotheses
def test_the_jacobian_is_central_differences(part: Take, hypothesis: Hypothesis, values: tuple[float, ...]) -> None:
    """But for a patch's place: where its edge is crossed between two steps cannot be seen."""
    phi = hypothesis.phi_of(CAR, values)
    r = pose_residuals(part, hypothesis.prediction_inputs(phi, part), part.start)
    smooth = range(hypothesis.base_size + min(len(values), 3))
    J = parameter_jacobian(part, hypothesis, phi, part.start, r, smooth)
    columns = []
    for j in smooth:
        step = np.eye(len(phi))[j] * (1e-4 if j < hypothesis.base_size else 0.01)
        up, down = (
            predict_poses(
                segment_layout(part),
                part.start,
                *hypothesis.prediction_inputs(phi + sign * step, part).kernel_arguments,
            )
            for sign in (1.0, -1.0)
        )
        columns.append((up - down) / (2.0 * np.abs(step).max()))
    assert agree(J, np.stack(columns, axis=2))


def test_a_place_has_a_slope(part: Take) -> None:
    """Towards the patch that is there a part of the way explains a part of the misfit."""
    phi = RICH.phi_of(CAR, RICH_VALUES)
    setting = RICH.prediction_inputs(phi, part)
    r = pose_residuals(part, setting, part.start)
    J = parameter_jacobian(part, RICH, phi, part.start, r, range(RICH.size - 3, RICH.size))
    for column, move in zip(np.moveaxis(J, 2, 0), 0.15 * np.eye(3), strict=True):
        there = RICH.prediction_inputs(phi + np.r_[np.zeros(RICH.size - 3), move], part)
        change = r - pose_residuals(part, there, part.start)
        assert np.corrcoef(change.ravel(), column.ravel())[0, 1] > 0.7


def test_a_difference_stays_within_the_bounds(part: Take) -> None:
    hypothesis = BASE.with_effects("tyre_soft_saturation", "steering_lag")
    size = 0.8  # declared with the effect
    for share in (1.0, 1.0 - 0.5 * EFFECT_STEP * size):
        phi = hypothesis.phi_of(CAR, [share, 0.014])
        r = pose_residuals(part, hypothesis.prediction_inputs(phi, part), part.start)
        J = parameter_jacobian(part, hypothesis, phi, part.start, r, range(hypothesis.size))
        less = hypothesis.prediction_inputs(hypothesis.phi_of(CAR, [share - EFFECT_STEP * size, 0.014]), part)
        expected = (pose_residuals(part, less, part.start) - r) / EFFECT_STEP
        assert misses(J[:, :, -2:-1], expected[:, :, None]).max() < 1e-9
        last = range(hypothesis.size - 1, hypothesis.size)
        np.testing.assert_array_equal(parameter_jacobian(part, hypothesis, phi, part.start, r, last), J[:, :, -1:])


# --- hypotheses --------------------------------------------------------------------------------------------------


def test_one_effect_more_has_the_sizes_it_is_given_and_all_else_stays() -> None:
    lag = BASE.with_effects("motor_lag")
    phi = lag.phi_of(CAR, [0.2])
    more, longer = lag.add_effect("floor_slope", phi, [0.01, -0.02])
    assert more.effects == ("motor_lag", "floor_slope")
    np.testing.assert_array_equal(longer, more.phi_of(CAR, [0.2, 0.01, -0.02]))
    np.testing.assert_array_equal(longer[: len(phi)], phi)


@pytest.mark.parametrize("unknown", [(), ("T_s", "d")])
@pytest.mark.parametrize("sets_force", [0.0, 1.0])
def test_phi_and_the_car_are_one(unknown: tuple[str, ...], sets_force: float) -> None:
    car = CAR._replace(sets_force=sets_force, u_0=0.1, K_v=30.0)
    hypothesis = Hypothesis(("motor_lag", "floor_slope"), car, LIMIT, Constants(), unknown)
    other = car._replace(**{n: 1.3 * getattr(car, n) for n in (*hypothesis.log_parameters, "R_1", "R_2")})
    phi = hypothesis.phi_of(other, [0.06, 0.03, -0.02])
    assert len(phi) == hypothesis.size == hypothesis.base_size + 3
    assert hypothesis.car(phi) == pytest.approx(other)
    assert list(hypothesis.effect_values(phi).values()) == pytest.approx([0.06, 0.03, -0.02])
    low, high = hypothesis.bounds()
    assert ((low <= phi) & (phi <= high)).all()


def test_a_throttle_that_sets_a_force_has_a_dead_zone_and_no_reference() -> None:
    force = Hypothesis((), CAR._replace(sets_force=1.0), LIMIT, Constants())
    assert "u_0" not in force.log_parameters  # what it lacks is the effect's
    assert "motor_regeneration" in BASE.entries
    assert "motor_regeneration" not in force.entries
    width = force.entries["motor_dead_zone"].parameters[0]
    assert (width.unit, width.high) == ("1", 1.0)


def test_a_front_wheel_that_is_not_driven_spends_no_grip_on_it() -> None:
    shares = {share: replace(BASE, nominal=CAR._replace(front_share=share)).entries for share in (0.0, 0.4, 1.0)}
    assert [share for share, entries in shares.items() if "friction_circle" in entries] == [0.4, 1.0]


def test_rear_wheels_are_as_far_apart_as_a_car_s_wheelbase_lets_expect(vehicle: Vehicle) -> None:
    """The bumper car's 0.6 m on 0.87 m, unless the vehicle file says."""
    own = vehicle.body
    bumper = own.model_copy(update={"cog_to_front_m": 0.4, "cog_to_rear_m": 0.47, "rear_track_m": None})
    small = bumper.model_copy(update={"cog_to_front_m": 0.0805, "cog_to_rear_m": 0.093})
    given = small.model_copy(update={"rear_track_m": 0.16})
    tracks = [effect_constants(vehicle.model_copy(update={"body": b})).track for b in (bumper, small, given)]
    assert tracks == pytest.approx([0.6, 0.6 * 0.1735 / 0.87, 0.16])


def test_a_steering_s_cubic_part_is_as_large_a_share_at_any_full_lock() -> None:
    """A small car's 0.4 rad would hardly be bent by what bends the bumper car's 2 rad."""
    cubic = BASE.entries["steering_nonlinearity"].parameters[0]
    small = replace(BASE, angle_limit=0.2 * LIMIT).entries["steering_nonlinearity"].parameters[0]
    for name in ("low", "high", "size"):
        assert getattr(small, name) * (0.2 * LIMIT) ** 2 == pytest.approx(getattr(cubic, name) * LIMIT**2)
    offset = BASE.entries["steering_offset"].parameters[0]
    assert replace(BASE, angle_limit=0.2 * LIMIT).entries["steering_offset"].parameters[0] == offset


def test_a_tracked_point_that_was_measured_is_not_far_from_there() -> None:
    own = [
        {p.symbol: (p.low, p.high, p.size) for p in h.entries["marker_offset"].parameters}
        for h in (BASE, replace(BASE, measured_point=True))
    ]
    for symbol, (low, high, size) in own[0].items():
        assert own[1][symbol] == (
            LIKELIHOOD_LIMITS.measured_marker_share * low,
            LIKELIHOOD_LIMITS.measured_marker_share * high,
            size,
        )


def test_late_poses_are_late_commands(take: Take) -> None:
    """pose_latency is exactly equal motor and steering delays (specification)."""
    one, two = BASE.with_effects("pose_latency"), BASE.with_effects("motor_delay", "steering_delay")
    r = [
        pose_residuals(take, h.prediction_inputs(h.phi_of(CAR, values), take), take.start)
        for h, values in ((one, [0.012]), (two, [0.012, 0.012]))
    ]
    np.testing.assert_allclose(r[0], r[1], atol=1e-9)


def test_a_chain_is_that_of_its_own_commands(take: Take) -> None:
    """Also of a take that shares its commands, but not when they came, with one seen before."""
    phi = BASE.phi_of(CAR)
    here, late = (
        BASE.prediction_inputs(phi, take),
        BASE.prediction_inputs(phi, take._replace(command_s=take.command_s + 0.1)),
    )
    np.testing.assert_allclose(late.chain.delta[8:], here.chain.delta[:-8], rtol=0, atol=1e-9)


def test_a_part_of_an_initial_state_that_is_gone_before_the_first_pose_is_hardly_known_and_no_more() -> None:
    """A side slip that decays at once leaves the shift that another place would: columns are the same."""
    rng = np.random.default_rng(0)
    A = rng.standard_normal((40, 5))
    A[:, 3] = 0.02 * A[:, 0] - 0.01 * A[:, 1]
    M = A.T @ A
    L = cholesky_factor(M)
    assert np.isfinite(L).all()
    np.testing.assert_allclose(L @ L.T, M, atol=1e-12 * M.max())
    b = A.T @ rng.standard_normal(40)
    y, _ = solve_triangular(L, b)
    rest = np.delete(A, 3, axis=1)
    seen = np.delete(b, 3) @ np.linalg.solve(rest.T @ rest, np.delete(b, 3))
    assert y @ y == pytest.approx(seen, rel=1e-9)
    # what is well determined stays as it was, to the last bit, and what is indefinite is none
    sound = rest.T @ rest
    np.testing.assert_allclose(cholesky_factor(sound), np.linalg.cholesky(sound), rtol=1e-12)
    assert np.isnan(cholesky_factor(sound - 2.0 * np.diag(np.diag(sound)))).all()


def test_a_car_that_answers_beyond_rounding_has_diverged() -> None:
    rng = np.random.default_rng(3)
    A = rng.standard_normal((30, 3, N_NUISANCE))
    r, first, scales = 1e-3 * rng.standard_normal((30, 3)), np.array([0, 30]), Scales(np.full(3, 1e-3), np.full(3, 0.1))
    assert np.isfinite(checked_marginal_terms(segment_moments(r, A, first), scales).chi2).all()
    A[:, :, 7] *= 1e9
    with pytest.raises(PredictionDiverged, match="rounding resolves"):
        checked_marginal_terms(segment_moments(r, A, first), scales)
