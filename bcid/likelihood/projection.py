"""Changes of predicted poses with all that a fit can imitate projected out, segment by segment.

Of a segment let r be the residual, F the derivatives of its poses by the fit's parameters phi, A those by its nuisance
parameters z (initial state and pushes, posterior covariance V = C C^T), and X the changes, all over the noise.  Then

    P = 1 - A V A^T,   F^T P X = F^T X - (C^T A^T F)^T (C^T A^T X),

and so on for each pair.  With t the weighted least-squares answer of phi to the changes, the projected changes X - F t
have the information X^T P X - 2 t^T F^T P X + t^T F^T P F t and the slope X^T P r - t^T F^T P r: no array of rows times
changes is made beside the changes themselves.
"""

from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.likelihood.divergence import require_finite
from bcid.likelihood.jacobian import parameter_jacobian
from bcid.likelihood.marginal import robust_weights, segment_moments
from bcid.likelihood.nuisance import about_no_pushes, pose_residuals
from bcid.likelihood.refit import Fit
from bcid.likelihood.scale_estimate import estimate_scales
from bcid.likelihood.take import N_NUISANCE, Take


class LinearisedFit(NamedTuple):
    """A fit of n parameters as a score test needs it: products of residual and derivatives in each of S segments.

    It is worth keeping where several sets of changes are tested beside one fit.
    """

    r: Floats  # (N, 3) measured less predicted poses
    beside: Floats  # (3 N, N_NUISANCE + n + 1) A, F and r without pushes over the squared noise
    precision: Floats  # (3,) one over the squared noise
    first: Ints  # (S + 1,) segment s has the rows first[s] to first[s + 1]
    root: Floats  # (S, N_NUISANCE, N_NUISANCE) C^T
    F: Floats  # (S, N_NUISANCE, n) C^T A^T F
    rest: Floats  # (S, N_NUISANCE) C^T A^T r
    information: Floats  # (S, n, n) F^T P F
    slopes: Floats  # (S, n) F^T P r
    weights: Floats  # (S,) robust weights
    chi2: Floats  # (S,)
    numbers: Floats  # (S,)
    known: Floats  # (n,) precision of the prior of a trusted simulation, 0 without one
    bends: Bools  # (n,) whether the parameter may answer: one at a bound of a trusted simulation may not
    tension: Floats  # (n,) standard deviations by which trusted parameters are off


def linearise_fit(fit: Fit, take: Take) -> LinearisedFit:
    """The products of a fit's residual and derivatives in each segment of its `take`, for score tests beside it.

    Raises:
        PredictionDiverged: where a prediction or a change of it is not finite.
    """
    hypothesis, r = fit.hypothesis, pose_residuals(take, fit.hypothesis.prediction_inputs(fit.phi, take), fit.start)
    own = parameter_jacobian(
        take, hypothesis, fit.phi, fit.start, r, range(hypothesis.base_size, hypothesis.named_size)
    )
    n = fit.tangent.J.shape[2] + own.shape[2]
    still = about_no_pushes(r, fit.tangent.A, fit.start, take.first)
    _, e = estimate_scales(segment_moments(still, fit.tangent.A, take.first), fit.scales, 0)
    root, noise = e.root, fit.scales.r
    base, functions = np.split(fit.tangent.J, [hypothesis.base_size], axis=2)
    rows = np.concatenate([fit.tangent.A, base, own, functions, still[:, :, None]], axis=2) / noise[:, None]
    rows = rows.reshape(-1, N_NUISANCE + n + 1)
    products = np.stack([part.T @ part for part in np.split(rows, 3 * take.first[1:-1])])
    # of all of A, F and r with A, and of F and r with themselves
    free, among = root @ products[:, :N_NUISANCE, N_NUISANCE:], products[:, N_NUISANCE:, N_NUISANCE:]
    among = among - free.transpose(0, 2, 1) @ free
    require_finite("a change of a prediction", among)  # LAPACK would not come back from it
    prior = hypothesis.prior(fit.phi)
    known = prior.stiffness(fit.phi)
    bends = np.ones(n, dtype=bool)
    if hypothesis.trusted_simulation is None:
        known[: hypothesis.named_size] = 0.0
    else:  # a parameter at its bound goes no farther
        bends = ~hypothesis.is_at_bound(fit.phi)
    rows.reshape(-1, 3, rows.shape[1])[:] /= noise[:, None]
    return LinearisedFit(
        r, rows, noise**-2.0, take.first, root, free[:, :, :n], free[:, :, n], among[:, :n, :n], among[:, :n, n],
        robust_weights(e), e.chi2, e.numbers, known, bends, np.sqrt(known) * (fit.phi - prior.centre),
    )  # fmt: skip


