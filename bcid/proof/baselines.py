"""What else a user would try on the same takes, so that the diagnosis' figures mean something.

All are given the base model's fit to the take and what pushed the car beside it; none refits the base.  The first two
may name an effect, the others fit a function and cannot.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from bcid.aliases import Floats, Ints
from bcid.diagnosis.diagnose import Diagnosis
from bcid.diagnosis.locate.pushes import Disturbances
from bcid.diagnosis.locate.regression import folds, variables
from bcid.diagnosis.search.screen import changes
from bcid.effects.table import EFFECTS
from bcid.likelihood.marginal import moments, products, rescaled, weights
from bcid.likelihood.nuisance import deviations
from bcid.likelihood.refit import Fit
from bcid.likelihood.score_test import Changes, Trial
from bcid.likelihood.take import Take
from bcid.proof.scores.tiers import shown

SEEN = 0.02  # share of the pushes' squares on blocks not seen, above which a fit counts as a detection
SIGNIFICANT = 0.01
THRESHOLD = 0.05  # of STLSQ, in standard deviations of a push
LAGS = 10
MOST_STEPS = 4


class Said(NamedTuple):
    """What a method makes of a take."""

    effect: str | None  # named first
    detected: bool
    explained: float | None  # share of the pushes' squares on blocks not seen


class Ground(NamedTuple):
    """What every method is given."""

    take: Take
    base: Fit
    pushed: Disturbances

    @property
    def features(self) -> Floats:
        """State and time at every knot (K, n), standardised."""
        X = np.hstack(list(variables(self.pushed).values()))
        return np.asarray((X - X.mean(axis=0)) / np.maximum(X.std(axis=0), 1e-9))

    @property
    def fold(self) -> Ints:
        """The fold (K,) of each knot: what is fitted has not seen the blocks that it is judged on."""
        return folds(len(self.pushed.time_s))

    @property
    def targets(self) -> Floats:
        """The pushes in standard deviations (K, 3), outliers cut."""
        y = np.clip(self.pushed.strength, -5.0, 5.0)
        return np.asarray(y - y.mean(axis=0))


def sparse_regression(ground: Ground) -> Said:
    """SINDy on the residual (pysindy's STLSQ): one term for each mechanism that is a force, the largest is named."""
    import pysindy

    names, terms = _mechanisms(ground)
    y = ground.targets.T.ravel()
    scale = np.maximum(np.sqrt((terms**2).mean(axis=1)), 1e-12)
    theta = (terms / scale[:, None]).T

    def coefficients(X: Floats, target: Floats) -> Floats:
        return np.asarray(pysindy.STLSQ(threshold=THRESHOLD, alpha=1e-3).fit(X, target).coef_).ravel()

    def linear(train: Floats, target: Floats, test: Floats) -> Floats:
        return np.asarray(test @ coefficients(train, target))

    found = np.abs(coefficients(theta, y))
    explained = _cross_explained(theta, y, linear, np.tile(ground.fold, 3))
    best = int(np.argmax(found))
    return Said(names[best] if found[best] > 0.0 else None, bool(found[best] > 0.0), explained)


def _mechanisms(ground: Ground) -> tuple[list[str], Floats]:
    """Each mechanism's acceleration at the knots, the three channels one after the other (n, 3 K), in their scale."""
    m, car, c = ground.pushed.mean, ground.base.car(), ground.base.hypothesis.constants
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
        "floor_slope": (np.cos(m["theta"]), -np.sin(m["theta"]), nothing),
        "yaw_scrub": (nothing, nothing, -omega),
        "yaw_coulomb": (nothing, nothing, -np.tanh(omega / c.w_c)),
        "drive_lateral_offset": (nothing, nothing, m["F_m"] * np.cos(delta)),
        "front_ply_steer": at_front(nothing, np.tanh(v_fx / c.v_c)),
        "rear_toe": (nothing, np.sign(v_x), -car.l_r * np.sign(v_x)),
        "motor_sag": at_front(-m["F_m"] * ground.pushed.time_s),
        "motor_power_limit": at_front(-np.maximum(m["F_m"], 0.0) * np.abs(v_fx)),
        "steering_offset": at_front(nothing, np.abs(v_fx)),
    }
    q = ground.base.scales.q * [car.m, car.m, car.I_z]
    terms = np.array([[w / s for w, s in zip(three, q, strict=True)] for three in wrenches.values()])
    terms -= terms.mean(axis=2, keepdims=True)  # as the targets are
    return list(wrenches), terms.reshape(len(terms), -1)


