"""What a take says of free functions: products of segments against explicit projections in the space of residuals."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from concealed import concealing, nothing_missing

from bcid.aliases import Floats
from bcid.diagnosis.remainder.chance import DRAWS, Chance, draw_chance
from bcid.diagnosis.remainder.evidence import Quadratic
from bcid.diagnosis.remainder.explain import basis_for, explain
from bcid.diagnosis.remainder.functions import RemainderBasis
from bcid.diagnosis.remainder.information import TakeInformation, gather_information
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.marginal import NU
from bcid.likelihood.nuisance import about_no_pushes, pose_residuals
from bcid.likelihood.refit import Fit, refit
from bcid.likelihood.take import N_NUISANCE, Take


class Explicit(NamedTuple):
    """Of each segment residual, names' derivatives and functions' answers over the noise, and the projection."""

    r: list[Floats]  # (3 n,)
    J: list[Floats]  # (3 n, names)
    B: list[Floats]  # (3 n, K)
    Q: list[Floats]  # (3 n, carriers)
    P: list[Floats]  # (3 n, 3 n)


@pytest.fixture(scope="module")
def fitted() -> tuple[Fit, Take]:
    """A minute with a name in the fit, and pushes that are free."""
    fit, take = concealing(60.0, yaw_scrub=20.0)
    more, phi = fit.hypothesis.add_effect("yaw_scrub", fit.phi, [15.0])
    return refit(take, more, phi, fit.start, fit.scales), take


@pytest.fixture(scope="module")
def basis(fitted: tuple[Fit, Take]) -> RemainderBasis:
    return basis_for(*fitted)


@pytest.fixture(scope="module")
def at(fitted: tuple[Fit, Take], basis: RemainderBasis) -> TakeInformation:
    return gather_information(*fitted, basis, np.zeros(len(basis.size)))


@pytest.fixture(scope="module")
def explicit(at: TakeInformation, fitted: tuple[Fit, Take]) -> Explicit:
    """By the rows, and the prior of initial states and pushes: an inverse of each segment's own."""
    fit, _ = fitted
    n, precision = fit.hypothesis.named_size, fit.scales.nuisance_precision()
    whole = Explicit([], [], [], [], [])
    for s, (a, b) in enumerate(zip(at.first, at.first[1:], strict=False)):
        A, J, Q, r = np.split(at.rows[a:b].reshape(3 * (b - a), -1), [N_NUISANCE, N_NUISANCE + n, -1], axis=1)
        P = np.eye(len(A)) - A @ np.linalg.inv(A.T @ A + precision) @ A.T
        for column, value in zip(whole, (r[:, 0], J, Q @ at.values[s], Q, P), strict=True):
            column.append(value)
    return whole


def test_rows_are_the_fit_s_own(at: TakeInformation, fitted: tuple[Fit, Take], basis: RemainderBasis) -> None:
    """The residual without pushes, derivatives by names, and a carrier for each knot's action and tracking function."""
    fit, take = fitted
    inputs = fit.hypothesis.prediction_inputs(fit.phi, take)
    r = pose_residuals(take, inputs, fit.start)
    r = about_no_pushes(r, fit.tangent.A, fit.start, take.first) / fit.scales.r
    np.testing.assert_allclose(at.rows[:, :, -1], r, atol=2e-2 * np.abs(r).max())
    n, K = fit.hypothesis.named_size, len(basis.size)
    assert at.rows.shape[2] == N_NUISANCE + n + at.values.shape[1] + 1
    assert at.values.shape == (take.segments, at.carriers.shape[1], K)
    assert at.names.shape == (take.segments, n, n)
    assert np.abs(at.names[:, -1, -1]).max() > 1.0  # the name that is no base parameter


def test_products_are_those_of_the_explicit_projection(at: TakeInformation, explicit: Explicit) -> None:
    for s in range(len(at.first) - 1):
        r, J, Q, P = explicit.r[s], explicit.J[s], explicit.Q[s], explicit.P[s]
        for found, expected in (
            (at.names[s], J.T @ P @ J), (at.cross[s], J.T @ P @ Q), (at.carriers[s], Q.T @ P @ Q),
            (at.name_slopes[s], J.T @ P @ r), (at.carrier_slopes[s], Q.T @ P @ r),
        ):  # fmt: skip
            np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())
        assert at.terms.chi2[s] == pytest.approx(r @ P @ r, rel=1e-6)


def drawn(at: TakeInformation, seed: int) -> tuple[Floats, Floats, Floats]:
    """A move of the names, coefficients of the functions, and weights of the segments."""
    rng = np.random.default_rng(seed)
    n, K = at.names.shape[1], at.values.shape[2]
    return 0.01 * rng.standard_normal(n), 0.02 * rng.standard_normal(K), rng.uniform(0.3, 1.0, len(at.names))


