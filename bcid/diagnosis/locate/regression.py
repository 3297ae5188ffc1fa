"""Is anything still predictable from what the car did, in which channel, and from which quantities?

Extra-trees predict the disturbances of blocks of time that they have not seen; what they predict is physics that
the model lacks.  Where it is simple, a formula of one or two terms predicts it as well.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.diagnosis.limits import LOCATE_LIMITS
from bcid.diagnosis.locate.pushes import WRENCH_CHANNELS, Disturbances
from bcid.physics.car import Car

TREES = 40
LEAF_KNOTS = 6
FOLDS = 4
FEATURE_SHARE = 0.6  # of the columns that a tree tries at a branch
BLOCK_KNOTS = 30  # 15 s: neighbours are alike


@dataclass(frozen=True)
class DisturbanceRegression:
    """What trees predict of the disturbances, in the channel where they predict most."""

    channel: str
    correlation: float  # of predicted with estimated disturbances, on blocks that the trees have not seen
    correlations: dict[str, float]  # by channel
    depends_on: tuple[str, ...]  # most important first
    gain_nats: float  # that the trees' predictions of all channels are worth on those blocks
    form: str | None  # a formula with units, where one predicts nearly as well
    min_correlation: float  # beyond which the disturbances of this take are predictable

    @property
    def predictable(self) -> bool:
        """Whether the trees predict more than they could by chance."""
        return self.correlation > self.min_correlation


def regressor_columns(disturbances: Disturbances) -> dict[str, Floats]:
    """Regressors for the disturbances at K knots of 0.5 s, by their names in diagnosis.json ("speed", "steering" ...).

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


def regress_disturbances(disturbances: Disturbances, car: Car) -> DisturbanceRegression:
    """Predict the disturbances (unexplained accelerations of the body) from the car's state by extra-trees.

    Predictions are cross-validated over blocks of time.  The result names the channel ("fx", "fy" or "mz") with the
    largest correlation of prediction and estimate, the regressors with the largest importance there, and a short
    formula if its correlation is at least `LOCATE_LIMITS.min_formula_share` of the trees'.
    """
    columns = regressor_columns(disturbances)
    X = np.hstack(list(columns.values()))
    owner = np.repeat(np.arange(len(columns)), [c.shape[1] for c in columns.values()])
    targets = np.clip(disturbances.strength, -LOCATE_LIMITS.max_strength_sd, LOCATE_LIMITS.max_strength_sd)
    targets = targets - targets.mean(axis=0)
    predicted, importances = _predict_unseen_blocks(X, targets)
    correlations = {c: _correlation(predicted[:, i], targets[:, i]) for i, c in enumerate(WRENCH_CHANNELS)}
    channel = max(correlations, key=lambda c: correlations[c])
    i = WRENCH_CHANNELS.index(channel)
    shares = np.bincount(owner, importances[i], minlength=len(columns))
    order = [list(columns)[j] for j in np.argsort(-shares) if shares[j] > LOCATE_LIMITS.min_importance]
    depends_on = order[: LOCATE_LIMITS.max_quantities]
    r = max(correlations[channel], 0.0)
    gain = -0.5 * len(targets) * sum(np.log1p(-(min(max(c, 0.0), 0.999) ** 2)) for c in correlations.values())
    min_correlation = max(LOCATE_LIMITS.min_correlation, LOCATE_LIMITS.min_correlation_se / np.sqrt(len(targets)))
    form = _fit_short_formula(disturbances, car, i, depends_on, r) if r > min_correlation else None
    return DisturbanceRegression(channel, r, correlations, tuple(depends_on), float(gain), form, min_correlation)


def _predict_unseen_blocks(X: Floats, targets: Floats) -> tuple[Floats, Floats]:
    """Cross-validated predictions (K, 3) of `targets` (K, 3) from `X` (K, n) by extremely randomised trees.

    Folds are blocks of consecutive samples.  The second array (3, n) holds the mean importance of each column of X
    for each target.
    """
    from sklearn.ensemble import ExtraTreesRegressor

    fold = blocked_folds(len(X))
    predicted, importances = np.zeros_like(targets), np.zeros((3, X.shape[1]))
    for c in range(3):
        for f in range(FOLDS):
            trees = ExtraTreesRegressor(TREES, min_samples_leaf=LEAF_KNOTS, max_features=FEATURE_SHARE, random_state=f)
            trees.fit(X[fold != f], targets[fold != f, c])
            predicted[fold == f, c] = trees.predict(X[fold == f])
            importances[c] += trees.feature_importances_ / FOLDS
    return predicted, importances


