"""Other methods on the takes of a blind test, so that the figures of the diagnosis can be compared.

Each is given the base model's fit and the pushes that the recorded motion needs beside it; none refits the base
model.  The first two may name an effect, the others fit a function and cannot.
"""

import time
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from bcid.aliases import Floats, Ints
from bcid.diagnosis.diagnose import Diagnosis
from bcid.diagnosis.locate.pushes import Disturbances
from bcid.diagnosis.search.screen import simulate_trials
from bcid.effects.table import EFFECTS
from bcid.likelihood.marginal import robust_weights, score_and_information, segment_moments
from bcid.likelihood.refit import Fit
from bcid.likelihood.scale_estimate import estimate_scales
from bcid.likelihood.take import Take
from bcid.proof.blind.limits import LIMITS
from bcid.proof.blind.regressors import (
    Predictor,
    blocked_folds,
    fit_boosted_trees,
    fit_perceptron,
    regressor_columns,
)

# coefficients below it are dropped by STLSQ; in standard deviations of a push
STLSQ_THRESHOLD = 0.05
WHITENESS_LAGS = 10
# columns that stepwise selection takes at most
MAX_COLUMNS = 4

Regression = Callable[[Floats, Floats], Predictor]
"""Fits X (N, n) and y (N,) or (N, m); what it returns predicts y at unseen rows of X."""


class MethodAnswer(NamedTuple):
    """What a method says of a take."""

    effect: str | None  # named first
    detected: bool
    explained: float | None  # share of the pushes' squares on blocks not seen


class ResidualData(NamedTuple):
    """What every method is given: the take, the fit of the base model, and the pushes beside it."""

    take: Take
    base: Fit
    pushed: Disturbances

    @property
    def features(self) -> Floats:
        """State and time at every knot (K, n), standardised."""
        X = np.hstack(list(regressor_columns(self.pushed).values()))
        return np.asarray((X - X.mean(axis=0)) / np.maximum(X.std(axis=0), 1e-9))

    @property
    def knot_fold(self) -> Ints:
        """Number of each knot's cross-validation fold (K,), in blocks of time."""
        return blocked_folds(len(self.pushed.time_s))

    @property
    def targets(self) -> Floats:
        """Pushes at the knots (K, 3) in their standard deviations, centred, outliers cut at 5."""
        y = np.clip(self.pushed.strength, -5.0, 5.0)
        return np.asarray(y - y.mean(axis=0))


def regress_sparsely(residual: ResidualData) -> MethodAnswer:
    """Sparse regression (STLSQ of SINDy, by pysindy) of the base model's disturbances on the forces of 15 effects.

    Disturbances are accelerations of the body, constant over 0.25 s, that the base model's fit needs to follow the
    recorded motion.  Regressors are scaled to RMS 1; the answer names the effect with the largest coefficient that is
    not dropped.
    """
    import pysindy

    names, terms = _mechanism_accelerations(residual)
    y = residual.targets.T.ravel()
    scale = np.maximum(np.sqrt((terms**2).mean(axis=1)), 1e-12)
    theta = (terms / scale[:, None]).T

    def coefficients(X: Floats, target: Floats) -> Floats:
        return np.asarray(pysindy.STLSQ(threshold=STLSQ_THRESHOLD, alpha=1e-3).fit(X, target).coef_).ravel()

    def linear(train: Floats, target: Floats) -> Predictor:
        fitted = coefficients(train, target)
        return lambda test: np.asarray(test @ fitted)

    found = np.abs(coefficients(theta, y))
    explained = _explained_share(theta, y, linear, np.tile(residual.knot_fold, 3))
    best = int(np.argmax(found))
    return MethodAnswer(names[best] if found[best] > 0.0 else None, bool(found[best] > 0.0), explained)


