"""The score test: what small changes of a prediction would gain, with the fit's own parameters projected out.

A trial is a vector of an effect's parameters beside a fit; its column (N, 3) is the change of predicted poses by it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.likelihood.divergence import require_finite
from bcid.likelihood.jacobian import parameter_jacobian
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.marginal import NU, estimate_scales, robust_weights, segment_moments
from bcid.likelihood.nuisance import pose_residuals, remove_pushes
from bcid.likelihood.predict import wrap_yaw
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import N_NUISANCE, SEGMENT_S, Take

NULL_DRAWS = 999
REWEIGHTINGS = 4
DRAWN_P_VALUE = 0.01  # tail of the null draws that they show well
POSE_TOLERANCE = 0.1  # of the distance from the origin, by which a pose's scale and the marker's offset may move it


class ProjectedChanges(NamedTuple):
    """K columns J of changes of a prediction, with the fit's own parameters projected out.

    The information of segment s about them is J^T P J = X^T X - Y^T Y, with X the columns over the noise and Y their
    projections on the nuisance parameters.
    """

    X: Floats  # (N, 3, K)
    Y: Floats  # (S, N_NUISANCE, K)
    each_g: Floats  # (S, K) J^T P r
    first: Ints  # (S + 1,) segment s has the rows first[s] to first[s + 1]
    weights: Floats  # (S,) robust weights
    G: Floats  # (K, K) weighted sum of J^T P J over segments
    chi2: Floats  # (S,) without any change
    numbers: Floats  # (S,)
    pulls: Floats  # (n, K) standard deviations by which a unit of a column moves the fit's own trusted parameters
    tension: Floats  # (n,) standard deviations by which these are off already

    def slope(self, own: slice) -> Floats:
        """Slope (k,) of the log-likelihood and the prior by the multiples of the columns `own`."""
        return np.asarray(self.weights @ self.each_g[:, own] + self.tension @ self.pulls[:, own])

    def segment_information(self, k: int, m: int) -> Floats:
        """Element (k, m) of J^T P J in every segment (S,)."""
        rows = np.add.reduceat(np.einsum("nc,nc->n", self.X[:, :, k], self.X[:, :, m]), self.first[:-1])
        return np.asarray(rows - np.einsum("sf,sf->s", self.Y[:, :, k], self.Y[:, :, m]))


def project_out_fit(fit: Fit, take: Take, columns: Floats) -> ProjectedChanges:
    """Changes `columns` (N, 3, K) of predicted poses less their projection on the fit's parameters, for score tests.

    The projection, a weighted least-squares fit, is what base parameters, present effects, initial states and pushes
    can imitate.  Slope and information of the log-likelihood for multiples of the columns are given segment by
    segment.

    Raises:
        PredictionDiverged: where a prediction or a change of it is not finite.
    """
    hypothesis, r = fit.hypothesis, pose_residuals(take, fit.hypothesis.prediction_inputs(fit.phi, take), fit.start)
    own = parameter_jacobian(take, hypothesis, fit.phi, fit.start, r, range(hypothesis.base_size, hypothesis.size))
    n = fit.tangent.J.shape[2] + own.shape[2]
    r = remove_pushes(r, fit.tangent.A, fit.start, take.first)
    _, e = estimate_scales(segment_moments(r, fit.tangent.A, take.first), fit.scales, 0)
    w, noise = robust_weights(e), fit.scales.r[:, None]
    X = np.concatenate([fit.tangent.J, own, columns], axis=2) / noise
    A, rest = fit.tangent.A / noise, r / fit.scales.r
    factor = np.linalg.cholesky(e.V)
    Y, y = np.empty((take.segments, N_NUISANCE, X.shape[2])), np.empty((take.segments, N_NUISANCE))
    for s, (a, b) in enumerate(zip(take.first, take.first[1:], strict=False)):
        As = A[a:b].reshape(-1, N_NUISANCE)
        Y[s] = factor[s].T @ (As.T @ X[a:b].reshape(len(As), -1))
        y[s] = factor[s].T @ (As.T @ rest[a:b].ravel())
    total = _weighted_information(X, Y, w, take.first)
    require_finite("a change of a prediction", total)  # LAPACK would not come back from it
    centre, known = hypothesis.prior(fit.phi)
    taken, bends = np.zeros((n, columns.shape[2])), np.ones(n, dtype=bool)
    if hypothesis.trusted_simulation is None:
        known = np.zeros(n)
    else:  # a parameter at its bound goes no farther
        bends = ~hypothesis.is_at_bound(fit.phi)
    answers = total[:n, :n] + np.diag(known)
    taken[bends] = np.linalg.lstsq(answers[np.ix_(bends, bends)], total[:n, n:][bends], rcond=None)[0]
    X, Y = X[:, :, n:] - X[:, :, :n] @ taken, Y[:, :, n:] - Y[:, :, :n] @ taken
    each_g = np.add.reduceat(np.einsum("nck,nc->nk", X, rest), take.first[:-1]) - np.einsum("sfk,sf->sk", Y, y)
    G = total[n:, n:] - total[n:, :n] @ taken
    root = np.sqrt(known)
    return ProjectedChanges(
        X, Y, each_g, take.first, w, G, e.chi2, e.numbers, root[:, None] * taken, root * (fit.phi - centre)
    )


def _weighted_information(X: Floats, Y: Floats, w: Floats, first: Ints) -> Floats:
    """Fisher information (K, K): sum over segments s of `w[s]` (X_s^T X_s - Y_s^T Y_s), for K columns of pose changes.

    `X` (N, 3, K) holds the columns divided by the noise, `Y` (S, N_NUISANCE, K) their projections on initial states
    and pushes, `w` (S,) robust weights; segment s has the rows `first[s]` to `first[s + 1]`.
    """
    root = np.sqrt(w)
    of_rows = np.repeat(root, np.diff(first))
    weighted = (X * of_rows[:, None, None]).reshape(-1, X.shape[2])
    free = (Y * root[:, None, None]).reshape(-1, Y.shape[2])
    return np.asarray(weighted.T @ weighted - free.T @ free)


def robust_amplitudes(changes: ProjectedChanges, own: slice) -> tuple[Floats, float]:
    """Multiples (k,) of the pose changes in columns `own` that raise the log-likelihood most, and their gain (nats).

    The likelihood is Student's t, with the prior of a trusted simulation.  Iteratively reweighted least squares
    (`best_amplitudes`) starts from multiples of 0 and of 1, as the latter may explain segments to which the former
    gives no weight; the better end is returned.
    """
    columns = range(own.start, own.stop)
    if np.any(np.diag(changes.G)[own] <= LIKELIHOOD_LIMITS.min_information):
        return np.zeros(len(columns)), 0.0
    g = changes.each_g[:, own]
    G = np.stack([[changes.segment_information(k, m) for m in columns] for k in columns]).transpose(2, 0, 1)
    pull, stiffness = changes.tension @ changes.pulls[:, own], changes.pulls[:, own].T @ changes.pulls[:, own]

    def chi2(a: Floats) -> Floats:
        """Chi^2 (S,) of each segment with the columns times `a`."""
        return np.asarray(np.maximum(changes.chi2 - 2.0 * g @ a + np.einsum("k,skl,l->s", a, G, a), 0.0))

    def gain(a: Floats) -> float:
        """Gain (nats) of the columns times `a` in Student's likelihood and the prior."""
        more = np.log1p(chi2(a) / NU) - np.log1p(changes.chi2 / NU)
        return float(-0.5 * np.sum((NU + changes.numbers) * more) + a @ pull - 0.5 * a @ stiffness @ a)

    best, most = np.zeros(len(columns)), 0.0
    for a in (np.zeros(len(columns)), np.ones(len(columns))):
        for _ in range(REWEIGHTINGS):
            w = (NU + changes.numbers) / (NU + chi2(a))
            a = best_amplitudes((w @ g + pull)[None], np.tensordot(w, G, axes=1) + stiffness)[0]  # noqa: PLW2901
            if gain(a) > most:
                best, most = a, gain(a)
    return best, most


