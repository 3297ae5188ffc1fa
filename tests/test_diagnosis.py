"""The likelihood that a diagnosis rests on: its linear algebra, its sensitivities, and what a joint refit finds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bcid.diagnosis.hypothesis import BASE, DRAG, Hypothesis
from bcid.diagnosis.marginal import NU, Scales, eliminate, log_likelihood, updated, weights
from bcid.diagnosis.refit import Fit, base_fit, jacobian, residuals, with_effects
from bcid.diagnosis.screen import screen
from bcid.diagnosis.search import search
from bcid.diagnosis.segments import KNOTS, N_FREE, free_sensitivities, predict
from bcid.diagnosis.take import SEGMENT_S, Take, take_of
from bcid.effects.constants import Constants
from bcid.effects.table import EFFECTS
from bcid.estimate.run import estimate_motion
from bcid.estimate.tuning import Tuning
from bcid.physics.car import Car
from bcid.recording.read import read_recording
from bcid.simulation.car import Plant, Sensor
from bcid.simulation.samples import Take as Order
from bcid.simulation.samples import write_take
from bcid.vehicle import Vehicle

CAR = Car(
    m=319.6, I_z=90.85, l_f=0.54, l_r=0.33, T_s=0.155, d=1.418, F_m_max=423.4, K_t=274.8, K_b=597.0, C_f=3594.0,
    C_r=7840.0, F_f_max=629.6, F_r_max=1360.0, R_1=43.4, R_2=4.0, v_0=1.0,
)  # fmt: skip
SCALES = Scales(np.array([5e-4, 5e-4, 1e-3]), np.array([0.02, 0.02, 0.02]))
ROUGH = {"rough_force": 3.0, "rough_moment": 1.5}
LIMIT = 2.012


def recorded(folder: Path, vehicle: Vehicle, tuning: Tuning, plant: Plant, seed: int, seconds: float = 150.0) -> Take:
    path = write_take(folder, Order(f"take{seed}", "mcap", seconds), plant, Sensor(), seed)
    recording = read_recording(path, vehicle)
    return take_of(recording, estimate_motion(recording, vehicle, tuning))


@pytest.fixture(scope="module")
def null_take(tmp_path_factory: pytest.TempPathFactory, vehicle: Vehicle, tuning: Tuning) -> Take:
    return recorded(tmp_path_factory.mktemp("null"), vehicle, tuning, Plant(**ROUGH), 1)


@pytest.fixture(scope="module")
def null_fit(null_take: Take) -> Fit:
    return base_fit(null_take, CAR, LIMIT, Constants(), SCALES)


def random_problem(segments: int = 4, n: int = 5) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(0)
    first = np.r_[0, np.cumsum(rng.integers(8, 14, segments))].astype(np.int64)
    N = int(first[-1])
    return (
        0.01 * rng.standard_normal((N, 3)), rng.standard_normal((N, 3, N_FREE)), rng.standard_normal((N, 3, n)), first,
        np.array([0.01, 0.02, 0.03]), rng.uniform(0.01, 0.5, N_FREE),
    )  # fmt: skip


def test_elimination_is_the_dense_algebra() -> None:
    """Against S = R + A Q A^T written out."""
    residual, A, J, first, r, variances = random_problem()
    e = eliminate(residual, A, J, first, r, variances)
    for s in range(len(first) - 1):
        rows = slice(first[s], first[s + 1])
        As, Js = A[rows].reshape(-1, N_FREE), J[rows].reshape(-1, J.shape[2])
        rs = residual[rows].ravel()
        S = np.diag(np.tile(r**2, first[s + 1] - first[s])) + As @ np.diag(variances) @ As.T
        inverse = np.linalg.inv(S)
        assert e.chi2[s] == pytest.approx(rs @ inverse @ rs, rel=1e-9)
        assert e.log_det[s] == pytest.approx(np.linalg.slogdet(S)[1], rel=1e-9)
        np.testing.assert_allclose(e.g[s], Js.T @ inverse @ rs, rtol=1e-7)
        np.testing.assert_allclose(e.G[s], Js.T @ inverse @ Js, rtol=1e-7)
        gain = np.diag(variances) @ As.T @ inverse
        np.testing.assert_allclose(e.z[s], gain @ rs, rtol=1e-6, atol=1e-12)
        np.testing.assert_allclose(e.V[s], np.diag(variances) - gain @ As @ np.diag(variances), atol=1e-9)
        assert e.numbers[s] == len(rs)


def test_the_density_is_student_s_t() -> None:
    from scipy.stats import multivariate_t

    residual, A, J, first, r, variances = random_problem()
    e = eliminate(residual, A, J, first, r, variances)
    for s, log_density in enumerate(log_likelihood(e)):
        rows = slice(first[s], first[s + 1])
        As = A[rows].reshape(-1, N_FREE)
        S = np.diag(np.tile(r**2, first[s + 1] - first[s])) + As @ np.diag(variances) @ As.T
        expected = multivariate_t(shape=S, df=NU, allow_singular=False).logpdf(residual[rows].ravel())
        assert log_density == pytest.approx(expected, rel=1e-8)


def test_em_raises_the_likelihood() -> None:
    residual, A, J, first, r, _ = random_problem(30)
    scales, before = Scales(r, np.full(3, 0.3)), -np.inf
    for _ in range(8):
        e = eliminate(residual, A, J, first, scales.r, scales.free_variances())
        now = float(log_likelihood(e).sum())
        assert now >= before - 1e-6
        scales, before = updated(scales, e, np.diff(first)), now


def test_a_bad_segment_weighs_little() -> None:
    residual, A, J, first, r, variances = random_problem()
    residual[first[1] : first[2]] += 10.0 * np.random.default_rng(1).standard_normal((first[2] - first[1], 3))
    w = weights(eliminate(residual, A, J, first, r, variances))
    assert w[1] < 0.01 * np.delete(w, 1).min()


def test_segments_cover_the_take(null_take: Take) -> None:
    assert null_take.segments == pytest.approx(150.0 / SEGMENT_S, abs=4)
    for s in range(null_take.segments):
        stamps = null_take.stamp_s[null_take.first[s] : null_take.first[s + 1]]
        assert (np.diff(stamps) > 0).all()
        assert stamps[0] >= null_take.step[s] * 0.025 - 1e-6
        assert stamps[-1] < null_take.step[s] * 0.025 + SEGMENT_S
    part = null_take.part(np.array([3, 7]))
    np.testing.assert_array_equal(part.pose[part.first[1] :], null_take.pose[null_take.first[7] : null_take.first[8]])


def test_predictions_join_the_estimate(null_take: Take) -> None:
    """With the true constants the poses of a segment are predicted to centimetres from the estimated start."""
    hypothesis = Hypothesis((), CAR, LIMIT, Constants())
    r = residuals(null_take, hypothesis.setting(hypothesis.start(CAR), null_take), null_take.start)
    assert np.sqrt((r[:, :2] ** 2).mean()) < 0.02
    assert np.sqrt((r[:, 2] ** 2).mean()) < 0.02


def test_sensitivities_are_the_differences(null_take: Take) -> None:
    """Moving the starts and the pushes moves the predictions as the sensitivities say."""
    part = null_take.part(np.arange(5, 9))
    hypothesis = Hypothesis((), CAR, LIMIT, Constants())
    setting = hypothesis.setting(hypothesis.start(CAR), part)
    shared = (part.stamp_s, part.first, part.step, part.steps)
    tail = (setting.chain, part.T, setting.car, setting.switches, setting.constants)
    A = free_sensitivities(*shared, part.start, *tail)
    rng = np.random.default_rng(0)
    nudge = 1e-3 * rng.standard_normal(part.start.shape)
    moved = predict(*shared, part.start + nudge, *tail) - predict(*shared, part.start, *tail)
    expected = np.concatenate(
        [A[a:b, :, :6] @ d for a, b, d in zip(part.first[:-1], part.first[1:], nudge, strict=True)]
    )
    np.testing.assert_allclose(moved, expected, atol=2e-5)
    assert np.abs(A[:, :, 6:]).max() > 0.1  # a push of 1 m/s^2 for half a second moves the car
    late = part.stamp_s < np.repeat(part.step * 0.025 + 0.9, np.diff(part.first))
    np.testing.assert_allclose(A[late][:, :, 6 + 3 * (KNOTS - 1) :], 0.0, atol=1e-9)  # and not before it acts


def test_the_jacobian_is_the_difference(null_take: Take) -> None:
    part = null_take.part(np.arange(5, 9))
    hypothesis = Hypothesis(("yaw_scrub", "steering_offset"), CAR, LIMIT, Constants())
    phi = hypothesis.start(CAR, [13.0, 0.008])
    J = jacobian(part, hypothesis, phi, part.start)
    change = 1e-3 * np.random.default_rng(0).standard_normal(len(phi))
    before, after = (residuals(part, hypothesis.setting(x, part), part.start) for x in (phi, phi + change))
    np.testing.assert_allclose(before - after, J @ change, atol=3e-5)


def test_phi_and_the_car_are_one(null_take: Take) -> None:
    hypothesis = Hypothesis(("motor_lag", "floor_slope"), CAR, LIMIT, Constants())
    phi = hypothesis.start(CAR, [0.06, 0.03, -0.02])
    assert len(phi) == hypothesis.size == len(BASE) + len(DRAG) + 3
    assert hypothesis.car(phi) == pytest.approx(CAR)
    assert list(hypothesis.values(phi).values()) == pytest.approx([0.06, 0.03, -0.02])
    low, high = hypothesis.bounds()
    assert ((low <= phi) & (phi <= high)).all()


def test_late_poses_are_late_commands(null_take: Take) -> None:
    """pose_latency is exactly equal motor and steering delays (specification)."""
    one = Hypothesis(("pose_latency",), CAR, LIMIT, Constants())
    two = Hypothesis(("motor_delay", "steering_delay"), CAR, LIMIT, Constants())
    r = [
        residuals(null_take, h.setting(h.start(CAR, values), null_take), null_take.start)
        for h, values in ((one, [0.012]), (two, [0.012, 0.012]))
    ]
    np.testing.assert_allclose(r[0], r[1], atol=1e-9)


def test_the_base_refit_recovers_the_car(null_fit: Fit) -> None:
    car = null_fit.hypothesis.car(null_fit.phi)
    for symbol in ("F_m_max", "K_t", "K_b", "I_z", "C_f", "C_r", "F_f_max"):
        assert getattr(car, symbol) == pytest.approx(getattr(CAR, symbol), rel=0.03), symbol
    assert (null_fit.scales.q > 0.003).all()  # the rough floor is seen as pushes,
    assert (null_fit.scales.q < 0.06).all()  # and nothing more


@pytest.mark.parametrize("name", ["yaw_scrub", "rear_rolling_viscous"])
def test_what_is_not_there_gains_nothing(name: str, null_fit: Fit, null_take: Take) -> None:
    """An effect that is off earns about half a nat per parameter, and its estimate covers zero."""
    fit = with_effects(null_fit, (name,), null_take)
    assert fit.log_likelihood - null_fit.log_likelihood < 5.0
    ((value, se),) = fit.values().values()
    assert abs(value) < 3.5 * se


@pytest.mark.parametrize(
    ("name", "size", "rival"),
    [("rear_rolling_viscous", 17.0, "quadratic_drag"), ("tyre_relaxation", 0.045, "steering_lag")],
)
def test_a_concealed_effect_is_recovered_and_its_look_alike_loses(
    name: str, size: float, rival: str, tmp_path: Path, vehicle: Vehicle, tuning: Tuning
) -> None:
    take = recorded(tmp_path, vehicle, tuning, Plant(**ROUGH)._replace(**{name: size}), 2)
    base = base_fit(take, CAR, LIMIT, Constants(), SCALES)
    right, wrong = (with_effects(base, (n,), take, CAR) for n in (name, rival))
    ((value, se),) = right.values().values()
    assert value == pytest.approx(size, abs=max(4.0 * se, 0.03 * size))
    assert right.log_likelihood - base.log_likelihood > 100.0
    assert right.bic > wrong.bic + 20.0


def test_the_screen_covers_the_vocabulary_and_nothing_stands_out_of_a_null(null_fit: Fit, null_take: Take) -> None:
    found = screen(null_fit, null_take)
    assert sorted(c.effect for c in found) == sorted(EFFECTS)
    assert [c.score for c in found] == sorted((c.score for c in found), reverse=True)
    assert found[0].score < 15.0  # the largest of some two hundred trials of nothing


def test_a_null_take_names_nothing(null_fit: Fit, null_take: Take) -> None:
    assert search(null_fit, null_take, CAR).effects == ()


def test_a_concealed_effect_is_found_by_name(tmp_path: Path, vehicle: Vehicle, tuning: Tuning) -> None:
    take = recorded(tmp_path, vehicle, tuning, Plant(**ROUGH, rear_rolling_coulomb=20.0), 3)
    base = base_fit(take, CAR, LIMIT, Constants(), SCALES)
    found = search(base, take, CAR)
    assert found.shortlist[0].effect == "rear_rolling_coulomb"
    assert found.effects == ("rear_rolling_coulomb",)
    ((value, se),) = found.best.values().values()
    assert value == pytest.approx(20.0, abs=max(4.0 * se, 0.6))


def test_a_fit_is_immutable(null_fit: Fit) -> None:
    assert replace(null_fit, log_likelihood=0.0).log_likelihood == 0.0
    with pytest.raises(AttributeError):
        null_fit.log_likelihood = 1.0  # type: ignore[misc]