class ProjectedChanges(NamedTuple):
    """K changes of predictions, with the fit's own parameters projected out.

    The information J^T P J is kept by bands: row d of `bands` and of `G` has the elements (k, k + d), for columns that
    are combined with each other.
    """

    bands: Floats  # (W, S, K) J^T P J
    each_g: Floats  # (S, K) J^T P r
    weights: Floats  # (S,) robust weights
    G: Floats  # (W, K) weighted sum of J^T P J over segments
    chi2: Floats  # (S,) without any change
    numbers: Floats  # (S,)
    pulls: Floats  # (n, K) standard deviations by which a unit of a column moves the fit's own trusted parameters
    tension: Floats  # (n,) standard deviations by which these are off already

    def slope(self, own: slice) -> Floats:
        """Slope (k,) of the log-likelihood and the prior by the multiples of the columns `own`."""
        return np.asarray(self.weights @ self.each_g[:, own] + self.tension @ self.pulls[:, own])

    def information(self, own: slice) -> Floats:
        """Information (k, k) of the log-likelihood and the prior about the multiples of the columns `own`."""
        k = own.stop - own.start
        upper = np.zeros((k, k))
        for d in range(k):
            upper += np.diag(self.G[d, own.start : own.stop - d], d)
        return upper + np.triu(upper, 1).T


def project_out_fit(fit: LinearisedFit, columns: Floats, widest: int = 1, moved: int = 0) -> ProjectedChanges:
    """Changes `columns` (N, 3, K) of predicted poses less their projection on the fit's parameters, for score tests.

    The projection, a weighted least-squares fit, is what base parameters, present effects, initial states and pushes
    can imitate.  Slope and information of the log-likelihood for multiples of the columns are given segment by
    segment, the information between columns less than `widest` apart.  Where the columns are `moved`, segment s has
    the changes of the segment that many later (the take is cyclic), and none beyond the end of a shorter one.

    Raises:
        PredictionDiverged: where a change of a prediction is not finite.
    """
    K, n, first = columns.shape[2], len(fit.known), fit.first
    flat, S = columns.transpose(2, 0, 1).reshape(K, -1), len(first) - 1
    products, bands = np.empty((S, K, N_NUISANCE + n + 1)), np.zeros((widest, S, K))
    for s in range(S):
        there = (s + moved) % S
        size = min(first[s + 1] - first[s], first[there + 1] - first[there])
        X = flat[:, 3 * first[there] : 3 * (first[there] + size)]
        products[s] = X @ fit.beside[3 * first[s] : 3 * (first[s] + size)]
        weighted = X * np.tile(fit.precision, size)
        for d in range(min(widest, K)):
            bands[d, s, : K - d] = np.einsum("kn,kn->k", weighted[: K - d], X[d:])
    Y = fit.root @ products[:, :, :N_NUISANCE].transpose(0, 2, 1)
    FX = products[:, :, N_NUISANCE:-1].transpose(0, 2, 1) - fit.F.transpose(0, 2, 1) @ Y
    each_g = products[:, :, -1] - np.einsum("sfk,sf->sk", Y, fit.rest)
    cross = np.tensordot(fit.weights, FX, axes=1)
    require_finite("a change of a prediction", cross, bands)
    taken, b = np.zeros((n, K)), fit.bends
    answers = np.tensordot(fit.weights, fit.information, axes=1) + np.diag(fit.known)
    taken[b] = np.linalg.lstsq(answers[np.ix_(b, b)], cross[b], rcond=None)[0]
    answered, G = fit.information @ taken - FX, np.empty((widest, K))
    for d in range(min(widest, K)):
        here, next_ = slice(0, K - d), slice(d, K)
        bands[d, :, here] -= np.einsum("sfk,sfk->sk", Y[:, :, here], Y[:, :, next_])
        G[d, here] = fit.weights @ bands[d, :, here] - np.einsum("nk,nk->k", cross[:, here], taken[:, next_])
        bands[d, :, here] += np.einsum("snk,nk->sk", answered[:, :, here], taken[:, next_])
        bands[d, :, here] -= np.einsum("snk,nk->sk", FX[:, :, next_], taken[:, here])
    return ProjectedChanges(
        bands, each_g - fit.slopes @ taken, fit.weights, G, fit.chi2, fit.numbers,
        np.sqrt(fit.known)[:, None] * taken, fit.tension,
    )  # fmt: skip