def unlimited_gain(changes: ProjectedChanges, own: slice) -> float:
    """Score-test statistic g^T G^+ g / 2: the log-likelihood gain (nats) of the columns `own` at their best multiples.

    Multiples may have any size and sign.  g (k,) is the slope of the log-likelihood by them, G (k, k) its
    information, G^+ the pseudo-inverse.  A column is the change of predicted poses by an effect.
    """
    g, G = changes.slope(own), changes.G[own, own]
    scale = np.sqrt(np.maximum(np.diag(G), LIKELIHOOD_LIMITS.min_information))
    return float(0.5 * (g / scale) @ np.linalg.lstsq(G / np.outer(scale, scale), g / scale, rcond=1e-8)[0])


def score_test_gain(changes: ProjectedChanges, own: slice) -> float:
    """Log-likelihood gain (nats) g^T a - a^T G a / 2 of the columns `own` by a score test with limited multiples a.

    a (k,) is `best_amplitudes`, g (k,) the slope of the log-likelihood by the multiples, G (k, k) its information.  A
    column is the change of predicted poses by an effect.
    """
    g, G = changes.slope(own), changes.G[own, own]
    return float(_quadratic_gain(best_amplitudes(g[None], G), g[None], G)[0])


def null_maxima(changes: ProjectedChanges, groups: list[slice]) -> Floats:
    """Null distribution (NULL_DRAWS,) of the greatest score-test gain (nats) over all `groups`, by a wild bootstrap.

    A group is a slice of the columns of `changes`, an effect's changes of predicted poses.  In each draw, every
    segment's residual gets a random sign (Liu 1988), which keeps correlations between columns and the scatter of
    segments.
    """
    each = changes.weights[:, None] * changes.each_g
    rng = np.random.default_rng(0)
    draws = rng.choice((-1.0, 1.0), (NULL_DRAWS, len(each))) @ each
    # a trusted parameter is off by chance, too
    draws += rng.standard_normal((NULL_DRAWS, len(changes.pulls))) @ changes.pulls
    most = np.zeros(NULL_DRAWS)
    for own in groups:
        g, G = draws[:, own], changes.G[own, own]
        most = np.maximum(most, _quadratic_gain(best_amplitudes(g, G), g, G))
    return most


