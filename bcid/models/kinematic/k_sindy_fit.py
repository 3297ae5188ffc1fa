"""Fitting K-SINDy: sparse regression, the threshold that predicts best, and the confidence in each term.

Everything is found from the terms' Gram matrix, which is summed once: per block of a few seconds, so that a resample
of the blocks is a sum of theirs (the ensembles of Fasel and others, 2022, over blocks in place of rows).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.bootstrap import draw_block_counts, quantile_interval
from bcid.estimate.types import Estimate
from bcid.models.fitting.block_covariance import BLOCK_S, Z_95, sandwich_covariance, sum_blocks
from bcid.models.fitting.windows import (
    Windows,
    cut_windows,
    inverse_spread,
    loss_steps,
    single_steps,
    split_off_ends,
    stretch_spacing,
)
from bcid.models.interface import FitTask
from bcid.models.kinematic import library
from bcid.models.kinematic.library import theta_matrix
from bcid.models.kinematic.sparse_sum import K_SINDY_KERNELS, SparseEquations
from bcid.models.kinematic.state import KinematicCar
from bcid.models.limits import LIMITS
from bcid.models.settings import SparseSettings

CANDIDATE_THRESHOLDS = (0.0, 0.001, 0.002, 0.005, 0.01, 0.02, 0.04, 0.06, 0.1, 0.15)
MAX_ROUNDS = 50  # of thresholding
MAX_WEIGHTED_ERROR = 10.0  # as much as any error of a rollout counts, infinite ones too
DIFFERENCE_STEP = 1e-4  # relative to a coefficient
MAX_JACOBIANS = 12  # evaluations, of the rollout loss
EQUATIONS = ("v_f", "α_f", "α_r")

TermConfidence = dict[str, dict[str, list[float]]]
"""By equation and term: the share of resamples that keep the term, and the 95 % interval of its coefficient."""


class BlockProducts(NamedTuple):
    """Sums over the samples of each of K blocks: of terms with terms, and of terms with the target."""

    gram: Floats  # (K, n, n)
    moment: Floats  # (K, n)
    square: Floats  # (K,) of the target
    rows: Floats  # (K,)

    @classmethod
    def from_samples(cls, terms: Floats, target: Floats, block: int) -> BlockProducts:
        """Sums of `terms` (N, n) and `target` (N,) over blocks of `block` samples."""
        edges = np.arange(0, len(terms), block)
        parts = np.split(terms, edges[1:]), np.split(target, edges[1:])
        return cls(
            np.stack([t.T @ t for t in parts[0]]), np.stack([t.T @ y for t, y in zip(*parts, strict=True)]),
            np.array([y @ y for y in parts[1]]), np.array([float(len(y)) for y in parts[1]]),
        )  # fmt: skip

    def sparse_coefficients(self, threshold: float, ridge: float, block_counts: Floats | None = None) -> Floats:
        """Sparse coefficients (n,) of one equation; `block_counts` (K,) says how often each block counts, else once."""
        w = np.ones(len(self.rows)) if block_counts is None else block_counts
        n = w @ self.rows
        gram, moment = np.tensordot(w, self.gram, axes=1) / n, w @ self.moment / n
        rms, size = np.sqrt(np.diag(gram)), float(np.sqrt(w @ self.square / n))
        rms = np.where(rms > 1e-12, rms, 1.0)
        scaled = stlsq(gram / np.outer(rms, rms), moment / (rms * size), threshold, ridge)
        return np.asarray(scaled * size / rms)


EquationProducts = tuple[BlockProducts, BlockProducts, BlockProducts]  # of v_f, alpha_f, alpha_r


def stlsq(gram: Floats, moment: Floats, threshold: float, ridge: float) -> Floats:
    """Sparse solution xi (n,) of gram xi = moment, by sequentially thresholded least squares (Brunton et al., 2016).

    `gram` (n, n) and `moment` (n,) are mean products of terms with terms and with the target.  Each round adds `ridge`
    to the diagonal, solves, and drops terms with |xi| < threshold; the terms left in the end are solved without ridge.
    """
    kept = np.ones(len(gram), dtype=bool)
    for _ in range(MAX_ROUNDS):
        xi = np.zeros(len(gram))
        kept_gram = gram[np.ix_(kept, kept)]
        xi[kept] = np.linalg.solve(kept_gram + ridge * np.eye(len(kept_gram)), moment[kept])
        still = kept & (np.abs(xi) >= threshold)
        if (still == kept).all() or not still.any():
            break
        kept = still
    out = np.zeros(len(gram))
    out[kept] = np.linalg.lstsq(gram[np.ix_(kept, kept)], moment[kept], rcond=None)[0]
    return np.where(np.abs(out) >= threshold, out, 0.0)


def fit_sparse_equations(task: FitTask, car: KinematicCar) -> tuple[SparseEquations, dict[str, Any]]:
    """Fit K-SINDy: v_f, alpha_f and alpha_r one period later as sparse sums of candidate terms; and facts of the fit.

    Sequentially thresholded least squares on single steps; unless the settings give the threshold, it is chosen by
    the rollout error on held-out ends.  For the loss "rollout" the kept coefficients are refitted to rollouts.  Facts
    hold the threshold, the rollout error of each candidate threshold, and each term's bootstrap confidence.
    """
    settings = SparseSettings.model_validate(task.settings)
    speed = library.SPEED_TERMS_PUBLISHED if settings.library == "published" else library.SPEED_TERMS
    threshold, tried = settings.threshold, dict[str, float]()
    if threshold is None:
        threshold, tried = _choose_threshold(task, settings, speed, car)
    products = _equation_products(task.estimates, speed, car)
    sparse = _solve_equations(products, threshold, settings.ridge, speed)
    facts: dict[str, Any] = {
        "threshold": threshold, "ridge": settings.ridge, "library": settings.library, "loss": settings.loss,
        "thresholds": tried, "term_confidence": _bootstrap_terms(products, threshold, settings, speed, task.seed),
    }  # fmt: skip
    if settings.loss == "rollout":
        steps = loss_steps("rollout", settings.horizon_s, task.period_s)
        every = stretch_spacing(task.estimates, steps)
        sparse, errors = _refine_on_rollouts(sparse, car, cut_windows(task.estimates, steps, every), every)
        _replace_intervals(facts["term_confidence"], sparse, errors)
    return sparse, facts


def _equation_products(estimates: Sequence[Estimate], speed: Ints, car: KinematicCar) -> EquationProducts:
    """Gram matrices of the candidate terms, and their products with the target, for K-SINDy's three equations.

    Both are summed over blocks of BLOCK_S seconds.  Targets are the change of v_f in a period, and the next alpha_f
    and alpha_r; `speed` (n, 10) holds the exponents of the candidate terms of v_f.
    """
    s = single_steps(estimates)
    x, after = s.kinematic_inputs, s.next_kinematic
    block = max(1, round(BLOCK_S / car.period))
    speed_terms, slip_terms = theta_matrix(x, speed, car), theta_matrix(x, library.SLIP_TERMS, car)
    return (
        BlockProducts.from_samples(speed_terms, after[:, 0] - s.kinematic[:, 0], block),
        BlockProducts.from_samples(slip_terms, after[:, 1], block),
        BlockProducts.from_samples(slip_terms, after[:, 2], block),
    )


def _solve_equations(
    products: EquationProducts, threshold: float, ridge: float, speed: Ints, block_counts: Floats | None = None
) -> SparseEquations:
    """Coefficients of K-SINDy's three equations by thresholded least squares, from products of terms by K blocks.

    `speed` (n, 10) holds the exponents of v_f's terms; `block_counts` (K,) says how often a bootstrap resample holds
    each block (None: once).  As the change of v_f was fitted, 1 is added to the coefficient of the term v_f.
    """
    xi_v, xi_f, xi_r = (p.sparse_coefficients(threshold, ridge, block_counts) for p in products)
    persistence = (speed == library.SPEED_ALONE).all(axis=1)
    return SparseEquations(xi_v + persistence, xi_f, xi_r, speed, library.SLIP_TERMS)


def _choose_threshold(
    task: FitTask, settings: SparseSettings, speed: Ints, car: KinematicCar
) -> tuple[float, dict[str, float]]:
    """Choose the threshold below which K-SINDy's coefficients are dropped; and the rollout error of each candidate.

    By the one-standard-error rule: the largest threshold whose mean squared error, weighted 1/sigma, is within a
    standard error of the least, in rollouts over the recordings' held-out ends.  `speed` (n, 10): exponents of v_f's
    candidate terms.
    """
    steps = loss_steps("rollout", settings.horizon_s, task.period_s)
    beginnings, ends = split_off_ends(task.estimates, LIMITS.min_threshold_horizons * steps, LIMITS.threshold_share)
    products, stretches = _equation_products(beginnings, speed, car), cut_windows(ends, steps, steps)
    weight = inverse_spread(stretches.twist[:, 0])
    errors = {}
    for threshold in CANDIDATE_THRESHOLDS:
        predicted = _predict_stretches(_solve_equations(products, threshold, settings.ridge, speed), car, stretches)
        squares = np.nan_to_num(weight * (predicted - stretches.twist[:, 1:]), nan=MAX_WEIGHTED_ERROR) ** 2
        errors[threshold] = np.minimum(squares, MAX_WEIGHTED_ERROR**2).mean(axis=(1, 2))
    best = min(CANDIDATE_THRESHOLDS, key=lambda t: errors[t].mean())
    several = len(errors[best]) > 1
    good = errors[best].mean() + (errors[best].std(ddof=1) / np.sqrt(len(errors[best])) if several else 0.0)
    chosen = max(t for t in CANDIDATE_THRESHOLDS if errors[t].mean() <= good)
    return chosen, {f"{t:g}": float(e.mean()) for t, e in errors.items()}


def _predict_stretches(s: SparseEquations, c: KinematicCar, stretches: Windows) -> Floats:
    """Twists (B, S, 3) that the K-SINDy equations `s` predict over B stretches of S steps from measured starts."""
    start, parts = np.ascontiguousarray(stretches.kinematic[:, 0]), np.ascontiguousarray(stretches.parts[:, :-1])
    return np.asarray(K_SINDY_KERNELS.scan_many(start, parts, s, c))


def _bootstrap_terms(
    products: EquationProducts, threshold: float, settings: SparseSettings, speed: Ints, seed: int
) -> TermConfidence:
    """Confidence in each term of K-SINDy by a block bootstrap, {equation: {term: [share, low, high]}}.

    `share` of the resamples' fits keep the term; low and high bound the 95 % interval of its coefficient.
    """
    block_counts = draw_block_counts(len(products[0].rows), settings.resamples, seed)
    draws = [_solve_equations(products, threshold, settings.ridge, speed, counts) for counts in block_counts]
    confidence = {}
    for i, name in enumerate(EQUATIONS):
        xi = np.stack([d[i] for d in draws])
        terms = speed if i == 0 else library.SLIP_TERMS
        low, high = quantile_interval(xi)
        kept = (xi != 0.0).mean(axis=0)
        confidence[name] = {
            library.term_name(e): [float(k), float(a), float(b)]
            for e, k, a, b in zip(terms, kept, low, high, strict=True) if k > 0.0
        }  # fmt: skip
    return confidence


def _replace_intervals(term_confidence: TermConfidence, sparse: SparseEquations, errors: SparseEquations) -> None:
    """Overwrite the 95 % intervals in `term_confidence` by coefficient +- 1.96 standard errors of a rollout refit.

    `sparse` holds the refitted coefficients, `errors` their standard errors in the same fields.
    """
    for i, name in enumerate(EQUATIONS):
        terms = sparse.speed if i == 0 else sparse.slip
        for e, value, se in zip(terms, sparse[i], errors[i], strict=True):
            term = library.term_name(e)
            if value != 0.0:
                kept = term_confidence[name][term][0] if term in term_confidence[name] else 0.0
                term_confidence[name][term] = [kept, float(value - Z_95 * se), float(value + Z_95 * se)]


def _refine_on_rollouts(
    sparse: SparseEquations, car: KinematicCar, stretches: Windows, every: int
) -> tuple[SparseEquations, SparseEquations]:
    """Refit the nonzero coefficients of `sparse` by nonlinear least squares on the twist in rollouts over stretches.

    These start `every` rows apart.  Returns the refitted equations, and the coefficients' standard errors in the same
    fields (sandwich covariance).
    """
    from scipy.optimize import least_squares

    weight = inverse_spread(stretches.twist[:, 0])
    kept = [np.flatnonzero(xi) for xi in sparse[:3]]
    start = np.concatenate([xi[k] for xi, k in zip(sparse[:3], kept, strict=True)])

    def equations_at(x: Floats) -> SparseEquations:
        parts = np.split(x, np.cumsum([len(k) for k in kept])[:-1])
        filled = [np.zeros_like(xi) for xi in sparse[:3]]
        for xi, k, values in zip(filled, kept, parts, strict=True):
            xi[k] = values
        return SparseEquations(filled[0], filled[1], filled[2], sparse.speed, sparse.slip)

    def residuals(x: Floats) -> Floats:
        errors = weight * (_predict_stretches(equations_at(x), car, stretches) - stretches.twist[:, 1:])
        finite = np.nan_to_num(errors, nan=MAX_WEIGHTED_ERROR)
        return np.asarray(np.clip(finite, -MAX_WEIGHTED_ERROR, MAX_WEIGHTED_ERROR).ravel() / np.sqrt(errors.size))

    def jacobian(x: Floats) -> Floats:
        r, steps = residuals(x), DIFFERENCE_STEP * np.maximum(np.abs(x), 1e-3)
        return np.column_stack([(residuals(x + h * e) - r) / h for h, e in zip(steps, np.eye(len(x)), strict=True)])

    x = least_squares(residuals, start, jacobian, x_scale=np.maximum(np.abs(start), 1e-3), max_nfev=MAX_JACOBIANS).x
    J = jacobian(x)
    gradients = (J * residuals(x)[:, None]).reshape(stretches.stretch_count, -1, len(x)).sum(axis=1)
    block = max(1, round(BLOCK_S / (car.period * every)))
    errors = np.sqrt(np.diag(sandwich_covariance(J, sum_blocks(gradients, block))))
    return equations_at(x), equations_at(errors)
