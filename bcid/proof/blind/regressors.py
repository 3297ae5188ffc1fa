"""Regressions of what a model leaves: what they are given at each 0.25 s, folds in time, a perceptron and trees."""

import warnings
from collections.abc import Callable

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.diagnosis.locate.pushes import Disturbances

Predictor = Callable[[Floats], Floats]
"""A fitted regression: targets (M, m) at inputs (M, n)."""

FOLDS = 4
BLOCK_KNOTS = 60  # 15 s: neighbours are alike


def regressor_columns(disturbances: Disturbances) -> dict[str, Floats]:
    """Regressors for the disturbances at K knots of 0.25 s, by their names in diagnosis.json ("speed", "steering" ...).

    Each is an array (K, n): n = 1 but for "throttle" (u_m and motor force F_m), "place" (x, y) and "heading" (sine,
    cosine), where n = 2.
    """
    m = disturbances.states
    single = {
        "v_x": m["v_x"], "v_y": m["v_y"], "speed": np.hypot(m["v_x"], m["v_y"]), "yaw_rate": m["omega"],
        "steering": m["delta"], "steering_rate": m["delta_rate"], "throttle": np.maximum(m["u_m"], 0.0),
        "braking": np.minimum(m["u_m"], 0.0), "alpha_f": m["alpha_f"], "alpha_r": m["alpha_r"],
    }  # fmt: skip
    columns = {name: v[:, None] for name, v in single.items()}
    columns["throttle"] = np.column_stack([single["throttle"], m["F_m"]])
    columns["place"] = np.column_stack([m["p_x"], m["p_y"]])
    columns["heading"] = np.column_stack([np.sin(m["theta"]), np.cos(m["theta"])])
    columns["time"] = disturbances.time_s[:, None]
    return columns


def blocked_folds(knots: int) -> Ints:
    """Number of the cross-validation fold, 0 to FOLDS - 1, of each of `knots` consecutive samples: shape (knots,).

    Blocks of BLOCK_KNOTS samples are given to the folds in turn, as neighbouring samples are correlated; blocks are
    shorter, knots // FOLDS, where that is less.
    """
    block = min(BLOCK_KNOTS, knots // FOLDS)
    return np.asarray((np.arange(knots) // block) % FOLDS)


def fit_perceptron(inputs: Floats, targets: Floats) -> Predictor:
    """Fit a multilayer perceptron to standardised `inputs` (N, n) and `targets` (N, m); seeded, so always the same."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.neural_network import MLPRegressor

    model = MLPRegressor(hidden_layer_sizes=(32, 32), alpha=1e-2, early_stopping=True, max_iter=300, random_state=0)
    with warnings.catch_warnings():
        # that it might learn on is what early stopping means
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(inputs, targets)
    return lambda unseen: np.asarray(model.predict(unseen))


def fit_boosted_trees(inputs: Floats, targets: Floats) -> Predictor:
    """Fit gradient-boosted trees to `inputs` (N, n) and each column of `targets` (N, m); seeded."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    models = [HistGradientBoostingRegressor(max_iter=80, random_state=0).fit(inputs, y) for y in targets.T]
    return lambda unseen: np.column_stack([model.predict(unseen) for model in models])