def _mechanism_accelerations(residual: ResidualData) -> tuple[list[str], Floats]:
    """Ids of n candidate effects, and the accelerations (n, 3 K) that each causes at unit strength at K knots (0.25 s).

    Each row holds K values along the body's x, then y, then K in yaw, each third centred.  Values are in standard
    deviations that the base model's fit expects of the disturbances.
    """
    m, car, c = residual.pushed.states, residual.base.car(), residual.base.hypothesis.constants
    v_x, v_y, omega, delta = m["v_x"], m["v_y"], m["omega"], m["delta"]
    v_fx = np.cos(delta) * v_x + np.sin(delta) * (v_y + car.l_f * omega)
    speed, nothing = np.hypot(v_x, v_y), np.zeros_like(v_x)

    def at_front(along: Floats, across: Floats = nothing) -> tuple[Floats, Floats, Floats]:
        x, y = np.cos(delta) * along - np.sin(delta) * across, np.sin(delta) * along + np.cos(delta) * across
        return x, y, car.l_f * y

    wrenches = {
        "rear_rolling_coulomb": (-np.tanh(v_x / c.v_c), nothing, nothing),
        "rear_rolling_viscous": (-v_x, nothing, nothing),
        "front_coulomb_friction": at_front(-np.tanh(v_fx / c.v_c)),
        "quadratic_drag": (-speed * v_x, -speed * v_y, nothing),
        "steering_drag": at_front(-np.abs(delta) * v_fx),
        "steering_friction": at_front(-np.abs(delta) * np.tanh(v_fx / c.v_c)),
        "floor_slope": (np.cos(m["theta"]), -np.sin(m["theta"]), nothing),
        "yaw_scrub": (nothing, nothing, -omega),
        "yaw_coulomb": (nothing, nothing, -np.tanh(omega / c.w_c)),
        "drive_lateral_offset": (nothing, nothing, m["F_m"] * np.cos(delta)),
        "front_ply_steer": at_front(nothing, np.tanh(v_fx / c.v_c)),
        "rear_toe": (nothing, np.sign(v_x), -car.l_r * np.sign(v_x)),
        "motor_sag": at_front(-m["F_m"] * residual.pushed.time_s),
        "motor_power_limit": at_front(-np.maximum(m["F_m"], 0.0) * np.abs(v_fx)),
        "steering_offset": at_front(nothing, np.abs(v_fx)),
    }
    q = residual.base.scales.q * [car.m, car.m, car.I_z]
    terms = np.array([[w / s for w, s in zip(three, q, strict=True)] for three in wrenches.values()])
    terms -= terms.mean(axis=2, keepdims=True)  # as the targets are
    return list(wrenches), terms.reshape(len(terms), -1)


def select_stepwise(residual: ResidualData) -> MethodAnswer:
    """Forward stepwise selection of effects by BIC, without refitting the base model; the answer names the first one.

    Gains (nats) are those of a score test, for each effect at a few sizes and places.  An effect is added while the
    joint gain of all rises by more than ln(number of segments) / 2 for each of its columns, up to MAX_COLUMNS
    columns.
    """
    take, fit = residual.take, residual.base
    r = fit.residuals(take, fit.phi)
    _, e = estimate_scales(segment_moments(r, fit.tangent.A, take.first), fit.scales, 0)
    tried = simulate_trials(fit, take)
    g, G = score_and_information(r, fit.tangent.A, tried.columns, take.first, fit.scales.r, e.root)
    w = robust_weights(e)
    slope, information = w @ g, np.tensordot(w, G, axes=1)
    taken: list[int] = []
    first, explained = None, 0.0
    while len(taken) < MAX_COLUMNS:
        # of the vocabulary's trials; a trial of one sign counts at either sign
        scored = [
            (_joint_gain(slope, information, [*taken, *range(t.own.start, t.own.stop)]), t)
            for t in tried.trials
            if t.effect in EFFECTS and t.own.start not in taken
        ]
        gain, best = max(scored, key=lambda pair: pair[0])
        if gain - explained < 0.5 * (best.own.stop - best.own.start) * np.log(take.segments):
            break
        first, explained = first or best.effect, gain
        taken += range(best.own.start, best.own.stop)
    return MethodAnswer(first, first is not None, None)