def stepwise(ground: Ground) -> Said:
    """Forward selection by BIC without refitting the base: what fits the residual best is named."""
    take, fit = ground.take, ground.base
    r = deviations(take, fit.hypothesis.setting(fit.phi, take), fit.start, fit.tangent.A)
    _, e = rescaled(moments(r, fit.tangent.A, take.first), fit.scales, 0)
    tried = changes(fit, take)
    g, G = products(r, fit.tangent.A, tried.columns, take.first, fit.scales.r, e.V)
    w = weights(e)
    slope, information = w @ g, np.tensordot(w, G, axes=1)
    taken: list[int] = []
    first, explained = None, 0.0
    while len(taken) < MOST_STEPS:
        scored = [
            (_joint(slope, information, [*taken, *range(t.own.start, t.own.stop)]), t) for t in _open(tried, taken)
        ]
        gain, best = max(scored, key=lambda pair: pair[0])
        if gain - explained < 0.5 * (best.own.stop - best.own.start) * np.log(take.segments):
            break
        first, explained = first or best.effect, gain
        taken += range(best.own.start, best.own.stop)
    return Said(first, first is not None, None)


def _open(tried: Changes, taken: Sequence[int]) -> list[Trial]:
    """The vocabulary's trials that are not taken yet; a trial of one sign counts at either."""
    return [t for t in tried.trials if t.effect in EFFECTS and t.own.start not in taken]


def _joint(slope: Floats, information: Floats, columns: Sequence[int]) -> float:
    """Nats that the columns gain together."""
    g, G = slope[list(columns)], information[np.ix_(columns, columns)]
    scale = np.sqrt(np.maximum(np.diag(G), 1e-12))
    return float(0.5 * (g / scale) @ np.linalg.lstsq(G / np.outer(scale, scale), g / scale, rcond=1e-8)[0])


def perceptron(ground: Ground) -> Said:
    """A multilayer perceptron of the residual."""
    from sklearn.neural_network import MLPRegressor

    def fitted(train: Floats, target: Floats, test: Floats) -> Floats:
        model = MLPRegressor(hidden_layer_sizes=(32, 32), alpha=1e-2, early_stopping=True, max_iter=300, random_state=0)
        return np.asarray(model.fit(train, target).predict(test))

    explained = _cross_explained(ground.features, ground.targets, fitted, ground.fold)
    return Said(None, explained > SEEN, explained)


