"""Is anything still predictable from what the car did, in which channel, and from what?

Extra-trees predict the disturbances of blocks of time that they have not seen; what they predict is physics that
the model lacks.  Where it is simple, one or two terms say it as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bcid.aliases import Floats, Ints
from bcid.diagnosis.locate.pushes import CHANNELS, CLIP_SD, Disturbances
from bcid.physics.car import Car

TREES = 40
LEAF = 6
FOLDS = 4
BLOCK_KNOTS = 30  # 15 s: neighbours are alike
PREDICTABLE = 0.25  # correlation above which something is predictable; ten-minute nulls gave at most 0.13,
BY_CHANCE = 4.0  # and short ones so many standard errors of none
LEADING = 0.15  # share of the importance above which a variable is named
SIMPLE = 0.8  # share of what the trees predict that a short sum must reach to be given as a form


@dataclass(frozen=True)
class Remainder:
    """What is still predictable in the channel where most is."""

    channel: str
    correlation: float  # of predicted with found disturbances, on blocks not seen
    correlations: dict[str, float]
    depends_on: tuple[str, ...]  # most important first
    gain: float  # nats that a model of it would be worth on the knots not seen
    form: str | None  # a short sum with units, where one is nearly as good
    least: float = PREDICTABLE  # correlation above which it is more than chance

    @property
    def predictable(self) -> bool:
        """Whether it is more than nothing."""
        return self.correlation > self.least


def variables(of: Disturbances) -> dict[str, Floats]:
    """What disturbances may depend on, in the words of diagnosis.json, as columns (K, n) each."""
    m = of.mean
    single = {
        "v_x": m["v_x"], "v_y": m["v_y"], "speed": np.hypot(m["v_x"], m["v_y"]), "yaw_rate": m["omega"],
        "steering": m["delta"], "steering_rate": m["delta_rate"], "throttle": np.maximum(m["u_m"], 0.0),
        "braking": np.minimum(m["u_m"], 0.0), "alpha_f": m["alpha_f"], "alpha_r": m["alpha_r"],
    }  # fmt: skip
    columns = {name: v[:, None] for name, v in single.items()}
    columns["throttle"] = np.column_stack([single["throttle"], m["F_m"]])
    columns["place"] = np.column_stack([m["p_x"], m["p_y"]])
    columns["heading"] = np.column_stack([np.sin(m["theta"]), np.cos(m["theta"])])
    columns["time"] = of.time_s[:, None]
    return columns


def remainder(of: Disturbances, car: Car) -> Remainder:
    """What of the disturbances is predictable."""
    columns = variables(of)
    X = np.hstack(list(columns.values()))
    owner = np.repeat(np.arange(len(columns)), [c.shape[1] for c in columns.values()])
    targets = np.clip(of.strength, -CLIP_SD, CLIP_SD)
    targets = targets - targets.mean(axis=0)
    predicted, importances = _cross_predicted(X, targets)
    correlations = {c: _correlation(predicted[:, i], targets[:, i]) for i, c in enumerate(CHANNELS)}
    channel = max(correlations, key=lambda c: correlations[c])
    i = CHANNELS.index(channel)
    shares = np.bincount(owner, importances[i], minlength=len(columns))
    order = [list(columns)[j] for j in np.argsort(-shares) if shares[j] > LEADING][:2]
    r = max(correlations[channel], 0.0)
    gain = -0.5 * len(targets) * sum(np.log1p(-(min(max(c, 0.0), 0.999) ** 2)) for c in correlations.values())
    least = max(PREDICTABLE, BY_CHANCE / np.sqrt(len(targets)))
    form = _form(of, car, i, order, r) if r > least else None
    return Remainder(channel, r, correlations, tuple(order), float(gain), form, least)


def _cross_predicted(X: Floats, targets: Floats) -> tuple[Floats, Floats]:
    """Predictions (K, 3) of blocks not seen, and importances (3, n)."""
    from sklearn.ensemble import ExtraTreesRegressor

    fold = folds(len(X))
    predicted, importances = np.zeros_like(targets), np.zeros((3, X.shape[1]))
    for c in range(3):
        for f in range(FOLDS):
            trees = ExtraTreesRegressor(TREES, min_samples_leaf=LEAF, max_features=0.6, random_state=f)
            trees.fit(X[fold != f], targets[fold != f, c])
            predicted[fold == f, c] = trees.predict(X[fold == f])
            importances[c] += trees.feature_importances_ / FOLDS
    return predicted, importances


def folds(knots: int) -> Ints:
    """The fold (K,) of each knot: blocks in turn, shorter ones where the take is short."""
    block = min(BLOCK_KNOTS, knots // FOLDS)
    return np.asarray((np.arange(knots) // block) % FOLDS)


def _correlation(a: Floats, b: Floats) -> float:
    if a.std() < 1e-12 or b.std() < 1e-12:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


_TERMS = {
    "v_x": ("v_x", "m/s"), "v_y": ("v_y", "m/s"), "yaw_rate": ("ω", "rad/s"), "steering": ("δ", "rad"),
    "steering_rate": ("δ̇", "rad/s"), "throttle": ("u_m", "m/s"), "braking": ("u_m⁻", "1"), "alpha_f": ("α_f", "rad"),
    "alpha_r": ("α_r", "rad"), "speed": ("|V|", "m/s"),
}  # fmt: skip
_UNITS = ("N", "N", "N m")
_SUMS = ("F_x", "F_y", "M_z")


def _form(of: Disturbances, car: Car, channel: int, depends: list[str], reached: float) -> str | None:
    """One or two terms of products of the variables, if they predict blocks not seen nearly as well as the trees.

    A posterior mean shows only a share of a push; divided by it, and weighted with it, the coefficients are right
    on the average.
    """
    terms = _terms(of, depends, "1" if car.sets_force > 0.0 else "m/s")
    share = of.share[:, channel]
    y = of.push[:, channel] * (car.m, car.m, car.I_z)[channel] / share
    y = np.clip(y, *np.quantile(y, [0.005, 0.995]))
    root = np.sqrt(share)
    chosen: list[str] = []
    X = np.ones((len(y), 1))
    for _ in range(2):
        rest = y - X @ _weighted(X, y, root)
        best = max(terms, key=lambda t: abs(_correlation(root * terms[t][0], root * rest)))
        if abs(_correlation(root * terms[best][0], root * rest)) < PREDICTABLE * 0.5:
            break
        chosen.append(best)
        X = np.column_stack([X, terms[best][0]])
        if _predicts(X, y, root) > SIMPLE * reached:
            break
    if not chosen or _predicts(X, y, root) < SIMPLE * reached:
        return None
    parts = [
        f"{v:+.3g} {_UNITS[channel]}/({terms[t][1]})·{t}" if terms[t][1] != "1" else f"{v:+.3g} {_UNITS[channel]}·{t}"
        for v, t in zip(_weighted(X, y, root)[1:], chosen, strict=True)
    ]
    return f"{_SUMS[channel]} += {' '.join(parts)}"


def _terms(of: Disturbances, depends: list[str], of_the_throttle: str) -> dict[str, tuple[Floats, str]]:
    """Single variables, their odd powers and signs, and products with those that matter: values and unit."""
    columns = variables(of)
    basic = {n: columns[n][:, 0] for n in _TERMS}
    told, terms = _TERMS | {"throttle": ("u_m", of_the_throttle)}, dict[str, tuple[Floats, str]]()
    for name, value in basic.items():
        symbol, unit = told[name]
        terms[symbol] = (value, unit)
        terms[f"tanh({symbol}/0.05 {unit})".replace(" 1)", ")")] = (np.tanh(value / 0.05), "1")
        terms[f"{symbol}|{symbol}|"] = (value * np.abs(value), f"({unit})²" if unit != "1" else "1")
        terms[f"{symbol}³"] = (value**3, f"({unit})³" if unit != "1" else "1")
    for i, one in enumerate(basic):
        for other in list(basic)[i + 1 :]:
            if one in depends or other in depends:
                (a, unit_a), (b, unit_b) = told[one], told[other]
                terms[f"{a}·{b}"] = (basic[one] * basic[other], f"{unit_a}·{unit_b}")
                terms[f"|{a}|·{b}"] = (np.abs(basic[one]) * basic[other], f"{unit_a}·{unit_b}")
    return terms


def _weighted(X: Floats, y: Floats, root: Floats) -> Floats:
    return np.asarray(np.linalg.lstsq(X * root[:, None], y * root, rcond=None)[0])


def _predicts(X: Floats, y: Floats, root: Floats) -> float:
    """Correlation on blocks not seen, as the trees have it."""
    fold, predicted = folds(len(y)), np.zeros(len(y))
    for f in range(FOLDS):
        seen = fold != f
        predicted[~seen] = X[~seen] @ _weighted(X[seen], y[seen], root[seen])
    return _correlation(root * predicted, root * y)
