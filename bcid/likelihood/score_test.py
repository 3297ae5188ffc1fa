"""The score test: what small changes of a prediction would gain, the fit's own parameters projected out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.likelihood.marginal import NU, moments, rescaled, weights
from bcid.likelihood.newton import jacobian
from bcid.likelihood.nuisance import residuals, without_pushes
from bcid.likelihood.predict import wrapped
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import N_FREE, SEGMENT_S, Take

LARGEST = 3.0  # an amplitude beyond this multiple of the trial is not believed
UNSEEN = 1e-9  # information below which a take does not excite a trial at all
NULLS = 999
REWEIGHTED = 4
KNOWN_P = 0.01  # of the null takes' tail that the draws show well


class Projected(NamedTuple):
    """Trial columns beside the fit's own parameters, so that J^T P J of segment s is a sum over its rows.

    J^T P J = X^T X - Y^T Y with X the columns over the noise and Y their projections on the free part.
    """

    X: Floats  # (N, 3, K)
    Y: Floats  # (S, N_FREE, K)
    each_g: Floats  # (S, K) J^T P r
    first: Ints  # (S + 1,)
    weights: Floats  # (S,)
    G: Floats  # (K, K) weighted sum over segments
    chi2: Floats  # (S,) without any trial
    numbers: Floats  # (S,)
    pulls: Floats  # (held, K) by which a unit of a column bends trusted parameters, in their standard deviations
    tension: Floats  # (held,) by which they are bent already

    def slope(self, own: slice) -> Floats:
        """What the columns `own` gain at first: in the likelihood, and by letting trusted parameters go back."""
        return np.asarray(self.weights @ self.each_g[:, own] + self.tension @ self.pulls[:, own])

    def each_information(self, k: int, other: int) -> Floats:
        """J^T P J of two columns in every segment (S,)."""
        rows = np.einsum("nc,nc->n", self.X[:, :, k], self.X[:, :, other])
        return np.asarray(
            np.add.reduceat(rows, self.first[:-1]) - np.einsum("sf,sf->s", self.Y[:, :, k], self.Y[:, :, other])
        )


def projected(fit: Fit, take: Take, columns: Floats) -> Projected:
    """The changes `columns` (N, 3, K) of a fit's prediction with its own parameters projected out."""
    hypothesis, r = fit.hypothesis, residuals(take, fit.hypothesis.setting(fit.phi, take), fit.start)
    own = jacobian(take, hypothesis, fit.phi, fit.start, r, range(hypothesis.base_size, hypothesis.size))
    held = fit.tangent.J.shape[2] + own.shape[2]
    r = without_pushes(r, fit.tangent.A, fit.start, take.first)
    _, e = rescaled(moments(r, fit.tangent.A, take.first), fit.scales, 0)
    w, noise = weights(e), fit.scales.r[:, None]
    X = np.concatenate([fit.tangent.J, own, columns], axis=2) / noise
    A, rest = fit.tangent.A / noise, r / fit.scales.r
    factor = np.linalg.cholesky(e.V)
    Y, y = np.empty((take.segments, N_FREE, X.shape[2])), np.empty((take.segments, N_FREE))
    for s, (a, b) in enumerate(zip(take.first, take.first[1:], strict=False)):
        As = A[a:b].reshape(-1, N_FREE)
        Y[s] = factor[s].T @ (As.T @ X[a:b].reshape(len(As), -1))
        y[s] = factor[s].T @ (As.T @ rest[a:b].ravel())
    total = _information(X, Y, w, take.first)
    if not np.isfinite(total).all():  # LAPACK would not come back from it
        raise FloatingPointError("a change of a prediction left the finite numbers")
    centre, known = hypothesis.prior(fit.phi)
    taken, bends = np.zeros((held, columns.shape[2])), np.ones(held, dtype=bool)
    if hypothesis.simulated is None:
        known = np.zeros(held)
    else:  # what has gone as far as it is trusted goes no farther
        bends = ~hypothesis.at_bound(fit.phi)
    answers = total[:held, :held] + np.diag(known)
    taken[bends] = np.linalg.lstsq(answers[np.ix_(bends, bends)], total[:held, held:][bends], rcond=None)[0]
    X, Y = X[:, :, held:] - X[:, :, :held] @ taken, Y[:, :, held:] - Y[:, :, :held] @ taken
    each_g = np.add.reduceat(np.einsum("nck,nc->nk", X, rest), take.first[:-1]) - np.einsum("sfk,sf->sk", Y, y)
    G = total[held:, held:] - total[held:, :held] @ taken
    root = np.sqrt(known)
    return Projected(
        X, Y, each_g, take.first, w, G, e.chi2, e.numbers, root[:, None] * taken, root * (fit.phi - centre)
    )


