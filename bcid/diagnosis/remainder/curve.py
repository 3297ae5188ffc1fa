"""The missing law before any hypothesis: what free functions explain in a channel, as a curve with a band.

The coefficients of the functions have the mean c = (G + T^-1)^-1 b and the covariance (G + T^-1)^-1 (`evidence`).  Over
the quantity on which a channel depends most, the curve is the mean of phi(s) . c over what the drive went through at
each value; its band is what the covariance leaves.

Names are drawn over it as the same functions would have shown them: with the change of predicted poses by the names in
the place of the residual, all else is the same.  What a refit of the base model takes up, and what the prior holds back,
is taken from both alike, so that a right name lies within the band.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bcid.aliases import Bools, Floats
from bcid.diagnosis.limits import SUMMARY_LIMITS
from bcid.diagnosis.remainder.evidence import Quadratic
from bcid.diagnosis.remainder.fit import Explained
from bcid.diagnosis.remainder.functions import QUANTITIES, RemainderBasis
from bcid.diagnosis.remainder.information import TakeInformation, gather_information
from bcid.effects.remainder import BODY_X, DIRECTION, DRIVEN_ALONG, INPUTS, WAVE
from bcid.likelihood.force_history import acting_values
from bcid.likelihood.nuisance import pose_residuals
from bcid.likelihood.predict import wrap_yaw
from bcid.likelihood.refit import Fit
from bcid.likelihood.take import Take
from bcid.physics.car import Car

ACTION_OF = {"fx": 0, "motor": 0, "fy": 1, "mz": 2, "steering": 3}
"""Of a_x, a_y, alpha_z and a turn of the wheel the one in which a channel's law is told.

A motor's law is told along the driven wheels: a_x would mix it with how far the wheel is turned.  Those of the tracking
have no curve."""

INPUT_OF = {written: name for name, written in reversed(QUANTITIES.items()) if written != "place"}
"""What a curve is drawn over, by the quantity's name in diagnosis.json.  A law of the place is a map, and no curve."""


class MissingLaw(NamedTuple):
    """What free functions show to be missing in one channel, in n bins of the quantity on which it depends most."""

    quantity: str  # by its name in diagnosis.json
    x: Floats  # (n,) mean of the quantity in each bin (SI)
    y: Floats  # (n,) mean of the law (m/s^2, rad/s^2 or rad)
    sd: Floats  # (n,) its standard deviation
    named: Floats | None  # (n,) what the names alone would have shown; None without names
    period_s: float | None = None  # where the law swings in time: the time within this period is the quantity


def missing_laws(
    fit: Fit, take: Take, seen: Explained, channels: Sequence[str], named_change: Floats | None = None
) -> dict[str, MissingLaw]:
    """The missing law of each of the `channels` in which it can be drawn as a curve.

    `seen` is what free functions explain beside the `fit`; `named_change` (N, 3) the change of predicted poses by what
    has a name, None where nothing has.
    """
    over = {channel: _main_quantity(seen, channel) for channel in channels if channel in ACTION_OF}
    drawn = {channel: quantity for channel, quantity in over.items() if quantity in INPUT_OF}
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
    for channel, quantity in drawn.items():
        own = _functions_on_body(basis, channel)
        period = _main_period(seen, own) if quantity == "time" else None
        x, mean = _mean_functions(at, basis.functions[own[: len(basis.functions)]], fit.car(), channel, quantity, period)
        variance = np.einsum("nk,kl,nl->n", mean, covariance[np.ix_(own, own)], mean)
        named = None if c_named is None else mean @ c_named[own]
        if len(x) >= SUMMARY_LIMITS.min_curve_bins:
            laws[channel] = MissingLaw(quantity, x, mean @ c[own], np.sqrt(np.maximum(variance, 0.0)), named, period)
    return laws


def change_by_names(fit: Fit, take: Take, names: Sequence[str]) -> Floats | None:
    """The change (N, 3) of the poses that a `fit` predicts by its effects `names`, from the same initial states.

    None where there are no names, or where predictions without them are not finite.
    """
    h = fit.hypothesis
    less, values = h.with_effects(*(e for e in h.effects if e not in names)), h.effect_values(fit.phi)
    phi = less.phi_of(fit.car(), [values[field] for field, _ in less.effect_parameters])
    without = pose_residuals(take, less.prediction_inputs(phi, take), fit.start)
    change = wrap_yaw(without - pose_residuals(take, h.prediction_inputs(fit.phi, take), fit.start))
    return change if len(names) and np.isfinite(change).all() else None


def _main_quantity(seen: Explained, channel: str) -> str:
    """The quantity on which what the functions of a `channel` explain depends most; empty if it depends on none."""
    return next(iter(seen.depends_on(channel)), "")


def _functions_on_body(basis: RemainderBasis, channel: str) -> Bools:
    """Which of all functions (K,) act on the body in a `channel`, its waves among them."""
    own = [name.removesuffix("~") == channel for name in basis.channel[: len(basis.functions)]]
    return np.array([*own, *[False] * len(basis.tracking)])


def _main_period(seen: Explained, own: Bools) -> float | None:
    """The period (s) of the function that explains most of those marked in `own` (K,), if it is a wave in time."""
    nats = np.where(own, seen.c * seen.quadratic.b, 0.0)
    k = int(np.argmax(nats))
    omega = abs(float(seen.basis.functions[k, WAVE + INPUTS.index("t")]))
    return 2.0 * np.pi / omega if seen.basis.channel[k].endswith("~") and omega > 0.0 else None


def _mean_functions(
    at: TakeInformation, functions: Floats, car: Car, channel: str, quantity: str, period: float | None
) -> tuple[Floats, Floats]:
    """Means of the quantity (n,), and of what a unit of each function does in a channel (n, K), in n bins.

    The bins are equally wide over what the drive covered, less 1 % at each end, or over one period; those with too few
    knots are left out.
    """
    q = at.along[:, :, INPUTS.index(INPUT_OF[quantity])].ravel()
    # a motor's push as it is along the driven wheels, however they are turned
    told = functions.copy()
    told[told[:, DIRECTION] == DRIVEN_ALONG, DIRECTION] = BODY_X
    acted = acting_values(told, at.along, car)[:, :, ACTION_OF[channel]].reshape(len(q), -1)
    q = q if period is None else q % period
    low, high = np.quantile(q, (0.01, 0.99)) if period is None else (0.0, period)
    bins = SUMMARY_LIMITS.curve_bins
    place = np.clip(((q - low) / max(high - low, 1e-12) * bins).astype(int), 0, bins - 1)
    inside = (q >= low) & (q <= high)
    count = np.bincount(place[inside], minlength=bins)
    total = np.zeros((bins, 1 + acted.shape[1]))
    np.add.at(total, place[inside], np.column_stack([q, acted])[inside])
    enough = count >= SUMMARY_LIMITS.min_knots_per_bin
    mean = total[enough] / count[enough, None]
    return mean[:, 0], mean[:, 1:]
