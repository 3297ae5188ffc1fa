"""Score tests against their definitions: dense projections, and reweighted least squares of one trial at a time."""

from typing import Any, NamedTuple

import numpy as np
import pytest

from bcid.aliases import Floats
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.marginal import NU
from bcid.likelihood.projection import LinearisedFit, ProjectedChanges, project_out_fit
from bcid.likelihood.score_test import (
    REWEIGHTINGS,
    best_amplitudes,
    null_gains,
    robust_amplitudes,
    score_test_gain,
    zero_if_lost,
)
from bcid.likelihood.take import N_NUISANCE

ROWS = np.array([9, 8, 9, 7, 9])
FIRST = np.concatenate([[0], np.cumsum(ROWS)])
NOISE = np.array([2e-3, 3e-3, 5e-3])
N_PARAMETERS, COLUMNS, WIDEST = 3, 7, 3
GROUPS = [slice(0, 1), slice(1, 2), slice(2, 4), slice(4, 7)]


class Dense(NamedTuple):
    """Random residual and derivatives of five segments, over the noise, and what is projected out of each."""

    A: list[Floats]  # (3 n, N_NUISANCE)
    F: list[Floats]  # (3 n, N_PARAMETERS)
    r: list[Floats]  # (3 n,)
    P: list[Floats]  # (3 n, 3 n)
    weights: Floats
    known: Floats
    bends: Any


def split(values: Floats) -> list[Floats]:
    """The rows of each segment, over the noise, channels one after the other."""
    scaled = values / NOISE.reshape(1, 3, *(1,) * (values.ndim - 2))
    return [part.reshape(-1, *values.shape[2:]) for part in np.split(scaled, FIRST[1:-1])]


@pytest.mark.parametrize("lost", [2e158, np.inf, np.nan])
def test_a_trial_that_is_lost_says_nothing_and_spoils_no_other(lost: float, columns: Floats, dense: Dense) -> None:
    """A finite number whose square is none would refuse the whole take."""
    changes = columns.copy()
    changes[3, 1, 2] = lost
    changes[..., 2] = zero_if_lost(changes[..., 2])
    assert not changes[..., 2].any()
    assert (zero_if_lost(columns[..., 0]) == columns[..., 0]).all()
    assert np.isfinite(project_out_fit(linearised(dense), changes, WIDEST).G).all()


@pytest.fixture
def columns() -> Floats:
    return 1e-3 * np.random.default_rng(1).standard_normal((FIRST[-1], 3, COLUMNS))


@pytest.fixture
def dense() -> Dense:
    rng = np.random.default_rng(2)
    A, F = (1e-3 * rng.standard_normal((FIRST[-1], 3, n)) for n in (N_NUISANCE, N_PARAMETERS))
    r = 4e-3 * rng.standard_normal((FIRST[-1], 3))
    P = [np.eye(len(a)) - a @ np.linalg.inv(a.T @ a + np.eye(N_NUISANCE)) @ a.T for a in split(A)]
    return Dense(
        split(A), split(F), split(r), P, rng.uniform(0.3, 1.0, len(ROWS)), np.array([0.0, 2.0, 5.0]),
        np.array([True, True, False]),
    )  # fmt: skip