def test_chi2_is_that_of_the_moved_residual(at: TakeInformation, explicit: Explicit) -> None:
    moved, c, _ = drawn(at, 0)
    already = 0.3 * drawn(at, 1)[1]
    for there in (np.zeros_like(c), already):
        found = at._replace(c=there).chi2_beside(moved, c)
        for s, chi2 in enumerate(found):
            x = explicit.r[s] - explicit.J[s] @ moved - explicit.B[s] @ (c - there)
            assert chi2 == pytest.approx(x @ explicit.P[s] @ x, rel=1e-6)
    np.testing.assert_allclose(at.chi2_beside(0.0 * moved, at.c), at.terms.chi2)
    np.testing.assert_allclose(at.robust_weights, (NU + at.terms.numbers) / (NU + at.terms.chi2))


def whitened(at: TakeInformation, explicit: Explicit, weights: Floats) -> tuple[Floats, Floats, Floats]:
    """Residual, names' and functions' columns whose squares are the misfit: weighted, projected, with prior's rows."""
    rows = []
    for s, w in enumerate(weights):
        values, vectors = np.linalg.eigh(explicit.P[s])
        root = np.sqrt(w * np.maximum(values, 0.0))[:, None] * vectors.T
        rows.append(root @ np.column_stack([explicit.r[s], explicit.J[s], explicit.B[s]]))
    stiff, K = np.sqrt(at.prior.stiffness(at.phi)), explicit.B[0].shape[1]
    off = stiff * (at.prior.centre - at.phi)
    rows.append(np.column_stack([off, np.diag(stiff), np.zeros((len(stiff), K))]))
    whole = np.concatenate(rows)
    return whole[:, 0], whole[:, 1 : 1 + len(stiff)], whole[:, 1 + len(stiff) :]


def misfit(r: Floats, J: Floats) -> float:
    """Half the squares that the best move of the names leaves."""
    return 0.5 * float(np.sum((r - J @ np.linalg.lstsq(J, r)[0]) ** 2))


def test_the_quadratic_is_the_least_squares_of_the_names(at: TakeInformation, explicit: Explicit) -> None:
    """For each of several coefficients, as an explicit fit of the names in the space of residuals leaves it."""
    _, _, weights = drawn(at, 2)
    weighed = at.weigh(weights)
    r, J, B = whitened(at, explicit, weights)
    for seed in range(3, 6):
        c = drawn(at, seed)[1]
        expected = misfit(r, J) - misfit(r - B @ c, J)
        assert weighed.quadratic.gain(c) == pytest.approx(expected, rel=1e-5, abs=1e-5 * misfit(r, J))
        moved = np.linalg.lstsq(J, r - B @ c)[0]
        np.testing.assert_allclose(J @ weighed.names_beside(c), J @ moved, atol=1e-5 * np.abs(J @ moved).max())


def test_the_quadratic_is_the_schur_complement(at: TakeInformation, explicit: Explicit) -> None:
    weights = drawn(at, 2)[2]
    weighed = at.weigh(weights)
    r, J, B = whitened(at, explicit, weights)
    left = np.eye(len(J)) - J @ np.linalg.pinv(J)
    G, b = B.T @ left @ B, B.T @ left @ r
    np.testing.assert_allclose(weighed.quadratic.G, G, atol=1e-6 * np.abs(G).max())
    np.testing.assert_allclose(weighed.quadratic.b, b, atol=1e-6 * np.abs(b).max())


def test_slopes_are_about_no_functions_wherever_the_fit_is(at: TakeInformation, explicit: Explicit) -> None:
    """At a fit that holds coefficients the residual lacks what they explain: to first order it is put back."""
    weights = np.ones(len(at.names))
    c = drawn(at, 7)[1]
    lacking = at._replace(
        c=c,
        carrier_slopes=np.stack([Q.T @ P @ (r - B @ c) for r, Q, B, P in zip(
            explicit.r, explicit.Q, explicit.B, explicit.P, strict=True)]),
        name_slopes=np.stack([J.T @ P @ (r - B @ c) for r, J, B, P in zip(
            explicit.r, explicit.J, explicit.B, explicit.P, strict=True)]),
    )  # fmt: skip
    here, there = at.weigh(weights), lacking.weigh(weights)
    np.testing.assert_allclose(there.slope_c, here.slope_c, atol=1e-6 * np.abs(here.slope_c).max())
    np.testing.assert_allclose(there.slope_n, here.slope_n, atol=1e-6 * np.abs(here.slope_n).max())