def _information(X: Floats, Y: Floats, w: Floats, first: Ints) -> Floats:
    """Weighted sum of J^T P J over the segments."""
    root = np.sqrt(w)
    of_rows = np.repeat(root, np.diff(first))
    weighted = (X * of_rows[:, None, None]).reshape(-1, X.shape[2])
    free = (Y * root[:, None, None]).reshape(-1, Y.shape[2])
    return np.asarray(weighted.T @ weighted - free.T @ free)


def best_amplitude(found: Projected, own: slice) -> tuple[Floats, float]:
    """The multiples of the columns `own` that gain most together, and the gain (nats) in the robust likelihood.

    Reweighted steps from nothing, and from the whole of the columns, which may explain what nothing gives no weight.
    """
    columns = range(own.start, own.stop)
    if np.any(np.diag(found.G)[own] <= UNSEEN):
        return np.zeros(len(columns)), 0.0
    g = found.each_g[:, own]
    G = np.stack([[found.each_information(k, m) for m in columns] for k in columns]).transpose(2, 0, 1)
    pull, stiffness = found.tension @ found.pulls[:, own], found.pulls[:, own].T @ found.pulls[:, own]

    def chi2(a: Floats) -> Floats:
        return np.asarray(np.maximum(found.chi2 - 2.0 * g @ a + np.einsum("k,skl,l->s", a, G, a), 0.0))

    def gain(a: Floats) -> float:
        more = np.log1p(chi2(a) / NU) - np.log1p(found.chi2 / NU)
        return float(-0.5 * np.sum((NU + found.numbers) * more) + a @ pull - 0.5 * a @ stiffness @ a)

    best, most = np.zeros(len(columns)), 0.0
    for a in (np.zeros(len(columns)), np.ones(len(columns))):
        for _ in range(REWEIGHTED):
            w = (NU + found.numbers) / (NU + chi2(a))
            a = amplitudes((w @ g + pull)[None], np.tensordot(w, G, axes=1) + stiffness)[0]  # noqa: PLW2901
            if gain(a) > most:
                best, most = a, gain(a)
    return best, most


def explained(found: Projected, own: slice) -> float:
    """What the columns `own` would gain with amplitudes as large as they like (nats)."""
    g, G = found.slope(own), found.G[own, own]
    scale = np.sqrt(np.maximum(np.diag(G), UNSEEN))
    return float(0.5 * (g / scale) @ np.linalg.lstsq(G / np.outer(scale, scale), g / scale, rcond=1e-8)[0])


def promise(found: Projected, own: slice) -> float:
    """What the columns `own` promise together (nats) by their slopes and information alone."""
    g, G = found.slope(own), found.G[own, own]
    return float(_gain(amplitudes(g[None], G), g[None], G)[0])


def null_maxima(found: Projected, groups: list[slice]) -> Floats:
    """The greatest `promise` among all groups of columns in NULLS takes of nothing (NULLS,).

    In each take the residuals of every segment have their sign drawn anew (a wild bootstrap: Liu 1988): what a
    trial promises by chance, with the trials' own correlations and the segments' own scatter.
    """
    each = found.weights[:, None] * found.each_g
    rng = np.random.default_rng(0)
    draws = rng.choice((-1.0, 1.0), (NULLS, len(each))) @ each
    draws += rng.standard_normal((NULLS, len(found.pulls))) @ found.pulls  # a trusted parameter is off by chance too
    most = np.zeros(NULLS)
    for own in groups:
        g, G = draws[:, own], found.G[own, own]
        most = np.maximum(most, _gain(amplitudes(g, G), g, G))
    return most


