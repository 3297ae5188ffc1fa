"""The missing law before any hypothesis: what free functions explain in a channel, as a curve with a band.

The coefficients of the functions have the mean c = (G + T^-1)^-1 b and the covariance (G + T^-1)^-1 (`evidence`).  Over
the quantity on which a channel depends most, the curve is the mean of phi(s) . c over what the drive went through at
each value; its band is what the covariance leaves.

Names are drawn over it as the same functions would have shown them, had the take been what the fit with the names
predicts: that prediction less the base model's stands in the place of the residual, and all else is the same.  What a
refit of the base model takes up, and what the prior holds back, is taken from both alike, so that a right name lies
within the band.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats, Ints
from bcid.diagnosis.limits import SUMMARY_LIMITS
from bcid.diagnosis.remainder.evidence import Quadratic
from bcid.diagnosis.remainder.explain import Explained
from bcid.diagnosis.remainder.functions import QUANTITIES, channel_of
from bcid.diagnosis.remainder.information import TakeInformation, gather_information
from bcid.effects.remainder_table import (
    BODY_X,
    COLUMNS,
    DIRECTION,
    DIRECTIONS,
    DRIVEN_ALONG,
    INPUTS,
    WAVE,
    WHEEL_ANGLE,
    YAW,
)
from bcid.likelihood.force_history import acting_values
from bcid.likelihood.predict import wrap_yaw
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take
from bcid.physics.car import Car

ACTION_OF = {"fx": 0, "motor": 0, "fy": 1, "mz": 2, "steering": 3}
"""By channel the action in which its law is drawn: 0 to 3 for a_x, a_y, alpha_z and a turn of the wheel.  Laws of the
tracking are not drawn."""

INPUT_OF = {written: name for name, written in reversed(QUANTITIES.items()) if written != "place"}
"""What a curve is drawn over, by the quantity's name in diagnosis.json.  A law of the place is a map, and no curve."""


class MissingLaw(NamedTuple):
    """What free functions show to be missing in one channel, in n bins of the quantity on which it depends most."""

    quantity: str  # by its name in diagnosis.json
    x: Floats  # (n,) mean of the quantity in each bin (SI)
    y: Floats  # (n,) mean of the law (m/s^2, rad/s^2 or rad)
    sd: Floats  # (n,) its standard deviation
    named: Floats | None  # (n,) what the names alone would have shown; None without names
    period_s: float | None = None  # of a wave in time: the quantity is the time within a period
    direction: str | None = None  # in which a wave acts, of DIRECTIONS; None for the channel's component of the body


class _Drawn(NamedTuple):
    """Which functions a curve is drawn from, and over what."""

    own: Bools  # (K,) of all functions
    action: int
    quantity: str
    period_s: float | None = None
    direction: int | None = None  # in which all of them act, and in which they are told


def missing_laws(
    fit: Fit, take: Take, seen: Explained, channels: Sequence[str], named_change: Floats | None = None
) -> dict[str, MissingLaw]:
    """The missing law of each of the `channels` in which it can be drawn as a curve.

    `seen` is what free functions explain beside the `fit`; `named_change` (N, 3) the change of predicted poses by what
    has a name, None where nothing has.
    """
    all_drawn = {channel: _choose_functions(seen, channel) for channel in channels if channel in ACTION_OF}
    drawn = {channel: how for channel, how in all_drawn.items() if how is not None}
    if not drawn:
        return {}
    basis, sd = seen.basis, seen.basis.sd(seen.spread)
    at = gather_information(fit, take, basis, np.zeros(len(basis.size)))
    quadratic = at.weigh(seen.weights).quadratic
    c, covariance, c_named = quadratic.posterior_mean(sd), quadratic.posterior_covariance(sd), None
    if named_change is not None:
        would_be = at.with_residual(named_change / fit.scales.r).weigh(seen.weights).quadratic
        c_named = Quadratic(would_be.b, quadratic.G).posterior_mean(sd)
    laws = dict[str, MissingLaw]()
    for channel, how in drawn.items():
        x, mean = _mean_functions(at, basis.functions[how.own[: len(basis.functions)]], fit.car(), how)
        variance = np.einsum("nk,kl,nl->n", mean, covariance[np.ix_(how.own, how.own)], mean)
        named = None if c_named is None else mean @ c_named[how.own]
        if len(x) >= SUMMARY_LIMITS.min_curve_bins:
            sds = np.sqrt(np.maximum(variance, 0.0))
            direction = None if how.period_s is None else DIRECTIONS[how.direction or 0]
            laws[channel] = MissingLaw(how.quantity, x, mean @ c[how.own], sds, named, how.period_s, direction)
    return laws