def _joint_gain(slope: Floats, information: Floats, columns: Sequence[int]) -> float:
    """Log-likelihood gain g^T G^+ g / 2 (nats) by the linear parameters at `columns` together: the score test.

    g are their entries of the score `slope` (n,), G those of the Fisher `information` (n, n), inverted by least
    squares.
    """
    g, G = slope[list(columns)], information[np.ix_(columns, columns)]
    scale = np.sqrt(np.maximum(np.diag(G), 1e-12))
    return float(0.5 * (g / scale) @ np.linalg.lstsq(G / np.outer(scale, scale), g / scale, rcond=1e-8)[0])


def _judge_regression(fit: Regression, residual: ResidualData) -> MethodAnswer:
    """Answer of a method that regresses the base model's disturbances (unexplained accelerations) on state and time.

    It detects missing physics, without a name, if its R^2 in cross-validation over blocks of time is above
    `LIMITS.min_explained_share`.
    """
    explained = _explained_share(residual.features, residual.targets, fit, residual.knot_fold)
    return MethodAnswer(None, explained > LIMITS.min_explained_share, explained)


def detect_residual_structure(residual: ResidualData) -> MethodAnswer:
    """Test the base model's disturbances for autocorrelation (Ljung-Box) and for correlation with the state (Pearson).

    Disturbances are accelerations of the body that the base model's fit does not explain.  The method detects missing
    physics, without a name, if the smallest p-value times the number of tests (Bonferroni) is below
    `LIMITS.residual_test_level`.
    """
    from scipy.stats import chi2, pearsonr

    y, X = residual.targets, residual.features
    n, smallest, tests = len(y), 1.0, 0
    for channel in y.T:
        rho = np.array([np.corrcoef(channel[k:], channel[:-k])[0, 1] for k in range(1, WHITENESS_LAGS + 1)])
        statistic = n * (n + 2) * np.sum(rho**2 / (n - np.arange(1, WHITENESS_LAGS + 1)))
        p_values = [float(chi2.sf(statistic, WHITENESS_LAGS))]
        p_values += [float(pearsonr(channel, x).pvalue) for x in X.T if x.std() > 0.0]
        smallest, tests = min(smallest, *p_values), tests + len(p_values)
    return MethodAnswer(None, bool(smallest * tests < LIMITS.residual_test_level), None)


METHODS: dict[str, Callable[[ResidualData], MethodAnswer]] = {
    "SINDy on the residual (pysindy)": regress_sparsely,
    "stepwise BIC, base not refitted": select_stepwise,
    "residual MLP": partial(_judge_regression, fit_perceptron),
    "residual gradient boosting": partial(_judge_regression, fit_boosted_trees),
    "residual tests (whiteness, correlation)": detect_residual_structure,
}


def _explained_share(X: Floats, y: Floats, fit: Regression, fold: Ints) -> float:
    """R^2 of a regression in cross-validation: 1 - sum (y - y_hat)^2 / sum y^2, `y` being centred.

    What `fit` returns of all other folds predicts y_hat in each fold; `fold` (N,) is each row's number of its fold.
    """
    predicted = np.zeros_like(y)
    for f in np.unique(fold):
        predicted[fold == f] = fit(X[fold != f], y[fold != f])(X[fold == f])
    return float(1.0 - np.sum((y - predicted) ** 2) / np.sum(y**2))


def run_baselines(diagnosis: Diagnosis) -> dict[str, dict[str, Any]]:
    """Run the other methods that METHODS lists (SINDy, stepwise BIC ...) on a diagnosed take; return answers by method.

    An answer has "effect" (named first, or None), "detected", "explained" (R^2 of the disturbances), "failed" (the
    error) and "seconds".  Of the diagnosis only the base model's fit and the disturbances beside it are used.
    """
    residual, answers = ResidualData(diagnosis.take, diagnosis.naming.base, diagnosis.pushes_before), {}
    # a suite's workers share the cores; warnings are of sparse fits that keep no term
    with threadpool_limits(1), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        for method, run_method in METHODS.items():
            begin = time.perf_counter()
            try:
                answer, failed = run_method(residual), ""
            except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
                answer, failed = MethodAnswer(None, False, None), repr(error)
            answers[method] = {**answer._asdict(), "failed": failed, "seconds": round(time.perf_counter() - begin, 2)}
    return answers