def test_functions_of_the_tracking_have_no_history(at: TakeInformation, basis: RemainderBasis) -> None:
    """Each is its own carrier; what acts on the body acts on no pose that is seen."""
    B, M = len(basis.functions), len(basis.tracking)
    H = at.values.shape[1] - M
    np.testing.assert_array_equal(at.values[:, H:, B:], np.broadcast_to(np.eye(M), (len(at.values), M, M)))
    assert not at.values[:, H:, :B].any()
    assert not at.values[:, :H, B:].any()
    assert np.abs(at.values[:, :H, :B]).max(axis=(0, 1)).min() > 1e-3


def test_every_function_on_the_body_is_answered(at: TakeInformation, basis: RemainderBasis) -> None:
    """The wheel's too, beside a car without any effect, which had no derivatives by it."""
    fit, take = concealing(60.0)
    alone = gather_information(fit, take, basis, np.zeros(len(basis.size)))
    for information in (at, alone):
        G = information.weigh(np.ones(len(information.names))).G_c
        shown = np.diag(G) * basis.size**2
        assert shown.min() > 1e-3, [c for c, s in zip(basis.channel, shown, strict=True) if s <= 1e-3]


def test_a_quadratic_s_gain_is_what_it_says() -> None:
    rng = np.random.default_rng(0)
    b, root, c = rng.standard_normal(4), rng.standard_normal((4, 4)), rng.standard_normal(4)
    quadratic = Quadratic(b, root @ root.T)
    assert quadratic.gain(c) == pytest.approx(b @ c - 0.5 * np.sum((root.T @ c) ** 2))


def test_functions_on_the_body_may_be_others_without_new_derivatives(
    at: TakeInformation, basis: RemainderBasis
) -> None:
    fit, take = concealing(60.0)
    less = basis._replace(functions=basis.functions[5:], channel=basis.channel[5:], size=basis.size[5:])
    whole = gather_information(fit, take, basis, np.zeros(len(basis.size)))
    anew = gather_information(fit, take, less, np.zeros(len(less.size)))
    weights = np.linspace(0.5, 1.0, len(whole.names))
    for one, other in zip(whole.with_functions(less, fit.car()).weigh(weights), anew.weigh(weights), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)


def test_functions_of_other_segments_have_their_values(fitted: tuple[Fit, Take]) -> None:
    fit, take = fitted
    basis = basis_for(fit, take)
    at = gather_information(fit, take, basis, np.zeros(len(basis.size)))
    order = np.roll(np.arange(take.segments), 3)
    elsewhere, M = at.carried_elsewhere(order), len(basis.tracking)
    forces = elsewhere.values[:, : elsewhere.values.shape[1] - M]
    np.testing.assert_array_equal(forces[3], at.values[0, : forces.shape[1]])
    assert not elsewhere.values[:, forces.shape[1] :].any()
    np.testing.assert_array_equal(elsewhere.carrier_slopes, at.carrier_slopes)


def test_what_is_missing_exceeds_what_chance_explains() -> None:
    fit, take = concealing(60.0, yaw_scrub=20.0)
    basis = basis_for(fit, take)
    assert explain(fit, take, basis).nats > 2.0 * draw_chance(fit, take, basis).reached_with(0.01)


def test_a_floor_that_is_rough_in_its_own_way_is_no_mismatch() -> None:
    """Its pushes come and go in 0.3 s.  Held constant over half a second they were 30 nats, which chance made too."""
    base = nothing_missing(2330449787, 1207)
    fit, take = base.fit, base.take
    basis = basis_for(fit, take)
    chance, explained = draw_chance(fit, take, basis), explain(fit, take, basis).nats
    assert explained < LIKELIHOOD_LIMITS.usual_gate_nats
    assert 0.5 < chance.mean < 5.0
    assert chance.p_value(explained) > 0.01


def test_chance_has_the_law_of_its_draws() -> None:
    """Levels of an exponential law are exact; those found from DRAWS draws are exceeded twice as often at most."""
    exponential = Chance(1.0, 1.0)
    assert exponential.reached_with(0.01) == pytest.approx(np.log(100.0))
    assert exponential.p_value(np.log(100.0)) == pytest.approx(0.01)
    rng, shares = np.random.default_rng(3), []
    for draws in rng.gamma(3.0, 5.0, (300, DRAWS)):
        level = Chance(float(draws.mean()), float(draws.std(ddof=1))).reached_with(0.01)
        shares.append(np.mean(rng.gamma(3.0, 5.0, 2000) > level))
    assert 0.01 < np.mean(shares) < 0.02
    assert (Chance(0.0, 0.0).reached_with(0.01), Chance(0.0, 0.0).p_value(0.1)) == (0.0, 0.0)
