"""The score test: what small changes of a prediction would gain, with the fit's own parameters projected out.

A trial is a vector of an effect's parameters beside a fit; its column (N, 3) is the change of predicted poses by it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.likelihood.limits import LIKELIHOOD_LIMITS
from bcid.likelihood.marginal import NU
from bcid.likelihood.nuisance import pose_residuals
from bcid.likelihood.predict import wrap_yaw
from bcid.likelihood.projection import ProjectedChanges
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import SEGMENT_S, Take

NULL_DRAWS, SEED = 999, 0
REWEIGHTINGS = 4
SHOWN_TAIL = (0.1, 0.01)  # tail of the null draws, by its probabilities, that they show well
HALF_CHI2_FALL = 1.885  # nats between these in the gain of one column, half a chi-square where its multiple is positive
MOST_SD = 5.0  # by which a trusted parameter is off by chance, where a bound of that is asked for
POSE_TOLERANCE = 0.1  # of the distance from the origin, by which a pose's scale and the marker's offset may move it


def robust_amplitudes(changes: ProjectedChanges, groups: Sequence[slice]) -> tuple[list[Floats], Floats]:
    """Multiples of the pose changes in each of T `groups` of columns that raise the log-likelihood most, and its gains.

    The likelihood is Student's t, with the prior of a trusted simulation.  Iteratively reweighted least squares
    (`best_amplitudes`) starts from multiples of 0 and of 1, as the latter may explain segments to which the former
    gives no weight; the better end is returned, for each group its multiples (k,), and the gains (T,) in nats.
    """
    amplitudes, gains = [np.empty(0)] * len(groups), np.zeros(len(groups))
    widths = [own.stop - own.start for own in groups]
    for k in set(widths):
        alike = [i for i, width in enumerate(widths) if width == k]
        first = np.array([groups[i].start for i in alike])
        best, gains[alike] = _reweighted_amplitudes(changes, first, k)
        for i, a in zip(alike, best, strict=True):
            amplitudes[i] = a
    return amplitudes, gains


def _reweighted_amplitudes(changes: ProjectedChanges, first: Ints, k: int) -> tuple[Floats, Floats]:
    """Multiples (T, k) of T groups of `k` columns, from each of `first` (T,) on, and gains (T,): `robust_amplitudes`.

    A group about one of whose columns the take holds no information has multiples and gain of zero.
    """
    own, before = first[:, None] + np.arange(k), changes.chi2[:, None]
    g, numbers = [changes.each_g[:, own[:, i]] for i in range(k)], (NU + changes.numbers)[:, None]
    # of columns i and j <= i
    G = {(i, j): changes.bands[i - j][:, own[:, j]] for i in range(k) for j in range(i + 1)}
    pulls = changes.pulls[:, own]
    pull, stiffness = np.tensordot(changes.tension, pulls, axes=1), np.einsum("ntk,ntl->tkl", pulls, pulls)

    def chi2(a: Floats) -> Floats:
        """Chi^2 (S, T) of each segment with the columns of each group times `a` (T, k)."""
        total = before - sum(2.0 * a[:, i] * g[i] for i in range(k))
        total += sum((1.0 if i == j else 2.0) * a[:, i] * a[:, j] * each for (i, j), each in G.items())
        return np.asarray(np.maximum(total, 0.0))

    def gain(a: Floats, after: Floats) -> Floats:
        """Gains (T,) in nats of the columns times `a` in Student's likelihood, with chi^2 `after`, and the prior."""
        more = -0.5 * (numbers * np.log((NU + after) / (NU + before))).sum(axis=0)
        return np.asarray(more + np.einsum("tk,tk->t", a, pull) - 0.5 * np.einsum("tk,tkl,tl->t", a, stiffness, a))

    shown = (changes.G[0][own] > LIKELIHOOD_LIMITS.min_information).all(axis=1)
    best, most = np.zeros(own.shape), np.zeros(len(own))
    for start in (0.0, 1.0):
        a = np.full(own.shape, start)
        after = chi2(a)
        for _ in range(REWEIGHTINGS):
            w, total = numbers / (NU + after), stiffness.copy()
            for (i, j), each in G.items():
                total[:, i, j] += np.einsum("st,st->t", w, each)
                total[:, j, i] = total[:, i, j]
            slope = np.stack([np.einsum("st,st->t", w, each) for each in g], axis=1) + pull
            a = best_amplitudes(slope, total)
            after = chi2(a)
            gained = gain(a, after)
            better = shown & (gained > most)
            best[better], most[better] = a[better], gained[better]
    return best, most


