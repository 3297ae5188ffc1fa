"""Fitting K-SINDy: sparse regression on the terms' products, a threshold that predicts best, how sure each term is.

Everything is found from the terms' Gram matrix, which is summed once: per block of a few seconds, so that a resample
of the blocks is a sum of theirs (the ensembles of Fasel and others, 2022, over blocks in place of rows).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.estimate.types import Estimate
from bcid.models.fitting.block_covariance import TWO_SIDED, blocks_of, covariance
from bcid.models.fitting.windows import Windows, divided, scale, steps_of, transitions, windows
from bcid.models.interface import FitTask
from bcid.models.kinematic import library
from bcid.models.kinematic.frame import Frame
from bcid.models.kinematic.library import theta_table
from bcid.models.kinematic.sparse_sum import Sparse, scan_many
from bcid.models.settings import SparseSettings

BLOCK_S = 5.0  # within which samples are alike
THRESHOLDS = (0.0, 0.001, 0.002, 0.005, 0.01, 0.02, 0.04, 0.06, 0.1, 0.15)
HELD_OUT = 0.2  # of every take, its end, on which thresholds are compared
LEAST_HELD = 3  # stretches' lengths, at least
MOST = 50  # rounds of thresholding
LOST = 10.0  # weighted miss of a rollout that leaves the finite numbers
NUDGE = 1e-4  # of a coefficient, for differences
SLOPES = 12  # evaluations of the slope of the rollout loss
EQUATIONS = ("v_f", "α_f", "α_r")


class Products(NamedTuple):
    """Sums over the samples of each block: of terms with terms, and of terms with the target."""

    gram: Floats  # (K, n, n)
    moment: Floats  # (K, n)
    square: Floats  # (K,) of the target
    rows: Floats  # (K,)

    @classmethod
    def of(cls, terms: Floats, target: Floats, block: int) -> Products:
        """Of `terms` (N, n) and `target` (N,) in blocks of so many samples."""
        edges = np.arange(0, len(terms), block)
        parts = np.split(terms, edges[1:]), np.split(target, edges[1:])
        return cls(
            np.stack([t.T @ t for t in parts[0]]), np.stack([t.T @ y for t, y in zip(*parts, strict=True)]),
            np.array([y @ y for y in parts[1]]), np.array([float(len(y)) for y in parts[1]]),
        )  # fmt: skip

    def coefficients(self, threshold: float, ridge: float, times: Floats | None = None) -> Floats:
        """Sparse coefficients, each block counted so many `times` (once)."""
        w = np.ones(len(self.rows)) if times is None else times
        n = w @ self.rows
        gram, moment = np.tensordot(w, self.gram, axes=1) / n, w @ self.moment / n
        rms, size = np.sqrt(np.diag(gram)), float(np.sqrt(w @ self.square / n))
        rms = np.where(rms > 1e-12, rms, 1.0)
        scaled = stlsq(gram / np.outer(rms, rms), moment / (rms * size), threshold, ridge)
        return np.asarray(scaled * size / rms)


Equations = tuple[Products, Products, Products]  # of v_f, alpha_f, alpha_r


def stlsq(gram: Floats, moment: Floats, threshold: float, ridge: float) -> Floats:
    """Sequentially thresholded least squares (Brunton and others, 2016) from mean products of terms and target.

    What falls below `threshold` is left out and the rest solved anew, until nothing falls; the ridge only steers that.
    """
    kept = np.ones(len(gram), dtype=bool)
    for _ in range(MOST):
        found = np.zeros(len(gram))
        own = gram[np.ix_(kept, kept)]
        found[kept] = np.linalg.solve(own + ridge * np.eye(len(own)), moment[kept])
        still = kept & (np.abs(found) >= threshold)
        if (still == kept).all() or not still.any():
            break
        kept = still
    out = np.zeros(len(gram))
    out[kept] = np.linalg.lstsq(gram[np.ix_(kept, kept)], moment[kept], rcond=None)[0]
    return np.where(np.abs(out) >= threshold, out, 0.0)


def fit_sparse(task: FitTask, frame: Frame) -> tuple[Sparse, dict[str, Any]]:
    """The three equations' coefficients, and how they were found."""
    settings = SparseSettings.model_validate(task.settings)
    speed = library.SPEED_PUBLISHED if settings.library == "published" else library.SPEED
    threshold, tried = settings.threshold, dict[str, float]()
    if threshold is None:
        threshold, tried = _chosen(task, settings, speed, frame)
    products = _products(task.estimates, speed, frame)
    sparse = _sparse(products, threshold, settings.ridge, speed)
    facts: dict[str, Any] = {
        "threshold": threshold, "ridge": settings.ridge, "library": settings.library, "loss": settings.loss,
        "thresholds": tried, "sure": _sure(products, threshold, settings, speed, task.seed),
    }  # fmt: skip
    if settings.loss == "rollout":
        sparse, errors = _on_rollouts(sparse, frame, _stretches(task.estimates, settings))
        _restate(facts["sure"], sparse, errors)
    return sparse, facts


def _products(estimates: Sequence[Estimate], speed: Ints, frame: Frame) -> Equations:
    """Of the three equations; v_f changes little within a period, so sparsity is asked of its change."""
    s = transitions(estimates)
    x = np.ascontiguousarray(np.column_stack([s.kinematic, s.command[:, 0]]))
    of_speed, of_slip = theta_table(x, speed, frame), theta_table(x, library.SLIP, frame)
    block, after = max(1, round(BLOCK_S / frame.period)), s.next_kinematic
    return (
        Products.of(of_speed, after[:, 0] - s.kinematic[:, 0], block), Products.of(of_slip, after[:, 1], block),
        Products.of(of_slip, after[:, 2], block),
    )  # fmt: skip