def boosting(ground: Ground) -> Said:
    """Gradient-boosted trees of the residual."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    def fitted(train: Floats, target: Floats, test: Floats) -> Floats:
        models = [HistGradientBoostingRegressor(max_iter=80, random_state=0).fit(train, y) for y in target.T]
        return np.column_stack([model.predict(test) for model in models])

    explained = _cross_explained(ground.features, ground.targets, fitted, ground.fold)
    return Said(None, explained > SEEN, explained)


def residual_tests(ground: Ground) -> Said:
    """Whiteness of the pushes (Ljung and Box 1978) and independence of the state, at one per cent over all of them."""
    from scipy.stats import chi2, pearsonr

    y, X = ground.targets, ground.features
    n, smallest, tests = len(y), 1.0, 0
    for channel in y.T:
        rho = np.array([np.corrcoef(channel[k:], channel[:-k])[0, 1] for k in range(1, LAGS + 1)])
        statistic = n * (n + 2) * np.sum(rho**2 / (n - np.arange(1, LAGS + 1)))
        each = [float(chi2.sf(statistic, LAGS)), *(float(pearsonr(channel, x).pvalue) for x in X.T if x.std() > 0.0)]
        smallest, tests = min(smallest, *each), tests + len(each)
    return Said(None, bool(smallest * tests < SIGNIFICANT), None)


METHODS: dict[str, Callable[[Ground], Said]] = {
    "SINDy on the residual (pysindy)": sparse_regression,
    "stepwise BIC, base not refitted": stepwise,
    "residual MLP": perceptron,
    "residual gradient boosting": boosting,
    "residual tests (whiteness, correlation)": residual_tests,
}


def _cross_explained(X: Floats, y: Floats, fitted: Callable[[Floats, Floats, Floats], Floats], fold: Ints) -> float:
    """Share of the squares of `y` that fits explain on folds that they have not seen."""
    predicted = np.zeros_like(y)
    for f in np.unique(fold):
        predicted[fold == f] = fitted(X[fold != f], y[fold != f], X[fold == f])
    return float(1.0 - np.sum((y - predicted) ** 2) / np.sum(y**2))


NAMING = ("bcid diagnose", "SINDy on the residual (pysindy)", "stepwise BIC, base not refitted")
"""The methods that can name; the first of the others has terms for 14 of the 41 effects."""


def compared(found: Diagnosis) -> dict[str, dict[str, Any]]:
    """What every method makes of a take, by its name; of the diagnosis only the base model's fit is used."""
    ground, told = Ground(found.take, found.search.base, found.before), {}
    with threadpool_limits(1), warnings.catch_warnings():  # a suite's workers share the cores
        warnings.simplefilter("ignore", UserWarning)  # of sparse fits that hold nothing, of nets that would go on
        for method, says in METHODS.items():
            begin = time.perf_counter()
            try:
                said, failed = says(ground), ""
            except (ArithmeticError, ValueError, np.linalg.LinAlgError) as error:  # it says nothing, and is counted
                said, failed = Said(None, False, None), repr(error)
            told[method] = {**said._asdict(), "failed": failed, "seconds": round(time.perf_counter() - begin, 2)}
    return told


def summary(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Of the diagnosis and each method on the same takes: first names right, false alarms, detections, of how many.

    A take on which the diagnosis ended in an error has nothing of the others, and counts as missed by it.
    """
    by_method: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        others = row.get("others", {})
        if not (others or "error" in row) or not shown(row):  # where naming is wrong
            continue
        first = row["findings"][0]["effect"] if row.get("findings") else None
        ours = {
            "effect": first, "detected": bool(first) or row.get("verdict") == "unknown", "explained": None,
            "seconds": row.get("seconds"), "failed": row.get("error", ""),
        }  # fmt: skip
        for method, said in {"bcid diagnose": ours, **others}.items():
            by_method.setdefault(method, []).append(
                {**said, "answer": row["answer"], "hidden": row["channel"], "tier": row["tier"]}
            )
    return [_counted(method, members) for method, members in by_method.items()]


def _counted(method: str, rows: list[dict[str, Any]]) -> dict[str, Any]:
    there, nothing = [r for r in rows if r["answer"]], [r for r in rows if r["tier"] == "null"]
    nameable = [r["effect"] in r["answer"] for r in there if not r["hidden"]]
    explained = [r["explained"] for r in there if r["explained"] is not None]
    seconds = [r["seconds"] for r in rows if r["seconds"] is not None]
    return {
        "method": method, "n": len(rows),
        "top1": [sum(nameable), len(nameable)] if nameable and method in NAMING else None,
        "false": [sum(r["detected"] for r in nothing), len(nothing)] if nothing else None,
        "detected": [sum(r["detected"] for r in there), len(there)] if there else None,
        "explained": float(np.median(explained)) if explained else None,
        "failed": sum(bool(r.get("failed")) for r in rows),
        "seconds": float(np.median(seconds)) if seconds else None,
    }  # fmt: skip
