"""Figures of a trusted simulation that are others in the car of a take: needed where the published one does not hold.

A figure is told if a take needs it outside of what its trust gives for likely, and if the published one would make the
take less likely by more than chance reaches.
"""

from typing import NamedTuple

import numpy as np
from scipy.stats import t as student_t

from bcid.diagnosis.limits import JUDGE_LIMITS
from bcid.likelihood.hypothesis import DRAG
from bcid.likelihood.prior import TRUST_NU
from bcid.likelihood.refit import Fit
from bcid.models.newton_euler.parameters import constant_units


class ChangedFigure(NamedTuple):
    """A figure of the simulation that is another one in the take, in SI units."""

    symbol: str  # of the base model, or `effect__symbol`
    published: float
    needed: float
    se: float
    unit: str
    nats: float  # by which the published figure, all others free, makes the take less likely


def find_other_figures(fit: Fit, gate: float) -> tuple[ChangedFigure, ...]:
    """The figures of the simulation of a `fit` that are others in its take, the most certain first.

    A figure is another if the simulation's trust says with `figure_p_value` that it lies as far off, and if the take
    tells so by more than the `gate` (nats).  These follow from the fit's curvature: half the square of the standard
    errors between the two figures.  A figure at a bound of what any car has is none that a take needs: something else
    is missing there.  Empty without a trusted simulation.
    """
    hypothesis, trusted = fit.hypothesis, fit.hypothesis.trusted_simulation
    if trusted is None:
        return ()
    n, found = len(trusted.phi), list[ChangedFigure]()
    off = hypothesis.prior(fit.phi).deviations(fit.phi)[:n]
    var = np.maximum(np.diag(fit.covariance)[:n], 0.0)
    far = student_t.isf(0.5 * JUDGE_LIMITS.figure_p_value, TRUST_NU)
    published = hypothesis.with_effects()
    centre = np.array(trusted.phi)
    car, there = published.car(centre), fit.car()
    units = constant_units(there)
    values = published.effect_values(centre), hypothesis.effect_values(fit.phi)
    for j in np.flatnonzero((np.abs(off) > far) & ~hypothesis.is_at_bound(fit.phi)[:n]):
        nats = 0.5 * float((fit.phi[j] - centre[j]) ** 2 / var[j]) if var[j] > 0.0 else 0.0
        if not nats > gate:
            continue
        if j < published.base_size:
            symbol = (*published.log_parameters, *DRAG)[j]
            pair = getattr(car, symbol), getattr(there, symbol)
            logs = len(published.log_parameters)
            scale = pair[1] if j < logs else published.drag_units[j - logs]
            unit = units[symbol]
        else:
            symbol, parameter = published.effect_parameters[j - published.base_size]
            pair, unit = (values[0][symbol], values[1][symbol]), parameter.unit
            scale = published.effect_units()[j - published.base_size]
        found.append(ChangedFigure(symbol, *pair, float(abs(scale) * np.sqrt(var[j])), unit, nats))
    return tuple(sorted(found, key=lambda f: -f.nats))