def level(maxima: Floats, p: float) -> float:
    """What a take of nothing promises with the probability `p`, rarer than the draws reach.

    Half of a chi-square falls off as exp(-x), and so does the greatest of many.
    """
    return float(np.quantile(maxima, 1.0 - KNOWN_P) + np.log(KNOWN_P / p))


def amplitudes(g: Floats, G: Floats) -> Floats:
    """The multiples (D, k) of the trial vectors that gain most, for D slopes `g` (D, k)."""
    if np.any(np.diag(G) <= UNSEEN):
        return np.zeros_like(g)
    if len(G) == 1:
        return np.asarray(np.clip(g / G[0, 0], 0.0, LARGEST))
    return np.asarray(np.clip(np.linalg.solve(G + 1e-9 * np.diag(np.diag(G)), g.T).T, -LARGEST, LARGEST))


def _gain(amplitude: Floats, g: Floats, G: Floats) -> Floats:
    return np.asarray(np.einsum("dk,dk->d", amplitude, g) - 0.5 * np.einsum("dk,kl,dl->d", amplitude, G, amplitude))


class Changes(NamedTuple):
    """What every trial changes in the predictions of a fit."""

    columns: Floats  # (N, 3, K)
    trials: list[Trial]

    def without(self, effects: Sequence[str]) -> Changes:
        """The same without the trials of `effects`."""
        return self._replace(trials=[t for t in self.trials if t.effect not in effects])


def changes_of(fit: Fit, take: Take, rows: Sequence[tuple[str, list[list[float]]]]) -> Changes:
    """What the trials in `rows`, pairs of an effect and its vectors, change."""
    r = residuals(take, fit.hypothesis.setting(fit.phi, take), fit.start)
    columns, trials, at = [], [], 0
    for name, vectors in rows:
        columns += [_difference(fit, take, name, values, r) for values in vectors]
        trials.append(Trial(name, vectors, slice(at, at + len(vectors))))
        at += len(vectors)
    return Changes(np.stack(columns, axis=2), trials)


def _difference(fit: Fit, take: Take, name: str, values: list[float], r: Floats) -> Floats:
    """What the effect at `values` changes in the prediction (N, 3)."""
    more, phi = fit.hypothesis.with_effect(name, fit.phi, values)
    at = {p.symbol: v for p, v in zip(more.entries[name].parameters, values, strict=True)}
    chosen = concerned(take, take.pose - r, at)
    part, rows = take.part(chosen), take.rows(chosen)
    change = np.zeros_like(r)
    change[rows] = wrapped(r[rows] - residuals(part, more.setting(phi, part), fit.start[chosen]))
    return change if np.isfinite(change).all() else np.zeros_like(change)


SEEN_ELSEWHERE = 0.1  # of its distance from the origin, at most: a pose's scale and the marker's offset


class Trial(NamedTuple):
    """One effect at one place: its trial vectors, combined linearly, and their columns among the changes."""

    effect: str
    vectors: list[list[float]]
    own: slice


def changed_in(values: list[float], i: int, value: float) -> list[float]:
    """The values with the `i`th replaced."""
    return [*values[:i], value, *values[i + 1 :]]


def concerned(take: Take, path: Floats, at: Mapping[str, float]) -> Ints:
    """The segments whose predictions an effect `at` a place or time can change, seen along `path` (N, 3) without it.

    A circle changes nothing for a car that does not come into it, a moment nothing for what was before.  Where the
    car is may differ from where it is seen.
    """
    if "radius" in at:
        steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
        within = np.diff(np.repeat(np.arange(take.segments), np.diff(take.first))) == 0
        apart = np.hypot(path[:, 0] - at["x"], path[:, 1] - at["y"]) - SEEN_ELSEWHERE * np.hypot(*path[:, :2].T)
        return np.flatnonzero(np.minimum.reduceat(apart, take.first[:-1]) < at["radius"] + 2.0 * steps[within].max())
    if "t_s" in at:
        return np.flatnonzero(take.begin_s - take.zero_s + 2.0 * SEGMENT_S > at["t_s"])
    return np.arange(take.segments)


GATE = 14.0  # what the gate of a usual take comes to; plans count with it before there is a take