def score_test_gain(changes: ProjectedChanges, own: slice) -> float:
    """Log-likelihood gain (nats) g^T a - a^T G a / 2 of the columns `own` by a score test with limited multiples a.

    a (k,) is `best_amplitudes`, g (k,) the slope of the log-likelihood by the multiples, G (k, k) its information.  A
    column is the change of predicted poses by an effect.
    """
    g, G = changes.slope(own), changes.information(own)
    return float(_quadratic_gain(best_amplitudes(g[None], G), g[None], G)[0])


def null_gains(changes: ProjectedChanges, groups: Sequence[slice]) -> Floats:
    """Null distributions (T, NULL_DRAWS) of the score-test gains (nats) of T `groups`, by a wild bootstrap.

    A group is a slice of the columns of `changes`, an effect's changes of predicted poses.  In each draw, every
    segment's residual gets a random sign (Liu 1988), which keeps correlations between columns and the scatter of
    segments.
    """
    each = changes.weights[:, None] * changes.each_g
    rng = np.random.default_rng(SEED)
    draws = rng.choice((-1.0, 1.0), (NULL_DRAWS, len(each))) @ each
    # a trusted parameter is off by chance, too
    draws += rng.standard_normal((NULL_DRAWS, len(changes.pulls))) @ changes.pulls
    gains = np.empty((len(groups), NULL_DRAWS))
    for each_gain, own in zip(gains, groups, strict=True):
        g, G = draws[:, own], changes.information(own)
        each_gain[:] = _quadratic_gain(best_amplitudes(g, G), g, G)
    return gains


def null_quantile(gains: Floats, p: float, c: float = 1.0) -> float:
    """Score-test gain (nats) that chance exceeds with probability `p`, extrapolated from null draws `gains` (D,).

    Where `p` is less than the draws can show, the tail falls as exp(-x/c), from their quantile of the lesser
    probability in SHOWN_TAIL on.  For half a chi-square c is 1.
    """
    return float(np.quantile(gains, 1.0 - SHOWN_TAIL[1]) + c * np.log(SHOWN_TAIL[1] / p))


def tail_scale(gains: Floats) -> float:
    """The c (nats) with which the tail of null draws `gains` (D,) falls as exp(-x/c): 1 at least.

    It is greater than 1 by as much as segments scatter more than their noise says.
    """
    often, seldom = SHOWN_TAIL
    near, far = np.quantile(gains, [1.0 - often, 1.0 - seldom])
    return max(float(far - near) / HALF_CHI2_FALL, 1.0)


def greatest_null_gain(changes: ProjectedChanges, own: slice) -> float:
    """The score-test gain (nats) of the columns `own` that no signs of the segments' residuals exceed.

    Whitened by the information, each segment has a slope of some length; signs can at best line these up.  A trusted
    simulation's parameters are taken to be off by MOST_SD at most.
    """
    G = changes.information(own)
    if not (np.diag(G) > LIKELIHOOD_LIMITS.min_information).all():
        return 0.0
    slopes = changes.weights[:, None] * changes.each_g[:, own]
    slopes, pulls = (np.linalg.lstsq(np.linalg.cholesky(G), each.T)[0] for each in (slopes, changes.pulls[:, own]))
    return 0.5 * float(np.linalg.norm(slopes, axis=0).sum() + MOST_SD * np.linalg.norm(pulls)) ** 2