def blocked_folds(knots: int) -> Ints:
    """Number of the cross-validation fold, 0 to FOLDS - 1, of each of `knots` consecutive samples: shape (knots,).

    Blocks of BLOCK_KNOTS samples are given to the folds in turn, as neighbouring samples are correlated; blocks are
    shorter, knots // FOLDS, where that is less.
    """
    block = min(BLOCK_KNOTS, knots // FOLDS)
    return np.asarray((np.arange(knots) // block) % FOLDS)


def _correlation(a: Floats, b: Floats) -> float:
    """Pearson's correlation coefficient of two samples (K,); 0 where the standard deviation of either is tiny."""
    if a.std() < 1e-12 or b.std() < 1e-12:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


_SYMBOLS = {
    "v_x": ("v_x", "m/s"), "v_y": ("v_y", "m/s"), "yaw_rate": ("ω", "rad/s"), "steering": ("δ", "rad"),
    "steering_rate": ("δ̇", "rad/s"), "throttle": ("u_m", "m/s"), "braking": ("u_m⁻", "1"), "alpha_f": ("α_f", "rad"),
    "alpha_r": ("α_r", "rad"), "speed": ("|V|", "m/s"),
}  # fmt: skip


def _fit_short_formula(
    disturbances: Disturbances, car: Car, channel: int, depends_on: list[str], tree_correlation: float
) -> str | None:
    """Fit a formula of a few terms to the disturbances in one channel: its text with units, or None if it fits badly.

    `channel` 0, 1, 2 is F_x, F_y, M_z.  Terms are added by forward selection, at most `max_formula_terms`; products
    need a factor in `depends_on`.  The result is None if the correlation in blocked cross-validation is below
    `LOCATE_LIMITS.min_formula_share` of `tree_correlation`.  Disturbances are posterior means, shrunk towards zero:
    dividing by the shrinkage factor, and weighting with it, makes the coefficients unbiased.
    """
    terms = _formula_terms(disturbances, depends_on, "1" if car.sets_force > 0.0 else "m/s")
    share = disturbances.posterior_share[:, channel]
    component, unit, inertia = (("F_x", "N", car.m), ("F_y", "N", car.m), ("M_z", "N m", car.I_z))[channel]
    y = disturbances.push[:, channel] * inertia / share
    y = np.clip(y, *np.quantile(y, [0.005, 0.995]))
    root = np.sqrt(share)
    chosen: list[str] = []
    X = np.ones((len(y), 1))
    required = LOCATE_LIMITS.min_formula_share * tree_correlation
    for _ in range(LOCATE_LIMITS.max_formula_terms):
        rest = root * (y - X @ _weighted_least_squares(X, y, root))
        strengths = {symbol: abs(_correlation(root * values, rest)) for symbol, (values, _) in terms.items()}
        best = max(strengths, key=lambda symbol: strengths[symbol])
        if strengths[best] < LOCATE_LIMITS.min_term_correlation:
            break
        chosen.append(best)
        X = np.column_stack([X, terms[best][0]])
        if _unseen_block_correlation(X, y, root) > required:
            break
    if not chosen or _unseen_block_correlation(X, y, root) < required:
        return None
    parts = [
        f"{v:+.3g} {unit}{'' if terms[t][1] == '1' else f'/({terms[t][1]})'}·{t}"
        for v, t in zip(_weighted_least_squares(X, y, root)[1:], chosen, strict=True)
    ]
    return f"{component} += {' '.join(parts)}"


def _formula_terms(
    disturbances: Disturbances, depends_on: list[str], throttle_unit: str
) -> dict[str, tuple[Floats, str]]:
    """Candidate terms of a formula for the disturbances, by their text: values (K,) at the knots, and unit.

    For each quantity q they are q, tanh(q / 0.05), q |q| and q^3; for two of them the products a b and |a| b if one
    is in `depends_on`.
    """
    columns = regressor_columns(disturbances)
    single = {n: columns[n][:, 0] for n in _SYMBOLS}
    symbols, terms = _SYMBOLS | {"throttle": ("u_m", throttle_unit)}, dict[str, tuple[Floats, str]]()
    for name, value in single.items():
        symbol, unit = symbols[name]
        terms[symbol] = (value, unit)
        terms[f"tanh({symbol}/0.05 {unit})".replace(" 1)", ")")] = (np.tanh(value / 0.05), "1")
        terms[f"{symbol}|{symbol}|"] = (value * np.abs(value), f"({unit})²" if unit != "1" else "1")
        terms[f"{symbol}³"] = (value**3, f"({unit})³" if unit != "1" else "1")
    for first, second in itertools.combinations(single, 2):
        if first in depends_on or second in depends_on:
            (a, unit_a), (b, unit_b) = symbols[first], symbols[second]
            terms[f"{a}·{b}"] = (single[first] * single[second], f"{unit_a}·{unit_b}")
            terms[f"|{a}|·{b}"] = (np.abs(single[first]) * single[second], f"{unit_a}·{unit_b}")
    return terms


def _weighted_least_squares(X: Floats, y: Floats, root: Floats) -> Floats:
    """Weighted least squares: the coefficients b (n,) that minimise |root (y - X b)|^2, for `X` (K, n) and `y` (K,).

    `root` (K,) holds the square roots of the weights.
    """
    return np.asarray(np.linalg.lstsq(X * root[:, None], y * root, rcond=None)[0])


def _unseen_block_correlation(X: Floats, y: Floats, root: Floats) -> float:
    """Correlation of `y` (K,) with its weighted least-squares prediction from `X` (K, n) in blocked cross-validation.

    `root` (K,) holds the square roots of the weights; both are multiplied by it before they are correlated.
    """
    fold, predicted = blocked_folds(len(y)), np.zeros(len(y))
    for f in range(FOLDS):
        seen = fold != f
        predicted[~seen] = X[~seen] @ _weighted_least_squares(X[seen], y[seen], root[seen])
    return _correlation(root * predicted, root * y)