def linearised(d: Dense) -> LinearisedFit:
    """The products of `linearise_fit`, of random numbers in place of a fit's."""
    root = np.stack([np.linalg.cholesky(np.linalg.inv(a.T @ a + np.eye(N_NUISANCE))).T for a in d.A])
    everything = [np.column_stack([a, f, r]) for a, f, r in zip(d.A, d.F, d.r, strict=True)]
    free = [c @ a.T @ x[:, N_NUISANCE:] for c, a, x in zip(root, d.A, everything, strict=True)]
    n = N_PARAMETERS
    return LinearisedFit(
        np.zeros((FIRST[-1], 3)), np.concatenate([x / np.tile(NOISE, len(x) // 3)[:, None] for x in everything]),
        NOISE**-2.0, FIRST, root, np.stack([f[:, :n] for f in free]), np.stack([f[:, n] for f in free]),
        np.stack([f.T @ P @ f for f, P in zip(d.F, d.P, strict=True)]),
        np.stack([f.T @ P @ r for f, P, r in zip(d.F, d.P, d.r, strict=True)]),
        d.weights, np.array([r @ P @ r for r, P in zip(d.r, d.P, strict=True)]), 3.0 * ROWS - 6.0,
        d.known, d.bends, np.array([0.0, 0.4, -0.7]),
    )  # fmt: skip


def moved_by(columns: Floats, segments: int) -> Floats:
    """The changes with those of the segment so many later in each segment, cut or filled up with zeros."""
    moved, parts = np.zeros_like(columns), np.split(columns, FIRST[1:-1])
    for s in range(len(ROWS)):
        there = parts[(s + segments) % len(ROWS)][: ROWS[s]]
        moved[FIRST[s] : FIRST[s] + len(there)] = there
    return moved


@pytest.mark.parametrize("moved", [0, 2])
def test_projected_changes_are_those_of_the_dense_projection(dense: Dense, columns: Floats, moved: int) -> None:
    found = project_out_fit(linearised(dense), columns, WIDEST, moved)
    X, w, b = split(moved_by(columns, moved)), dense.weights, dense.bends
    among = sum(w_s * f.T @ P @ f for w_s, f, P in zip(w, dense.F, dense.P, strict=True)) + np.diag(dense.known)
    cross = sum(w_s * f.T @ P @ x for w_s, f, P, x in zip(w, dense.F, dense.P, X, strict=True))
    taken = np.zeros((N_PARAMETERS, COLUMNS))
    taken[b] = np.linalg.solve(among[np.ix_(b, b)], cross[b])
    left = [x - f @ taken for x, f in zip(X, dense.F, strict=True)]
    information = np.stack([x.T @ P @ x for x, P in zip(left, dense.P, strict=True)])
    slopes = np.stack([x.T @ P @ r for x, P, r in zip(left, dense.P, dense.r, strict=True)])
    np.testing.assert_allclose(found.each_g, slopes, rtol=1e-9, atol=1e-9 * np.abs(slopes).max())
    np.testing.assert_allclose(found.pulls, np.sqrt(dense.known)[:, None] * taken, atol=1e-12)
    # what a trusted parameter answers costs its prior, too
    G = np.tensordot(w, information, axes=1) + taken.T @ np.diag(dense.known) @ taken
    for d in range(WIDEST):
        each = np.stack([np.diag(i, d) for i in information])
        np.testing.assert_allclose(found.bands[d, :, : COLUMNS - d], each, rtol=1e-9, atol=1e-9 * information.max())
        np.testing.assert_allclose(found.G[d, : COLUMNS - d], np.diag(G, d), rtol=1e-9, atol=1e-9 * G.max())
    for own in GROUPS:
        np.testing.assert_allclose(found.information(own), G[own, own], rtol=1e-9, atol=1e-9 * G.max())


def plain_amplitudes(changes: ProjectedChanges, own: slice) -> tuple[Floats, float]:
    """`robust_amplitudes` of one group as it is defined, with whole matrices."""
    k, g = own.stop - own.start, changes.each_g[:, own]
    G = np.zeros((len(g), k, k))
    for i in range(k):
        for j in range(k):
            G[:, i, j] = changes.bands[abs(i - j), :, own.start + min(i, j)]
    pulls = changes.pulls[:, own]
    pull, stiffness = changes.tension @ pulls, pulls.T @ pulls

    def chi2(a: Floats) -> Floats:
        return np.asarray(np.maximum(changes.chi2 - 2.0 * g @ a + np.einsum("k,skl,l->s", a, G, a), 0.0))

    best, most = np.zeros(k), 0.0
    for a in (np.zeros(k), np.ones(k)):
        for _ in range(REWEIGHTINGS):
            w = (NU + changes.numbers) / (NU + chi2(a))
            a = best_amplitudes((w @ g + pull)[None], (np.tensordot(w, G, axes=1) + stiffness)[None])[0]  # noqa: PLW2901
            more = np.log1p(chi2(a) / NU) - np.log1p(changes.chi2 / NU)
            gain = float(-0.5 * np.sum((NU + changes.numbers) * more) + a @ pull - 0.5 * a @ stiffness @ a)
            if gain > most:
                best, most = a, gain
    return best, most


def test_all_trials_at_once_are_those_one_by_one(dense: Dense, columns: Floats) -> None:
    """Of one, two and three columns; the fourth column does nothing, so that its trial is zero."""
    # a change that explains much of the residual, and one that is not there
    columns[:, :, 0] = 0.5 * np.concatenate(dense.r).reshape(-1, 3) * NOISE
    columns[:, :, 3] = 0.0
    changes = project_out_fit(linearised(dense), columns, WIDEST)
    amplitudes, gains = robust_amplitudes(changes, GROUPS)
    for own, a, gain in zip(GROUPS, amplitudes, gains, strict=True):
        expected, most = plain_amplitudes(changes, own) if own != GROUPS[2] else (np.zeros(2), 0.0)
        np.testing.assert_allclose(a, expected, rtol=1e-9, atol=1e-12)
        assert gain == pytest.approx(most, rel=1e-9, abs=1e-12)
    assert gains[0] > 10.0
    assert (null_gains(changes, GROUPS) >= 0.0).all()
    assert score_test_gain(changes, GROUPS[2]) == 0.0


def test_amplitudes_are_limited_and_zero_where_nothing_is_shown() -> None:
    most = LIKELIHOOD_LIMITS.max_trial_amplitude
    single = best_amplitudes(np.array([[1.0], [-1.0], [99.0], [1.0]]), np.array([[[2.0]], [[2.0]], [[2.0]], [[0.0]]]))
    np.testing.assert_array_equal(single[:, 0], [0.5, 0.0, most, 0.0])
    pair = best_amplitudes(np.array([[2.0, -3.0], [-99.0, 1.0]]), np.diag([2.0, 2.0]))
    np.testing.assert_allclose(pair, [[1.0, -1.5], [-most, 0.5]], rtol=1e-8)
    np.testing.assert_array_equal(best_amplitudes(np.ones((2, 2)), np.diag([1.0, 0.0])), np.zeros((2, 2)))