def _sparse(
    products: Equations,
    threshold: float,
    ridge: float,
    speed: Ints,
    times: Floats | None = None,
) -> Sparse:
    xi_v, xi_f, xi_r = (p.coefficients(threshold, ridge, times) for p in products)
    return Sparse(xi_v + library.is_speed(speed), xi_f, xi_r, speed, library.SLIP)


def _stretches(estimates: Sequence[Estimate], settings: SparseSettings) -> Windows:
    steps = steps_of("rollout", settings.horizon_s, estimates[0].period_s)
    return windows(estimates, steps, steps)


def _chosen(task: FitTask, settings: SparseSettings, speed: Ints, frame: Frame) -> tuple[float, dict[str, float]]:
    """The largest threshold whose rollouts on the takes' ends are as good as the best's within its standard error."""
    steps = steps_of("rollout", settings.horizon_s, task.period_s)
    early, late = divided(task.estimates, LEAST_HELD * steps, HELD_OUT)
    products, judged = _products(early, speed, frame), _stretches(late, settings)
    weight = scale(judged.twist[:, 0])
    errors = {}
    for threshold in THRESHOLDS:
        predicted = _predicted(_sparse(products, threshold, settings.ridge, speed), frame, judged)
        off = weight * (predicted - judged.twist[:, 1:])
        errors[threshold] = np.minimum(np.nan_to_num(off, nan=LOST) ** 2, LOST**2).mean(axis=(1, 2))
    best = min(THRESHOLDS, key=lambda t: errors[t].mean())
    several = len(errors[best]) > 1
    good = errors[best].mean() + (errors[best].std(ddof=1) / np.sqrt(len(errors[best])) if several else 0.0)
    chosen = max(t for t in THRESHOLDS if errors[t].mean() <= good)
    return chosen, {f"{t:g}": float(e.mean()) for t, e in errors.items()}


def _predicted(s: Sparse, c: Frame, of: Windows) -> Floats:
    """Twists (B, S, 3) that the equations predict over the stretches."""
    start, command = np.ascontiguousarray(of.kinematic[:, 0]), np.ascontiguousarray(of.command[:, :-1])
    return np.asarray(scan_many(start, command, s, c))


def _sure(
    products: Equations, threshold: float, settings: SparseSettings, speed: Ints, seed: int
) -> dict[str, dict[str, list[float]]]:
    """Per equation and term: the share of resamples that keep it, and the 95 % interval of its coefficient."""
    rng, count = np.random.default_rng(seed), len(products[0].rows)
    times = np.asarray(rng.multinomial(count, np.full(count, 1.0 / count), settings.resamples), dtype=float)
    draws = [_sparse(products, threshold, settings.ridge, speed, each) for each in times]
    found = {}
    for i, name in enumerate(EQUATIONS):
        each = np.stack([d[i] for d in draws])
        terms = speed if i == 0 else library.SLIP
        low, high = np.quantile(each, [0.025, 0.975], axis=0)
        kept = (each != 0.0).mean(axis=0)
        found[name] = {
            library.name_of(e): [float(k), float(a), float(b)]
            for e, k, a, b in zip(terms, kept, low, high, strict=True) if k > 0.0
        }  # fmt: skip
    return found


def _restate(sure: dict[str, dict[str, list[float]]], sparse: Sparse, errors: Sparse) -> None:
    """Intervals of the coefficients that were refitted, in place of those that resamples of single steps gave."""
    for i, name in enumerate(EQUATIONS):
        terms = sparse.speed if i == 0 else sparse.slip
        for e, value, se in zip(terms, sparse[i], errors[i], strict=True):
            term = library.name_of(e)
            if value != 0.0:
                kept = sure[name][term][0] if term in sure[name] else 0.0
                sure[name][term] = [kept, float(value - TWO_SIDED * se), float(value + TWO_SIDED * se)]


def _on_rollouts(sparse: Sparse, frame: Frame, taken: Windows) -> tuple[Sparse, Sparse]:
    """The same terms with the coefficients whose rollouts are nearest to the twist, and their standard errors."""
    from scipy.optimize import least_squares

    weight = scale(taken.twist[:, 0])
    kept = [np.flatnonzero(xi) for xi in sparse[:3]]
    start = np.concatenate([xi[k] for xi, k in zip(sparse[:3], kept, strict=True)])

    def at(x: Floats) -> Sparse:
        parts = np.split(x, np.cumsum([len(k) for k in kept])[:-1])
        filled = [np.zeros_like(xi) for xi in sparse[:3]]
        for xi, k, values in zip(filled, kept, parts, strict=True):
            xi[k] = values
        return Sparse(filled[0], filled[1], filled[2], sparse.speed, sparse.slip)

    def misses(x: Floats) -> Floats:
        off = weight * (_predicted(at(x), frame, taken) - taken.twist[:, 1:])
        return np.asarray(np.clip(np.nan_to_num(off, nan=LOST), -LOST, LOST).ravel() / np.sqrt(off.size))

    def slopes(x: Floats) -> Floats:
        before, steps = misses(x), NUDGE * np.maximum(np.abs(x), 1e-3)
        return np.column_stack([(misses(x + h * e) - before) / h for h, e in zip(steps, np.eye(len(x)), strict=True)])

    x = least_squares(misses, start, slopes, x_scale=np.maximum(np.abs(start), 1e-3), max_nfev=SLOPES).x
    J = slopes(x)
    each = (J * misses(x)[:, None]).reshape(taken.number, -1, len(x)).sum(axis=1)
    block = max(1, round(BLOCK_S / (frame.period * taken.steps)))
    return at(x), at(np.sqrt(np.diag(covariance(J, blocks_of(each, block)))))