def null_quantile(maxima: Floats, p: float) -> float:
    """Score-test gain (nats) that chance exceeds with probability `p`, extrapolated from the null draws `maxima` (D,).

    It is the 1 - DRAWN_P_VALUE quantile of `maxima` plus ln(DRAWN_P_VALUE / p): the tail falls as exp(-x), like that
    of half a chi-square, where `p` is less than the draws can show.
    """
    return float(np.quantile(maxima, 1.0 - DRAWN_P_VALUE) + np.log(DRAWN_P_VALUE / p))


def best_amplitudes(g: Floats, G: Floats) -> Floats:
    """Multiples a (D, k) of k columns of pose changes that raise the log-likelihood most: G a = g, then clipped.

    `g` (D, k) are the slopes of D cases, `G` (k, k) is the information.  A single column's multiple is clipped to [0,
    `max_trial_amplitude`], those of several to +- that.  All are zero if the information about a column is at most
    `min_information` (nats): the recording does not excite it.
    """
    if np.any(np.diag(G) <= LIKELIHOOD_LIMITS.min_information):
        return np.zeros_like(g)
    most = LIKELIHOOD_LIMITS.max_trial_amplitude
    if len(G) == 1:
        return np.asarray(np.clip(g / G[0, 0], 0.0, most))
    return np.asarray(np.clip(np.linalg.solve(G + 1e-9 * np.diag(np.diag(G)), g.T).T, -most, most))