def change_by_names(fit: Fit, named: Fit, take: Take) -> Floats | None:
    """The poses (N, 3) that the fit with names predicts less those of the `fit` without, each without its pushes.

    None where `named` is that fit itself, or where a prediction is not finite.
    """
    if named is fit:
        return None
    change = wrap_yaw(fit.residuals(take, fit.phi) - named.residuals(take, named.phi))
    return change if np.isfinite(change).all() else None


def _choose_functions(seen: Explained, channel: str) -> _Drawn | None:
    """Choose the functions from which the curve of a `channel` is drawn, and over what; None where no curve shows it.

    That is all of the channel's functions, over its main quantity; where a wave in time explains most, that wave alone.
    """
    quantity, basis = next(iter(seen.depends_on(channel)), ""), seen.basis
    if quantity not in INPUT_OF:
        return None
    functions = basis.functions
    own = [channel_of(name) == channel for name in basis.channel[: len(functions)]]
    every = np.array([*own, *[False] * len(basis.tracking)])
    main = int(np.argmax(np.where(every, seen.c * seen.quadratic.b, 0.0)))
    if quantity == "time" and basis.channel[main].endswith("~"):
        same = functions[:, [DIRECTION, *range(WAVE, COLUMNS)]] == functions[main, [DIRECTION, *range(WAVE, COLUMNS)]]
        wave = np.r_[same.all(axis=1), np.zeros(len(basis.tracking), dtype=bool)] & every
        period = 2.0 * np.pi / abs(float(functions[main, WAVE + INPUTS.index("t")]))
        return _Drawn(wave, ACTION_OF[channel], quantity, period, int(functions[main, DIRECTION]))
    # a motor's push is told along the driven wheels, however they are turned
    return _Drawn(every, ACTION_OF[channel], quantity, None, DRIVEN_ALONG if channel == "motor" else None)


def _mean_functions(at: TakeInformation, functions: Floats, car: Car, how: _Drawn) -> tuple[Floats, Floats]:
    """Means of the quantity (n,), and of what a unit of each function does (n, K), in n bins.

    The bins lie over what the drive covered, less 1 % at each end, or over one period.
    """
    q, period, action = at.along[:, :, INPUTS.index(INPUT_OF[how.quantity])].ravel(), how.period_s, how.action
    if how.direction is not None and how.direction not in (YAW, WHEEL_ANGLE):
        functions, action = functions.copy(), ACTION_OF["fx"]
        functions[:, DIRECTION] = BODY_X
    acted = acting_values(functions, at.along, car)[:, :, action].reshape(len(q), -1)
    q = q if period is None else q % period
    low, high = np.quantile(q, (0.01, 0.99)) if period is None else (0.0, period)
    inside = (q >= low) & (q <= high)
    place = _merged_bins(q[inside], low, high)
    total = np.zeros((place.max(initial=-1) + 1, 1 + acted.shape[1]))
    np.add.at(total, place, np.column_stack([q, acted])[inside])
    mean = total / np.bincount(place)[:, None]
    return mean[:, 0], mean[:, 1:]


def _merged_bins(q: Floats, low: float, high: float) -> Ints:
    """The bin of each value q (n,) from `low` to `high`: equally wide ones, joined with the next while too empty."""
    bins = SUMMARY_LIMITS.curve_bins
    place = np.clip(((q - low) / max(high - low, 1e-12) * bins).astype(int), 0, bins - 1)
    joined, now, held = np.empty(bins, dtype=np.int64), 0, 0
    for k, count in enumerate(np.bincount(place, minlength=bins).tolist()):
        joined[k], held = now, held + count
        if held >= SUMMARY_LIMITS.min_knots_per_bin:
            now, held = now + 1, 0
    if held or now:  # what is left over belongs to the last bin
        joined[joined == now] = max(now - 1, 0)
    return np.asarray(joined[place])