def best_amplitudes(g: Floats, G: Floats) -> Floats:
    """Multiples a (D, k) of k columns of pose changes that raise the log-likelihood most: G a = g, then clipped.

    `g` (D, k) are the slopes of D cases, `G` (D, k, k), or (k, k) of all, is the information.  A single column's
    multiple is clipped to [0, `max_trial_amplitude`], those of several to +- that.  All of a case are zero if the
    information about a column is at most `min_information` (nats): the recording does not excite it.
    """
    diagonal = np.diagonal(G, axis1=-2, axis2=-1)
    shown = np.all(diagonal > LIKELIHOOD_LIMITS.min_information, axis=-1, keepdims=True)
    most = LIKELIHOOD_LIMITS.max_trial_amplitude
    if G.shape[-1] == 1:
        return np.where(shown, np.clip(g / np.where(shown, diagonal, 1.0), 0.0, most), 0.0)
    unit = np.eye(G.shape[-1])
    solvable = np.where(shown[..., None], G + 1e-9 * diagonal[..., None] * unit, unit)
    return np.where(shown, np.clip(np.linalg.solve(solvable, g[..., None])[..., 0], -most, most), 0.0)


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

    columns: Floats  # (N, 3, K), in memory one column after the other
    trials: list[Trial]

    @property
    def widest(self) -> int:
        """Most columns that a trial has."""
        return max((len(t.vectors) for t in self.trials), default=1)

    def without(self, effects: Sequence[str]) -> TrialChanges:
        """The trial changes without the trials of `effects`, whose columns stay."""
        return self._replace(trials=[t for t in self.trials if t.effect not in effects])


def compute_trial_changes(
    fit: Fit, take: Take, rows: Sequence[tuple[str, list[list[float]]]], r: Floats | None = None
) -> TrialChanges:
    """Changes of a fit's predicted poses by trials: an effect added at given parameter values, one trial at a time.

    Each of the `rows` is an effect's id and a list of its parameter vectors (SI); each vector gives one column (N,
    3).  `r` (N, 3) is the fit's residual where it is known.
    """
    if r is None:
        r = pose_residuals(take, fit.hypothesis.prediction_inputs(fit.phi, take), fit.start)
    ends = np.cumsum([len(vectors) for _, vectors in rows]).tolist()
    trials = [Trial(*row, slice(end - len(row[1]), end)) for row, end in zip(rows, ends, strict=True)]
    # one column after the other: a row of the K changes would be written at K places
    columns = np.empty((ends[-1] if ends else 0, *r.shape))
    for trial in trials:
        for k, values in zip(range(trial.own.start, trial.own.stop), trial.vectors, strict=True):
            columns[k] = _prediction_change(fit, take, trial.effect, values, r)
    return TrialChanges(columns.transpose(1, 2, 0), trials)


def _prediction_change(fit: Fit, take: Take, name: str, values: list[float], r: Floats) -> Floats:
    """Change (N, 3) in x, y (m), yaw (rad) of a fit's predicted poses when effect `name` is added with `values` (SI).

    All else stays as fitted; `r` (N, 3) is the fit's residual.  All zeros if a changed prediction is lost.
    """
    more, phi = fit.hypothesis.add_effect(name, fit.phi, values)
    at = {p.symbol: v for p, v in zip(more.entries[name].parameters, values, strict=True)}
    chosen = affected_segments(take, take.pose - r, at)
    if len(chosen) == take.segments:
        change = wrap_yaw(r - pose_residuals(take, more.prediction_inputs(phi, take), fit.start))
    else:
        part, rows, change = take.part(chosen), take.rows(chosen), np.zeros_like(r)
        change[rows] = wrap_yaw(r[rows] - pose_residuals(part, more.prediction_inputs(phi, part), fit.start[chosen]))
    return zero_if_lost(change)


def zero_if_lost(change: Floats) -> Floats:
    """The change (N, 3) of predicted poses, or zeros of its shape where it is not finite or beyond `lost_change`."""
    # NaN is not below it
    return change if (np.abs(change) <= LIKELIHOOD_LIMITS.lost_change).all() else np.zeros_like(change)


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