def _quadratic_gain(amplitude: Floats, g: Floats, G: Floats) -> Floats:
    """Log-likelihood gains (D,) in nats, g^T a - a^T G a / 2, of multiples a (D, k) of k columns, to second order.

    Slopes `g` are (D, k), the information `G` is (k, k).
    """
    return np.asarray(np.einsum("dk,dk->d", amplitude, g) - 0.5 * np.einsum("dk,kl,dl->d", amplitude, G, amplitude))


class Trial(NamedTuple):
    """One effect at one place: trial vectors that are combined linearly, and their columns among the changes."""

    effect: str
    vectors: list[list[float]]
    own: slice


class TrialChanges(NamedTuple):
    """Trials beside a fit, and the changes of its predicted poses by them."""

    columns: Floats  # (N, 3, K)
    trials: list[Trial]

    def without(self, effects: Sequence[str]) -> TrialChanges:
        """The trial changes without the trials of `effects`, whose columns stay."""
        return self._replace(trials=[t for t in self.trials if t.effect not in effects])


def compute_trial_changes(fit: Fit, take: Take, rows: Sequence[tuple[str, list[list[float]]]]) -> TrialChanges:
    """Changes of a fit's predicted poses by trials: an effect added at given parameter values, one trial at a time.

    Each of the `rows` is an effect's id and a list of its parameter vectors (SI); each vector gives one column (N,
    3).
    """
    r = pose_residuals(take, fit.hypothesis.prediction_inputs(fit.phi, take), fit.start)
    columns, trials = list[Floats](), []
    for name, vectors in rows:
        trials.append(Trial(name, vectors, slice(len(columns), len(columns) + len(vectors))))
        columns += [_prediction_change(fit, take, name, values, r) for values in vectors]
    return TrialChanges(np.stack(columns, axis=2), trials)


def _prediction_change(fit: Fit, take: Take, name: str, values: list[float], r: Floats) -> Floats:
    """Change (N, 3) in x, y (m), yaw (rad) of a fit's predicted poses when effect `name` is added with `values` (SI).

    All else stays as fitted; `r` (N, 3) is the fit's residual.  All zeros if a changed prediction is not finite.
    """
    more, phi = fit.hypothesis.add_effect(name, fit.phi, values)
    at = {p.symbol: v for p, v in zip(more.entries[name].parameters, values, strict=True)}
    chosen = affected_segments(take, take.pose - r, at)
    part, rows = take.part(chosen), take.rows(chosen)
    change = np.zeros_like(r)
    change[rows] = wrap_yaw(r[rows] - pose_residuals(part, more.prediction_inputs(phi, part), fit.start[chosen]))
    return change if np.isfinite(change).all() else np.zeros_like(change)


def replace_value(values: list[float], i: int, value: float) -> list[float]:
    """A copy of the list `values` with `value` at index `i`."""
    return [*values[:i], value, *values[i + 1 :]]


def affected_segments(take: Take, path: Floats, at: Mapping[str, float]) -> Ints:
    """Indices of the segments that an effect with parameters `at` can change, by their predicted poses `path` (N, 3).

    `at` maps symbols to values.  With x, y and radius (m), these are the segments near that circle on the floor; with
    t_s (s), an onset time, those that end after t_s or less than a segment's length before; otherwise all.
    """
    if "radius" in at:
        steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
        within = np.diff(np.repeat(np.arange(take.segments), np.diff(take.first))) == 0
        apart = np.hypot(path[:, 0] - at["x"], path[:, 1] - at["y"]) - POSE_TOLERANCE * np.hypot(*path[:, :2].T)
        return np.flatnonzero(np.minimum.reduceat(apart, take.first[:-1]) < at["radius"] + 2.0 * steps[within].max())
    if "t_s" in at:
        return np.flatnonzero(take.begin_s - take.zero_s + 2.0 * SEGMENT_S > at["t_s"])
    return np.arange(take.segments)
